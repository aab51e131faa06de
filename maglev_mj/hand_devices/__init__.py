"""A gamepad or a 3D mouse as the hand: it moves the pose to which the hand's spring pulls, on six axes."""

from maglev_mj.hand_devices.device import HAND_MAPPING, HandDevice, InputDevice, Reading
from maglev_mj.hand_devices.find import AUTO, described_devices, open_device
from maglev_mj.hand_devices.gamepad import Gamepad
from maglev_mj.hand_devices.mouse import SpacenavMouse

__all__ = [
    "AUTO",
    "HAND_MAPPING",
    "Gamepad",
    "HandDevice",
    "InputDevice",
    "Reading",
    "SpacenavMouse",
    "described_devices",
    "open_device",
]

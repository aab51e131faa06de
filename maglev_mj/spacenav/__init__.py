"""The joystick as a 3D mouse: six axes to any program that speaks spacenav's protocol, on a Unix socket."""

from maglev_mj.spacenav.axes import FULL, PoseAxes, RateAxes
from maglev_mj.spacenav.buttons import Taps
from maglev_mj.spacenav.mapping import AxisMapping
from maglev_mj.spacenav.place import default_path
from maglev_mj.spacenav.server import SpacenavServer

__all__ = ["FULL", "AxisMapping", "PoseAxes", "RateAxes", "SpacenavServer", "Taps", "default_path"]

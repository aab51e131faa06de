"""The joystick as a 3D mouse over spacenav's protocol.

Six axes for any program, on a Unix socket.
"""

from maglev_mj.spacenav.axes import FULL, PoseAxes, RateAxes
from maglev_mj.spacenav.buttons import Taps
from maglev_mj.spacenav.mapping import AxisMapping, SpacenavMapping
from maglev_mj.spacenav.place import default_path, searched_paths
from maglev_mj.spacenav.server import SpacenavServer

__all__ = [
    "FULL",
    "AxisMapping",
    "PoseAxes",
    "RateAxes",
    "SpacenavMapping",
    "SpacenavServer",
    "Taps",
    "default_path",
    "searched_paths",
]

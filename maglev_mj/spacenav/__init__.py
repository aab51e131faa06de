"""The joystick as a 3D mouse: six axes to any program that speaks spacenav's protocol, on a Unix socket."""

from maglev_mj.spacenav.axes import FULL, PoseAxes, RateAxes
from maglev_mj.spacenav.place import default_path
from maglev_mj.spacenav.server import SpacenavServer

__all__ = ["FULL", "PoseAxes", "RateAxes", "SpacenavServer", "default_path"]

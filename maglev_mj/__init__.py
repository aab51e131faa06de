"""A 6-DOF magnetically levitated joystick, simulated, and the sampled laws that render walls and friction on it."""

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Command, Sample
from maglev_mj.laws import Hold, Wall
from maglev_mj.loop import run
from maglev_mj.plants import ExactPlant, MuJoCoPlant, Timing

__all__ = ["AXES", "Command", "Controller", "ExactPlant", "Hold", "MuJoCoPlant", "Sample", "Timing", "Wall", "run"]

__version__ = "0.1.0"

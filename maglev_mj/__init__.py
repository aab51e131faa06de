"""A 6-DOF magnetically levitated joystick, simulated, and the sampled laws that render walls and friction on it."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.bridge.remote import RemotePlant as RemotePlant
    from maglev_mj.controller import Controller as Controller
    from maglev_mj.errors import DivergenceError as DivergenceError
    from maglev_mj.errors import MaglevError as MaglevError
    from maglev_mj.errors import ParameterError as ParameterError
    from maglev_mj.errors import PlantError as PlantError
    from maglev_mj.frames import AXES as AXES
    from maglev_mj.frames import Command as Command
    from maglev_mj.frames import Sample as Sample
    from maglev_mj.laws import AxisLaw as AxisLaw
    from maglev_mj.laws import Bias as Bias
    from maglev_mj.laws import Hold as Hold
    from maglev_mj.laws import Law as Law
    from maglev_mj.laws import StickSlip as StickSlip
    from maglev_mj.laws import Wall as Wall
    from maglev_mj.laws import gain as gain
    from maglev_mj.loop import drive as drive
    from maglev_mj.parameters import param as param
    from maglev_mj.plants import ExactPlant as ExactPlant
    from maglev_mj.plants import MuJoCoPlant as MuJoCoPlant
    from maglev_mj.plants import Sensor as Sensor
    from maglev_mj.plants import Timing as Timing
    from maglev_mj.recording import Recording as Recording
    from maglev_mj.scenes.figures import Figure as Figure
    from maglev_mj.scenes.figures import figure as figure
    from maglev_mj.scenes.find import find_scene as find_scene
    from maglev_mj.scenes.run import Phases as Phases
    from maglev_mj.scenes.run import Result as Result
    from maglev_mj.scenes.run import run as run
    from maglev_mj.scenes.run import run_phases as run_phases
    from maglev_mj.scenes.scene import Scene as Scene
    from maglev_mj.scenes.scene import Start as Start
    from maglev_mj.studies.sweep import sweep as sweep
    from maglev_mj.theory.linearise import linearise as linearise
    from maglev_mj.theory.verdict import stability as stability
else:
    _HOMES = {
        "bridge.remote": "RemotePlant",
        "controller": "Controller",
        "errors": "DivergenceError MaglevError ParameterError PlantError",
        "frames": "AXES Command Sample",
        "laws": "AxisLaw Bias Hold Law StickSlip Wall gain",
        "loop": "drive",
        "parameters": "param",
        "plants": "ExactPlant MuJoCoPlant Sensor Timing",
        "recording": "Recording",
        "scenes.figures": "Figure figure",
        "scenes.find": "find_scene",
        "scenes.run": "Phases Result run run_phases",
        "scenes.scene": "Scene Start",
        "studies.sweep": "sweep",
        "theory": "linearise stability",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)

__version__ = "0.1.0"

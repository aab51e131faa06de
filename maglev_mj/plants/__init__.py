"""Plants: what a controller can be put in front of, behind one contract."""

from maglev_mj.plants.base import Plant, PlantKeywords, SampledPlant
from maglev_mj.plants.batch import MuJoCoBatchPlant
from maglev_mj.plants.engine import INTEGRATORS, engine_warnings_silenced, one_step
from maglev_mj.plants.exact import ExactPlant
from maglev_mj.plants.mujoco import MuJoCoPlant
from maglev_mj.plants.sensor import PoseSensor, Sensor, SpotReader, SpotSensor
from maglev_mj.timeline import Timing

__all__ = [
    "INTEGRATORS",
    "ExactPlant",
    "MuJoCoBatchPlant",
    "MuJoCoPlant",
    "Plant",
    "PlantKeywords",
    "PoseSensor",
    "SampledPlant",
    "Sensor",
    "SpotReader",
    "SpotSensor",
    "Timing",
    "engine_warnings_silenced",
    "one_step",
]

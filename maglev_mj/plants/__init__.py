"""Plants: what a controller can be put in front of, behind one contract."""

from maglev_mj.plants.base import PlantKeywords, SampledPlant
from maglev_mj.plants.batch import MuJoCoBatchPlant
from maglev_mj.plants.coil_driven import CoilDrivenPlant
from maglev_mj.plants.contract import Plant
from maglev_mj.plants.corrected import CorrectedBatchPlant, CorrectedPlant
from maglev_mj.plants.engine import INTEGRATORS, engine_warnings_silenced
from maglev_mj.plants.exact import ExactPlant
from maglev_mj.plants.metered import MeteredPlant
from maglev_mj.plants.mujoco import MuJoCoPlant
from maglev_mj.plants.sensor import PoseSensor, Sensor, SpotReader, SpotSensor
from maglev_mj.plants.steps import one_step
from maglev_mj.timeline import Timing

__all__ = [
    "INTEGRATORS",
    "CoilDrivenPlant",
    "CorrectedBatchPlant",
    "CorrectedPlant",
    "ExactPlant",
    "MeteredPlant",
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

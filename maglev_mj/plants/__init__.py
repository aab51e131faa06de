"""Plants: what a controller can be put in front of, behind one contract."""

from maglev_mj.plants.base import SampledPlant
from maglev_mj.plants.contract import Plant, Timing
from maglev_mj.plants.exact import ExactPlant
from maglev_mj.plants.mujoco import MuJoCoPlant, engine_warnings_silenced

__all__ = ["ExactPlant", "MuJoCoPlant", "Plant", "SampledPlant", "Timing", "engine_warnings_silenced"]

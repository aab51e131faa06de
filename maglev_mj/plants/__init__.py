"""Plants: what a controller can be put in front of, behind one contract."""

from maglev_mj.plants.base import Plant, SampledPlant, Timing
from maglev_mj.plants.exact import ExactPlant
from maglev_mj.plants.mujoco import MuJoCoPlant

__all__ = ["ExactPlant", "MuJoCoPlant", "Plant", "SampledPlant", "Timing"]

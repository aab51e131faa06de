"""Plants behind one interface, simulated or real."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.plants.base import Plant as Plant
    from maglev_mj.plants.base import SampledPlant as SampledPlant
    from maglev_mj.plants.batch import MuJoCoBatchPlant as MuJoCoBatchPlant
    from maglev_mj.plants.engine import INTEGRATORS as INTEGRATORS
    from maglev_mj.plants.engine import engine_warnings_silenced as engine_warnings_silenced
    from maglev_mj.plants.engine import one_step as one_step
    from maglev_mj.plants.exact import ExactPlant as ExactPlant
    from maglev_mj.plants.mujoco import MuJoCoPlant as MuJoCoPlant
    from maglev_mj.plants.sensor import PoseSensor as PoseSensor
    from maglev_mj.plants.sensor import Sensor as Sensor
    from maglev_mj.plants.sensor import SpotReader as SpotReader
    from maglev_mj.plants.sensor import SpotSensor as SpotSensor
    from maglev_mj.timeline import Timing as Timing
else:
    _HOMES = {
        "base": "Plant SampledPlant",
        "batch": "MuJoCoBatchPlant",
        "engine": "INTEGRATORS engine_warnings_silenced one_step",
        "exact": "ExactPlant",
        "mujoco": "MuJoCoPlant",
        "sensor": "PoseSensor Sensor SpotReader SpotSensor",
        ".timeline": "Timing",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)

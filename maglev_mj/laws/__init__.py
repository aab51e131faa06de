"""Control laws as pure functions with frozen parameters.

A law takes a state and returns the next one; the same code serves one device and N devices.

A law acts on some of the six axes. The controller hands it the position and velocity components of all six,
and each law adds its force to the same wrench.
"""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.laws.base import AxisLaw as AxisLaw
    from maglev_mj.laws.base import Gains as Gains
    from maglev_mj.laws.base import Law as Law
    from maglev_mj.laws.base import LinearController as LinearController
    from maglev_mj.laws.base import VelocityEstimator as VelocityEstimator
    from maglev_mj.laws.base import gain as gain
    from maglev_mj.laws.bristle import Dahl as Dahl
    from maglev_mj.laws.bristle import ElastoPlastic as ElastoPlastic
    from maglev_mj.laws.bristle import HaywardArmstrong as HaywardArmstrong
    from maglev_mj.laws.bristle import LuGre as LuGre
    from maglev_mj.laws.checking import check_law as check_law
    from maglev_mj.laws.friction import Friction as Friction
    from maglev_mj.laws.friction import FrictionState as FrictionState
    from maglev_mj.laws.friction import ImplicitCoulomb as ImplicitCoulomb
    from maglev_mj.laws.friction import SpringReset as SpringReset
    from maglev_mj.laws.friction import StickSlip as StickSlip
    from maglev_mj.laws.hold import Bias as Bias
    from maglev_mj.laws.hold import Hold as Hold
    from maglev_mj.laws.passivity import PassivityController as PassivityController
    from maglev_mj.laws.prediction import ObserverWall as ObserverWall
    from maglev_mj.laws.prediction import PredictiveWall as PredictiveWall
    from maglev_mj.laws.velocity import AdaptiveWindow as AdaptiveWindow
    from maglev_mj.laws.velocity import FiniteDifference as FiniteDifference
    from maglev_mj.laws.velocity import LowPass as LowPass
    from maglev_mj.laws.velocity import Window as Window
    from maglev_mj.laws.wall import Wall as Wall
else:
    _HOMES = {
        "base": "AxisLaw Gains Law LinearController VelocityEstimator gain",
        "bristle": "Dahl ElastoPlastic HaywardArmstrong LuGre",
        "checking": "check_law",
        "friction": "Friction FrictionState ImplicitCoulomb SpringReset StickSlip",
        "hold": "Bias Hold",
        "passivity": "PassivityController",
        "prediction": "ObserverWall PredictiveWall",
        "velocity": "AdaptiveWindow FiniteDifference LowPass Window",
        "wall": "Wall",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)

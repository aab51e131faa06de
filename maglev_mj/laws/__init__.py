"""Pure laws: frozen parameters, state in and state out, written once for one device and for N.

A law acts on some of the six axes. The controller hands it the position and velocity components of all six,
and each law adds its force to the same wrench.
"""

from __future__ import annotations

from maglev_mj.laws.base import AxisLaw, Gains, Law, LinearController, VelocityEstimator, gain
from maglev_mj.laws.bias import Bias
from maglev_mj.laws.bristle import Dahl, ElastoPlastic, HaywardArmstrong, LuGre
from maglev_mj.laws.checking import check
from maglev_mj.laws.friction import Friction, FrictionState, ImplicitCoulomb, SpringReset, StickSlip
from maglev_mj.laws.hold import Hold
from maglev_mj.laws.passivity import PassivityController
from maglev_mj.laws.prediction import ObserverWall, PredictiveWall
from maglev_mj.laws.velocity import AdaptiveWindow, FiniteDifference, LowPass, Window
from maglev_mj.laws.wall import Wall

__all__ = [
    "AdaptiveWindow",
    "AxisLaw",
    "Bias",
    "Dahl",
    "ElastoPlastic",
    "FiniteDifference",
    "Friction",
    "FrictionState",
    "Gains",
    "HaywardArmstrong",
    "Hold",
    "ImplicitCoulomb",
    "Law",
    "LinearController",
    "LowPass",
    "LuGre",
    "ObserverWall",
    "PassivityController",
    "PredictiveWall",
    "SpringReset",
    "StickSlip",
    "VelocityEstimator",
    "Wall",
    "Window",
    "check",
    "gain",
]

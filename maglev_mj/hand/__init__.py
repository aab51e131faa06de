"""Hand on the flotor: impedance, forces, and published values."""

from maglev_mj.hand.forces import GuidedHand, HandForce, RecordedHand, SpringHand, Trajectory
from maglev_mj.hand.impedance import HANDS, Hand, get_hand, motion, transition

__all__ = [
    "HANDS",
    "GuidedHand",
    "Hand",
    "HandForce",
    "RecordedHand",
    "SpringHand",
    "Trajectory",
    "get_hand",
    "motion",
    "transition",
]

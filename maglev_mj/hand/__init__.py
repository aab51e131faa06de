"""The hand that holds the flotor: its impedance, the forces that it exerts, and what was published of both."""

from maglev_mj.hand.forces import GuidedHand, HandForce, RecordedHand, SpringHand, Trajectory
from maglev_mj.hand.impedance import HANDS, Hand, exponential, hand_called, motion, transition

__all__ = [
    "HANDS",
    "GuidedHand",
    "Hand",
    "HandForce",
    "RecordedHand",
    "SpringHand",
    "Trajectory",
    "exponential",
    "hand_called",
    "motion",
    "transition",
]

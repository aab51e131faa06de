"""The hand that holds the flotor: its impedance, the forces that it exerts, and what was published of both."""

from maglev_mj.hand.forces import ConstantForce, GuidedHand, HandForce, Path, RecordedHand, SpringHand
from maglev_mj.hand.impedance import Hand, exponential, motion, transition
from maglev_mj.hand.published import HANDS, PUBLISHED_RANGE, hand_called

__all__ = [
    "HANDS",
    "PUBLISHED_RANGE",
    "ConstantForce",
    "GuidedHand",
    "Hand",
    "HandForce",
    "Path",
    "RecordedHand",
    "SpringHand",
    "exponential",
    "hand_called",
    "motion",
    "transition",
]

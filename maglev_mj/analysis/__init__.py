"""What recordings tell: walls, energy, friction, and how far they are from the simulation of the same parameters."""

from maglev_mj.analysis.analysed import Analysed, Run, analyse
from maglev_mj.analysis.comparison import Comparison, compare, simulate
from maglev_mj.analysis.contacts import HARDNESS_WINDOW, Contact, FaceFigures, face_figures
from maglev_mj.analysis.figures import Energy, Stick, StretchFigures, stretch_figures
from maglev_mj.analysis.motion import Motion, reconstruct

__all__ = [
    "HARDNESS_WINDOW",
    "Analysed",
    "Comparison",
    "Contact",
    "Energy",
    "FaceFigures",
    "Motion",
    "Run",
    "Stick",
    "StretchFigures",
    "analyse",
    "compare",
    "face_figures",
    "reconstruct",
    "simulate",
    "stretch_figures",
]

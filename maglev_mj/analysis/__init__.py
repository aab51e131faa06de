"""Analysis of recordings: walls, energy, friction, comparison with simulation."""

from maglev_mj.analysis.analysed import Analysed, Run, analyse
from maglev_mj.analysis.comparison import Comparison
from maglev_mj.analysis.contacts import FaceFigures, face_figures
from maglev_mj.analysis.estimates import Estimate, Identification
from maglev_mj.analysis.figures import StretchFigures
from maglev_mj.analysis.identification import identify
from maglev_mj.analysis.motion import reconstruct

__all__ = [
    "Analysed",
    "Comparison",
    "Estimate",
    "FaceFigures",
    "Identification",
    "Run",
    "StretchFigures",
    "analyse",
    "face_figures",
    "identify",
    "reconstruct",
]

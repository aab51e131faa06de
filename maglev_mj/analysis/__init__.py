"""Analysis of recordings: walls, energy, friction, comparison with simulation."""

from maglev_mj.analysis.contacts import FaceFigures, StretchFigures, face_figures
from maglev_mj.analysis.fit import Estimate
from maglev_mj.analysis.identification import Identification, identify
from maglev_mj.analysis.motion import reconstruct
from maglev_mj.analysis.report import Comparison, Run, StretchReport, analyse

__all__ = [
    "Comparison",
    "Estimate",
    "FaceFigures",
    "Identification",
    "Run",
    "StretchFigures",
    "StretchReport",
    "analyse",
    "face_figures",
    "identify",
    "reconstruct",
]

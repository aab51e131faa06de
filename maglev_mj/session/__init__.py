"""A scene in real time, without a window: pacing, what keys change, recording, and what there is to see."""

from maglev_mj.session.admission import Refusal, refusal
from maglev_mj.session.outlet import Moment, Outlet, Outlets
from maglev_mj.session.pacing import Pacer
from maglev_mj.session.session import ACTIONS, Session
from maglev_mj.session.view import Showable, View, stick_positions, wall_faces

__all__ = [
    "ACTIONS",
    "Moment",
    "Outlet",
    "Outlets",
    "Pacer",
    "Refusal",
    "Session",
    "Showable",
    "View",
    "refusal",
    "stick_positions",
    "wall_faces",
]

"""Figures of a stretch: walls, energy, friction, missing samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.analysis.contacts import FaceFigures, face_figures
from maglev_mj.analysis.motion import Motion
from maglev_mj.energy import actuator_work, hand_work
from maglev_mj.frames import AXES, Array
from maglev_mj.recording import RunMetadata
from maglev_mj.result import plain


class Energy(NamedTuple):
    """Energy balance of each axis [J], (6,) each.

    Attributes:
        taken: Energy absorbed by the rendered environment; below 0 it has generated energy.
        least: Least absorbed energy at any switch of the force; the further below 0, the less passive.
        hand: Work of the hand; NaN if its force was not recorded.
        others: Work of unrecorded forces: of an unmeasured hand, or from a wrong mass.
    """

    taken: Array
    least: Array
    hand: Array
    others: Array


class Stick(NamedTuple):
    """One sticking phase of an axis.

    Attributes:
        start: Time of the first stuck sample [s].
        duration: Time until the first sliding sample, or the last of all [s].
        position: Final anchor of the friction spring [m, rad].
        slipped: True if it broke away; otherwise it stuck until the end.
    """

    start: float
    duration: float
    position: float
    slipped: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class StretchFigures:
    """Figures of a stretch.

    Attributes:
        samples: Number of samples.
        missed: Number of missing samples, by the gaps in their numbers.
        start: Time of the first sample [s].
        end: Time of the last sample [s].
        travel: Distance between the extremes of each axis [m, rad], (6,).
        peak_force: Largest wrench of the actuators on each axis [N, N m], (6,).
        faces: Touched walls.
        untouched: Number of untouched walls.
        energy: Energy balance.
        unexplained: Root mean square of the wrench of unrecorded forces [N, N m], (6,).
        sticks: Sticking phases of each axis, in order; None for an axis without friction.
    """

    samples: int
    missed: int
    start: float
    end: float
    travel: Array
    peak_force: Array
    faces: Sequence[FaceFigures]
    untouched: int
    energy: Energy
    unexplained: Array
    sticks: Sequence[Sequence[Stick] | None]

    @property
    def contacts(self) -> int:
        """Number of contacts with all walls."""
        return sum(len(face.contacts) for face in self.faces)

    def slips(self, axis: int) -> int:
        """Return the number of breakaways of an axis."""
        return sum(stick.slipped for stick in self.sticks[axis] or ())

    def transitions(self, axis: int) -> int:
        """Return the number of stick and slip transitions.

        They are those of one axis.
        """
        return self.slips(axis) + sum(stick.start > self.start for stick in self.sticks[axis] or ())

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        by_axis = {"travel": self.travel, "peak_force": self.peak_force, "unexplained_force": self.unexplained}
        energy = {name: dict(zip(AXES, map(plain, values.tolist()))) for name, values in self.energy._asdict().items()}
        return {
            "samples": self.samples,
            "missed": self.missed,
            "start": self.start,
            "end": self.end,
            **{name: dict(zip(AXES, map(plain, values.tolist()))) for name, values in by_axis.items()},
            "faces": [face.as_json() for face in self.faces],
            "energy": energy,
            "friction": {
                AXES[axis]: {
                    "slips": self.slips(axis),
                    "transitions": self.transitions(axis),
                    "sticks": [stick._asdict() for stick in sticks],
                }
                for axis, sticks in enumerate(self.sticks)
                if sticks is not None
            },
        }


def stretch_figures(
    motion: Motion, metadata: RunMetadata, ticks: Array, hand: Array, anchors: Array | None, rest: float | None = None
) -> StretchFigures:
    """Return the figures of a stretch of N samples.

    Args:
        motion: The motion through them.
        metadata: Metadata of the stretch.
        ticks: Numbers of the samples, (N,).
        hand: Wrench of the hand from each sample on [N, N m], (N, 6).
        anchors: Stick positions at each sample [m, rad], (N, 6), NaN while sliding; None without friction.
        rest: Rest position at a wall [m, rad]; found from the samples by default.
    """
    trace = motion.trace
    faces = [found for face in metadata.faces if (found := face_figures(trace, face, rest=rest)) is not None]
    return StretchFigures(
        samples=len(ticks),
        missed=round(float(ticks[-1] - ticks[0])) + 1 - len(ticks),
        start=float(motion.time[0]),
        end=float(motion.time[-1]),
        travel=np.ptp(trace.pose, axis=0),
        peak_force=np.abs(trace.wrench[:-1]).max(axis=0),
        faces=faces,
        untouched=len(metadata.faces) - len(faces),
        energy=_energy(motion, metadata, hand),
        unexplained=np.sqrt((motion.unexplained**2).mean(axis=0)),
        sticks=[None] * len(AXES) if anchors is None else [_sticks(motion.time, line) for line in anchors.T],
    )


def _energy(motion: Motion, metadata: RunMetadata, hand: Array) -> Energy:
    """Return the energy balance of each axis.

    Each force is paired with the displacement during its action.
    """
    taken = -np.vstack([np.zeros(len(AXES)), np.cumsum(actuator_work(motion.trace, metadata.carried), axis=0)])
    places = motion.trace.pose[motion.starts]
    work = hand_work(places, hand).sum(axis=0) if metadata.hand_recorded else np.full(len(AXES), np.nan)
    return Energy(taken[-1], taken.min(axis=0), work, (motion.unexplained * np.diff(places, axis=0)).sum(axis=0))


def _sticks(time: Array, anchors: Array) -> list[Stick] | None:
    """Return the sticking phases of an axis.

    None if it never stuck.
    """
    stuck = np.isfinite(anchors)
    if not stuck.any():
        return None
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stuck, [False]]).astype(np.int8)))
    final = len(time) - 1
    return [
        Stick(
            float(time[first]),
            float(time[min(last, final)] - time[first]),
            float(anchors[last - 1]),
            bool(last <= final),
        )
        for first, last in edges.reshape(-1, 2)
    ]

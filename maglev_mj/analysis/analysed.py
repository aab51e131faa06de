"""Complete analysis of a stretch of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from maglev_mj.analysis.comparison import Comparison, compare, simulate
from maglev_mj.analysis.estimates import Estimate, Identification
from maglev_mj.analysis.figures import StretchFigures, stretch_figures
from maglev_mj.analysis.identification import identify
from maglev_mj.analysis.motion import Motion, reconstruct
from maglev_mj.errors import ParameterError, check_instance
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import flag, number
from maglev_mj.recording import InvalidRecordingError, Rebuild, RunMetadata, Stretch
from maglev_mj.recording.recording import READ_STRETCH
from maglev_mj.result import Result, Table
from maglev_mj.scenes import Scene

_STILL = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One side of a comparison: recording or simulation.

    It covers the requested time.

    Attributes:
        motion: Motion of the flotor.
        figures: Figures of the motion.
        anchors: Stick positions at each sample [m, rad], (N, 6); None without friction, or for a simulation.
    """

    motion: Motion
    figures: StretchFigures
    anchors: Array | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Analysed(Result):
    """Results of a stretch's analysis.

    Attributes:
        kind: Kind of its setup.
        metadata: Metadata of the run.
        recorded: Motion and figures of the samples.
        simulated: Motion and figures of the simulation; None if none was requested, or it failed at once.
        comparison: Distance between both; None if none was requested.
        identified: Identified walls, friction, mass, delay and sensor.
    """

    kind: str
    metadata: RunMetadata
    recorded: Run
    simulated: Run | None
    comparison: Comparison | None
    identified: Identification
    drawn_by: ClassVar = "maglev_mj.analysis.pictures:analysed"

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return time, recorded and simulated positions, (N,) each.

        A simulation that ended early goes on with NaN.
        """
        sides = {"recorded": self.recorded, "simulated": self.simulated}
        time = self.recorded.motion.time
        found = {"time": time}
        for name, run in sides.items():
            if run is not None:
                poses = np.full((len(time), len(AXES)), np.nan)
                poses[: len(run.motion.starts)] = run.motion.trace.pose[run.motion.starts]
                found |= {f"{name}.{axis}": poses[:, index] for index, axis in enumerate(AXES)}
        return found

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        sides = "recorded", "simulated"
        return {"time": "s"} | {f"{side}.{axis}": "m" if axis in AXES[:3] else "rad" for side in sides for axis in AXES}

    def table(self) -> Table:
        """Return the identified quantities with their 95 % intervals."""
        found = self.identified
        parts: dict[str, Any] = {AXES[axis]: one for axis, one in found.axes.items()}
        parts |= {f"wall {one.name}": one for one in found.walls}
        parts |= {f"friction {AXES[axis]}": one for axis, one in found.friction.items()}
        estimates = [
            (where, name.replace("_", " "), one)
            for where, part in parts.items()
            for name, one in vars(part).items()
            if isinstance(one, Estimate)
        ]
        rows = [(where, name, one.value, one.low, one.high) for where, name, one in estimates if one.known]
        title = "" if self.comparison is None else f"; {self.comparison.sentence}"
        return Table(
            f"{self.metadata.name}, {self.recorded.figures.samples} samples{title}",
            ("of", "quantity (SI units)", "value", "from", "to (95 %)"),
            rows,
            f"{len(estimates) - len(rows)} quantities cannot be told; `identified` says why",
        )

    def axis(self, name: str | None = None) -> int:
        """Return the index of the axis to draw.

        It is that named, or the most significant one.

        This is the scene's own axis if a wall on it was touched, else the first axis with a touched wall, else the axis
        with the largest travel, of the translations unless only rotations moved.

        Raises:
            ParameterError: If the named axis does not move.
        """
        figures = self.recorded.figures
        if name is not None:
            moving = [AXES[index] for index in np.flatnonzero(figures.travel > _STILL)]
            if name not in moving:
                allowed = f"one that moves, of {', '.join(moving)}" if moving else "left out, for none moves"
                raise ParameterError(f"axis must be {allowed}, not {name!r}")
            return AXES.index(name)
        touched = [face.axis for face in figures.faces]
        if touched:
            shown = AXES.index(self.metadata.axis)
            return shown if shown in touched else touched[0]
        turned = not (figures.travel[:3] > _STILL).any()
        return int(np.argmax(figures.travel[3:])) + 3 if turned else int(np.argmax(figures.travel[:3]))

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        known = {name: getattr(self.metadata, name) for name in ("name", "period", "delay")}
        data: dict[str, Any] = {"kind": self.kind, **known}
        data["recorded"] = self.recorded.figures.as_json()
        data["simulated"] = None if self.simulated is None else self.simulated.figures.as_json()
        data["comparison"] = None if self.comparison is None else self.comparison.as_json()
        data["identified"] = self.identified.as_json()
        return data


def analyse(
    stretch: Stretch,
    rebuild: Rebuild | None = None,
    *,
    anchors: Array | None = None,
    begin: float = 0.0,
    end: float | None = None,
    simulated: bool = True,
    rest: float | None = None,
    scene: type[Scene] | None = None,
) -> Analysed:
    """Analyse a stretch of at least two samples.

    Args:
        stretch: The stretch.
        rebuild: Function from a setup and a hand to plant and controller; None if there is none: then nothing is
            simulated.
        anchors: Stick positions at each sample [m, rad], (N, 6); None without friction.
        begin: Start of the analysis, in the stretch's time [s].
        end: End of the analysis [s]; None for the stretch's end.
        simulated: True to run the simulation of the same parameters and compare.
        rest: Rest position at a wall [m, rad]; found from the samples by default.
        scene: Scene class of a user's own recording.

    Raises:
        InvalidRecordingError: If it has less than two samples.
        ParameterError: If there are less than two samples from `begin` to `end`.

    Example:
        >>> from maglev_mj import analyse, find_scene, rebuild, record_run
        >>> found = analyse(record_run(find_scene("drop")(), plant="exact").stretches[0], rebuild)
        >>> wall = found.identified.walls[0]
        >>> round(float(wall.stiffness.value)), round(float(wall.damping.value))
        (6000, 80)
    """
    flag("simulated", simulated)
    check_instance("stretch", stretch, Stretch, READ_STRETCH)
    metadata = stretch.metadata
    if len(stretch.tick) < 2:
        raise InvalidRecordingError(f"a stretch must have at least 2 samples to be analysed, not {len(stretch.tick)}")
    whole = reconstruct(stretch, metadata)
    first, last = _rows(whole, begin, end)
    comparison = other = None
    if simulated and rebuild is not None:
        twin = simulate(stretch, whole, metadata, rebuild, scene)
        comparison = compare(stretch[first : last + 1], twin[first : last + 1], whole.between(first, last))
        until = min(last, len(twin.tick) - 1)
        if until - first >= 1:
            other = _run(twin, reconstruct(twin, metadata), metadata, None, (first, until), rest)
    run = _run(stretch, whole, metadata, anchors, (first, last), rest)
    return Analysed(
        kind=stretch.setup["kind"],
        metadata=metadata,
        recorded=run,
        simulated=other,
        comparison=comparison,
        identified=identify(stretch[first : last + 1], metadata, anchors=run.anchors),
    )


def _rows(motion: Motion, begin: float, end: float | None) -> tuple[int, int]:
    """Return the first and last sample of an interval."""
    time = motion.time
    number("from", begin, at_least=0.0, below=float(time[-1]))
    final = float(time[-1]) if end is None else number("to", end, above=begin)
    inside = np.flatnonzero((time >= begin - _STILL) & (time <= final + _STILL))
    if len(inside) < 2:
        raise ParameterError(f"from and to must have at least 2 samples between them, not {begin:g} and {final:g}")
    return int(inside[0]), int(inside[-1])


def _run(
    stretch: Stretch,
    whole: Motion,
    metadata: RunMetadata,
    anchors: Array | None,
    rows: tuple[int, int],
    rest: float | None,
) -> Run:
    first, last = rows
    chosen = slice(first, last + 1)
    motion, stuck = whole.between(first, last), None if anchors is None else anchors[chosen]
    figures = stretch_figures(motion, metadata, stretch.tick[chosen], stretch.hand[chosen], stuck, rest)
    return Run(motion=motion, figures=figures, anchors=stuck)

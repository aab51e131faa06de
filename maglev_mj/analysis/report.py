"""Report on a segment of a recording: its figures, its simulation's, and what it identifies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from maglev_mj.analysis.identification import Identification, identify
from maglev_mj.analysis.motion import Motion, SegmentFigures, axis_row, by_axis, reconstruct, segment_figures
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import MaglevError, ParameterError, check_instance
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.keywords import checked
from maglev_mj.parameters import flag, number
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import RecordedHand
from maglev_mj.recording import Rebuild, Recorder, RunMetadata, Segment
from maglev_mj.recording.recording import SEGMENT_TYPE
from maglev_mj.recording.setup import MEASURED, UNCONTROLLED, scripted
from maglev_mj.result import Result, Table, capitalised, conditions_text, number_text, plain
from maglev_mj.scenes import Scene
from maglev_mj.scenes.find import recorded_scene
from maglev_mj.scenes.stability_check import wall_loops
from maglev_mj.session import live_plant
from maglev_mj.theory import Verdict, judge

_STILL = 1e-9
_NOTHING = 1e-12
_UNMEASURED_HAND = "the hand on the device is not measured: judge the model by the one-step prediction"


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """Deviation of a simulation from its recording.

    Attributes:
        same: True if all positions are bit-identical.
        rms: RMS deviation on each axis [m, rad], (6,).
        most: Maximum deviation on each axis [m, rad], (6,).
        when: Time of the maximum deviation [s], (6,).
        one_step_rms: RMS one-step prediction error on each axis [m, rad], (6,), from the previous sample, its speed and
            the recorded forces; NaN with fewer than three samples.
        samples: Number of samples recorded.
        compared: Number of samples simulated; fewer than recorded if the simulation failed.
        device: True for a recording of a device, with an unmeasured hand.
    """

    same: bool
    rms: Array
    most: Array
    when: Array
    one_step_rms: Array
    samples: int
    compared: int
    device: bool

    @property
    def worst(self) -> int:
        """Index into AXES of the maximum deviation, among the translations unless only rotations differ."""
        group = slice(0, 3) if self.most[:3].any() else slice(3, 6)
        return int(np.argmax(self.most[group])) + group.start

    @property
    def sentence(self) -> str:
        """Verdict in one sentence."""
        if self.compared == 0:
            return "no comparison: the simulation failed at the first sample"
        if self.same:
            return "recording and simulation are bit-identical"
        axis = self.worst
        unit = unit_of("µm", axis)
        return (
            f"deviation of the simulation on {AXES[axis]}: {self.rms[axis] * 1e6:.4g} {unit} RMS, "
            f"max. {self.most[axis] * 1e6:.4g} {unit} at {self.when[axis]:.4g} s"
        )

    def table(self) -> Table:
        """Return the deviations on each axis."""
        rows = [axis_row("one-step prediction", self.one_step_rms, 1e6, "µm, µrad")]
        if not self.same and self.compared:
            times = (f"{when:.3f}" if most >= _NOTHING else "-" for most, when in zip(self.most, self.when))
            rows = [
                axis_row("RMS", self.rms, 1e6, "µm, µrad"),
                axis_row("maximum", self.most, 1e6, "µm, µrad"),
                ("  time", *times, "s"),
                *rows,
            ]
        remarks = [self.sentence]
        if 0 < self.compared < self.samples:
            remarks.append(f"simulation failed after {self.compared} of {self.samples} samples")
        if self.device:
            remarks.append(_UNMEASURED_HAND)
        return Table("", ("deviation", *AXES, ""), rows, "\n".join(remarks))

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        axes = {name: getattr(self, name) for name in ("rms", "most", "when", "one_step_rms")}
        return {"same": self.same, "compared": self.compared, "sentence": self.sentence, **by_axis(axes)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One side of a comparison, recording or simulation, over the analysed interval.

    Attributes:
        motion: Motion of the flotor.
        figures: Figures of the motion.
        anchors: Stick positions at each sample [m, rad], (N, 6); None without friction, or for a simulation.
    """

    motion: Motion
    figures: SegmentFigures
    anchors: Array | None


@dataclass(frozen=True, kw_only=True, eq=False)
class SegmentReport(Result):
    """Results of a segment's analysis.

    Attributes:
        kind: Kind of its setup.
        metadata: Metadata of the run.
        recorded: Motion and figures of the samples.
        simulated: Motion and figures of the simulation; None if none was requested, or it failed at once.
        comparison: Deviation between both; None if none was requested.
        identified: Identified walls, friction, mass, delay and sensor.
        wall: Verdict on the simulated scene's wall; None without one, for a device, or if the scene is not available.
    """

    kind: str
    metadata: RunMetadata
    recorded: Run
    simulated: Run | None
    comparison: Deviation | None
    identified: Identification
    wall: Verdict | None = None
    units: ClassVar = {"time": "s"} | {
        f"{side}.{axis}": unit_of("m", axis) for side in ("recorded", "simulated") for axis in AXES
    }

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return time, recorded and simulated positions, (N,) each.

        A simulation that ended early is padded with NaN.
        """
        sides = {"recorded": self.recorded, "simulated": self.simulated}
        time = self.recorded.motion.time
        columns = {"time": time}
        for name, run in sides.items():
            if run is not None:
                poses = np.full((len(time), len(AXES)), np.nan)
                poses[: len(run.motion.starts)] = run.motion.trace.pose[run.motion.starts]
                columns |= {f"{name}.{axis}": poses[:, index] for index, axis in enumerate(AXES)}
        return columns

    def _headline(self) -> str:
        axis, compared = self.axis(), "" if self.comparison is None else f"; {self.comparison.sentence}"
        travel = f"{1e3 * self.recorded.figures.travel[axis]:.3g} {unit_of('mm', axis)} of travel on {AXES[axis]}"
        return f"{capitalised(self.metadata.name)}: {travel}{compared}"

    @property
    def run_title(self) -> str:
        """Name, rate and delay of the run in a few words."""
        run = self.metadata
        return f"{run.name}, {1.0 / run.period:g} Hz, delay {run.delay * 1e3:g} ms"

    @property
    def warnings(self) -> list[str]:
        """See `Result`."""
        return [f"wall {self.wall.words}"] if self.wall is not None and self.wall.stable is False else []

    def table(self) -> Table:
        """Return the tables of figures, comparison and identified quantities.

        The simulation's figures are rows below the recording's if they differ.
        """
        figures, comparison = self.recorded.figures, self.comparison
        other = None if comparison is not None and comparison.same else self.simulated
        below = figures.tables(None if other is None else other.figures)
        if comparison is not None:
            below.append(comparison.table())
        if self.kind == MEASURED:
            below.append(Table("", (), (), UNCONTROLLED))
        span = f"{figures.samples} samples, {figures.start:.4g} to {figures.end:.4g} s, {figures.missed} lost"
        span += f", device force up to {number_text(figures.device_force, 3, 2)} N"
        return Table(
            f"{self.run_title}: {span}", [], [], below=[*below, self.identified.table()], warnings=self.warnings
        )

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return self.conditions_on([AXES[self.axis()]])

    def conditions_on(self, axes: Sequence[str]) -> str:
        """Return the conditions with other axes than the most significant one."""
        run = self.metadata
        return conditions_text(run.name, axes, [run.period], [run.delay])

    @property
    def pictures(self) -> Mapping[str, str]:
        """Drawing functions, see `Result`: `contact` if there was one, `sticks` with friction."""
        chosen = {"run": "whole_run"}
        chosen |= {"contact": "first_contact"} if self.recorded.figures.faces else {}
        chosen |= {"sticks": "sticks"} if self.recorded.anchors is not None else {}
        return {name: f"maglev_mj.analysis.pictures:{function}" for name, function in chosen.items()}

    def plot(
        self,
        path: Path | str | None = None,
        picture: str | None = None,
        *,
        axis: str | None = None,
        ax: Any = None,
        width: float | None = None,
        bare: bool = False,
    ) -> Any:
        """Draw recording and simulation on an axis; see `Result.plot`.

        Args:
            path: File to write; None to return the figure.
            picture: One of `pictures` by name; the run by default.
            axis: Name from AXES; the most significant one by default, see `SegmentReport.axis`.
            ax: See `Result.plot`, as the others.
            width: See there.
            bare: See there.

        Raises:
            ParameterError: If the axis does not move, and as `Result.plot`.
        """
        index = self.axis(axis)
        return self._plotted(lambda function: function(self, index), path, picture, ax, width, bare)

    def axis(self, name: str | None = None) -> int:
        """Return the index of the named axis, or of the most significant one.

        This is the scene's own axis if a wall on it was touched, else the first axis with a touched wall, else the axis
        with the largest travel, of the translations unless only rotations moved.

        Raises:
            ParameterError: If the named axis does not move.
        """
        figures = self.recorded.figures
        if name is not None:
            moving = [AXES[index] for index in np.flatnonzero(figures.travel > _STILL)]
            if name not in moving:
                allowed = f"one of those with motion ({', '.join(moving)})" if moving else "omitted, as none has motion"
                raise ParameterError(f"axis must be {allowed} (got {name!r})")
            return AXES.index(name)
        touched = [face.axis for face in figures.faces]
        if touched:
            return AXES.index(self.metadata.axis if self.metadata.axis in touched else touched[0])
        turned = not (figures.travel[:3] > _STILL).any()
        return int(np.argmax(figures.travel[3:])) + 3 if turned else int(np.argmax(figures.travel[:3]))

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        run = {name: getattr(self.metadata, name) for name in ("name", "period", "delay")}
        parts = {
            "recorded": self.recorded.figures,
            "simulated": self.simulated and self.simulated.figures,
            "comparison": self.comparison,
            "identified": self.identified,
        }
        return {"kind": self.kind, **run, **plain(parts)}


@checked(own="segment")
def analyse(
    segment: Segment,
    rebuild: Rebuild | None = None,
    *,
    anchors: Array | None = None,
    begin: float = 0.0,
    end: float | None = None,
    simulated: bool = True,
    rest: float | None = None,
    scene: type[Scene] | None = None,
) -> SegmentReport:
    """Analyse a segment of at least two samples.

    Args:
        segment: The segment.
        rebuild: Function from a setup and a hand to plant and controller; None to simulate nothing.
        anchors: Stick positions at each sample [m, rad], (N, 6); None without friction.
        begin: Start of the analysis, in the segment's time [s].
        end: End of the analysis [s]; None for the segment's end.
        simulated: True to run the simulation of the same parameters and compare.
        rest: Rest position at a wall [m, rad]; computed from the samples by default.
        scene: Scene class of a user-defined scene.

    Raises:
        InvalidRecordingError: If it has less than two samples.
        ParameterError: If there are less than two samples from `begin` to `end`.

    Example:
        >>> from maglev_mj import analyse, find_scene, rebuild, record_run
        >>> report = analyse(record_run(find_scene("drop")(), plant="exact").segments[0], rebuild)
        >>> wall = report.identified.walls[0]
        >>> round(float(wall.stiffness.value)), round(float(wall.damping.value))
        (6000, 80)
    """
    flag("simulated", simulated)
    check_instance("segment", segment, Segment, SEGMENT_TYPE)
    whole = reconstruct(segment)
    first, last = _rows(whole, begin, end)
    comparison = other = None
    if simulated and rebuild is not None and segment.setup["kind"] != MEASURED:
        twin = simulate(segment, whole, rebuild, scene)
        comparison = compare(segment[first : last + 1], twin[first : last + 1], whole.between(first, last))
        until = min(last, len(twin.tick) - 1)
        if until - first >= 1:
            other = _run(twin, reconstruct(twin), None, (first, until), rest)
    run, wall = _run(segment, whole, anchors, (first, last), rest), None
    if segment.setup["kind"] not in ("device", MEASURED):  # its link delay is not in the setup
        with suppress(MaglevError, KeyError):
            recorded = recorded_scene(segment.setup["scene"], segment.setup["parameters"], scene)
            loops = wall_loops(recorded, held=scripted(segment.setup))
            wall = judge(loops) if loops else None
    return SegmentReport(
        kind=segment.setup["kind"],
        metadata=segment.metadata,
        recorded=run,
        simulated=other,
        comparison=comparison,
        identified=identify(segment[first : last + 1], anchors=run.anchors),
        wall=wall,
    )


def _rows(motion: Motion, begin: float, end: float | None) -> tuple[int, int]:
    """Return the first and last sample of an interval."""
    time = motion.time
    number("from", begin, at_least=0.0, below=float(time[-1]))
    final = float(time[-1]) if end is None else number("to", end, above=begin)
    inside = np.flatnonzero((time >= begin - _STILL) & (time <= final + _STILL))
    if len(inside) < 2:
        raise ParameterError(f"from and to must have at least 2 samples between them (got {begin:g} and {final:g})")
    return int(inside[0]), int(inside[-1])


def _run(segment: Segment, whole: Motion, anchors: Array | None, rows: tuple[int, int], rest: float | None) -> Run:
    first, last = rows
    chosen = slice(first, last + 1)
    motion, stuck = whole.between(first, last), None if anchors is None else anchors[chosen]
    figures = segment_figures(motion, segment[chosen], stuck, rest)
    return Run(motion=motion, figures=figures, anchors=stuck)


def simulate(segment: Segment, motion: Motion, rebuild: Rebuild, scene: type[Scene] | None = None) -> Segment:
    """Simulate a recorded run with the same laws, hand and start.

    A device is replaced by the simulated one, from the first sample at the speed of the first two, without a hand.
    Samples missing in the recording are skipped.

    Args:
        segment: The recording.
        motion: Its motion.
        rebuild: Function from a setup and a hand to plant and controller.
        scene: Scene class of a user-defined scene.

    Returns:
        The simulated samples: fewer than recorded if the simulation failed.

    Raises:
        RecordingError: If the setup is unknown.
        ParameterError: If a plant cannot be made at the recorded start.
    """
    run = segment.whole
    rows = np.round(segment.tick - run.tick[0]).astype(np.intp)
    plant, controller = rebuild(run.setup, RecordedHand(run.recorded_hand_wrench))
    if plant is None:
        device = recorded_scene(segment.setup["scene"], segment.setup["parameters"], scene)
        start = {"pose": motion.trace.pose[motion.starts[0]], "twist": motion.trace.twist[motion.starts[0]]}
        plant = live_plant(device, **start, wrench=segment.metadata.before)
    recorder = Recorder(plant, segment.setup)
    with plant, engine_warnings_silenced():
        try:
            ControlLoop(plant, controller, record=recorder).cycle(int(rows[-1]) + 1)
        except ParameterError:
            raise
        except MaglevError:
            pass  # the comparison reports the number of samples
    rows = rows[rows < len(recorder)]
    return recorder.segment()[rows].replace(tick=segment.tick[: len(rows)], time=segment.time[: len(rows)])


def compare(segment: Segment, simulated: Segment, motion: Motion) -> Deviation:
    """Return the deviation of a simulation from its recording.

    Args:
        segment: The recording, N samples.
        simulated: Its simulation, of at most N samples.
        motion: The motion of the recording.
    """
    count = len(simulated.tick)
    gap = np.abs(simulated.position - segment.position[:count])
    none = np.full(len(AXES), np.nan)
    jumps = motion.jumps[np.isfinite(motion.jumps).all(axis=1)]
    return Deviation(
        same=bool(count == len(segment.tick) and not gap.any()),
        rms=np.sqrt((gap**2).mean(axis=0)) if count else none,
        most=gap.max(axis=0) if count else none,
        when=motion.time[np.argmax(gap, axis=0)] if count else none,
        one_step_rms=np.sqrt((jumps**2).mean(axis=0)) if len(jumps) else none,
        samples=len(segment.tick),
        compared=count,
        device=segment.setup["kind"] == "device",
    )

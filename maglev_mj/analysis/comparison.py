"""Comparison of a recording with its simulation.

The simulation has the same parameters; distances are overall and from one sample to the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from maglev_mj.analysis.motion import Motion
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.hand import RecordedHand
from maglev_mj.loop import ControlLoop
from maglev_mj.plants import SampledPlant, engine_warnings_silenced
from maglev_mj.recording import Rebuild, Recorder, RunMetadata, Stretch
from maglev_mj.result import plain
from maglev_mj.scenes import Scene
from maglev_mj.scenes.find import recorded_scene
from maglev_mj.session import live_plant


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Distance between a recording and its simulation.

    Attributes:
        same: True if every position is the same to the last bit.
        rms: Root mean square of the distance on each axis [m, rad], (6,).
        most: Largest distance on each axis [m, rad], (6,).
        when: Time of the largest distance [s], (6,).
        one_step: Root mean square of the one-step prediction error on each axis [m, rad], (6,), predicted from the
            sample before, its speed and the recorded forces; NaN with less than three samples.
        compared: Number of samples simulated; less than all if the simulation failed.
        device: True for a recording of a device, with an unmeasured hand.
    """

    same: bool
    rms: Array
    most: Array
    when: Array
    one_step: Array
    compared: int
    device: bool

    @property
    def worst(self) -> int:
        """Index into AXES of the largest distance.

        Of the translations, unless only rotations differ.
        """
        group = slice(0, 3) if self.most[:3].any() else slice(3, 6)
        return int(np.argmax(self.most[group])) + group.start

    @property
    def sentence(self) -> str:
        """Result of the comparison in one sentence."""
        if self.compared == 0:
            return "the simulation failed at once: there is nothing to compare"
        if self.same:
            return "the recording and its simulation are the same to the last bit"
        axis = self.worst
        unit = "µm" if axis < 3 else "µrad"
        return (
            f"the recording and its simulation are {self.rms[axis] * 1e6:.4g} {unit} apart (RMS), "
            f"{self.most[axis] * 1e6:.4g} {unit} at most, on {AXES[axis]} at {self.when[axis]:.4g} s"
        )

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        figures = {"rms": self.rms, "most": self.most, "when": self.when, "one_step_rms": self.one_step}
        return {
            "same": self.same,
            "compared": self.compared,
            "sentence": self.sentence,
            **{name: dict(zip(AXES, map(plain, values.tolist()))) for name, values in figures.items()},
        }


def simulate(
    stretch: Stretch, motion: Motion, metadata: RunMetadata, rebuild: Rebuild, scene: type[Scene] | None = None
) -> Stretch:
    """Simulate a recorded run again.

    It has the same laws, the recorded hand, and the recorded start.

    A device is replaced by the simulated one, from the first sample at the speed of the first two, without a hand.
    Samples missing in the recording are left out.

    Args:
        stretch: The recording.
        motion: Its motion.
        metadata: Metadata of the stretch.
        rebuild: Function from a setup and a hand to plant and controller.
        scene: Scene class of a user's own recording.

    Returns:
        The simulated samples: fewer than recorded if the simulation failed.

    Raises:
        RecordingError: If the setup is not known here.
        ParameterError: If a plant cannot be made at the recorded start.
    """
    rows = np.round(stretch.tick - stretch.tick[0]).astype(np.intp)
    plant, controller = rebuild(stretch.setup, RecordedHand(stretch.known_hand))
    if plant is None:
        plant = _twin(stretch, motion, metadata, scene)
    recorder = Recorder(plant, stretch.setup)
    with plant, engine_warnings_silenced():
        try:
            ControlLoop(plant, controller, record=recorder).cycle(int(rows[-1]) + 1)
        except ParameterError:
            raise
        except MaglevError:
            pass  # the comparison reports the number of samples
    kept = rows[rows < len(recorder)]
    return recorder.stretch()[kept].replace(tick=stretch.tick[: len(kept)], time=stretch.time[: len(kept)])


def _twin(stretch: Stretch, motion: Motion, metadata: RunMetadata, scene: type[Scene] | None) -> SampledPlant:
    """Return the simulated device in place of a real one."""
    flown, first = recorded_scene(stretch.setup["scene"], stretch.setup["parameters"], scene), motion.starts[0]
    return live_plant(flown, pose=motion.trace.pose[first], twist=motion.trace.twist[first], wrench=metadata.before)


def compare(stretch: Stretch, simulated: Stretch, motion: Motion) -> Comparison:
    """Return the distance between a recording and its simulation.

    Args:
        stretch: The recording, N samples.
        simulated: Its simulation, of at most N samples.
        motion: The motion of the recording.
    """
    count = len(simulated.tick)
    gap = np.abs(simulated.position - stretch.position[:count])
    none = np.full(len(AXES), np.nan)
    known = motion.jumps[np.isfinite(motion.jumps).all(axis=1)]
    return Comparison(
        same=bool(count == len(stretch.tick) and not gap.any()),
        rms=np.sqrt((gap**2).mean(axis=0)) if count else none,
        most=gap.max(axis=0) if count else none,
        when=motion.time[np.argmax(gap, axis=0)] if count else none,
        one_step=np.sqrt((known**2).mean(axis=0)) if len(known) else none,
        compared=count,
        device=stretch.setup["kind"] == "device",
    )

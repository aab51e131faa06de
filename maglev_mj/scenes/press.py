"""Scene: a hand hits a wall, then presses, figure 6 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from maglev_mj.control import Law
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component
from maglev_mj.parameters import number, param
from maglev_mj.plants import Timing
from maglev_mj.plants.hand import GuidedHand, Hand, Trajectory, get_hand, motion
from maglev_mj.scenes.figures import PressSummary, press_name
from maglev_mj.scenes.results import RunResult
from maglev_mj.scenes.scene import Start
from maglev_mj.scenes.wall_scene import WallScene, hold, others

# fractions of an interval: wait before the first stroke, and duration of a stroke down or up
_WAIT, _WAY = 0.5, 0.25
_LEAST_SAMPLES = 8
_PRESSING = 1.0


class Press(WallScene):
    """Hit the wall several times, then press (figure 6).

    The muscles move the rest point of the arm's spring along z: for each hit from `height` down to `resting_point` and
    back within half an interval, and finally down. Strokes are minimum-jerk trajectories. Impact speed and rebound of
    the flotor follow from the arm's dynamics.

    The muscle force is constant from sample to sample; mass, damping and stiffness of the hand act continuously. The
    weight is compensated, and the five other axes are held.
    """

    title: ClassVar = "Hit the wall several times, then press (figure 6)"
    model: ClassVar = "scenes/press"
    figures: ClassVar = {name: press_name(name) for name in PressSummary._fields}
    plots: ClassVar[Mapping[str, str]] = {"press": "maglev_mj.scenes.pictures:figure_6"}

    hand: str = param("arm, stylus, fingertip or MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]", default="arm")
    hits: int = param("number of hits", default=4, at_least=1, at_most=1000)
    interval: float = param("interval between hits", "s", default=0.4, at_most=100.0)
    height: float = param(
        "start height of a hit above the wall",
        "m",
        default=None,
        derive=lambda scene: float(0.003 * scene.hardware.range_ratio[2]),
        above=0.0,
    )
    press: float = param("force of the final press", "N", default=5.0, above=0.0, at_most=1e6)
    # an eighth of the speed of a hit, and 20 times the apparent speed of one step of the device's sensor (5 µm): hits
    # trigger a pulse, and a light press with noise at the edge does not rattle
    pulse_gate: float = param(
        "least approach speed for a braking pulse", "m/s", default=0.02, at_least=0.0, at_most=1e3
    )
    duration: float = param(
        "simulated time; by default 1 s from the start of the final press",
        "s",
        default=None,
        derive=lambda scene: scene.down + _PRESSING,
        at_most=1e5,
    )

    def check(self) -> None:
        """See `Scene`."""
        held = get_hand(self.hand)
        if held is None or not np.all(np.asarray(held.stiffness) > 0.0):
            raise ParameterError(f"hand must have a stiffness above 0, in order to press (got {self.hand!r})")
        number("stiffness", self.stiffness, above=0.0, at_most=1e8)
        super().check()
        if not self.height < self.hardware.escape:
            number("height", self.height, below=self.hardware.escape, unit="m")
        if self.force_limit and not self.press < self.force_limit:
            raise ParameterError(
                f"press must be below the force_limit of {self.force_limit:g} N, or it penetrates the wall "
                f"(got {self.press:g})"
            )
        number("interval", self.interval, at_least=_LEAST_SAMPLES * self.period, at_most=100.0)
        number("duration", self.duration, above=self.down, at_most=1e5)

    def start(self) -> Start:
        """Return a flotor at rest above the wall, its weight compensated."""
        return Start(pose=(0.0, 0.0, self.height, 0.0, 0.0, 0.0), gravity=0.0)

    def laws(self) -> list[Law]:
        """Return the wall and the hold of the other axes."""
        return [self.wall(gate=self.pulse_gate), *self.damper(), hold(self, others("z"))]

    def timing(self, phase: Component = 0.0) -> Timing:
        """Return a timing without phase, which shifts the hand's motion instead: the hand is always in contact."""
        return super().timing()

    def scripted_hand(self, phase: float = 0.0) -> GuidedHand:
        """Return the hitting and pressing hand."""
        return GuidedHand(hand=self.impedance, path=self.path(phase))

    def plant_options(self) -> dict[str, Any]:
        """See `Scene`."""
        return super().plant_options() | {"longest_step": self.longest_step}

    def longest_step(self, plant: object = None) -> float:
        """Return the longest integration step [s]: 0.1 rad of the fastest mode of flotor and hand, at least 10 µs.

        The recorded curve is then within a nanometre of the exact one.
        """
        fastest = float(np.abs(np.linalg.eigvals(motion(self.body.inertia[2], self.impedance)[0])).max())
        # the engine integrates the hand, the exact plant only records it
        most = self.period if plant == "exact" else 5e-4
        return max(min(most, 0.1 / fastest), 1e-5)

    def describe(self) -> str:
        """Return a one-line description."""
        wall = f"a wall of {self.stiffness:.6g} N/m and {self.damping:.4g} N s/m"
        hits = f"a hand ({self.hand}) hits {wall} from {self.height * 1e3:.4g} mm"
        return f"{hits}, then presses with {self.press:g} N"

    @property
    def impedance(self) -> Hand:
        """Mass, damping and stiffness of the hand."""
        hand = get_hand(self.hand)
        assert hand is not None  # see check()
        return hand

    @property
    def down(self) -> float:
        """Latest start of the final press [s], over all phases."""
        return self.period + (_WAIT + self.hits + _WAY) * self.interval

    @property
    def resting_point(self) -> float:
        """Rest point of the arm's spring in the press [m]: -press (1/k_wall + 1/k_arm + 1/k_grip).

        Wall, grip and arm are springs in series; a rigid grip has no deflection.
        """
        hand = self.impedance
        springs = [self.stiffness, hand.stiffness, *([] if hand.grip_stiffness is None else [hand.grip_stiffness])]
        return -self.press * sum(1.0 / float(np.asarray(spring)) for spring in springs)

    def strokes(self, phase: float) -> list[float]:
        """Return the start times of the hits and of the press [s], (hits + 1,)."""
        begin = (1.0 - phase) * self.period
        return [begin + (_WAIT + stroke) * self.interval for stroke in range(self.hits + 1)]

    def path(self, phase: float) -> Trajectory:
        """Return the trajectory of the arm's rest point."""
        up, down = ([0.0, 0.0, z, 0.0, 0.0, 0.0] for z in (self.height, self.resting_point))
        times, poses, way = [(1.0 - phase) * self.period], [up], _WAY * self.interval
        for start in self.strokes(phase):
            times += [start, start + way, start + 2.0 * way]
            poses += [up, down, up]
        return Trajectory(times[:-1], poses[:-1], "minimum-jerk")

    def series(self, result: RunResult, time: Array) -> dict[str, Array]:
        """Return height [m], actuator force [N], and rest point of the arm's spring as target [m]."""
        path = self.path(result.phase)
        return super().series(result, time) | {"target": np.array([path.at(instant)[2] for instant in time.tolist()])}

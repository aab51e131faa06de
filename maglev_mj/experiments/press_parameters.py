"""What a scripted hand does to a wall: several hits, then a press."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.hand import Hand, Path, hand_called, motion
from maglev_mj.parameters import number
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.spec import ESCAPE, Spec

__all__ = ["PressParameters"]

_MOST_TICKS = 1_000_000
_MOST_HITS = 1000

# of an interval: how long the hand stays up before the first stroke, and how long each way takes
_WAIT, _WAY = 0.5, 0.25
_LEAST_SAMPLES = 8
_PRESSING = 1.0


@dataclass(frozen=True, kw_only=True)
class PressParameters:
    """A hand hits a wall that fills z <= 0, several times, and presses against it in the end.

    The muscles draw the point to which the arm's spring pulls along z: from `height` down to `resting_point` and back
    up within half an interval, once a hit, and in the end down to stay. Each way is of minimum jerk. How fast the
    flotor then meets the wall, and how far it comes back up, is the arm's doing.

    What the muscles exert is held from sample to sample; mass, damping and stiffness of the hand act all the time.
    Weight is compensated: there is no gravity. The five other axes are held.

    Attributes:
        plant: "mujoco" or "exact".
        hand: See `hand_called`; not "none", and the stiffness of the arm above 0.
        hits: How many hits.
        interval: From one hit to the next [s], at least 8 periods; each way takes a quarter of it.
        height: Height above the wall from which the hand hits [m].
        press: Force with which it presses in the end [N]; below the force limit.
        phase: The samples are at (k + phase) period after the hand begins; in [0, 1).
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        pulse: Further damping in the braking pulse [N s/m]; 0 for none.
        pulse_width: How long the pulse lasts [s].
        pulse_gate: Approach speed from which on a pulse is given [m/s]. The default is an eighth of the speed of a
            hit, and 20 times what a step of the device's sensor (5 µm) makes of a flotor at rest: a hit gets its
            pulse, and a light press that noise lifts off the edge does not rattle.
        mass: Moving mass [kg].
        force_limit: Largest force of the actuators along z [N]; None for no limit.
        quantize: Resolution of the position sensor [m]; 0 for an ideal one.
        duration: Simulated time [s]; None for one second from the hand's coming to its end.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    plant: str = "mujoco"
    hand: str = "arm"
    hits: int = 4
    interval: float = 0.4
    height: float = 0.003
    press: float = 5.0
    phase: float = 0.0
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    stiffness: float = 6000.0
    damping: float = 80.0
    pulse: float = 220.0
    pulse_width: float = 0.003
    pulse_gate: float = 0.02
    mass: float = Spec.moving_mass.value
    force_limit: float | None = None
    quantize: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise ParameterError(f"plant must be one of {', '.join(PLANTS)}, not {self.plant!r}")
        held = hand_called(str(self.hand))
        if held is None or not np.all(np.asarray(held.stiffness) > 0.0):
            raise ParameterError(f"hand must have an arm of some stiffness, by which it presses, not {self.hand!r}")
        bounds: dict[str, dict[str, float]] = {
            "hits": {"at_least": 1, "at_most": _MOST_HITS},
            "height": {"above": 0.0, "below": ESCAPE},
            "press": {"above": 0.0, "at_most": 1e6},
            "phase": {"at_least": 0.0, "below": 1.0},
            "period": {"at_least": 1e-6, "at_most": 1.0},
            "delay": {"at_least": 0.0, "at_most": 1.0},
            "stiffness": {"above": 0.0, "at_most": 1e8},
            "damping": {"at_least": 0.0, "at_most": 1e6},
            "pulse": {"at_least": 0.0, "at_most": 1e6},
            "pulse_width": {"at_least": 0.0, "at_most": 1.0},
            "pulse_gate": {"at_least": 0.0, "at_most": 1e3},
            "mass": {"at_least": 1e-3, "at_most": 1e3},
            "force_limit": {"above": 0.0, "at_most": 1e6},
            "quantize": {"at_least": 0.0, "at_most": 1.0},
        }
        for name, allowed in bounds.items():
            value = getattr(self, name)
            if name != "force_limit" or value is not None:
                object.__setattr__(self, name, number(name, value, **allowed))
        if self.hits != int(self.hits):
            raise ParameterError(f"hits must be a whole number, not {self.hits:g}")
        object.__setattr__(self, "hits", int(self.hits))
        if self.pulse > 0.0 and self.pulse_width == 0.0:
            raise ParameterError("pulse_width must be above 0 where there is a pulse, not 0.0")
        if self.force_limit is not None and not self.press < self.force_limit:
            raise ParameterError(
                f"press must be below the force_limit of {self.force_limit:g} N, or it goes through the wall, "
                f"not {self.press:g}"
            )
        self._check_times()

    def _check_times(self) -> None:
        least = _LEAST_SAMPLES * self.period
        object.__setattr__(self, "interval", number("interval", self.interval, at_least=least, at_most=100.0))
        down = self.period + (_WAIT + self.hits + _WAY) * self.interval
        wanted = down + _PRESSING if self.duration is None else self.duration
        object.__setattr__(self, "duration", number("duration", wanted, above=down, at_most=1e5))
        if self.end / self.period > _MOST_TICKS:
            raise ParameterError(f"duration must be at most {_MOST_TICKS} periods, not {self.end:g} s")

    @property
    def end(self) -> float:
        """When the run ends [s]: the duration."""
        return self.duration or 0.0

    @property
    def begin(self) -> float:
        """When the hand begins [s]; the plant samples from release on, so that the hand holds all the time."""
        return (1.0 - self.phase) * self.period

    @property
    def impedance(self) -> Hand:
        """Mass, damping and stiffness of the hand."""
        hand = hand_called(self.hand)
        assert hand is not None  # checked when made
        return hand

    @property
    def longest_step(self) -> float:
        """Longest stretch between two states [s]: a tenth of a radian of what flotor and hand do fastest.

        The recorded curve is then within a nanometre of the true one; without bound a stiff grip would take for ever.
        """
        fastest = float(np.abs(np.linalg.eigvals(motion(self.mass, self.impedance)[0])).max())
        # the engine integrates the hand, the exact plant has only to record it
        most = self.period if self.plant == "exact" else 5e-4
        return max(min(most, 0.1 / fastest), 1e-5)

    @property
    def resting_point(self) -> float:
        """Where the arm's spring pulls to in the press [m]: -press (1 / wall + 1 / arm + 1 / grip), of stiffnesses.

        Wall, grip and arm are three springs in a row, and each carries the same force. The wall gives way by
        press / wall, a soft grip by press / grip, a rigid one by nothing; the rest is the arm's.
        """
        hand = self.impedance
        springs = [self.stiffness, hand.stiffness, *([] if hand.grip_stiffness is None else [hand.grip_stiffness])]
        return -self.press * sum(1.0 / float(np.asarray(spring)) for spring in springs)

    @property
    def strokes(self) -> list[float]:
        """When the strokes begin [s], (hits + 1,): those of the hits, then that of the press."""
        return [self.begin + (_WAIT + place) * self.interval for place in range(self.hits + 1)]

    @property
    def path(self) -> Path:
        """Where the arm's spring pulls to."""
        up, down = ([0.0, 0.0, z, 0.0, 0.0, 0.0] for z in (self.height, self.resting_point))
        times, poses, way = [self.begin], [up], _WAY * self.interval
        for start in self.strokes:
            times += [start, start + way, start + 2.0 * way]
            poses += [up, down, up]
        return Path(times[:-1], poses[:-1])

"""Path, rest and reports of takeoff and landing, and the switch that ends a flight."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.guarded import GuardedPlant
from maglev_mj.bridge.realtime import interrupt, stopping
from maglev_mj.control import Bias, Hold
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, PlantError
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.parameters import number
from maglev_mj.plants.hand import Trajectory
from maglev_mj.scenes.find import line_of

LANDING_TIME = 2.0
"""Longest landing before the currents are cut [s]."""

TOLERATED = 0.02
"""Delay for which the hold of an early landing is chosen [s].

It is stable up to 59 ms at 200 Hz, 53 ms at 1 kHz.
"""

_DROPPED, _LONG = 0.3, 0.1
"""Speed of a dropped flotor [m/s], and time above it that cuts an early landing [s]."""

_ASIDE, _ASKEW = 0.002, math.radians(3.0)

_SLOW, _SLOW_SPIN = 5e-3, 0.1
"""Largest speed [m/s] and angular speed [rad/s] at rest.

At 200 Hz they are 300 times the apparent speed due to noise of half a spot's step, and 3 times that due to 50 µm.
"""

_WATCHED, _BLOCKS = 0.1, 5


class Motion:
    """Pose and speed of the flotor over 0.1 s.

    The speeds are the range of the mean poses of five blocks, over the time between the first and the last: noise
    counts the less the faster the sampling, and a swing to and fro below 25 Hz is not missed.

    Args:
        period: Sample period [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._seen: deque[Sample] = deque(maxlen=max(round(_WATCHED / period), 2) + 1)
        self.add = self._seen.append

    @property
    def full(self) -> bool:
        """True if the samples cover 0.1 s."""
        return len(self._seen) == self._seen.maxlen

    @property
    def pose(self) -> list[float]:
        """Mean pose [m, rad], six; NaN without samples."""
        return np.mean([one.position for one in self._seen] or [[math.nan] * 6], axis=0).tolist()  # type: ignore[no-any-return]

    @property
    def speeds(self) -> tuple[float, float]:
        """Speed [m/s] and angular speed [rad/s].

        NaN for less than two samples.
        """
        if len(self._seen) < 2:
            return math.nan, math.nan
        rows = np.array([(one.tick * self._period, *one.position) for one in self._seen])
        means = np.array([block.mean(axis=0) for block in np.array_split(rows, min(_BLOCKS, len(rows)))])
        gone = np.ptp(means[:, 1:], axis=0) / (means[-1, 0] - means[0, 0])
        return math.hypot(*gone[:3]), math.hypot(*gone[3:])

    @property
    def at_rest(self) -> bool:
        """True if the flotor is at rest."""
        speed, spin = self.speeds
        return speed <= _SLOW and spin <= _SLOW_SPIN

    def __str__(self) -> str:
        return _speeds_shown(*self.speeds)


class Swing:
    """Detector of a flotor that swings in a landing, faster than one that is dropped."""

    def __init__(self) -> None:
        self._last: tuple[float, Sequence[float]] | None = None
        self._fast = 0.0

    def check(self, pose: Sequence[float], time: float) -> float:
        """Add a pose at a time [s]; return a lasting speed [m/s], or 0."""
        last, self._last = self._last, (time, pose)
        if last is None or time <= last[0]:
            return 0.0
        speed = math.dist(pose[:3], last[1][:3]) / (time - last[0])
        self._fast += (time - last[0]) * (speed > _DROPPED)
        return speed if self._fast > _LONG else 0.0


class LandingReport(NamedTuple):
    """Pose and motion of a flotor after landing.

    Attributes:
        error: Distance from the pose before takeoff [m]; NaN if its pose is not known.
        speed: Speed over the last 0.1 s [m/s].
        spin: Angular speed over the last 0.1 s [rad/s].
        at_rest: True if it rests.
        reason: Why the flight was ended early; "" if it was not.
        path: File of the last cycles before that; None without any.
    """

    error: float
    speed: float
    spin: float
    at_rest: bool
    reason: str = ""
    path: Path | None = None

    def __str__(self) -> str:
        how = "at rest" if self.at_rest else f"NOT at rest: {_speeds_shown(self.speed, self.spin)}"
        landed = f"landed {self.error * 1e3:.2f} mm from where it lay, {how}"
        where = f"; the cycles before are in {self.path}" if self.path is not None else ""
        return f"{landed}; ended early: {self.reason}{where}" if self.reason else landed


class Leader:
    """Controller that leads the flotor along a minimum-jerk path.

    A soft spring and damper, and the weight carried.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].
        delay: Total time from a sample to its command's effect [s].

    Attributes:
        period: Sample period [s].
    """

    def __init__(self, calibration: Calibration, period: float, delay: float) -> None:
        self.period = period
        inertia = np.concatenate([[calibration.mass] * 3, calibration.inertia])
        weight = np.concatenate([-calibration.mass * calibration.gravity, np.zeros(3)])
        hold = Hold.critically_damped(inertia=inertia, period=period, delay=delay)
        self._controller = Controller([Bias(weight), hold], period=period)
        self.aim(straight(ZERO, ZERO, 1.0))

    def aim(self, path: Trajectory, astray: Callable[[Sequence[float]], object] | None = None) -> None:
        """Begin a path at the next sample.

        Args:
            path: The path; its times begin there.
            astray: Called with the pose if the flotor does not follow.
        """
        self._path = path
        self._astray, self._first = astray, -1
        self.motion = Motion(self.period)
        self._controller.reset()

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        if self._first < 0:
            self._first = sample.tick
        self.motion.add(sample)
        goal = self._path.at((sample.tick - self._first) * self.period)
        off = [found - wanted for found, wanted in zip(sample.position, goal)]
        if self._astray is not None and (math.hypot(*off[:3]) > _ASIDE or math.hypot(*off[3:]) > _ASKEW):
            self._astray(sample.position)
        return self._controller.step(Sample(sample.tick, sample.time, off))


def straight(start: Sequence[float], end: Sequence[float], duration: float) -> Trajectory:
    """Return the path between two poses [m, rad] in a time [s]."""
    return Trajectory([0.0, number("duration", duration, above=0.0)], [list(start), list(end)])


class StopSwitch:
    """Switch that ends a flight by landing or zero current.

    Attributes:
        landing: True if the flight is to land.
    """

    def __init__(self) -> None:
        self.landing = False
        self._plant: GuardedPlant | None = None  # that flies

    def land(self) -> None:
        """Request landing, from any thread."""
        self.landing = True

    def cut(self) -> None:
        """Interrupt the flight once, which cuts its currents.

        Only for the thread that flies.
        """
        self.landing = True
        plant, self._plant = self._plant, None
        if plant is not None and not plant.disarmed:
            interrupt()

    def signals(self) -> AbstractContextManager[None]:
        """Land at the first stop signal; cut at a second Ctrl-C, or if landing takes long."""
        return stopping(self.land, self.cut, within=LANDING_TIME)

    @contextmanager
    def flying(self, plant: GuardedPlant) -> Iterator[None]:
        """Guard a flight: any error cuts its currents.

        An interrupt is an emergency stop, any other error a fault of the host.

        Raises:
            KeyboardInterrupt: If landing was requested before the start, or the currents were cut before takeoff.
            DeviceFault: If the currents were cut, by an interrupt or by an error once it is armed.
            PlantError: If the device does not confirm the cut.
        """
        if self.landing:
            interrupt()
        self._plant, plant.disarmed = plant, False
        try:
            yield
        except KeyboardInterrupt:
            self._plant = None
            try:
                plant.estop()
            except MaglevError as error:
                raise PlantError(f"the flight was to be cut, {error}") from None
            plant.read()  # raises the fault, with the last cycles on disk
            raise KeyboardInterrupt("stopped before takeoff; ESTOP is latched in the device") from None
        except BaseException as error:
            self._plant = None
            where = line_of(error)
            plant.abort(f"{where}: " * (where is not None) + f"{type(error).__name__}: {error}")
            raise
        finally:
            self._plant = None


def _speeds_shown(speed: float, spin: float) -> str:
    return f"{speed * 1e3:.2g} mm/s and {spin:.2g} rad/s"

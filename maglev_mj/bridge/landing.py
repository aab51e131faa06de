"""Paths, rest detection and reports of takeoff and landing; switch that ends a flight."""

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
from maglev_mj.scale import Scale
from maglev_mj.scenes.find import line_of

LANDING_TIME = 2.0
"""Time after which an unfinished landing is cut [s]."""

LANDING_DELAY = 0.02
"""Design delay of the hold of an early landing [s]; it is stable up to 59 ms at 200 Hz, 53 ms at 1 kHz."""

_FAST_TIME = 0.1
"""Total time above the speed of a dropped flotor that cuts an early landing [s]."""

_WINDOW, _BLOCKS = 0.1, 5


class RecentMotion:
    """Pose and speed of the flotor over 0.1 s.

    Speed is the range of the mean poses of five blocks, over the time from the first to the last: averaging reduces
    noise, and oscillations below 25 Hz are detected.

    Args:
        period: Sample period [s].
        scale: Scale of the device: the largest speeds at rest.
    """

    def __init__(self, period: float, scale: Scale) -> None:
        self._period, self._slow = period, (scale.rest, scale.rest_spin)
        self._samples: deque[Sample] = deque(maxlen=max(round(_WINDOW / period), 2) + 1)
        self.add = self._samples.append

    @property
    def full(self) -> bool:
        """True if the samples cover 0.1 s."""
        return len(self._samples) == self._samples.maxlen

    @property
    def pose(self) -> list[float]:
        """Mean pose [m, rad], six; NaN without samples."""
        return np.mean([x.position for x in self._samples] or [[math.nan] * 6], axis=0).tolist()  # type: ignore[no-any-return]

    @property
    def speeds(self) -> tuple[float, float]:
        """Speed [m/s] and angular speed [rad/s]; NaN for fewer than two samples."""
        if len(self._samples) < 2:
            return math.nan, math.nan
        rows = np.array([(sample.tick * self._period, *sample.position) for sample in self._samples])
        means = np.array([block.mean(axis=0) for block in np.array_split(rows, min(_BLOCKS, len(rows)))])
        speeds = np.ptp(means[:, 1:], axis=0) / (means[-1, 0] - means[0, 0])
        return math.hypot(*speeds[:3]), math.hypot(*speeds[3:])

    @property
    def at_rest(self) -> bool:
        """True if the flotor is at rest."""
        (speed, spin), (slow, slow_spin) = self.speeds, self._slow
        return speed <= slow and spin <= slow_spin

    def __str__(self) -> str:
        return _speeds_text(*self.speeds)


class Swing:
    """Detector of a flotor that oscillates in an early landing, faster than one that is dropped.

    Args:
        drop: Speed of a dropped flotor [m/s].
    """

    def __init__(self, drop: float) -> None:
        self._drop = drop
        self._last: tuple[float, Sequence[float]] | None = None
        self._fast = 0.0

    def check(self, pose: Sequence[float], time: float) -> float:
        """Add a pose at a time [s]; return the speed [m/s] once it was high for 0.1 s in total, else 0."""
        last, self._last = self._last, (time, pose)
        if last is None or time <= last[0]:
            return 0.0
        speed = math.dist(pose[:3], last[1][:3]) / (time - last[0])
        self._fast += (time - last[0]) * (speed > self._drop)
        return speed if self._fast > _FAST_TIME else 0.0


class LandingReport(NamedTuple):
    """Pose and motion of a flotor after landing.

    Attributes:
        error: Distance from the pose before takeoff [m]; NaN if the pose was not measured.
        speed: Speed over the last 0.1 s [m/s].
        spin: Angular speed over the last 0.1 s [rad/s].
        at_rest: True if the flotor is at rest.
        reason: Reason of an early end of the flight; "" without.
        path: File of the last cycles before an early end; None without.
    """

    error: float
    speed: float
    spin: float
    at_rest: bool
    reason: str = ""
    path: Path | None = None

    def __str__(self) -> str:
        how = "at rest" if self.at_rest else f"NOT at rest: {_speeds_text(self.speed, self.spin)}"
        landed = f"landed {self.error * 1e3:.2f} mm from its takeoff position, {how}"
        where = f"; the last cycles are in {self.path}" if self.path is not None else ""
        return f"{landed}; ended early: {self.reason}{where}" if self.reason else landed


class Leader:
    """Controller that moves the flotor along a minimum-jerk path.

    A soft spring and damper with weight compensation.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].
        delay: Total time from a sample to its command's effect [s].

    Attributes:
        period: Sample period [s].
    """

    def __init__(self, calibration: Calibration, period: float, delay: float) -> None:
        self.period = period
        body, self._scale = calibration.body, calibration.device.scale
        hold = Hold.critically_damped(inertia=body.inertia, period=period, delay=delay)
        self._controller = Controller([Bias(0.0 - body.load), hold], period=period)
        self.aim(straight(ZERO, ZERO, 1.0))

    def aim(self, path: Trajectory, off_path: Callable[[Sequence[float]], object] | None = None) -> None:
        """Start a path at the next sample.

        Args:
            path: The path; time 0 is the next sample.
            off_path: Called with the pose if the flotor does not follow.
        """
        self._path = path
        self._astray, self._first = off_path, -1
        self.motion = RecentMotion(self.period, self._scale)
        self._controller.reset()

    def step(self, sample: Sample) -> Command:
        """Return the command for one sample."""
        if self._first < 0:
            self._first = sample.tick
        self.motion.add(sample)
        goal = self._path.at((sample.tick - self._first) * self.period)
        error = [actual - target for actual, target in zip(sample.position, goal)]
        scale = self._scale
        astray = math.hypot(*error[:3]) > scale.path or math.hypot(*error[3:]) > scale.path_angle
        if astray and self._astray is not None:
            self._astray(sample.position)
        return self._controller.step(Sample(sample.tick, sample.time, error))


def straight(start: Sequence[float], end: Sequence[float], duration: float) -> Trajectory:
    """Return the minimum-jerk path between two poses [m, rad]; duration in [s]."""
    return Trajectory([0.0, number("duration", duration, above=0.0)], [list(start), list(end)])


class StopSwitch:
    """Switch that ends a flight by landing, or by cutting the currents.

    Attributes:
        landing: True if landing is requested.
    """

    def __init__(self) -> None:
        self.landing = False
        self._plant: GuardedPlant | None = None  # in flight

    def land(self) -> None:
        """Request landing, from any thread."""
        self.landing = True

    def cut(self) -> None:
        """Cut the currents by interrupting the flight, once; call only in the flight's thread."""
        self.landing = True
        plant, self._plant = self._plant, None
        if plant is not None and not plant.disarmed:
            interrupt()

    def signals(self) -> AbstractContextManager[None]:
        """Land at the first stop signal; cut at a second Ctrl-C, or if landing takes too long."""
        return stopping(self.land, self.cut, within=LANDING_TIME)

    @contextmanager
    def flying(self, plant: GuardedPlant) -> Iterator[None]:
        """Cut the currents of a flight on any error.

        An interrupt sends an emergency stop; any other error trips HOST.

        Raises:
            KeyboardInterrupt: If landing was requested before the start, or the currents were cut before takeoff.
            DeviceFault: If the currents were cut, by an interrupt or by an error after arming.
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
                raise PlantError(f"cut requested; {error}") from None
            plant.read()  # raises the fault after writing the last cycles
            raise KeyboardInterrupt("stopped before takeoff; ESTOP is latched in the device") from None
        except BaseException as error:
            self._plant = None
            where = line_of(error)
            plant.abort(f"{where}: " * (where is not None) + f"{type(error).__name__}: {error}")
            raise
        finally:
            self._plant = None


def _speeds_text(speed: float, spin: float) -> str:
    return f"{speed * 1e3:.2g} mm/s and {spin:.2g} rad/s"

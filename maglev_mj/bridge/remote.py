"""The plant that is a device at the other end of a wire: spots in, currents out; the controller knows nothing of it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.bridge.device import RemoteDevice
from maglev_mj.bridge.safety import WARNING_RISE, Envelope, FlotorGuard, OutputLimiter
from maglev_mj.bridge.wire import Command as CommandFrame
from maglev_mj.bridge.wire import Fault, Frame, State, StateReport
from maglev_mj.controller import Controller
from maglev_mj.errors import PlantError, SensingError
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.hand import Trajectory
from maglev_mj.laws import Bias, Hold
from maglev_mj.loop import ControlLoop
from maglev_mj.net.udp import Link, LinkError
from maglev_mj.parameters import number
from maglev_mj.sensing.solver import PoseTracker

__all__ = ["Leader", "RemotePlant"]

_ASIDE, _ASKEW = 0.002, math.radians(3.0)


class Leader:
    """A controller that leads the flotor along a minimum-jerk path by a soft spring and damper, and carries its weight.

    Args:
        calibration: What is known of the device.
        start: Where the path begins [m, rad], six components.
        end: Where it ends.
        duration: How long it takes [s].
        period: Sample period [s].
        delay: From a sample to its command taking effect [s], however it comes about.
        astray: Called with the pose where the flotor does not follow.

    Attributes:
        period: Sample period [s].

    Raises:
        ParameterError: If the duration is not above 0.
    """

    def __init__(
        self,
        calibration: Calibration,
        start: Sequence[float],
        end: Sequence[float],
        *,
        duration: float,
        period: float,
        delay: float,
        astray: Callable[[Sequence[float]], object],
    ) -> None:
        self.period = period
        self._path = Trajectory([0.0, number("duration", duration, above=0.0)], [list(start), list(end)])
        self._astray = astray
        inertia = np.concatenate([[calibration.mass] * 3, calibration.inertia])
        weight = np.concatenate([-calibration.mass * calibration.gravity, np.zeros(3)])
        hold = Hold.critically_damped(inertia=inertia, period=period, delay=delay)
        self._controller = Controller([Bias(weight), hold], period=period)
        self._first: int | None = None

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        if self._first is None:
            self._first = sample.tick
        goal = self._path.at((sample.tick - self._first) * self.period)
        off = [found - wanted for found, wanted in zip(sample.position, goal)]
        if math.hypot(*off[:3]) > _ASIDE or math.hypot(*off[3:]) > _ASKEW:
            self._astray(sample.position)
        return self._controller.step(Sample(sample.tick, sample.time, off))


_UNKNOWN = (math.nan,) * 6


class RemotePlant(RemoteDevice):
    """A device at the other end of a wire. The controller cannot tell it from `MuJoCoPlant`.

    The device is the clock: `read` waits for its next sample. A sample that was lost leaves a gap in the tick numbers.
    Six currents leave through one output limiter: finite, wrench limit, current limit, temperatures. What goes wrong
    ends in zero currents, a fault that is latched until `reset`, and a file with the last cycles.

    Args:
        link: The wire; see `open_link`. It is closed with the plant.
        calibration: What is known of the device, whose hash it must have.
        key: With which frames are sealed.
        envelope: Where and how fast the flotor may go.
        wrench_limit: Largest wrench, a number or (6,) [N, N m]; None for what the currents allow.
        patience: How long to wait for the device [s]: for an answer, and for a sample.
        folder: Where the last cycles before a fault are written.

    Attributes:
        period: Sample period [s].
        delay: From a command's arrival to its taking effect [s].
        lockstep: Whether the device's time waits for each answer.
        state: Of the device, at the last sample.
        faults: Likewise.
        last_currents: What was sent last [A], six.
        last_delay: From the sample before the last to its answer's taking effect, by the device's clock [s]; NaN where
            the command in force at the last sample answers another.
        rest: Where the flotor lay before it took off [m, rad]; where it is landed.
        samples: Their count, and what is missing of them.
        hand_wrench: Zero: nobody measures what the hand does.

    Raises:
        HandshakeError: If no device answers, or it will not have this host: another is flying it, its protocol is of
            another version, or its calibration is another.
        ParameterError: If a value is outside its bounds.
    """

    hand_wrench = ZERO

    def __init__(
        self,
        link: Link,
        *,
        calibration: Calibration | None = None,
        key: bytes | None = None,
        envelope: Envelope | None = None,
        wrench_limit: ArrayLike | None = None,
        patience: float = 1.0,
        folder: Path = Path(),
    ) -> None:
        super().__init__(link, calibration or Calibration.nominal(), key, patience, folder)
        self._guard = FlotorGuard(envelope or Envelope())
        self._track = PoseTracker(self.calibration.beams)
        offsets = self.calibration.spot_offsets
        self._offsets: list[float] | None = offsets.tolist() if offsets.any() else None
        welcome = self._line.welcome
        self.period, self.delay = welcome.period / 1e9, welcome.delay / 1e9
        self.lockstep, self.limits = bool(welcome.lockstep), self._line.limits
        self._output = OutputLimiter(self.calibration.coils, self.limits, wrench_limit, self.period)
        self._felt: Sequence[float] = ZERO  # what the device says of its coils' temperatures
        self._warned = False
        self.last_delay = math.nan
        self.rest: Sequence[float] = ZERO
        self._sequence = 0
        self._owed = False  # an answer, to the last sample
        self._known: Sequence[float] = ZERO  # the pose at the last sample

    def read(self) -> Sample:
        """Wait for the device's next sample and return what is measured there; the newest, if several are there.

        Raises:
            DeviceFault: If the device has gone into the fault state, or what it says is not to be trusted.
            PlantError: If the plant is closed.
        """
        self._check_open()
        if self._owed and self.lockstep:  # a device that waits for an answer gets the one before, without its pulse
            self._send(self.last_currents, None, 0.0)
        frame = self._next_frame()
        report: StateReport = frame.body  # type: ignore[assignment]
        out_of_step = self._account(frame, report)
        # one from before the device did what it was asked for is old
        if (report.state != self.state or report.faults != self.faults) and frame.time > self._line.settled:
            self._adopt(report.state, report.faults)
        if self.state == State.FAULT and self._armed:
            self._fail(self.faults, "asked for")
        position = self._locate(report.spots)
        wrong = self._guard.check(position, self.samples.elapsed * self.period)
        if self.state == State.ACTIVE:
            if out_of_step:
                self._fail(Fault.CLOCK, out_of_step)
            if wrong:
                self._fail(wrong, f"the flotor is at {_shown(position)}")
            if max(report.temperatures) >= WARNING_RISE or max(self._output.thermal.rises) >= WARNING_RISE:
                self._watch_temperatures()
        tick = self.samples.tick
        return Sample(tick, tick * self.period, position)

    def write(self, command: Command) -> Command:
        """Send the answer to the last sample; return it as applied, after every limit.

        Raises:
            DeviceFault: If the command is not finite.
            PlantError: If no sample was read.
        """
        self._check_open()
        if self.samples.tick < 0:
            raise PlantError("write() needs a sample: call read() first")
        try:
            command, held, pulsed, width = self._output.currents(command, self._known)
        except (PlantError, TypeError) as error:
            self._fail(Fault.INVALID_COMMAND, str(error))
        self._send(held, pulsed, width)
        self._owed = False
        self._output.passed(held, pulsed, width)
        self._box.keep((*self._row, self._seen, held, held if pulsed is None else pulsed, width))
        return command

    @property
    def temperatures(self) -> list[float]:
        """Of the six coils, the higher of what the device says and what was sent: 1 where they trip."""
        return [max(one, other) for one, other in zip(self._felt, self._output.thermal.rises)]

    def takeoff(self, duration: float = 0.6) -> None:
        """Arm, and lead the flotor from where it lies to the centre; keep hands off it.

        Args:
            duration: How long [s].

        Raises:
            DeviceFault: If it does not follow, or anything else goes wrong.
        """
        rest = list(self.read().position)
        self.arm()
        self.rest = rest
        self._lead(self.rest, ZERO, duration, self._astray)

    def land(self, duration: float = 0.6) -> None:
        """Lead the flotor back to where it lay, and disarm; a hand that holds it then has it.

        Raises:
            DeviceFault: As for `takeoff`.
        """
        self._lead(self.read().position, self.rest, duration, lambda place: None)
        self.disarm()

    def _lead(
        self, start: Sequence[float], end: Sequence[float], duration: float, astray: Callable[[Sequence[float]], object]
    ) -> None:
        known, period, delay = self.calibration, self.period, self.delay
        leader = Leader(known, start, end, duration=duration, period=period, delay=delay, astray=astray)
        ControlLoop(self, leader).cycle(max(round(duration / period), 1))

    def _astray(self, place: Sequence[float]) -> NoReturn:
        self._fail(Fault.NOT_FOLLOWING, f"the flotor is at {_shown(place)}, not where it is led")

    def _next_frame(self) -> Frame:
        """Return the newest STATE."""
        missing = f"no sample from the device within {self._patience:g} s"
        try:
            frame = self._line.state(self._patience)
        except LinkError as error:
            frame, missing = None, str(error)
        if frame is not None:
            return frame
        if self.state == State.ACTIVE:
            self._fail(Fault.HOST, missing)
        raise PlantError(missing)

    def _account(self, frame: Frame, report: StateReport) -> str:
        """Count a sample and its heat; return what is wrong with the device's clock, nothing where it keeps step."""
        answered, self._owed = not self._owed, False
        samples = self.samples
        out_of_step = samples.count(frame.sequence, frame.time, self._line.skipped)
        if (unanswered := samples.elapsed - answered) > 0:  # what nobody wrote for: the coils cool, or go on
            self._output.stay(unanswered, self.last_currents if self.state == State.ACTIVE else ZERO)
        self._felt = report.temperatures
        in_force = samples.elapsed == 1 and report.answered == self._sequence
        self.last_delay = self.period - report.age * 1e-6 + self.delay if in_force else math.nan
        self._sequence = frame.sequence
        self._row, self._seen = (frame.sequence, frame.time, report.state, report.faults, report.spots), _UNKNOWN
        return out_of_step

    def _locate(self, spots: Sequence[float]) -> list[float]:
        """Return the pose whose spots these are; an answer to it is owed."""
        if self._offsets is not None:
            spots = [spot - offset for spot, offset in zip(spots, self._offsets)]
        try:
            position = self._track(spots)
        except SensingError as error:
            if self.state == State.ACTIVE:
                self._fail(Fault.SENSOR_OUT_OF_RANGE, str(error))
            raise
        self._known = position
        self._seen = tuple(position)  # whoever gets the list may write in it
        self._owed = True
        return position

    def _send(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        self.last_currents = held
        one, other = tuple(held), tuple(held if pulsed is None else pulsed)
        try:
            self._line.command(CommandFrame(self._sequence, 0, one, other, width))
        except LinkError as error:
            if self.state == State.ACTIVE:
                self._fail(Fault.HOST, str(error))
            raise

    def _watch_temperatures(self) -> None:
        warmest = max(temperatures := self.temperatures)
        if warmest >= 1.0:
            self._fail(Fault.COIL_OVERTEMP, f"coil {temperatures.index(warmest)} bears no more")
        if not self._warned:
            self._warned = True
            warnings.warn(f"a coil is at {warmest:.0%} of what it bears", stacklevel=3)


def _shown(position: Sequence[float]) -> str:
    return ", ".join(f"{part * 1e3:.2f}" for part in position) + " (mm, mrad)"

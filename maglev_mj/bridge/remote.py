"""Plant at the other end of a wire: spots, currents."""

from __future__ import annotations

import gc
import math
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, Self, TypeAlias

import numpy as np

from maglev_mj.bridge import safety
from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.connection import Connection, EstopReport
from maglev_mj.bridge.fault import BlackBox, DeviceFault, HandshakeError
from maglev_mj.bridge.landing import TOLERATED, LandingReport, Leader, Motion, Swing, shown, straight
from maglev_mj.bridge.links import Link, LinkError, open_link
from maglev_mj.bridge.observer import HandObserver
from maglev_mj.bridge.safety import WARNING_RISE, CoilGuard, HostLimits, Limits, reading_fault
from maglev_mj.bridge.wire import NEVER, WRAP, Fault, Flag, Frame, Operation, State, StateReport, fault_names
from maglev_mj.bridge.wire import Command as CommandFrame
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import ParameterError, PlantError, SensingError
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.parameters import flag, number
from maglev_mj.plants.hand import Trajectory
from maglev_mj.plants.sensor import PoseTracker
from maglev_mj.spec import Spec

_INACTIVE, _ACTIVE, _FAULT = State  # an enumeration's members are slow to look up
_ENABLED, _HOLDING = Flag.ENABLED.value, Flag.HOLDING.value
_NAN, _UNKNOWN = math.nan, (math.nan,) * 6
_ON_STOP = 0.6 * Spec.translation_range.value

_TRY = 0.15
_TRIES = [7e-4, 0.0, 0.0, 0.0, 0.0, 0.007], [-3.5e-4, 6e-4, 0.0, 0.0, 0.0, -0.007], ZERO
"""Poses around the centre that need each coil [m, rad], and time to each [s]."""

_SETTLING, _WATCHING = 0.3, 0.2
"""Longest wait for rest before disarming, and observation after it [s]."""

_Watch: TypeAlias = Callable[[], object]
_MOST = Limits(current_limit=20.0, continuous_current=20.0, hover_limit=20.0)


class RemotePlant:
    """Plant at the other end of a wire.

    It has the interface of `MuJoCoPlant`, for one thread. The device is the clock: `read` waits for its next sample. A
    lost sample leaves a gap in the tick numbers. Six currents leave through one output limiter: finite, wrench limit,
    current limit, temperatures. A failure ends in zero currents, a fault until `reset`, and a file of the last cycles.

    Args:
        link: The wire, or its address; see `open_link`. It is closed with the plant, or if the handshake fails.
        calibration: Calibration of the device; the device must have its hash.
        key: Authentication key of the frames; None for none.
        limits: Limits of the host; the smaller of these and the device's apply.
        patience: Longest wait for an answer or a sample [s].
        folder: Folder of black box files.

    Attributes:
        period: Sample period [s].
        delay: Time from a command's arrival to its effect [s].
        lockstep: True if the device's time waits for each answer.
        limits: The smaller of the device's and the host's; `stated` are the device's.
        latched: One line about faults that were latched in the device at the handshake; empty without faults.
        disarmed: True after this host armed the device and switched the currents off.
        guided: True in takeoff and landing: the default envelope applies if it is the larger.
        doubt: Fault of the last sample's numbers, as text; empty if they are plausible.
        state: State of the device at the last sample; `faults` are its faults then.
        first: First faults, at `fault_time` by the device's clock [ns]; 0 without faults.
        last_currents: Last sent currents [A], six.
        last_delay: Time from the last but one sample to its answer's effect, by the device's clock [s]; NaN if the
            command in force at the last sample answers another.
        newest_delay: The same for the newest answer that has arrived, to any sample; NaN without a new one.
        lateness: The same, or without a new one the least that the next answer's delay can be.
        pose: Last known pose [m, rad].
        rest: Pose before takeoff and target of the landing [m, rad].
        answer_latency: Time from the last sample's arrival to its answer [s].
        answered_tick: Number of the sample that the newest answer arrived at the device answers.
        transport: Clock difference between last sample and arrival [ns], offset unknown.
        samples: Counter of received, lost and skipped samples.
        hand_wrench: The hand's wrench as estimated, low-passed at 20 Hz [N, N m]; NaN unless the device is active. A
            touched stop counts as a hand; see `HandObserver`.
        coils: Estimator of the coils' gains in takeoff.
        arrival: Arrival of the last sample, by the link's clock [s].

    Raises:
        HandshakeError: If no device answers, another host flies it, its version or calibration differs, or its
            numbers are not sane or do not carry the weight.
        LinkError: If the link has failed.
        ParameterError: If a value is outside its bounds, or the host's own limits do not carry the weight.

    Example:
        >>> from maglev_mj.bridge import Twin, TwinParameters
        >>> from maglev_mj.bridge.twin import simulated_links
        >>> RemotePlant(simulated_links.VirtualLink(Twin(TwinParameters()))).period
        0.005
    """

    hand_wrench = property(lambda self: self._hand.wrench)
    coils = property(lambda self: self._hand.coils)
    arrival = property(lambda self: self._line.heard * 1e-9)

    def __init__(
        self,
        link: Link | str,
        *,
        calibration: Calibration | None = None,
        key: bytes | None = None,
        limits: HostLimits | None = None,
        patience: float = 1.0,
        folder: Path | str = Path(),
    ) -> None:
        known, own, link = calibration or Calibration.nominal(), limits or HostLimits(), open_link(link, key)
        self.calibration = known
        self._hover: list[float] = known.hover.tolist()
        weight = known.mass * math.hypot(*known.gravity)
        if said := safety.weight_fault(weight, self._hover, own, own.narrowed(_MOST)):
            link.close()
            raise ParameterError(said)
        self._line = Connection(link, known.digest, key, patience)
        try:
            self._patience, welcome, profile = patience, self._line.welcome, self._line.profile
            self.stated, self.limits = profile.limits, own.narrowed(profile.limits)
            if said := safety.weight_fault(weight, self._hover, own, self.limits):
                raise HandshakeError(f"the device does not carry the flotor: {said}")
            self.period, self.delay = profile.period / 1e9, profile.delay / 1e9
            self.lockstep, self.latched = profile.lockstep, self._line.latched
            self.state, self.faults = State(welcome.state), Fault(welcome.faults)
            self.first, self.fault_time = Fault(welcome.first), welcome.fault_time
            self.samples = self._line.samples
            self._box = BlackBox(Path(folder))
            self._spots, self._guard = safety.SpotGuard(self.limits, self.period), safety.FlotorGuard(own)
            self._track = PoseTracker(known.beams)
            self._offsets: list[float] | None = known.spot_offsets.tolist() if known.spot_offsets.any() else None
            self._output = safety.OutputLimiter(known.coils, self.limits, own.wrench, self.period)
            self._leader = Leader(known, self.period, self.delay)
            self._hand = HandObserver(known, self.period)
            self._tolerant = Leader(known, self.period, TOLERATED)
        except BaseException:
            self._line.close()
            raise
        self.last_currents: Sequence[float] = ZERO
        self.rest: Sequence[float] = ZERO
        self.last_delay = self.newest_delay = _NAN
        self.lateness = self.delay
        self._answered: int | None = None  # by the newest answer
        # armed by this host, and nothing has ended it that was reported
        self.disarmed = self._armed = self._warned = False
        self.guided = self._owed = False  # an answer is owed to the last sample
        self.answered_tick = self.transport = 0
        self.answer_latency = 0.0
        self._coils = CoilGuard()
        self._open = 0  # samples in a row without ENABLED
        self._sequence, self._located, self.doubt = 0, 0, ""  # last sample, last known pose
        self._frame: Frame | None = None  # the last sample
        self._seen: Sequence[float] = _UNKNOWN  # its pose
        self.pose: Sequence[float] = ZERO

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        try:
            if isinstance(error, Exception):
                with suppress(Exception):
                    self.abort(f"{type(error).__name__}: {error}")
        finally:
            self.close()

    def close(self) -> None:
        """Switch the currents off and end the session; idempotent."""
        self._armed = False
        self._line.close()

    def read(self) -> Sample:
        """Return the next sample, or the newest of several waiting.

        Raises:
            DeviceFault: If the device has gone into the fault state, or its measurements are implausible.
            PlantError: If the plant is closed.
        """
        self._check_open()
        if self._owed and self.lockstep:  # a device that waits for an answer gets the one before, without its pulse
            self._send(self.last_currents, None, 0.0)
        frame = self._next_frame()
        report: StateReport = frame.body  # type: ignore[assignment]
        self._account(frame, report)
        # a sample from before the device's last answer holds an outdated state
        if (report.state != self.state or report.faults != self.faults) and frame.time > self._line.settled:
            self._adopt(report.state, report.faults)
        if self.state is _FAULT and self._armed:
            self.fail(self.faults, "asked for")
        samples, limits = self.samples, self.limits
        fault = self._spots.check(report.spots, report.valid, report.conversions, samples.elapsed)
        wrong = reading_fault(limits, report.currents, report.temperatures)
        if fault or wrong or self.doubt:
            self._mistrust(fault | wrong, report)
        position = self._locate(report.spots)
        tick, active = samples.tick, self.state is _ACTIVE
        if wrong := self._guard.check(position, (tick - self._located) * self.period, self.guided or not active):
            self._suspect(wrong, f"the flotor is at {shown(position)}")
        self._located = tick
        # a sample from before arming need not be ENABLED
        self._open = 0 if report.flags & _ENABLED or report.state != _ACTIVE else self._open + 1
        if active:
            self._hand.tries = self.guided
            self._hand.sampled(tick, samples.elapsed, self._seen, self.answered_tick, self.newest_delay)
            if (flows := self._hand.currents) is not None and self._coils.check(flows, report.currents):
                amperes = (", ".join(f"{one:.2f}" for one in six) for six in (report.currents, flows))
                self.fail(Fault.COIL_NOT_FOLLOWING, "the device measures {} A, and was told {} A".format(*amperes))
            if report.flags & _HOLDING and report.age * 1e-6 < 2.0 * self.period:
                self.fail(Fault.HOST, f"the device is HOLDING for want of answers, the newest {report.age} µs old")
            if self._open > 1:
                self.fail(Fault.HOST, "the amplifiers are not ENABLED, and the device does not cut the currents")
            if samples.out_of_step:
                self.fail(Fault.CLOCK, samples.out_of_step)
            if max(report.temperatures) >= WARNING_RISE or self._output.thermal.warmest >= WARNING_RISE:
                self._watch_temperatures()
        return Sample(tick, tick * self.period, position)

    def write(self, command: Command) -> Command:
        """Send the answer to the last sample; return it limited.

        Raises:
            DeviceFault: If the command is not finite.
            PlantError: If no sample was read.
        """
        frame = self._answered_frame("write")
        try:
            command, held, pulsed, width = self._output.currents(command, self.pose)
        except (PlantError, TypeError) as error:
            self.fail(Fault.INVALID_COMMAND, str(error))
        self._answer(frame, held, pulsed, width)
        self._hand.answered(self.samples.tick, command, held, pulsed, width)
        return command

    def drive(self, currents: Sequence[float]) -> None:
        """Send six coil currents [A] in place of a wrench.

        Raises:
            ParameterError: If one is not finite or above the limit.
            PlantError: If no sample was read.
        """
        frame = self._answered_frame("drive")
        if safety.command_fault(self.limits, currents, currents, 0.0):
            raise ParameterError(f"currents must be within {self.limits.current_limit:g} A, not {list(currents)}")
        self._answer(frame, currents, None, 0.0)
        wrench = self.calibration.coils.wrench(np.asarray(currents)).tolist()
        self._hand.answered(self.samples.tick, Command(wrench), currents, None, 0.0)

    def _answered_frame(self, call: str) -> Frame:
        self._check_open()
        if self._frame is None:
            raise PlantError(f"{call}() needs a sample: call read() first")
        return self._frame

    def _answer(self, frame: Frame, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        self._send(held, pulsed, width)
        self._owed = False
        if self.state is _ACTIVE:
            self._output.passed(held, pulsed, width)
        else:
            self._output.stay(1, ZERO)
        self._box.keep((frame, self._seen, held, pulsed, width, self.last_delay, self.answer_latency))

    @property
    def report(self) -> StateReport:
        """Device's report at the last sample; PlantError before the first."""
        if self._frame is None:
            raise PlantError("there is no sample: call read() first")
        return self._frame.body  # type: ignore[return-value]

    @property
    def temperatures(self) -> list[float]:
        """Temperature rises of the coils, reported or modelled; 1 trips."""
        said = ZERO if self._frame is None else self._frame.body.temperatures  # type: ignore[union-attr]
        return [max(one, other) for one, other in zip(said, self._output.thermal.rises)]

    def arm(self, hover: Sequence[float] | None = None) -> None:
        """Switch the currents on; PlantError if the device refuses.

        Args:
            hover: Held by the device if commands are missing [A], six; by default the currents that carry the flotor.
        """
        self._ask(Operation.ARM, hover=self._hover if hover is None else hover)
        self.state, self._armed, self.guided = _ACTIVE, True, False
        self._hand.reset()
        self._coils = CoilGuard()

    def disarm(self) -> None:
        """Switch the currents off."""
        self._ask(Operation.DISARM)
        self._armed, self.disarmed = False, True
        self._hand.reset()
        if self.state is _ACTIVE:
            self.state = _INACTIVE

    def estop(self) -> EstopReport:
        """Switch the currents off in any state and latch ESTOP.

        PlantError if the device does not confirm it. The next sample is a fault.
        """
        self._check_open()
        report = self._line.estop()
        self._latch(Fault.ESTOP, report.at)
        if not report.confirmed:
            raise PlantError(f"emergency stop {report}")
        return report

    def reset(self) -> None:
        """Leave the fault state; PlantError while the coils are warm."""
        self._ask(Operation.RESET)
        self.state, self.faults, self.first, self.fault_time, self._armed = _INACTIVE, Fault(0), Fault(0), 0, False

    def trip(self, faults: Fault) -> None:
        """Put the device into the fault state, answered or not."""
        self._latch(faults, self.samples.time)
        with suppress(LinkError):  # the watchdog does it where there is no line
            self._line.control(Operation.TRIP, faults=faults)

    def abort(self, reason: str) -> None:
        """Trip a device that this host armed; DeviceFault then."""
        if self._armed:
            self._fail_if_active(Fault.HOST, reason)

    def takeoff(self, duration: float = 0.6, *, watch: _Watch | None = None, tries: bool = False) -> None:
        """Check rest, arm, and move the flotor to the centre.

        Untouched for 0.1 s, it must rest: up to 5 mm/s and 0.1 rad/s. Slow work is done before the currents flow.

        Args:
            duration: Time of the motion [s].
            watch: Called after each sample of the motion; True ends it early.
            tries: True to move by 0.7 mm and 7 mrad around the centre in 0.45 s more, which tries each coil.

        Raises:
            DeviceFault: If the flotor does not follow, or another fault occurs.
            PlantError: If the flotor moves, is not on its lower stop or not measured: the device is not armed; or if a
                coil that was tried is not as calibrated: it has landed.
        """
        flag("tries", tries)
        self._check_open()
        self.require_inactive()
        leader, loop = self._leader, ControlLoop(self, self._leader)
        gc.collect()
        motion = self._observed(0.0)
        if self.doubt or not motion.full:
            raise PlantError(f"no takeoff: {self.doubt or 'the flotor is not measured'}")
        rest = motion.pose
        if not motion.at_rest:
            raise PlantError(f"no takeoff: the flotor moves at {motion}, and must rest")
        gravity = self.calibration.gravity.tolist()
        # with respect to gravity; without any no pose is off the lower stop
        if sum(one * other for one, other in zip(rest, gravity)) < _ON_STOP * math.hypot(*gravity):
            raise PlantError(f"no takeoff: the flotor is at {shown(rest)}, and must lie on its lower stop")

        def astray(pose: Sequence[float]) -> NoReturn:
            why = (said := self.coils.fault(lost=True)) and f"; {said}"
            self.fail(Fault.NOT_FOLLOWING, f"the flotor is at {shown(pose)}, not where it is led{why}")

        leader.aim(straight(rest, rest, duration))
        loop.cycle(2)  # the device ignores these answers; slow first calls are done
        poses = [rest, ZERO, *(_TRIES if tries else ())]
        times = [0.0, *(number("duration", duration, above=0.0) + _TRY * leg for leg in range(len(poses) - 1))]
        leader.aim(Trajectory(times, poses), astray)
        self.arm()
        self.rest, self.guided = rest, True
        try:
            ended = self._lead(loop, times[-1], watch)
            why = self.coils.fault() if tries and not ended else ""
        finally:
            self.guided = False
        if why:
            self._landed(leader, duration, None)
            raise PlantError(f"no flight: {why}; landed again: keep hands off while it takes off, or calibrate it anew")

    def land(self, duration: float = 0.6, *, watch: _Watch | None = None, reason: str = "") -> LandingReport:
        """Move the flotor back to its rest pose and disarm.

        Args:
            duration: Time of the motion [s]; up to 0.3 s more until it rests.
            watch: As for `takeoff`.
            reason: Why the flight is ended early; "" if it is not. Then a softer hold leads, stable up to 50 ms
                of delay, and the cycles before are written to a file; a flotor that still swings is cut.

        Returns:
            Pose and motion 0.2 s later.

        Raises:
            DeviceFault: As for `takeoff`.
        """
        if not reason:
            return self._landed(self._leader, duration, watch)
        cycles, swing = self._box.cycles, Swing()

        def calm() -> bool:
            if self.state is _ACTIVE and (speed := swing.check(self.pose, self.samples.tick * self.period)):
                self.fail(Fault.HOST, f"{reason}; in the landing it still moved at {speed:.2f} m/s")
            return watch is not None and bool(watch())

        report = self._landed(self._tolerant, duration, calm)
        path = self._box.write(Fault(0), reason, self._about(), cycles)
        return report._replace(reason=reason, path=path)

    def require_inactive(self) -> None:
        """Refuse a device that is not inactive."""
        if self.state is not _INACTIVE:
            raise PlantError(f"no takeoff: the device is {self.state.name}, faults {fault_names(self.faults)}")

    def _landed(self, leader: Leader, duration: float, watch: _Watch | None) -> LandingReport:
        """Lead the flotor back to its rest pose and disarm."""
        loop, self.guided = ControlLoop(self, leader), True
        leader.aim(straight(self.pose, self.rest, duration))
        self._lead(loop, duration, watch)
        end = self.samples.tick + round(_SETTLING / self.period)
        while self.samples.tick < end and not leader.motion.at_rest:
            loop.cycle()
        self.disarm()
        motion = self._observed(_WATCHING)
        rests = motion.at_rest and not self.doubt
        return LandingReport(math.dist(motion.pose[:3], self.rest[:3]), *motion.speeds, rests)

    def _lead(self, loop: ControlLoop, duration: float, watch: _Watch | None) -> bool:
        """Run a loop for a time [s]; return True if it was ended early."""
        end = self.samples.tick + max(round(duration / self.period), 1)
        while self.samples.tick < end:
            loop.cycle()
            if watch is not None and watch():
                return True
        return False

    def _observed(self, duration: float) -> Motion:
        """Observe motion for `duration` [s] and until known or doubtful."""
        motion, self.doubt = Motion(self.period), ""
        end = self.samples.tick + round(duration / self.period)
        while self.samples.tick < end or not (motion.full or self.doubt):
            try:
                motion.add(self.read())
            except SensingError as error:
                self.doubt = str(error)
        return motion

    def _ask(self, operation: Operation, *, hover: Sequence[float] = ZERO) -> None:
        self._check_open()
        answer = self._line.control(operation, hover=hover)
        if answer is None:
            raise PlantError(f"the device did not answer {operation.name} within {self._patience:g} s")
        if answer.result:
            hint = "; see to it, then reset" if answer.state == _FAULT else ""
            state = State(answer.state).name if answer.state in tuple(State) else f"in state {answer.state}"
            names = fault_names(answer.faults)
            raise PlantError(f"the device refused {operation.name}: it is {state}, faults {names}{hint}")

    def _check_open(self) -> None:
        if not self._line.open:
            raise PlantError("the plant is closed")

    def _next_frame(self) -> Frame:
        try:
            if (frame := self._line.state(self._patience)) is not None:
                return frame
        except Exception as error:
            self._fail_if_active(Fault.HOST, str(error))
            raise
        missing = f"no sample from the device within {self._patience:g} s"
        self._fail_if_active(Fault.HOST, missing)
        raise PlantError(missing)

    def _account(self, frame: Frame, report: StateReport) -> None:
        """Store a sample and update the temperatures up to it."""
        answered, self._owed = not self._owed, False
        elapsed = self.samples.elapsed
        if (unanswered := elapsed - answered) > 0:  # without a command the coils cool, or keep their currents
            self._output.stay(unanswered, self.last_currents if self.state is _ACTIVE else ZERO)
        behind = (frame.sequence - report.answered) & WRAP
        self.answered_tick, self.transport = self.samples.tick - behind, self._line.heard - frame.time
        known = report.age != NEVER and report.answered != self._answered
        self._answered = report.answered
        self.newest_delay = behind * self.period - report.age * 1e-6 + self.delay if known else _NAN
        self.last_delay = self.newest_delay if elapsed == behind == 1 else _NAN
        # the answer after the newest that has arrived is at least so late
        self.lateness = self.newest_delay if known else (behind - 1) * self.period + self.delay
        self._sequence, self._frame, self._seen = frame.sequence, frame, _UNKNOWN

    def _adopt(self, state: int, faults: int) -> None:
        if state not in tuple(State):
            self.fail(Fault.HOST, f"the device says that it is in state {state}, which is none")
        if (state == _FAULT) != bool(faults):
            self.fail(Fault.HOST, f"the device says state {State(state).name} with faults {fault_names(faults)}")
        before = self.state
        if state == _FAULT:
            self._latch(Fault(faults), self.samples.time)
        self.state, self.faults = State(state), Fault(faults)
        if self.state is _FAULT is not before:
            self.fail(self.faults, "said by the device")
        if self.state is _INACTIVE and before == _ACTIVE:
            self.fail(Fault.HOST, "the device switched its currents off without being asked to")

    def _mistrust(self, fault: Fault, report: StateReport) -> None:
        """Note a fault in a sample's numbers, or clear it."""
        self.doubt = ""
        if not fault:
            return
        spots = ", ".join(f"{part * 1e3:.3f}" for part in report.spots)
        rest = [f"{part:.3g}" for part in (*report.currents, *report.temperatures)]
        said = f"spots {spots} mm, valid {report.valid:03b}, conversion {report.conversions}"
        if fault & (Fault.COIL_OVERCURRENT | Fault.COIL_OVERTEMP):
            said = f"measured currents {', '.join(rest[:6])} A, temperatures {', '.join(rest[6:])}"
        self._suspect(fault, said)

    def _suspect(self, fault: Fault, said: str) -> None:
        self.doubt = f"{fault_names(fault)}: {said}"
        self._fail_if_active(fault, said)

    def _fail_if_active(self, fault: Fault, said: str) -> None:
        if self.state is _ACTIVE:
            self.fail(fault, said)

    def _locate(self, spots: Sequence[float]) -> list[float]:
        """Return the pose of spots; its answer is then due."""
        if self._offsets is not None:
            spots = [spot - offset for spot, offset in zip(spots, self._offsets)]
        try:
            position = self._track(spots)
        except SensingError as error:
            self._fail_if_active(Fault.SENSOR_OUT_OF_RANGE, str(error))
            raise
        self.pose, self._owed = position, True
        self._seen = tuple(position)  # the caller may write into the list
        return position

    def _send(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        self.last_currents = held
        one = tuple(held)
        try:
            self._line.command(CommandFrame(self._sequence, 0, one, one if pulsed is None else tuple(pulsed), width))
            self.answer_latency = self._line.latency * 1e-9
        except Exception as error:
            self._fail_if_active(Fault.HOST, str(error))
            raise

    def _watch_temperatures(self) -> None:
        warmest = max(temperatures := self.temperatures)
        if warmest >= 1.0:
            self.fail(Fault.COIL_OVERTEMP, f"coil {temperatures.index(warmest)} bears no more")
        if not self._warned:
            self._warned = True
            warnings.warn(f"a coil is at {warmest:.0%} of what it bears", stacklevel=3)

    def _latch(self, faults: Fault, time: int) -> None:
        if not self.faults:
            self.first, self.fault_time = faults, time
        self.state, self.faults = _FAULT, self.faults | faults

    def fail(self, faults: Fault, message: str) -> NoReturn:
        """Trip the device, write the black box, raise DeviceFault."""
        self._armed = False
        if self.state is not _FAULT or not self.faults & faults:
            with suppress(Exception):  # report and black box must not depend on the line
                self.trip(faults)
        faults |= self.faults  # such as an e-stop, after which it fell
        if (frame := self._frame) is not None:
            self._box.keep((frame, self._seen, self.last_currents, None, 0.0, self.last_delay, self.answer_latency))
        raise DeviceFault(faults, message, self._box.write(faults, message, self._about()))

    def _about(self) -> dict[str, Any]:
        about = {"first": fault_names(self.first), "fault_time_ns": self.fault_time, "period_ns": self.samples.period}
        return about | {name: getattr(self.samples, name) for name in ("tick", "lost", "skipped")}

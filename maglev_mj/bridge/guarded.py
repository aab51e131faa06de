"""Remote device with guards: spots in, currents out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, Self, TypeAlias

import numpy as np

from maglev_mj.bridge import safety
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.connection import Connection, EstopReport
from maglev_mj.bridge.fault import DeviceFault, HandshakeError, LastCycles
from maglev_mj.bridge.flight_guards import Alarm, DeviceSample, When, device_guards
from maglev_mj.bridge.links import Link, LinkError, open_link
from maglev_mj.bridge.observer import UNKNOWN, HandObserver
from maglev_mj.bridge.safety import HostLimits, Limits
from maglev_mj.bridge.wire import (
    CUT,
    CommandFrame,
    Ending,
    Fault,
    Flag,
    Frame,
    Operation,
    State,
    StateReport,
    WallMessage,
    fault_names,
)
from maglev_mj.errors import ParameterError, PlantError, SensingError, check_instance
from maglev_mj.frames import ZERO, Command, DeviceWall, Sample
from maglev_mj.keywords import checked, every_tick, explained
from maglev_mj.parameters import numbers
from maglev_mj.plants.coils import wrench_of
from maglev_mj.plants.sensor import tracker_of

_INACTIVE, _ACTIVE, _FAULT = State  # enum member lookup is slow
_STOPPING = Flag.STOPPING.value
_PROOFS = 20
"""Samples in which the currents must be off after a cut or a controlled stop."""
_WALLED = 3
"""Samples in which currents of walls may flow after the device has answered a command without walls."""
_BEFORE = -(2**63)  # tick before any answer
_Walls: TypeAlias = tuple[WallMessage, ...]
_LARGEST = Limits(current_limit=20.0, continuous_current=20.0, hover_limit=20.0)


def _weight_fault(calibration: Calibration, own: HostLimits, limits: Limits) -> str:
    weight = calibration.mass * math.hypot(*calibration.gravity)
    return safety.weight_fault(weight, calibration.hover.tolist(), own, limits)


@checked(own="link")
class GuardedPlant:
    """Remote device with guards, without takeoff and landing; see `RemotePlant`.

    Arguments and errors are those of `RemotePlant`.

    Attributes:
        period: Sample period [s].
        delay: Time from a command's arrival to its effect, plus the age of a pose at its sample [s].
        lockstep: True if the device waits for each answer.
        limits: The smaller of the device's and the host's limits; `stated` are the device's.
        scale: Thresholds that follow from the device's file.
        walls_clock: Sample period and delay of walls on the device [s]; None for a device without walls.
        renders_walls: True if the device renders walls at its own rate.
        latched: Faults latched in the device at the handshake, as one line; empty without faults.
        cycles: Last cycles, written to a file on a fault.
        guards: Checks of each sample, in order; an alarm in flight ends it, see `end`.
        disarmed: True after this host armed the device and switched the currents off again.
        guided: True in takeoff and landing; the larger of the device's own and the chosen envelope then applies.
        reason: Reason to land since ARM, of the first alarm without a fault; empty without. Then only the weight is
            carried, until the landing.
        alarm: First alarm of the guards for the last sample, as text; empty without.
        state: State of the device at the last sample; `faults` are its faults then.
        first: First faults, at `fault_time` by the device's clock [ns]; 0 without faults.
        last_currents: Last sent currents [A], six.
        pose: Last measured pose [m, rad].
        answers: Delays of answers, as reported with the last sample; see `AnswerTiming`. `last_delay` is one of them.
        answer_latency: Time from the last sample's arrival to its answer [s].
        samples: Counter of received, lost and skipped samples.
        hand_wrench: Estimated wrench of the hand, low-passed at 20 Hz [N, N m]; NaN unless the device is active.
            Includes contact with a stop; see `HandObserver`.
        sensor_delay: Largest delay of the sensor in flight [s], 0 if none was found; see `Residual`.
        coils: Estimator of the coil gains in takeoff.
        failing_coil: Message about a coil that fails in flight, "" without; see `Residual`.
        probes: Probes of the last flight by their outcome, as text; "" without.
        arrival: Arrival time of the last sample, by the link's clock [s].
    """

    hand_wrench = property(lambda self: self._hand.wrench)
    sensor_delay = property(lambda self: self._hand.residual.delay)
    coils = property(lambda self: self._hand.coils)
    failing_coil = property(lambda self: self._hand.residual.coil)
    arrival = property(lambda self: self._connection.arrival * 1e-9)
    answers = property(lambda self: self._connection.answers)
    last_delay = property(lambda self: self._connection.answers.last_delay)
    answer_latency = property(lambda self: self._connection.latency * 1e-9)

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
        link = open_link(link, key)
        calibration = calibration or Calibration.nominal()
        self.scale = scale = calibration.device.scale
        self._own_limits = host = (limits or HostLimits()).scaled(scale)
        if problem := _weight_fault(calibration, host, host.narrowed(_LARGEST)):
            link.close()
            raise ParameterError(problem)
        self._connection = Connection(link, calibration.digest, key, patience)
        try:
            welcome, profile = self._connection.welcome, self._connection.profile
            self.stated, self.limits = profile.limits, host.narrowed(profile.limits)
            if problem := _weight_fault(calibration, host, self.limits):
                raise HandshakeError(f"the device cannot hover: {problem}")
            if problem := safety.off_fault(profile.limits, calibration.device):
                raise HandshakeError(f"the device cannot tell that its coils are off: {problem}")
            self.period, self.delay = profile.period / 1e9, (profile.delay + profile.latency) / 1e9
            self.lockstep, self.latched = profile.lockstep, self._connection.latched
            self.state, self.faults = State(welcome.state), Fault(welcome.faults)
            self.first, self.fault_time = Fault(welcome.first), welcome.fault_time
            self.samples = self._connection.samples
            self.guards = device_guards(self.limits, host, self.period, scale)
            self.cycles = LastCycles(Path(folder))
            self._track = tracker_of(calibration.beams, scale.reach)
            offsets = calibration.spot_offsets
            self._offsets: list[float] | None = offsets.tolist() if offsets.any() else None
            self._output = safety.OutputLimiter(calibration.coils, self.limits, host.wrench, self.period)
            step, delay = profile.wall_period / 1e9, profile.wall_delay / 1e9
            self.walls_clock = (step, delay) if step else None
            self.renders_walls = self.walls_clock is not None
            self._hand = HandObserver(
                calibration, self.period, self.delay, age=0.5 * step - delay, seed=self._connection.session
            )
            self._maps = calibration.wall_maps
            self._carry(calibration)
        except BaseException:
            self._connection.close()
            raise
        self.last_currents: Sequence[float] = ZERO
        # armed by this host, with no end of the flight reported
        self.disarmed = self._armed = False
        self.probes = ""
        self.guided = False
        self.reason = ""
        self.unanswered: Sample | None = None  # an answer that is too late is ignored by the device
        self._pose_tick, self.alarm = 0, ""
        self._frame: Frame | None = None  # the last sample
        self._sample: DeviceSample | None = None  # as the guards see it
        self._located: Sequence[float] = UNKNOWN  # its pose
        self.pose: Sequence[float] = ZERO
        self._forget_walls()

    def check_walls(self, walls: Sequence[DeviceWall]) -> _Walls:
        """Return walls as sent to the device.

        Raises:
            ParameterError: If the device cannot render one, with its limit.
        """
        sent = tuple([WallMessage(axis, side, edge, k, b, cutoff or 0.0) for axis, edge, side, k, b, cutoff in walls])
        if problem := self._connection.profile.wall_problem(sent):
            raise ParameterError(problem)
        return sent

    def _on_device(self, walls: Sequence[DeviceWall]) -> _Walls:
        """Return walls as sent: edges in the device's linearised pose, exact at the last sample.

        Raises:
            ParameterError: As `check_walls`, or if the device refuses an edge.
        """
        linear = self._maps.pose(self.report.spots)
        shift = [part - exact for part, exact in zip(linear, self.pose)]
        sent = tuple([wall._replace(edge=wall.edge + shift[wall.axis]) for wall in self.check_walls(walls)])
        periods = self.samples.tick - self._answered_tick
        if problem := self._connection.profile.edge_problem(sent, self._walls, linear, periods):
            raise ParameterError(problem)
        return sent

    def _forget_walls(self) -> None:
        """Forget the walls of earlier commands: a device that is armed has none."""
        self._walls: _Walls = ()  # of the last command
        self._answered_tick = 0  # tick of the last command
        self._walled_tick, self._walled_until = _BEFORE, _BEFORE  # last command with walls; last tick of their currents

    def _carry(self, calibration: Calibration) -> str:
        """Take the mass and inertia of a calibration; return a message if the limits do not allow hovering, else ""."""
        self.calibration = calibration
        self._hover: list[float] = calibration.hover.tolist()
        self._stop = calibration.controlled_stop(self.period + self.delay, self.limits.continuous_current)
        self._carrying = Command((0.0 - calibration.body.load).tolist())
        self._prepare()
        return _weight_fault(calibration, self._own_limits, self.limits)

    def _prepare(self) -> None:
        """Do slow work before takeoff."""

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
        self._connection.close()

    def read(self) -> Sample:
        """Return the next sample, or the newest of several waiting.

        Raises:
            DeviceFault: If the device entered the fault state, or a guard raised an alarm in flight.
            PlantError: If the plant is closed.
        """
        self._check_open()
        if self.unanswered and self.lockstep:  # the device waits: repeat the previous answer, without its pulse
            self._send(self.last_currents, None, 0.0, self._walls)
        before, frame, samples = self._frame, self._linked(self._connection.state), self.samples
        unanswered = samples.elapsed - (self.unanswered is None)
        if unanswered > 0:  # no new command: currents are held, or zero
            self._output.add_periods(unanswered, self.last_currents if self.state is _ACTIVE else ZERO)
        self._frame, self._located, self.unanswered = frame, UNKNOWN, None
        report: StateReport = frame.body
        # a sample from before the device's last answer reports an outdated state
        if (report.state != self.state or report.faults != self.faults) and frame.time > self._connection.settled:
            self._adopt(report.state, report.faults)
        if self.state is _FAULT and self._armed:
            self.fail(self.faults, "requested by this host")
        active, hand = self.state is _ACTIVE, self._hand
        # walls stand until a command without them has arrived, however long the host is silent
        if self._connection.answers.answered_tick <= self._walled_tick:
            self._walled_until = samples.tick + _WALLED
        hand.measured = report.currents if samples.tick <= self._walled_until else None
        since, error = (samples.tick - self._pose_tick) * self.period, self._locate(report.spots)
        if active and error is None:
            answers = self._connection.answers
            hand.sampled(samples.tick, samples.elapsed, self._located, answers.answered_tick, answers.newest_delay)
        previous: Any = before.body if before is not None else None
        guided, modelled = self.guided or not active, self._output.thermal.rises
        backwards = hand.residual.reversed and not hand.check_coils  # in takeoff a coil is named
        self._sample = DeviceSample(
            report, previous, samples, active, guided, self._located, error, since, hand.currents, modelled, backwards
        )
        self.alarm = ""
        self.check_guards(When.SAMPLED)
        if error is not None:
            raise error
        return self.unanswered  # type: ignore[return-value]  # stored with the pose

    @every_tick
    def write(self, command: Command) -> Command:
        """Send a command as the answer to the last sample; return it as limited.

        Raises:
            DeviceFault: If the command is not finite.
            ParameterError: If it is not a command; nothing is sent.
            PlantError: If no sample was read.
        """
        self._check_sample("write")
        check_instance("command", command, Command, "a Command")
        try:
            walls = self._on_device(command.walls) if command.walls else ()
            command, held, pulsed, width = self._output.currents(command, self.pose)
        except (PlantError, ParameterError, TypeError) as error:
            self.fail(Fault.INVALID_COMMAND, str(error))
        if not self.guided and self._sample is not None:
            self._sample = self._sample._replace(force=command.force)
            self.check_guards(When.COMMANDED)
            if self.reason:
                command, held, pulsed, width = self._output.currents(self._carrying, self.pose)
        command, held, pulsed, probe = self._probed(command, held, pulsed)
        self._answer(held, pulsed, width, walls)
        self._hand.answered(self.samples.tick, command, held, pulsed, width, probe)
        return command

    def _probed(self, command: Command, held: Any, pulsed: Any) -> tuple[Command, Any, Any, Sequence[float]]:
        """Return a command and its currents with those of a probe, within the limit, and the wrench of the probe."""
        residual, most, before = self._hand.residual, self.limits.current_limit, (held, pulsed)
        residual.watching = self.state is _ACTIVE and not self._hand.check_coils
        if (added := residual.currents()) is None:
            return command, held, pulsed, ZERO
        both = held if pulsed is None else pulsed
        added = [max(min(dx, most - max(x, y)), -most - min(x, y)) for dx, x, y in zip(added, held, both)]
        turned = self.calibration.coils.inverse_at_angle(*self.pose[3:])
        probe = wrench_of(turned, np.array(added)).tolist()
        held = [x + dx for x, dx in zip(held, added)]
        pulsed = None if pulsed is None else [x + dx for x, dx in zip(pulsed, added)]
        force = [x + dx for x, dx in zip(command.force, probe)]
        own = self._own_limits.wrench
        if own is not None and any(abs(x) > most for x, most in zip(force, own)):
            return command, *before, ZERO  # a probe obeys the host's own limit, too
        return Command(force, command.extra, command.pulse_width, command.walls), held, pulsed, probe

    @explained
    def drive(self, currents: Sequence[float]) -> None:
        """Send six coil currents [A] instead of a wrench.

        Raises:
            ParameterError: If they are not six, or one is not finite or above the limit; nothing is sent.
            PlantError: If no sample was read.
        """
        self._check_sample("drive")
        if len(currents) != len(ZERO):
            raise ParameterError(f"currents must be six (got {len(currents)})")
        if safety.command_fault(self.limits, currents, currents, 0.0):
            raise ParameterError(f"currents must be within ±{self.limits.current_limit:g} A (got {list(currents)})")
        self._answer(currents, None, 0.0)
        wrench = self.calibration.coils.wrench(np.asarray(currents)).tolist()
        self._hand.answered(self.samples.tick, Command(wrench), currents, None, 0.0)

    def _check_sample(self, call: str) -> None:
        self._check_open()
        if self._frame is None:
            raise PlantError(f"{call}() needs a sample: call read() first")

    def _answer(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float, walls: _Walls = ()) -> None:
        self._send(held, pulsed, width, walls)
        self.unanswered = None
        if self.state is _ACTIVE:
            self._output.add_command(held, pulsed, width)
        else:
            self._output.add_periods(1, ZERO)
        self._keep_cycle(held, pulsed, width)

    def _keep_cycle(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        if self._frame is not None:
            self.cycles.keep(self._frame, self._located, (held, pulsed, width), self.last_delay, self.answer_latency)

    @property
    def report(self) -> StateReport:
        """Device's report with the last sample; PlantError before the first."""
        if self._frame is None:
            raise PlantError("no sample yet: call read() first")
        return self._frame.body  # type: ignore[return-value]

    @property
    def temperatures(self) -> list[float]:
        """Temperature rises of the coils, the larger of reported and modelled; 1 trips."""
        return list(map(max, ZERO if self._frame is None else self.report.temperatures, self._output.thermal.rises))

    def arm(self, hover: Sequence[float] | None = None) -> None:
        """Switch the currents on; PlantError if the device refuses.

        Args:
            hover: Currents held by the device while commands are missing [A], six; by default those that carry the
                flotor, and a controlled stop follows. With others the device cuts instead.

        Raises:
            ParameterError: If they are not six finite numbers; nothing is sent.
        """
        hover = None if hover is None else numbers("hover", hover, shape="(6,)").tolist()
        stop = self._stop if hover is None else CUT
        self._ask(Operation.ARM, hover=self._hover if hover is None else hover, stop=stop)
        self.state, self._armed, self.guided, self.reason, self.disarmed = _ACTIVE, True, False, "", False
        self._hand.reset()
        self._forget_walls()

    def disarm(self) -> None:
        """Switch the currents off."""
        self._ask(Operation.DISARM)
        self._armed, self.disarmed, self.probes = False, True, str(self._hand.residual)
        self._hand.reset()
        if self.state is _ACTIVE:
            self.state = _INACTIVE

    def estop(self) -> EstopReport:
        """Switch the currents off in any state and latch ESTOP.

        PlantError if the device does not confirm it. The next `read` raises the fault.
        """
        self._check_open()
        report = self._connection.estop()
        self._latch(Fault.ESTOP, report.at)
        if not report.confirmed:
            raise PlantError(f"emergency stop {report}")
        return report

    def reset(self) -> None:
        """Leave the fault state; PlantError while the coils are warm."""
        self._ask(Operation.RESET)
        self.state, self.faults, self.first, self.fault_time, self._armed = _INACTIVE, Fault(0), Fault(0), 0, False

    def trip(self, faults: Fault) -> None:
        """Put the device into the fault state; best effort."""
        self._latch(faults, self.samples.time)
        with suppress(LinkError):  # without a link the watchdog cuts
            self._connection.control(Operation.TRIP, faults=faults)

    def abort(self, reason: str) -> None:
        """Trip a device armed by this host and raise DeviceFault; else do nothing."""
        if self._armed:
            self._fail_if_active(Fault.HOST, reason)

    def require_inactive(self) -> None:
        """Raise PlantError unless the device is inactive."""
        self._check_open()
        if self.state is not _INACTIVE:
            remedy = ": find the cause, then clear the fault with --reset or reset()" if self.state is _FAULT else ""
            raise PlantError(f"no takeoff: device state {self.state.name}, faults {fault_names(self.faults)}{remedy}")

    def _ask(self, operation: Operation, *, hover: Sequence[float] = ZERO, stop: Sequence[float] = CUT) -> None:
        self._check_open()
        answer = self._connection.control(operation, hover=hover, stop=stop)
        if answer is None:
            raise PlantError(f"the device did not answer {operation.name} within {self._connection.patience:g} s")
        if answer.result:
            hint = "; remove the cause, then reset" if answer.state == _FAULT else ""
            state = State(answer.state).name if answer.state in tuple(State) else answer.state
            names = fault_names(answer.faults)
            raise PlantError(f"the device refused {operation.name}: state {state}, faults {names}{hint}")

    def _check_open(self) -> None:
        if not self._connection.open:
            raise PlantError("the plant is closed")

    def _linked(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a call of the connection; an error trips HOST in flight."""
        try:
            return call(*arguments)
        except Exception as error:
            self._fail_if_active(Fault.HOST, str(error))
            raise

    def _adopt(self, state: int, faults: int) -> None:
        if state not in tuple(State):
            self.fail(Fault.HOST, f"the device reports unknown state {state}")
        if (state == _FAULT) != bool(faults):
            self.fail(Fault.HOST, f"the device reports state {State(state).name} with faults {fault_names(faults)}")
        before = self.state
        if state == _FAULT:
            self._latch(Fault(faults), self.samples.time)
        self.state, self.faults = State(state), Fault(faults)
        if self.state is _FAULT is not before:
            self.fail(self.faults, "reported by the device")
        if self.state is _INACTIVE and before == _ACTIVE:
            self.fail(Fault.HOST, "the device disarmed without a request")

    def _locate(self, spots: Sequence[float]) -> SensingError | None:
        """Store the pose; return the error if it is not measured."""
        if self._offsets is not None:
            spots = [spot - offset for spot, offset in zip(spots, self._offsets)]
        try:
            pose = self._track(spots)
        except SensingError as error:
            return error
        tick = self._pose_tick = self.samples.tick
        self.pose, self.unanswered = pose, Sample(tick, tick * self.period, pose)
        self._located = tuple(pose)  # copy: the caller may modify the list
        return None

    def _send(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float, walls: _Walls = ()) -> None:
        self.last_currents = held
        self._walls, self._answered_tick = walls, self.samples.tick
        self._walled_tick = self._answered_tick if walls else self._walled_tick
        currents = tuple(held), tuple(held if pulsed is None else pulsed)
        self._linked(self._connection.command, CommandFrame(self._connection.sequence, 0, *currents, width, walls))

    def _latch(self, faults: Fault, time: int) -> None:
        if not self.faults:
            self.first, self.fault_time = faults, time
        self.state, self.faults = _FAULT, self.faults | faults

    def _fail_if_active(self, faults: Fault, message: str) -> None:
        if self.state is _ACTIVE:
            self.fail(faults, message)

    def check_guards(self, when: When) -> None:
        """Check the last sample by the guards of a time; end the flight at an alarm."""
        for time, guard in self.guards:
            if time is when and self._sample is not None and (alarm := guard(self._sample)) is not None:
                self.end(alarm)

    def end(self, alarm: Alarm) -> None:
        """End a flight by an alarm: set the reason to land, or trip the device, which stops or cuts; see `ENDINGS`.

        Raises:
            DeviceFault: If it has faults, in flight.
        """
        if alarm.ending is Ending.LAND:
            self.reason = self.reason or alarm.message
            return
        self.alarm = self.alarm or f"{fault_names(alarm.faults)}: {alarm.message}"
        if self.state is not _ACTIVE:
            return
        if alarm.removes_walls and alarm.ending is Ending.STOP and self._walls:
            self._send(self.last_currents, None, 0.0)
            self.read()  # the link may deliver two frames in reverse order
        self.fail(alarm.faults, alarm.message)

    def fail(self, faults: Fault, message: str) -> NoReturn:
        """Trip the device, write its last cycles, raise DeviceFault."""
        self._armed, self.probes = False, str(self._hand.residual)
        if self.state is not _FAULT or not self.faults & faults:
            with suppress(Exception):  # report and last cycles must not depend on the link
                self.trip(faults)
        faults |= self.faults  # for example ESTOP, after which the flotor fell
        path = None
        with suppress(Exception):
            self._keep_cycle(self.last_currents, None, 0.0)
            path = self.cycles.write(self.cycles.mark(faults, message, self._about()))
        raise DeviceFault(faults, message, path, off=self.stated.off_current if self._shows_off() else None)

    def _shows_off(self) -> bool:
        """Return True once a sample shows the currents off, after the device's answer to the last request."""
        frame = self._frame
        with suppress(Exception):  # a link that has failed proves nothing
            for _ in range(_PROOFS + math.ceil(self._stop[6] / self.period)):
                if frame is not None and frame.time > self._connection.settled:
                    report: StateReport = frame.body  # type: ignore[assignment]
                    off = report.state != _ACTIVE and safety.are_off(report.currents, self.stated.off_current)
                    if off and not report.flags & _STOPPING:
                        return True
                if self.lockstep:  # the device waits for an answer
                    self._send(ZERO, None, 0.0)
                frame = self._connection.state()
        return False

    def _about(self) -> dict[str, Any]:
        about = {"first": fault_names(self.first), "fault_time_ns": self.fault_time, "period_ns": self.samples.period}
        return about | {name: getattr(self.samples, name) for name in ("tick", "lost", "skipped")}

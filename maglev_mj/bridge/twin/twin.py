"""Simulated device behind the device protocol: flotor, coils, amplifiers, LEDs and diodes."""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.links import Address, Server
from maglev_mj.bridge.realtime import LatencyHistogram
from maglev_mj.bridge.safety import Limits, Profile, limits_of
from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS, Effect, InjectedFault
from maglev_mj.bridge.twin.firmware import Firmware, Reading
from maglev_mj.bridge.wire import WRAP, Codec, Fault, State, StateReport, fault_names
from maglev_mj.control.timeline import Interval
from maglev_mj.device import lag_of
from maglev_mj.errors import check_instance, check_one_of
from maglev_mj.frames import ZERO, Array
from maglev_mj.keywords import checked, explained, rate_of
from maglev_mj.parameters import number, numbers, store
from maglev_mj.plants import MuJoCoPlant, SpotReader, Timing
from maglev_mj.plants.exact_coils import ExactCoilPlant
from maglev_mj.plants.hand import HandForce
from maglev_mj.plants.sensor import PoseScale
from maglev_mj.scenes.scene import PLANTS
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, Spec
from maglev_mj.terminal import wrapped

_ALL = 7
_OF_DEVICE: Any = None  # default of the calibration's device
_MARGIN = 1.25
"""Factor over the calibrated hover currents, for the hover limit."""


@checked(own="plant")
@dataclass(frozen=True, kw_only=True, eq=False)
class TwinParameters:
    """Parameters of a twin.

    `plant="exact"` simulates in closed form, without MuJoCo; see
    `ExactCoilPlant` for the differences.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> from maglev_mj import TwinParameters
        >>> TwinParameters(period=0.001, lockstep=True).delay
        0.0015
    """

    period: float = _OF_DEVICE  # sample period [s]
    rate: float = rate_of("period")
    delay: float = _OF_DEVICE  # from a command's arrival (lockstep: from the sample) to its effect [s]
    latency: float = _OF_DEVICE  # age of a pose at its sample [s]: simulated by a pose without age and a longer delay
    lockstep: bool = False  # simulated time waits for each command
    calibration: Calibration = field(default_factory=Calibration.nominal)  # a host needs the same digest
    truth: Calibration | None = None  # the true one; `calibration` by default
    pose: ArrayLike = _OF_DEVICE  # at the start [m, rad], (6,): on the lower stop
    quantum: ArrayLike = _OF_DEVICE  # resolution of spots [m], or of the values of a pose sensor, (6,)
    noise: ArrayLike = _OF_DEVICE  # standard deviation of the same [m]; half the resolution of spots, assumed
    seed: int = 0  # of the noise
    limits: Limits = _OF_DEVICE
    faults: Sequence[InjectedFault] = ()
    plant: str = "mujoco"  # name from PLANTS
    wall_period: float = DEVICE_PERIOD  # sample period of walls [s], rounded to a divisor of `period`; 0 for no walls
    wall_delay: float = DEVICE_DELAY  # delay of walls [s]

    profile: Profile = field(init=False)  # for the handshake; limits adapted to calibration, period and sensor

    def __post_init__(self) -> None:
        check_one_of("plant", PLANTS, self.plant)
        device, spots = self.calibration.base, Spec.spot_resolution.value
        usual: dict[str, Any] = {"quantum": spots, "noise": 0.5 * spots}
        if isinstance(scale := self.calibration.beams, PoseScale):
            usual = {"quantum": scale.spots(device.sensor.resolution), "noise": scale.spots(device.sensor.noise)}
        usual |= {"period": device.period, "delay": device.loop.delay, "latency": device.sensor.latency}
        usual |= {"pose": device.rest, "limits": self.limits or limits_of(self.calibration.device)}
        store(self, **{name: value for name, value in usual.items() if getattr(self, name) is None})
        numbers("pose", self.pose, shape="(6,)")
        # whole nanoseconds, the protocol's unit of time
        times = "period", "delay", "latency"
        period, delay, latency = (round(number(name, getattr(self, name)) * 1e9) for name in times)
        noise = np.asarray(self.noise)
        limits, most = self.limits, _MARGIN * np.abs(self.calibration.hover).max()
        limits = limits.replace(
            enable=min(max(limits.enable, 3.0 * self.period), limits.watchdog),
            hover_limit=min(limits.hover_limit, limits.continuous_current, most),
            # with noise of half a quantum no reading repeats for long
            frozen=limits.frozen if np.all(noise > 0.0) and np.all(noise >= 0.5 * np.asarray(self.quantum)) else 0,
        )
        stated: dict[str, Any] = {"calibration": self.calibration.digest, "limits": limits, "lockstep": self.lockstep}
        if number("wall_period", self.wall_period, at_least=0.0):
            count = max(round(self.period / self.wall_period), 1)
            own = period // next(part for part in range(count, 0, -1) if period % part == 0)
            late = round(number("wall_delay", self.wall_delay, at_least=0.0) * 1e9)
            stated |= {"wall_period": own, "wall_delay": min(late, 2 * own), "wall_maps": self.calibration.wall_maps}
        store(self, profile=Profile(period=period, delay=delay, latency=latency, **stated))


class AmplifierBoard:
    """Simulated board of six amplifiers with an enable line.

    In hardware: the currents are cut when the line has not toggled for `enable`. See `Amplifiers`.

    Attributes:
        now: The hardware's time [ns].
        stuck: Constant currents of stuck amplifiers [A], by coil.
    """

    def __init__(self, plant: MuJoCoPlant | ExactCoilPlant, parameters: TwinParameters) -> None:
        self._plant, self._lockstep, self._delay = plant, parameters.lockstep, parameters.delay + parameters.latency
        self._enable = parameters.profile.stated["enable"]
        self._sampled_at, self.now, self._opens = -1, 0, 0
        self._commands: Sequence[float] = ZERO
        self.stuck: dict[int, float] = {}
        self.walls: WallClock | None = None  # of the twin

    @property
    def enabled(self) -> bool:
        """True if currents can flow: the enable line toggled recently."""
        return self.now < self._opens

    def commanded(self, currents: list[float]) -> list[float]:
        """Return the commanded currents for these actual ones [A], six."""
        return [self._commands[coil] if coil in self.stuck else x for coil, x in enumerate(currents)]

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Switch to the currents [A] after the device's delay."""
        if self.enabled:
            # in lockstep the command takes no time; None avoids rounding
            passed = (self.now - self._sampled_at) * 1e-9
            after = None if self._lockstep and not passed else passed + self._delay
            self._switch(held, pulsed, width, after)

    def add(self, now: int, currents: Sequence[float]) -> None:
        """Add the currents of walls after their delay; see `Amplifiers`."""
        if self.walls is not None and self.enabled:
            moving = [0.0 if coil in self.stuck else x for coil, x in enumerate(currents)]
            self.walls.add((self.now - self._sampled_at) * 1e-9, moving)

    def cut(self) -> None:
        """Switch all currents off immediately."""
        if self.walls is not None:
            self.walls.cut()
        self._switch(ZERO, None, 0.0, (self.now - self._sampled_at) * 1e-9)

    def toggle(self, now: int) -> None:
        """Toggle the enable line."""
        self._opens = self.now + self._enable

    def advance(self, now: int) -> None:
        """Advance to the next sample [ns]; cut the currents if `enable` has elapsed."""
        if self._sampled_at < self._opens <= now:
            self.pass_to(self._opens)
            self.cut()

    def pass_to(self, now: int) -> None:
        """Let time pass to `now` [ns], with the samples of walls until then."""
        if self.walls is not None and self.walls.busy and self._sampled_at >= 0:
            self._plant.advance((now - self._sampled_at) * 1e-9)
        self.now = now

    def sampled(self, now: int) -> None:
        """Set the time of the last sample [ns]."""
        self._sampled_at = self.now = now

    def _switch(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float, after: float | None) -> None:
        self._commands = held
        if self._sampled_at >= 0:  # no current before the first sample
            pulsed = None if pulsed is None else self._flowing(pulsed)
            self._plant.drive(self._flowing(held), pulsed, width, after=after)

    def _flowing(self, commands: Sequence[float]) -> Sequence[float]:
        return [self.stuck.get(coil, x) for coil, x in enumerate(commands)] if self.stuck else commands


@checked(own="parameters")
class Twin:
    """Simulated device in simulated time [ns].

    Time advances by sample periods and by the times passed to `receive`.

    Args:
        parameters: Parameters of the device.
        key: Authentication key of the frames; None for none.
        hand_force: Model of the hand.
        draw: See `Firmware`.

    Attributes:
        plant: Simulated mechanics and coils, driven only by `board`.
        truth: True calibration.
        tick: Number of the last sample; -1 before the first.
        ahead: Offset of the firmware's clock [ns].
        hung: True if the firmware hangs.
        silent_until: Time until which no frames pass [ns].
        sensor_delay: Delay of the diodes' readings [ns].

    Example:
        >>> from maglev_mj import Twin, TwinParameters
        >>> twin = Twin(TwinParameters(noise=0.0))
        >>> twin.firmware.state.name, twin.pose.round(4).tolist()[2]
        ('INACTIVE', -0.0045)
    """

    def __init__(
        self,
        parameters: TwinParameters,
        *,
        key: bytes | None = None,
        hand_force: HandForce | None = None,
        draw: Callable[[], int] = lambda: secrets.randbelow(2**32 - 1) + 1,
    ) -> None:
        check_instance("parameters", parameters, TwinParameters, "TwinParameters(...)")
        self.parameters = parameters
        self.truth = truth = parameters.truth or parameters.calibration
        self.plant = _plant(parameters, truth, hand_force)
        reader = partial(SpotReader, truth.beams, quantum=parameters.quantum, noise=parameters.noise)
        self._read, self._read_walls = (reader(seed=parameters.seed + offset) for offset in (0, 1))
        self._offsets: list[float] | None = truth.spot_offsets.tolist() if truth.spot_offsets.any() else None
        self.codec = Codec(key)
        self.board = AmplifierBoard(self.plant, parameters)
        self.firmware = Firmware(parameters.profile, self.board, self.codec, draw)
        self.tick = -1
        self._period = parameters.profile.period
        self._waiting = sorted(parameters.faults, key=lambda fault: fault.at)
        self._live: list[tuple[Effect, int, Reading]] = []
        self.ahead, self.hung, self.silent_until, self.sensor_delay = 0, False, 0, 0
        self._seen = deque[tuple[int, Sequence[float]]]()

    @property
    def answered(self) -> bool:
        """True if the last sample has been answered (lockstep)."""
        return self.firmware.answered == self.tick & WRAP

    @property
    def pose(self) -> Array:
        """True pose at the last sample [m, rad], (6,)."""
        return self.plant.state()[0]

    @explained
    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        """Handle a frame received at `now` [ns], in simulated time; return the reply, or None."""
        if self.hung or self._silent:
            return None
        self.board.pass_to(max(now, self.tick * self._period))
        return self.firmware.receive(data, self.board.now + self.ahead, peer)

    def sample(self) -> bytes | None:
        """Advance to the next sample; return its STATE frame, or None without a session.

        Raises:
            DivergenceError: If the flotor is far outside its range of motion, which the metal stops prevent.
        """
        now = (self.tick + 1) * self._period
        if self.board.walls is None and self.firmware.walled:
            self.board.walls = WallClock(self)
            self.plant.follow(self.board.walls)
        self.board.advance(now)
        position = self.plant.read().position
        self.tick += 1
        self.board.sampled(now)
        currents, board = self.plant.currents.tolist(), self.board
        commands = board.commanded(currents) if board.stuck else currents
        spots = self._spots(self._read(position), now)
        reading = Reading(spots, _ALL, currents, commands, self.plant.intervals, self.tick + 1, board.enabled)
        self._begin(reading)
        reading = self._affected(reading)
        if self.hung:
            return None
        frame = self.firmware.sample(self.tick, now + self.ahead, reading)
        return None if frame is None or self._silent else self._reported(frame)

    def _spots(self, spots: Sequence[float], now: int) -> Sequence[float]:
        """Return spots as the sensor reports them, with its offsets and its own delay."""
        if self._offsets is not None:
            spots = [spot + offset for spot, offset in zip(spots, self._offsets)]
        if self.sensor_delay:
            self._seen.append((now, spots))
            while len(self._seen) > 1 and self._seen[1][0] <= now - self.sensor_delay:
                self._seen.popleft()
            return self._seen[0][1]
        return spots

    def _affected(self, reading: Reading) -> Reading:
        """Return a reading as changed by injected faults."""
        for effect, which, first in self._live:
            reading = effect.read(reading, first, which) if effect.read else reading
        return reading

    def _sample_walls(self, after: float) -> None:
        """Sample the walls at a time after the last sample [s]."""
        now = self.board.now = self.tick * self._period + round(after * 1e9)
        spots = self._spots(self._read_walls(self.plant._motion()[0]), now)
        self.firmware.wall(now + self.ahead, self._affected(Reading(spots, _ALL, ZERO, ZERO)))

    @property
    def _silent(self) -> bool:
        return max(self.tick, 0) * self._period < self.silent_until

    def estop(self) -> None:
        """Trip as on an ESTOP frame."""
        self.firmware.trip(Fault.ESTOP, self.board.now + self.ahead)

    def _begin(self, reading: Reading) -> None:
        """Start the injected faults that are due."""
        while self._waiting and self._waiting[0].at * 1e9 <= self.tick * self._period:
            fault = self._waiting.pop(0)
            effect = INJECTED_FAULTS[fault.kind]
            if effect.begin is not None:
                effect.begin(self, fault.which)
            self._live.append((effect, fault.which, reading))

    def _reported(self, data: bytes) -> bytes:
        """Return a STATE frame as changed by injected faults."""
        changes = [(effect.report, which) for effect, which, _ in self._live if effect.report is not None]
        frame = self.codec.decode(data) if changes else None
        if frame is None or not isinstance(frame.body, StateReport):
            return data
        body = frame.body
        for change, which in changes:
            body = change(body, which)
        return self.codec.encode(frame.session, frame.sequence, frame.time, body)


class WallClock:
    """Periods of a simulated device whose firmware renders walls.

    Without walls the intervals of a period are those of the timeline.

    Args:
        twin: The device, whose currents they are in the same plant.

    Attributes:
        drive: Drive in effect.
        intervals: Intervals of the last period.
        measure: None; the sensor is the twin's.
    """

    measure = None

    def __init__(self, twin: Twin) -> None:
        profile, self._twin, self._timeline = twin.firmware.profile, twin, twin.plant._timeline
        self._step, self._delay = profile.wall_period * 1e-9, profile.wall_delay * 1e-9
        self._period = self._timeline.timing.period
        self._least = 1e-6 * self._period
        self._extra: Sequence[float] | None = None  # currents in effect
        self._waiting: deque[tuple[float, Sequence[float]]] = deque()
        self._done, self._next = 0.0, 0  # time of the motion after the last sample [s]; next wall sample
        self.drive, self.intervals = self._timeline.now(), list[Interval]()

    @property
    def _walled(self) -> bool:
        """True while there are walls."""
        return self._twin.firmware.walled and not self._twin.hung

    @property
    def busy(self) -> bool:
        """True while there are walls or their currents."""
        return self._walled or self._extra is not None or bool(self._waiting)

    def add(self, at: float, currents: Sequence[float]) -> None:
        """Queue currents of walls, sampled at a time after the last sample [s]."""
        self._waiting.append((at + self._delay, currents))

    def cut(self) -> None:
        """Remove the currents of walls."""
        self._extra = None
        self._waiting.clear()

    def period(self, tick: int, answer: tuple[Any, Any, float] | None = None) -> Iterator[Interval]:
        """Yield the rest of a period's intervals; advance the plant between them."""
        yield from self.until(tick, self._period)
        self._waiting = deque((at - self._period, currents) for at, currents in self._waiting)
        self._done, self._next = 0.0, 0

    def until(self, tick: int, end: float) -> Iterator[Interval]:
        """Yield the intervals up to a time after sample `tick` [s]."""
        if self._done == 0.0:
            self.intervals = []
        while self._done < end - self._least:
            following = end
            if self._walled:
                self._next = max(self._next, int((self._done - self._least) // self._step) + 1)
                if self._next * self._step <= self._done + self._least:
                    self._twin._sample_walls(self._next * self._step)
                    self._next += 1
                following = min(following, self._next * self._step)
            while self._waiting and self._waiting[0][0] <= self._done + self._least:
                self._extra = self._waiting.popleft()[1]
                self._extra = self._extra if any(self._extra) else None
            if self._waiting:
                following = min(following, self._waiting[0][0])
            whole = self._done == 0.0 and following == self._period
            part: dict[str, Any] = {} if whole else {"begin": self._done, "until": following}
            for duration, drive in self._timeline.period(tick, **part):
                self.drive = drive if self._extra is None else self._twin.plant._raised(drive, self._extra)
                self.intervals.append((duration, self.drive))
                yield duration, self.drive
            self._done = following
        self.drive = self._timeline.now()
        if self._extra is not None:
            self.drive = self._twin.plant._raised(self.drive, self._extra)


def _plant(
    parameters: TwinParameters, truth: Calibration, hand_force: HandForce | None
) -> MuJoCoPlant | ExactCoilPlant:
    timing = Timing(period=parameters.period, delay=parameters.delay + parameters.latency)
    start: Any = {"pose": parameters.pose, "hand_force": hand_force}
    own: dict[str, Any] = {"mass": truth.mass, "inertia": truth.inertia, "gravity": truth.gravity}
    if parameters.plant == "exact":
        return ExactCoilPlant(timing, coils=truth.coils, reach=truth.base.reach, lag=lag_of(truth.base), **own, **start)
    if not truth.base.published:
        stops = truth.base.range.stops
        return MuJoCoPlant(timing, model=truth.device, stops=stops, stop_damping=stops, **start)
    # keep the model's own numbers if they are true: setting them would round
    nominal = Calibration.nominal()
    own |= {name: None for name in ("mass", "inertia") if np.array_equal(own[name], getattr(nominal, name))}
    same = np.array_equal(truth.coils.wrench_per_current, nominal.coils.wrench_per_current)
    return MuJoCoPlant(timing, coil_map=None if same else truth.coils, stops=True, stop_damping=True, **own, **start)


_AGAIN, _LOOK = 0.02, 0.05
_LET_GO = 2.0
"""Timeout for a host in lockstep [s]."""

_IGNORED = {
    "short": "too short",
    "magic": "not of this protocol",
    "version": "other protocol version",
    "type": "unknown type",
    "length": "wrong length",
    "crc": "wrong checksum",
    "tag": "wrong key",
    "direction": "sent by a device",
    "session": "other session",
    "old": "outdated or repeated",
    "busy": "other host connected",
    "inactive": "device inactive",
}
"""Meanings of the reasons to ignore a frame."""

_MOST = 4096
"""Largest number of frames that wait."""
_ESTOP = b"\x07"
"""Frame type of ESTOP, the fourth byte."""


class ServerReport(NamedTuple):
    """Statistics of a twin server.

    Attributes:
        ticks: Samples taken.
        missed: Periods for which simulated time stood still because the machine stalled.
        wall_time: Duration in real time [s].
        latency: Latency of the samples in real time.
        ignored: Ignored frames by reason.
        state: State of the device at the end.
        faults: Its latched faults.
    """

    ticks: int
    missed: int
    wall_time: float
    latency: LatencyHistogram
    ignored: Mapping[str, int]
    state: State
    faults: Fault

    def __str__(self) -> str:
        rate = self.ticks / max(self.wall_time, 1e-9)
        lines = [f"  {self.wall_time:.1f} s, {self.ticks} samples, {rate:.0f} Hz, {self.missed} periods stalled"]
        if self.latency.count:
            median, most = self.latency.p50 * 1e6, self.latency.p99 * 1e3
            lines.append(f"  sample latency: median {median:.0f} µs, 99th percentile {most:.2f} ms")
        if self.ignored:
            counts = ", ".join(f"{count} ({_IGNORED[reason]})" for reason, count in sorted(self.ignored.items()))
            lines += wrapped(f"frames ignored: {counts}", further="    ")
        faults = f"faults {fault_names(self.faults)}" if self.faults else "no faults"
        lines += wrapped(f"final state: {self.state.name.lower()}, {faults}", further="    ")
        return "\n".join(lines)


class TwinServer:
    """Server of a twin: samples on schedule, receives and sends frames.

    In real time it samples at absolute deadlines; if it is late by whole periods, simulated time stands still for
    them, and while it computes a sample: a device measures a sample at once. In lockstep it takes a sample when the
    last one is answered, repeats it after 20, 40, 80 ms and so on without an answer, and drops the host after 2 s.
    Emergency stops are handled before all other frames; in real time, frames take at most half a period between two
    samples.

    Args:
        twin: The device.
        server: Socket or serial line; closed with this server.
        spin: Polling time before sleeping in lockstep [s]; lowers latency if a core is free.

    Attributes:
        address: Address for hosts.
        missed: See `ServerReport`.
    """

    def __init__(self, twin: Twin, server: Server, *, spin: float = 0.0) -> None:
        self.twin, self._server, self._spin = twin, server, spin
        self._lockstep, self._period = twin.parameters.lockstep, twin.firmware.profile.period
        self.address: Address = server.address
        self.missed, self.latency = 0, LatencyHistogram()
        self._waiting: deque[tuple[bytes, Address]] = deque()
        self._zero = self._deadline = 0
        self._computing = 0  # time from the last deadline to its frame [ns]
        self._left = self._period // 2  # time for frames until the next sample [ns]
        self._stopped = threading.Event()

    def run(self, duration: float | None = None, each: Callable[[], object] | None = None) -> ServerReport:
        """Serve for `duration` [s] or until `stop`; call `each` after each sample.

        Raises:
            MaglevError: If the simulated device diverges, or the link has failed.
        """
        twin, start = self.twin, time.monotonic_ns()
        end = None if duration is None else start + round(duration * 1e9)
        self._zero = start - max(twin.tick, 0) * self._period
        try:
            while not self._stopped.is_set() and (end is None or time.monotonic_ns() < end):
                if not self._lockstep:
                    self._await_deadline()
                elif twin.firmware.session == 0:
                    self._receive(_LOOK)
                    continue
                frame = twin.sample()
                self._send(frame)
                self._computing = max(time.monotonic_ns() - self._zero - twin.tick * self._period, 0)
                if each is not None:
                    each()
                if self._lockstep:
                    self._await_answer(frame)
        finally:
            twin.board.cut()
        wall = (time.monotonic_ns() - start) * 1e-9
        device, ignored = twin.firmware, twin.firmware.counts + twin.codec.dropped
        return ServerReport(twin.tick + 1, self.missed, wall, self.latency, ignored, device.state, device.faults)

    def stop(self) -> None:
        """Stop `run`, from any thread."""
        self._stopped.set()

    def close(self) -> None:
        """Stop, and close the socket or serial line."""
        self.stop()
        self._server.close()

    def _await_deadline(self) -> None:
        """Handle frames until the next sample is due, and those already waiting if it is overdue."""
        clock, period = time.monotonic_ns, self._period
        self._left = period // 2
        self._deadline = self._zero + (self.twin.tick + 1) * period
        remaining = 1
        while remaining > 0 and not self._stopped.is_set():
            remaining = self._deadline - clock()
            self._receive(min(max(remaining * 1e-9, 0.0), _LOOK))
        delay = max(clock() - self._deadline, 0)
        self.latency.add(delay)
        # after a stall, pause simulated time too: catching up would look like a silent host
        self.missed += delay // period
        self._zero += delay // period * period

    def _await_answer(self, frame: bytes | None) -> None:
        """Wait until the last sample is answered or the host is dropped."""
        twin, clock = self.twin, time.monotonic_ns
        start = clock()
        timeout, again, spun = (start + round(span * 1e9) for span in (_LET_GO, _AGAIN, self._spin))
        while not twin.answered and twin.firmware.session and not self._stopped.is_set():
            self._receive(0.0 if clock() < spun else _AGAIN)
            if twin.answered:
                return
            now = clock()
            if now > timeout:
                twin.firmware.lose_host(max(twin.tick, 0) * self._period)
            elif now >= again:
                self._send(frame)
                again = now + (now - start)  # back off: repeats must not congest a slow link

    def _receive(self, timeout: float) -> None:
        """Receive for `timeout` [s] and handle the frames, emergency stops first.

        In real time the frames left after half a period wait for the next sample; in lockstep, for the next call.
        """
        if self._lockstep:
            self._left = self._period // 2
        elif self._left <= 0:
            time.sleep(timeout)
            return
        arrived = self._server.receive(0.0 if self._waiting else timeout)
        end = time.monotonic_ns() + self._left
        while arrived is not None or self._waiting:
            if arrived is not None and arrived[0][3:4] == _ESTOP:
                self._take(*arrived)
            elif arrived is None:
                self._take(*self._waiting.popleft())
            elif len(self._waiting) < _MOST:  # else it is dropped
                self._waiting.append(arrived)
            if time.monotonic_ns() >= end:
                break
            arrived = self._server.receive(0.0)
        self._left = end - time.monotonic_ns()

    def _take(self, data: bytes, sender: Address) -> None:
        tick, soonest = max(self.twin.tick, 0), min(time.monotonic_ns(), self._deadline)
        now = tick * self._period if self._lockstep else soonest - self._zero - self._computing
        if (answer := self.twin.receive(data, now, sender)) is not None:
            self._server.send(answer, sender)

    def _send(self, frame: bytes | None) -> None:
        if frame is not None and self.twin.firmware.session:  # it may have ended since
            self._server.send(frame, self.twin.firmware.peer)

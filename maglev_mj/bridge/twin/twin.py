"""Simulated device: flotor, coils, amplifiers, LEDs and diodes.

It is reached by the device's own protocol.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.links import Address, Server
from maglev_mj.bridge.realtime import LatencyHistogram
from maglev_mj.bridge.safety import Limits, Profile
from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS, Effect, InjectedFault
from maglev_mj.bridge.twin.firmware import Firmware, Reading
from maglev_mj.bridge.wire import WRAP, Codec, Fault, State, StateReport, fault_names
from maglev_mj.errors import check_instance, check_one_of
from maglev_mj.frames import ZERO, Array
from maglev_mj.parameters import number
from maglev_mj.plants import MuJoCoPlant, SpotReader, Timing
from maglev_mj.plants.exact_coils import ExactCoilPlant
from maglev_mj.plants.hand import HandForce
from maglev_mj.scenes.scene import PLANTS
from maglev_mj.spec import Spec
from maglev_mj.terminal import wrapped

REST = (0.0, 0.0, -Spec.translation_range.value, 0.0, 0.0, 0.0)
"""Pose at rest on the lower stop [m, rad]."""

_ALL = 7
_MARGIN = 1.25
"""Factor over the calibrated hover currents, for the hover limit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TwinParameters:
    """Parameters of a twin.

    A twin in closed form, `plant="exact"`, flies where there is no engine; it then needs a calibration, as from a file.
    See `ExactCoilPlant` for how it differs.

    Raises:
        ParameterError: If a value is outside its bounds.

    Example:
        >>> from maglev_mj import TwinParameters
        >>> TwinParameters(period=0.001, lockstep=True).delay
        0.0015
    """

    period: float = 1.0 / Spec.control_rate.value  # of samples [s]
    delay: float = Spec.transport_delay.value  # command's arrival to its effect, in lockstep from the sample on [s]
    lockstep: bool = False  # simulated time waits for each answer
    calibration: Calibration = field(default_factory=Calibration.nominal)  # a host must have its hash
    truth: Calibration | None = None  # the true one; `calibration` by default
    pose: ArrayLike = REST  # at the start [m, rad], (6,)
    quantum: float = Spec.spot_resolution.value  # of a spot's coordinates [m]
    noise: float = 0.5 * Spec.spot_resolution.value  # standard deviation of a spot's; assumed [m]
    seed: int = 0  # of the noise
    limits: Limits = field(default_factory=Limits)
    faults: Sequence[InjectedFault] = ()
    plant: str = "mujoco"  # name from PLANTS

    profile: Profile = field(init=False)  # handshake properties, limits narrowed by calibration, period and sensor

    def __post_init__(self) -> None:
        check_one_of("plant", PLANTS, self.plant)
        # whole nanoseconds, the wire's unit of time
        period, delay = (round(number(name, getattr(self, name)) * 1e9) for name in ("period", "delay"))
        limits, most = self.limits, _MARGIN * np.abs(self.calibration.hover).max()
        limits = limits.replace(
            enable=min(max(limits.enable, 3.0 * self.period), limits.watchdog),
            hover_limit=min(limits.hover_limit, limits.continuous_current, most),
            # noise of half a step keeps no reading
            frozen=limits.frozen if self.noise > 0.0 and self.noise >= 0.5 * self.quantum else 0,
        )
        digest = self.calibration.digest
        profile = Profile(period=period, delay=delay, calibration=digest, limits=limits, lockstep=self.lockstep)
        object.__setattr__(self, "profile", profile)


class AmplifierBoard:
    """Simulated board of six amplifiers with an enable line.

    No program acts between line and currents: they are cut when the line has stopped for too long. See `Amplifiers`.

    Attributes:
        now: The hardware's time [ns].
        stuck: Constant currents of stuck amplifiers [A], by coil.
    """

    def __init__(self, plant: MuJoCoPlant | ExactCoilPlant, parameters: TwinParameters) -> None:
        self._plant, self._lockstep, self._delay = plant, parameters.lockstep, parameters.delay
        self._enable = parameters.profile.stated["enable"]
        self._sampled_at, self.now, self._opens = -1, 0, 0
        self._told: Sequence[float] = ZERO
        self.stuck: dict[int, float] = {}

    @property
    def enabled(self) -> bool:
        """True if the enable line toggles and currents can flow."""
        return self.now < self._opens

    def commanded(self, currents: list[float]) -> list[float]:
        """Return the commanded currents at these actual currents [A], six."""
        return [self._told[coil] if coil in self.stuck else one for coil, one in enumerate(currents)]

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Switch the currents [A] after the conversion's delay."""
        if self.enabled:
            # in lockstep the answer takes no time; saying so in seconds would round
            after = None if self._lockstep else (self.now - self._sampled_at) * 1e-9 + self._delay
            self._switch(held, pulsed, width, after)

    def cut(self) -> None:
        """Switch all currents off at once."""
        self._switch(ZERO, None, 0.0, (self.now - self._sampled_at) * 1e-9)

    def toggle(self, now: int) -> None:
        """Change the level of the enable line."""
        self._opens = self.now + self._enable

    def go_on(self, now: int) -> None:
        """Advance to the next sample [ns]; cut currents if due."""
        if self._sampled_at < self._opens <= now:
            self.now = self._opens
            self.cut()

    def sampled(self, now: int) -> None:
        """Set the time of the last sample [ns]."""
        self._sampled_at = self.now = now

    def _switch(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float, after: float | None) -> None:
        self._told = held
        if self._sampled_at >= 0:  # before that nothing flows
            pulsed = None if pulsed is None else self._flowing(pulsed)
            self._plant.drive(self._flowing(held), pulsed, width, after=after)

    def _flowing(self, told: Sequence[float]) -> Sequence[float]:
        return [self.stuck.get(coil, one) for coil, one in enumerate(told)] if self.stuck else told


class Twin:
    """Simulated device in simulated time [ns].

    Time advances by sample periods and by the instants given to `receive`.

    Args:
        parameters: Parameters of the device.
        key: Authentication key of the frames; None for none.
        hand_force: Model of the hand.
        draw: See `Firmware`.

    Attributes:
        plant: The device in the engine or in closed form; only `board`, its amplifiers, commands it.
        truth: The true calibration.
        tick: Number of the last sample; -1 before the first.
        ahead: Jump of the firmware's clock [ns].
        hung: True if the firmware hangs.
        silent_until: End of a silence without any frames [ns].

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
        self._read = SpotReader(truth.beams, quantum=parameters.quantum, noise=parameters.noise, seed=parameters.seed)
        self._offsets: list[float] | None = truth.spot_offsets.tolist() if truth.spot_offsets.any() else None
        self.codec = Codec(key)
        self.board = AmplifierBoard(self.plant, parameters)
        self.firmware = Firmware(parameters.profile, self.board, self.codec, draw)
        self.tick = -1
        self._period = parameters.profile.period
        self._waiting = sorted(parameters.faults, key=lambda one: one.at)
        self._live: list[tuple[Effect, int, Reading]] = []
        self.ahead, self.hung, self.silent_until = 0, False, 0

    @property
    def answered(self) -> bool:
        """True if the last sample is answered, in lockstep."""
        return self.firmware.answered == self.tick & WRAP

    @property
    def pose(self) -> Array:
        """True pose at the last sample [m, rad], (6,)."""
        return self.plant.state()[0]

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        """Handle a frame received at `now` [ns]; return the reply.

        None if there is no reply. `now` is in simulated time.
        """
        if self.hung or self._silent:
            return None
        self.board.now = max(now, self.tick * self._period)
        return self.firmware.receive(data, self.board.now + self.ahead, peer)

    def sample(self) -> bytes | None:
        """Advance to the next sample; return its STATE frame.

        None without a session.

        Raises:
            DivergenceError: If the flotor leaves its range by a wide margin, impossible with metal stops.
        """
        now = (self.tick + 1) * self._period
        self.board.go_on(now)
        position = self.plant.read().position
        self.tick += 1
        self.board.sampled(now)
        spots: Sequence[float] = self._read(position)
        if self._offsets is not None:
            spots = [spot + offset for spot, offset in zip(spots, self._offsets)]
        currents, board = self.plant.currents.tolist(), self.board
        told = board.commanded(currents) if board.stuck else currents
        reading = Reading(spots, _ALL, currents, told, self.plant.intervals, self.tick + 1, board.enabled)
        if self._waiting:
            self._begin(reading)
        for effect, which, first in self._live:
            reading = effect.read(reading, first, which) if effect.read else reading
        if self.hung:
            return None
        frame = self.firmware.sample(self.tick, now + self.ahead, reading)
        return None if frame is None or self._silent else self._reported(frame)

    @property
    def _silent(self) -> bool:
        return max(self.tick, 0) * self._period < self.silent_until

    def estop(self) -> None:
        """Stop as on an ESTOP frame."""
        self.firmware.trip(Fault.ESTOP, self.board.now + self.ahead)

    def _begin(self, reading: Reading) -> None:
        """Begin the injected faults that are due."""
        while self._waiting and self._waiting[0].at * 1e9 <= self.tick * self._period:
            one = self._waiting.pop(0)
            effect = INJECTED_FAULTS[one.kind]
            if effect.begin is not None:
                effect.begin(self, one.which)
            self._live.append((effect, one.which, reading))

    def _reported(self, data: bytes) -> bytes:
        """Return a STATE frame changed by the injected faults."""
        changes = [(effect.report, which) for effect, which, _ in self._live if effect.report is not None]
        frame = self.codec.decode(data) if changes else None
        if frame is None or not isinstance(frame.body, StateReport):
            return data
        body = frame.body
        for change, which in changes:
            body = change(body, which)
        return self.codec.encode(frame.session, frame.sequence, frame.time, body)


def _plant(
    parameters: TwinParameters, truth: Calibration, hand_force: HandForce | None
) -> MuJoCoPlant | ExactCoilPlant:
    timing = Timing(period=parameters.period, delay=parameters.delay)
    if parameters.plant == "exact":
        return ExactCoilPlant(
            timing,
            coils=truth.coils,
            mass=truth.mass,
            inertia=truth.inertia,
            gravity=truth.gravity,
            pose=parameters.pose,
            hand_force=hand_force,
        )
    known = Calibration.nominal()
    # the model's own numbers where they are the truth: what is set anew is rounded
    same = np.array_equal(truth.coils.wrench_per_current, known.coils.wrench_per_current)
    return MuJoCoPlant(
        timing,
        coil_map=None if same else truth.coils,
        gravity=truth.gravity,
        mass=None if truth.mass == known.mass else truth.mass,
        inertia=None if np.array_equal(truth.inertia, known.inertia) else truth.inertia,
        pose=parameters.pose,
        stops=True,
        stop_damping=True,
        hand_force=hand_force,
    )


_AGAIN, _LOOK = 0.02, 0.05
_LET_GO, _COMPUTES = 2.0, 60.0
"""Longest silence of a host in lockstep [s], and before a flight.

There it computes what a scene bears.
"""

_MOST, _FEW = 4096, 32
_ESTOP = b"\x07"
"""Frame type of ESTOP, the fourth byte."""


class ServerReport(NamedTuple):
    """Statistics of a twin server.

    Attributes:
        ticks: Samples taken.
        missed: Periods for which simulated time stood still because the machine did.
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
        lines = [f"  {self.wall_time:.1f} s, {self.ticks} samples, {rate:.0f} a second, {self.missed} periods stalled"]
        if self.latency.count:
            median, most = self.latency.p50 * 1e6, self.latency.p99 * 1e3
            lines.append(f"  late by {median:.0f} µs in the median, {most:.2f} ms at 99 %")
        if self.ignored:
            counts = ", ".join(f"{count} for {reason}" for reason, count in sorted(self.ignored.items()))
            lines += wrapped(f"frames ignored: {counts}", further="    ")
        lines += wrapped(f"{self.state.name.lower()}, faults: {fault_names(self.faults)}", further="    ")
        return "\n".join(lines)


class TwinServer:
    """Server of a twin: punctual samples, frames in and out.

    In real time it is the clock of both ends: it samples at absolute deadlines, and if it is late by whole periods
    simulated time stands still for as long. In lockstep it takes a sample when the one before is answered, repeats it
    after 20 ms without answer, and drops the host after 2 s, or 60 s while it is inactive. Emergency stops are handled
    before all other frames.

    Args:
        twin: The device.
        server: Socket or serial line; closed with this server.
        spin: Polling time before sleeping in lockstep [s]; short latencies if a processor is free.

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
        self._stopped = threading.Event()

    def run(self, duration: float | None = None, each: Callable[[], object] | None = None) -> ServerReport:
        """Serve for `duration` [s] or until `stop`.

        `each` is called after each sample.

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
        """Stop, and close the socket or line."""
        self.stop()
        self._server.close()

    def _await_deadline(self) -> None:
        """Handle frames until the next sample is due.

        Frames that wait at a late deadline are handled too.
        """
        clock, period = time.monotonic_ns, self._period
        self._deadline = self._zero + (self.twin.tick + 1) * period
        left = 1
        while left > 0 and not self._stopped.is_set():
            left = self._deadline - clock()
            self._receive(min(max(left * 1e-9, 0.0), _LOOK))
        late = max(clock() - self._deadline, 0)
        self.latency.add(late)
        # a machine that stalls makes simulated time stall, where catching up would look like a host gone silent
        self.missed += late // period
        self._zero += late // period * period

    def _await_answer(self, frame: bytes | None) -> None:
        """Wait until the last sample is answered or host lost."""
        twin, clock = self.twin, time.monotonic_ns
        asked, state, patience = clock(), None, 0
        again, spun = asked + round(_AGAIN * 1e9), asked + round(self._spin * 1e9)
        while not twin.answered and twin.firmware.session and not self._stopped.is_set():
            if twin.firmware.state is not state:  # the time to compute ends when the device is armed
                state = twin.firmware.state
                patience = clock() + round((_COMPUTES if state is State.INACTIVE else _LET_GO) * 1e9)
            self._receive(0.0 if clock() < spun else _AGAIN)
            if twin.answered:
                return
            now = clock()
            if now > patience:
                twin.firmware.lose_host(max(twin.tick, 0) * self._period)
            elif now > again:
                self._send(frame)
                again = now + round(_AGAIN * 1e9)

    def _receive(self, timeout: float) -> None:
        """Receive for `timeout` [s] and handle the frames.

        Once the sample is due, at most one period is spent.
        """
        self._collect(0.0 if self._waiting else timeout)
        for count in range(1, len(self._waiting) + 1):
            self._take(*self._waiting.popleft())
            if count % _FEW == 0:
                self._collect(0.0)
                if self._overdue:
                    return

    def _collect(self, timeout: float) -> None:
        """Queue received frames; handle emergency stops at once."""
        for count in range(_MOST):
            if (count % _FEW == _FEW - 1 and self._overdue) or (arrived := self._server.receive(timeout)) is None:
                return
            timeout = 0.0
            if arrived[0][3:4] == _ESTOP:
                self._take(*arrived)
            elif len(self._waiting) < _MOST:
                self._waiting.append(arrived)

    @property
    def _overdue(self) -> bool:
        return not self._lockstep and time.monotonic_ns() > self._deadline + self._period

    def _take(self, data: bytes, sender: Address) -> None:
        tick, soonest = max(self.twin.tick, 0), min(time.monotonic_ns(), self._deadline)
        now = tick * self._period if self._lockstep else soonest - self._zero
        if (answer := self.twin.receive(data, now, sender)) is not None:
            self._server.send(answer, sender)

    def _send(self, frame: bytes | None) -> None:
        if frame is not None and self.twin.firmware.session:  # it may have ended since
            self._server.send(frame, self.twin.firmware.peer)

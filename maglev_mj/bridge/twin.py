"""A device that is not there: the MuJoCo flotor with coils, amplifiers, LEDs and diodes, behind the device's wire."""

from __future__ import annotations

import re
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.bridge.firmware import Firmware, Profile, Reading
from maglev_mj.bridge.realtime import LatencyHistogram
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.wire import Codec
from maglev_mj.errors import ParameterError
from maglev_mj.frames import ZERO, Array
from maglev_mj.hand import HandForce
from maglev_mj.net.udp import Address, Server
from maglev_mj.parameters import flag, number
from maglev_mj.plants import MuJoCoPlant, SpotReader, Timing
from maglev_mj.spec import Spec

__all__ = ["INJECTED_FAULTS", "REST", "InjectedFault", "ServerReport", "Twin", "TwinParameters", "TwinServer"]

REST = (0.0, 0.0, -Spec.translation_range.value, 0.0, 0.0, 0.0)
"""Where the flotor lies while nothing carries it [m, rad]: on its lower stop."""

_ALL = 7
_MARGIN = 1.25
"""Hover currents may be that much above those of the calibration."""

INJECTED_FAULTS = {
    "dead-coil": ("coil K gives no current", 5),
    "stuck-diode": ("diode K repeats its last spot", 2),
    "invalid-diode": ("diode K says that its spot cannot be trusted", 2),
    "swapped-diodes": ("the cables of diode K and the next are exchanged", 2),
    "clock-jump": ("the device's clock jumps ahead by K milliseconds", 10_000),
    "silence": ("nothing comes or goes for K milliseconds", 60_000),
}
"""Faults of a device by name: what goes wrong, and the largest K."""


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """What goes wrong with a twin, and when.

    Args:
        kind: One of INJECTED_FAULTS.
        which: Its K.
        at: When, in simulated time [s].

    Raises:
        ParameterError: If there is no such fault, or a number is outside its bounds.
    """

    kind: str
    which: int
    at: float

    def __post_init__(self) -> None:
        if self.kind not in INJECTED_FAULTS:
            raise ParameterError(f"fault must be one of {', '.join(INJECTED_FAULTS)}, not {self.kind!r}")
        most = INJECTED_FAULTS[self.kind][1]
        if not 0 <= self.which <= most:
            raise ParameterError(f"{self.kind} must be of 0 to {most}, not {self.which}")
        number("fault time", self.at, at_least=0.0)

    @classmethod
    def parse(cls, text: str) -> InjectedFault:
        """Return what NAME:K@SECONDS says.

        Raises:
            ParameterError: If it says nothing.
        """
        found = re.fullmatch(r"([a-z-]+):(\d+)@(\d+\.?\d*)", text)
        if not found:
            raise ParameterError(
                f"fault must be NAME:K@SECONDS with a name of {', '.join(INJECTED_FAULTS)}, not {text!r}"
            )
        return cls(kind=found[1], which=int(found[2]), at=float(found[3]))


@dataclass(frozen=True, kw_only=True, eq=False)
class TwinParameters:
    """What a twin is.

    Args:
        period: Sample period [s].
        delay: From a command's arrival to its taking effect [s]; in lockstep from the sample to that.
        lockstep: Whether simulated time waits for each answer.
        calibration: What is known of it, whose hash a host must have.
        truth: What it is; what is known by default.
        pose: Where the flotor starts [m, rad], (6,); at rest by default.
        quantum: Resolution of a spot's place [m].
        noise: Standard deviation of a spot's noise [m]; assumed, half a step of the sensor by default.
        seed: Of the noise.
        limits: What it bears.
        faults: What goes wrong, and when.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    lockstep: bool = False
    calibration: Calibration = field(default_factory=Calibration.nominal)
    truth: Calibration | None = None
    pose: ArrayLike = REST
    quantum: float = Spec.spot_resolution.value
    noise: float = 0.5 * Spec.spot_resolution.value
    seed: int = 0
    limits: Limits = field(default_factory=Limits)
    faults: Sequence[InjectedFault] = ()

    def __post_init__(self) -> None:
        # whole nanoseconds, which is what the wire counts time in
        number("period", self.period, at_least=1e-5, at_most=0.1)
        number("delay", self.delay, at_least=0.0, at_most=0.1)
        flag("lockstep", self.lockstep)

    @cached_property
    def profile(self) -> Profile:
        """What it says of itself."""
        return Profile(
            period=round(self.period * 1e9),
            delay=round(self.delay * 1e9),
            calibration=self.calibration.digest,
            limits=self._limits(),
            lockstep=self.lockstep,
        )

    def _limits(self) -> Limits:
        """Return the limits, as far as calibration, sample period and sensor narrow them."""
        limits, known = self.limits, self.calibration
        return replace(
            limits,
            enable=min(max(limits.enable, 3.0 * self.period), limits.watchdog),
            hover=min(limits.hover, limits.continuous_current, _MARGIN * float(np.abs(known.hover).max())),
            # noise of half a step keeps no reading
            frozen=limits.frozen if self.noise > 0.0 and self.noise >= 0.5 * self.quantum else 0,
        )


class Twin:
    """A device that is not there. Its time [ns] is the simulated one: whole sample periods, and what others say.

    Args:
        parameters: What it is.
        key: With which frames are sealed.
        hand_force: The hand on it.
        draw: See `Firmware`.

    Attributes:
        plant: The device in the engine; commanded by nobody else.
        firmware: Its side of the wire.
        tick: Number of the last sample; -1 before the first.
    """

    def __init__(
        self,
        parameters: TwinParameters,
        *,
        key: bytes | None = None,
        hand_force: HandForce | None = None,
        draw: Callable[[], int] | None = None,
    ) -> None:
        self.parameters = parameters
        truth = parameters.truth or parameters.calibration
        self.plant = _plant(parameters, truth, hand_force)
        self._read = SpotReader(truth.beams, quantum=parameters.quantum, noise=parameters.noise, seed=parameters.seed)
        self._offsets: list[float] | None = truth.spot_offsets.tolist() if truth.spot_offsets.any() else None
        self.codec = Codec(key)
        self.firmware = Firmware(parameters.profile, self, self.codec, draw or _draw)
        self.tick = -1
        self._period, self._delay = parameters.profile.period, parameters.delay
        self._enable = round(parameters.profile.limits.enable * 1e9)
        self._sampled_at, self._now = 0, 0
        self._waiting = sorted(parameters.faults, key=lambda one: one.at)
        self._live: dict[str, int] = {}
        self._silent_until, self._ahead = -1, 0
        self._stuck: list[float] = []
        self._conversions, self._toggled = 0, -1

    @property
    def answered(self) -> bool:
        """Whether the last sample has had its answer, in lockstep."""
        return self.firmware.answered == self.tick & 0xFFFFFFFF

    @property
    def silent(self) -> bool:
        """Whether nothing comes or goes for the moment."""
        return self._sampled_at < self._silent_until

    @property
    def pose(self) -> Array:
        """True pose at the last sample [m, rad], (6,)."""
        return self.plant.state()[0]

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        """Take a frame from a peer at an instant of simulated time [ns]; return what to send back, if anything."""
        if self.silent:
            return None
        self._now = max(now, self._sampled_at)
        return self.firmware.receive(data, self._now + self._ahead, peer)

    def sample(self) -> bytes | None:
        """Go on to the next sampling instant; return what to send to the host in session, if there is one.

        Raises:
            DivergenceError: If the flotor leaves its range by a wide margin, which metal stops do not allow.
        """
        position = self.plant.read().position
        self.tick += 1
        self._sampled_at = self._now = self.tick * self._period
        if self._waiting:
            self._suffer()
        spots = self._read(position)
        if self._offsets is not None:
            spots = [spot + offset for spot, offset in zip(spots, self._offsets)]
        valid, currents = _ALL, self.plant.currents.tolist()
        measured: Sequence[float] = currents
        if self._live:
            spots, valid, measured = self._afflicted(spots, currents)
        self._conversions += 1
        enabled = self._toggled >= 0 and self._now - self._toggled <= self._enable
        if not enabled:
            self.cut()
        reading = Reading(spots, valid, measured, currents, self.plant.segments, self._conversions, enabled)
        frame = self.firmware.sample(self.tick, self._now + self._ahead, reading)
        return None if self.silent else frame

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Switch the currents [A] after the conversion's delay; see `Amplifiers`."""
        # in lockstep the answer takes no time; saying so in seconds would round
        after = None if self.parameters.lockstep else (self._now - self._sampled_at) * 1e-9 + self._delay
        self.plant.drive(held, pulsed, width, after=after)

    def cut(self) -> None:
        """Switch all currents off at once; see `Amplifiers`."""
        if self.tick >= 0:
            self.plant.drive(ZERO, after=(self._now - self._sampled_at) * 1e-9)

    def toggle(self, now: int) -> None:
        """Keep the amplifier board's enable line alive; see `Amplifiers`."""
        self._toggled = self._now

    def _suffer(self) -> None:
        """Begin with what goes wrong by now."""
        while self._waiting and self._waiting[0].at * 1e9 <= self._sampled_at:
            one = self._waiting.pop(0)
            if one.kind == "clock-jump":
                self._ahead += one.which * 1_000_000
            elif one.kind == "silence":
                self._silent_until = self._sampled_at + one.which * 1_000_000
            else:
                self._live[one.kind] = one.which
                if one.kind == "dead-coil":
                    self.plant.open_coil(one.which)

    def _afflicted(self, spots: list[float], currents: Sequence[float]) -> tuple[list[float], int, Sequence[float]]:
        """Return spots, which of them are valid, and currents, as a device reads them that is not well."""
        live, valid = self._live, _ALL
        if "swapped-diodes" in live:
            one = live["swapped-diodes"]
            pairs = [spots[0:2], spots[2:4], spots[4:6]]
            pairs[one], pairs[(one + 1) % 3] = pairs[(one + 1) % 3], pairs[one]
            spots = [part for pair in pairs for part in pair]
        if "stuck-diode" in live:
            first = 2 * live["stuck-diode"]
            self._stuck = self._stuck or spots[first : first + 2]
            spots[first : first + 2] = self._stuck
        if "invalid-diode" in live:
            valid = _ALL & ~(1 << live["invalid-diode"])
        measured = list(currents)
        if "dead-coil" in live:
            measured[live["dead-coil"]] = 0.0
        return spots, valid, measured


def _plant(parameters: TwinParameters, truth: Calibration, hand_force: HandForce | None) -> MuJoCoPlant:
    known = Calibration.nominal()
    # the model's own numbers where they are the truth: what is set anew is rounded
    same = np.array_equal(truth.coils.wrench_per_current, known.coils.wrench_per_current)
    return MuJoCoPlant(
        Timing(period=parameters.period, delay=parameters.delay),
        coil_map=None if same else truth.coils,
        gravity=truth.gravity,
        mass=None if truth.mass == known.mass else truth.mass,
        inertia=None if np.array_equal(truth.inertia, known.inertia) else truth.inertia,
        pose=parameters.pose,
        stops=True,
        hand_force=hand_force,
    )


def _draw() -> int:
    return secrets.randbelow(2**32 - 1) + 1


_AGAIN = 0.02
_LET_GO = 2.0
_LOOK = 0.05
_AT_ONCE = 8


class ServerReport(NamedTuple):
    """What a server came to.

    Attributes:
        ticks: Samples taken.
        missed: Periods for which simulated time stood still because the machine did.
        wall_time: For how long it ran [s].
        latency: Of the samples, in real time.
    """

    ticks: int
    missed: int
    wall_time: float
    latency: LatencyHistogram


class TwinServer:
    """Runs a twin: samples on time, frames in and out.

    In real time it is the clock of both ends: it samples at absolute deadlines, and where it is late by whole periods
    simulated time stands still for as long. In lockstep it takes a sample when the one before is answered, says it
    again after 20 ms without answer, and lets go after 2 s.

    Args:
        twin: The device.
        server: Where hosts reach it; closed with the server.
        spin: How long to poll rather than sleep in lockstep [s]: quick where a processor is free for it.

    Attributes:
        address: Where hosts reach it.
        missed: See `ServerReport`.
    """

    def __init__(self, twin: Twin, server: Server, *, spin: float = 0.0) -> None:
        self.twin, self._server, self._spin = twin, server, spin
        self._period = twin.firmware.profile.period
        self.address: Address = server.address
        self.missed = 0
        self.latency = LatencyHistogram()
        self._stopped = threading.Event()

    def run(self, duration: float | None = None, each: Callable[[], object] | None = None) -> ServerReport:
        """Serve until `stop`, or for so long [s].

        Args:
            duration: How long [s]; None until stopped.
            each: Called after each sample.

        Raises:
            MaglevError: If the simulated device cannot go on, or the line is gone.
        """
        start = time.monotonic_ns()
        end = None if duration is None else start + round(duration * 1e9)
        try:
            if self.twin.parameters.lockstep:
                self._in_lockstep(end, each)
            else:
                self._in_real_time(end, each)
        finally:
            self.twin.cut()
        wall = (time.monotonic_ns() - start) * 1e-9
        return ServerReport(self.twin.tick + 1, self.missed, wall, self.latency)

    def stop(self) -> None:
        """Let `run` end; from any thread."""
        self._stopped.set()

    def close(self) -> None:
        """Stop, and close the socket or line."""
        self.stop()
        self._server.close()

    def _over(self, end: int | None) -> bool:
        return self._stopped.is_set() or (end is not None and time.monotonic_ns() >= end)

    def _in_real_time(self, end: int | None, each: Callable[[], object] | None) -> None:
        twin, clock, period = self.twin, time.monotonic_ns, self._period
        zero = clock() - max(twin.tick, 0) * period
        while not self._over(end):
            deadline = zero + (twin.tick + 1) * period
            self._listen(deadline, zero)
            late = clock() - deadline
            self.latency.add(late)
            # a machine that stalls makes simulated time stall, where catching up would look like a host gone silent
            self.missed += late // period
            zero += late // period * period
            self._say(twin.sample())
            if each is not None:
                each()

    def _listen(self, deadline: int, zero: int) -> None:
        """Take frames until a deadline [ns]; a few where it has passed already, for late is not deaf."""
        clock, server = time.monotonic_ns, self._server
        for _ in range(_AT_ONCE if clock() >= deadline else 0):
            if (arrived := server.receive(0.0)) is None:
                break
            self._take(*arrived, deadline - zero)
        while (left := deadline - clock()) > 0:
            arrived = server.receive(min(left * 1e-9, _LOOK))
            if arrived is not None:
                self._take(*arrived, clock() - zero)
            elif self._stopped.is_set():
                return

    def _take(self, data: bytes, sender: Address, now: int) -> None:
        answer = self.twin.receive(data, now, sender)
        if answer is not None:
            self._server.send(answer, sender)

    def _say(self, frame: bytes | None) -> None:
        if frame is not None:
            self._server.send(frame, self.twin.firmware.peer)

    def _in_lockstep(self, end: int | None, each: Callable[[], object] | None) -> None:
        twin = self.twin
        while not self._over(end):
            if twin.firmware.session == 0:
                self._hear(_LOOK)
                continue
            frame = twin.sample()
            self._say(frame)
            if each is not None:
                each()
            self._await_answer(frame)

    def _await_answer(self, frame: bytes | None) -> None:
        """Wait until the last sample is answered, or nobody is there any more."""
        twin, clock = self.twin, time.monotonic_ns
        asked = clock()
        patience = asked + round(_LET_GO * 1e9)
        again = asked + round(_AGAIN * 1e9)
        spun = asked + round(self._spin * 1e9)
        while not twin.answered and twin.firmware.session and not self._stopped.is_set():
            self._hear(0.0 if clock() < spun else _AGAIN)
            if twin.answered:
                return
            now = clock()
            if now > patience:
                twin.firmware.lose_host(max(twin.tick, 0) * self._period)
            elif now > again:
                self._say(frame)
                again = now + round(_AGAIN * 1e9)

    def _hear(self, timeout: float) -> None:
        """Take a frame if one comes in time [s]."""
        arrived = self._server.receive(timeout)
        if arrived is not None:
            self._take(*arrived, max(self.twin.tick, 0) * self._period)

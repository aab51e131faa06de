"""Device side of the protocol: sessions, states, faults, walls; without sockets, clocks or mechanics."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import count
from typing import Any, NamedTuple, Protocol

from maglev_mj.bridge import wire
from maglev_mj.bridge.safety import WARNING_RISE, CoilGuard, Profile, SpotGuard, ThermalModel, are_off, command_fault
from maglev_mj.bridge.wire import (
    MOST_WALLS,
    NEVER,
    WRAP,
    Codec,
    Fault,
    HelloStatus,
    Operation,
    State,
    WallMessage,
    newer,
)
from maglev_mj.frames import ZERO

_SOFT = sum((fault for fault in Fault if wire.ending_of(fault) is wire.Ending.STOP), Fault(0)) & ~Fault.WALL_ENERGY
"""Faults at which a TRIP starts a controlled stop; no host detects WALL_ENERGY."""
_LONGEST_STOP = 1.0
_GAP = 2
_SILENCE = 1_000_000_000
_HELLO = 1


_MEMORY = 1.0
"""Time constant with which generated energy is forgotten [s]: sensor noise in a wall generates a little."""


class Amplifiers(Protocol):
    """Interface of the amplifiers that the firmware drives."""

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Switch to the currents [A] as soon as possible; `now` is the device's time [ns]."""

    def add(self, now: int, currents: Sequence[float]) -> None:
        """Add the currents of walls [A] to the others from `wall_delay` after `now` [ns], until the next call."""

    def cut(self) -> None:
        """Switch all currents off and discard pending ones, those of walls too."""

    def toggle(self, now: int) -> None:
        """Toggle the amplifiers' enable line."""


class Reading(NamedTuple):
    """Measurements of a device at one sample."""

    spots: Sequence[float]  # on the diodes [m], six
    valid: int  # bit k: spot of diode k is valid
    measured: Sequence[float]  # currents [A], six
    commanded: Sequence[float]  # of the amplifiers [A], six
    intervals: Iterable[tuple[float, Sequence[float]]] = ()  # since the last sample: duration [s], currents [A]
    conversions: int = 0  # counter of the sensor interface
    enabled: bool = True  # as reported by the amplifier board


class Firmware:
    """Device firmware: one session, a state, latched faults.

    Args:
        profile: Device properties.
        amplifiers: Driven amplifiers.
        codec: Encoder and decoder of frames.
        draw: Function that returns a new session number, 1 to 2³² - 1; unpredictable except in tests.

    Attributes:
        stopping: True during a controlled stop: currents flow in FAULT.
        counts: Ignored frames by reason, besides those of the codec.
        answered: Number of the newest sample that was answered; None before the first.
        peer: Address of the host in session; None for none.
    """

    def __init__(self, profile: Profile, amplifiers: Amplifiers, codec: Codec, draw: Callable[[], int]) -> None:
        self.profile, self._amplifiers, self._codec, self._draw = profile, amplifiers, codec, draw
        self.state, self.faults, self.stopping = State.INACTIVE, Fault(0), False
        self.counts: Counter[str] = Counter()
        self.answered: int | None = None
        self.peer: Any = None
        self.session = 0
        self._nonce, self._heard, self._sequence = 0, 0, 0
        self._acknowledgement: wire.ControlAck | None = None
        self._hover: Sequence[float] = ZERO
        self._lifted: Sequence[float] = ZERO  # largest currents without a command
        self._stop: Sequence[float] = wire.CUT
        self._stopped = 0  # number of the last sample when the controlled stop began
        self._newest = 0  # newest sample answered since ARM
        self._commanded_at, self._answers, self._holding, self._sampled = 0, NEVER, False, 0
        self._thermal = ThermalModel(profile.limits)
        self._watchdog = profile.stated["watchdog"]
        self._first, self._fault_time, self._sampled_at = Fault(0), 0, 0
        self._measured: Sequence[float] = ZERO
        self._walls, self._wall_samples = Walls(profile), count()  # in place of the converter's counter
        self._reset_guards()
        # largest age of the answered sample [ns]
        self._stale = 0 if profile.lockstep else profile.stated["stale"]

    def _reset_guards(self) -> None:
        limits = self.profile.limits
        self._coils, self._off, self._disabled = CoilGuard(limits), CoilGuard(limits), 0
        self._spots = SpotGuard(self.profile.limits, self.profile.period * 1e-9)

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        """Handle a frame received at `now` [ns]; return the reply, or None."""
        codec = self._codec
        codec.version_met = None
        frame = codec.decode(data)
        if frame is None:
            if codec.version_met is not None and data[3] == _HELLO:
                return self._answer_hello(now, 0, HelloStatus.VERSION)
            return None
        body = frame.body
        if isinstance(body, wire.Hello):
            return self._hello(body, now, peer)
        if isinstance(body, wire.Estop):
            self.trip(Fault.ESTOP, now)
            sampled, profile = (self._sampled_at, tuple(self._measured)), self.profile
            off = profile.limits.off_current
            answer = wire.EstopAck(body.request, self.state, profile.lockstep, self.faults, *sampled, off)
            return codec.encode(0, 0, now, answer)
        if not isinstance(body, (wire.CommandFrame, wire.ControlRequest)):
            self.counts["direction"] += 1
            return None
        if self.session == 0 or frame.session != self.session or peer != self.peer:
            self.counts["session"] += 1
            return None
        if isinstance(body, wire.ControlRequest):
            return self._control(body, now)
        if not newer(frame.sequence, self._sequence):
            self.counts["old"] += 1
            return None
        self._sequence, self._heard = frame.sequence, now
        self._apply(body, now)
        return None

    def sample(self, tick: int, now: int, reading: Reading) -> bytes | None:
        """Check one sample, trip on faults and return the STATE frame; None without a session.

        Sensors raise faults only in ACTIVE: an idle device may be opened and turned over.

        Args:
            tick: Number of the sample.
            now: Time of the sample [ns].
            reading: Measurements.
        """
        spots, valid, measured, commanded, intervals, conversions, enabled = reading
        steps, self._sampled = (tick - self._sampled) & WRAP, tick & WRAP
        self._sampled_at, self._measured = now, measured
        before, stopping = self._spots.last, self.stopping
        faults = Fault.COIL_OVERTEMP if self._thermal.add(intervals) >= 1.0 else Fault(0)
        if self.state == State.ACTIVE or self.stopping:
            faults |= self._coils.check(commanded, measured)
            faults |= self._spots.check(spots, valid, conversions, steps)
            self._disabled = 0 if enabled else self._disabled + 1
            if self._disabled > 1:
                faults |= Fault.WATCHDOG
        elif self._off.check(ZERO, measured):
            faults |= Fault.COIL_NOT_OFF
        silent = self.state == State.ACTIVE and self._hold(now, faults)
        if faults or silent:
            self.trip(faults | Fault.WATCHDOG * silent, now, soft=not faults)
        stopping |= self.stopping  # also where it ends: these currents were measured before
        if self.stopping:
            self._descend(now, spots, before, steps)
        if self.state == State.ACTIVE or self.stopping:
            self._amplifiers.toggle(now)  # last, so that the amplifiers open if this step hangs
        if self.session == 0:
            return None
        age = min(max(now - self._commanded_at, 0) // 1000, NEVER - 1) if self._answers != NEVER else NEVER
        flags = wire.Flag.HOLDING * self._holding | wire.Flag.ENABLED * enabled | wire.Flag.STOPPING * stopping
        sixes, count = (tuple(spots), tuple(measured), tuple(self._thermal.rises)), conversions & WRAP
        body = wire.StateReport(*sixes, self.state, valid, flags, self.faults, self._answers, age, count)
        return self._codec.encode(self.session, tick, now, body)

    @property
    def walled(self) -> bool:
        """True while `wall` is to be called at each sample of the walls."""
        return self._walls.active

    def wall(self, now: int, reading: Reading) -> None:
        """Render the walls at a sample of their own clock, `wall_period` after the last one.

        Args:
            now: Time of the sample [ns].
            reading: Measurements; spots and validity are used.
        """
        if not self._walls.active or not (self.state == State.ACTIVE or self.stopping):
            return
        if faults := self._walls.guard.check(reading.spots, reading.valid, next(self._wall_samples), 1):
            self.trip(faults, now)
            return
        silent = self._holding or self.stopping
        self._amplifiers.add(now, self._walls.render(now, reading.spots, silent, self.stopping))
        if self._walls.unstable:
            self._walls.clear()
            self._amplifiers.add(now, ZERO)
            self.trip(Fault.WALL_ENERGY, now, soft=True)

    def trip(self, faults: Fault, now: int, *, soft: bool = False) -> None:
        """Latch faults at `now` [ns], and cut the currents; if `soft`, by a controlled stop if currents flow."""
        flying = self.state == State.ACTIVE and (self._holding or self._answers != NEVER)
        if soft and flying and self._stop[6]:
            self.stopping, self._stopped = True, self._sampled
            self._amplifiers.drive(now, self._hover, None, 0.0)
        elif not (soft and self.stopping):
            self._cut()
        if not self.faults:
            self._first, self._fault_time = faults, now
        self._holding = False
        self.state, self.faults = State.FAULT, self.faults | faults

    def lose_host(self, now: int) -> None:
        """End the session; trip the watchdog if currents flow, without a controlled stop: lockstep stands still."""
        if self.state == State.ACTIVE or self.stopping:
            self.trip(Fault.WATCHDOG, now)
        self.session, self.peer = 0, None

    def _cut(self) -> None:
        self._amplifiers.cut()
        self._walls.clear()
        self.stopping = self._holding = False

    def _hold(self, now: int, faults: Fault) -> bool:
        """Hold hover currents while commands are missing; return True after the timeout."""
        gap = 0 if self.profile.lockstep else now - self._commanded_at
        if gap > self._watchdog:
            return True
        if gap > _GAP * self.profile.period and not self._holding and not faults:
            self._holding = True
            self._amplifiers.drive(now, self._hover, None, 0.0)
        return False

    def _descend(self, now: int, spots: Sequence[float], before: Sequence[float] | None, steps: int) -> None:
        """Scale the hover currents: fade out, and damp the motion along the lift."""
        *damping, duration, lift = self._stop
        # in samples, as the clock may be what failed
        elapsed = ((self._sampled - self._stopped) & WRAP) * self.profile.period * 1e-9
        if not elapsed < duration:
            self._cut()
            return
        motion = 0.0
        for share, new, old in zip(damping, spots, before or spots):
            motion += share * (new - old)
        scale = 1.0 - elapsed / duration - motion / (max(steps, 1) * self.profile.period * 1e-9)
        scale = min(scale, lift) if scale > 0.0 else 0.0  # also for NaN
        self._amplifiers.drive(now, tuple([scale * current for current in self._hover]), None, 0.0)

    def _hello(self, hello: wire.Hello, now: int, peer: Any) -> bytes:
        if self.session and hello.nonce == self._nonce and peer == self.peer:
            return self._answer_hello(now, hello.nonce, HelloStatus.WELCOME)  # the earlier answer was lost
        if self.session and (self.state == State.ACTIVE or now - self._heard < _SILENCE):
            self.counts["busy"] += 1
            return self._answer_hello(now, hello.nonce, HelloStatus.BUSY)
        if hello.calibration != self.profile.calibration:
            return self._answer_hello(now, hello.nonce, HelloStatus.CALIBRATION)
        self.session, self._nonce, self.peer, self._heard = self._draw(), hello.nonce, peer, now
        self._sequence, self._acknowledgement = 0, None
        self._answers, self.answered = NEVER, None
        return self._answer_hello(now, hello.nonce, HelloStatus.WELCOME)

    def _answer_hello(self, now: int, nonce: int, status: HelloStatus) -> bytes:
        state = {"state": self.state, "fault_time": self._fault_time, "faults": self.faults, "first": self._first}
        body = self.profile.answer(nonce=nonce, status=status, **state)
        session = self.session if status == HelloStatus.WELCOME else 0
        return self._codec.encode(session, 0, now, body)

    def _apply(self, command: wire.CommandFrame, now: int) -> None:
        # wraps to a huge age for a future sample
        age = ((self._sampled - command.answers) & WRAP) * self.profile.period
        if not self.profile.lockstep:
            age += max(now - self._sampled_at, 0)
        if age > self._stale:
            self.counts["old"] += 1  # delayed in a queue, for a future sample, or duplicated
            return
        self.answered = command.answers
        if self.state != State.ACTIVE:
            self.counts["inactive"] += 1
            if self.state == State.INACTIVE:  # so that a host can measure the link before takeoff
                self._commanded_at, self._answers = now, command.answers
            return
        wrong = command_fault(self.profile.limits, command.held, command.pulsed, command.width)
        # an answer to an older sample moves no edge, nor is the time before it counted again
        newest = command.answers if newer(command.answers, self._newest) else self._newest
        if wrong := wrong or self._walls.fault(command.walls, self._spots.last, (newest - self._newest) & WRAP):
            self.trip(wrong, now, soft=True)
            return
        self._walls.command(command.walls, now + self.profile.delay, (command.held, command.pulsed, self._lifted))
        self._commanded_at, self._answers, self._holding = now, command.answers, False
        self._newest = newest
        self._amplifiers.drive(now, command.held, command.pulsed if command.width else None, command.width)

    def _control(self, control: wire.ControlRequest, now: int) -> bytes | None:
        last = self._acknowledgement
        if last is None or control.request != last.request:
            if last is not None and not newer(control.request, last.request):
                self.counts["old"] += 1
                return None
            self._heard = now
            result = 0 if self._do(control, now) else wire.Outcome.REFUSED
            last = self._acknowledgement = wire.ControlAck(control.request, control.operation, result, 0, 0)
        answer = self._codec.encode(self.session, 0, now, last._replace(state=self.state, faults=self.faults))
        if last.operation == Operation.BYE:
            self.session, self.peer = 0, None
        return answer

    def _do(self, control: wire.ControlRequest, now: int) -> bool:
        """Execute an operation; return True if done."""
        operation = control.operation
        if operation == Operation.TRIP:
            faults = Fault(control.faults & sum(Fault)) or Fault.HOST
            self.trip(faults, now, soft=not faults & ~_SOFT)
        elif operation == Operation.RESET:
            return self._reset()
        elif operation == Operation.ARM:
            return self._arm(control, now)
        elif operation in (Operation.DISARM, Operation.BYE):
            if self.state == State.ACTIVE or self.stopping:
                self._cut()
            if self.state == State.ACTIVE:
                self.state = State.INACTIVE
        else:
            return False
        return True

    def _arm(self, control: wire.ControlRequest, now: int) -> bool:
        hover, stop, limits = control.hover, control.stop, self.profile.limits
        if self.state != State.INACTIVE or not all(abs(x) <= limits.hover_limit for x in hover):
            return False
        if not (all(map(math.isfinite, stop)) and 0.0 <= stop[6] <= _LONGEST_STOP and stop[7] >= 0.0):
            return False
        if not all(abs(stop[7] * x) <= limits.continuous_current for x in hover):
            return False
        self._hover, self._stop = hover, stop
        self._lifted = [max(stop[7], 1.0) * x for x in hover]
        self._commanded_at, self._answers, self._holding = now, NEVER, False
        self._newest = self._sampled
        self._reset_guards()
        self.state = State.ACTIVE
        self._amplifiers.toggle(now)
        return True

    def _reset(self) -> bool:
        off = are_off(self._measured, self.profile.limits.off_current)
        if self.state == State.ACTIVE or self.stopping or max(self._thermal.rises) >= WARNING_RISE or not off:
            return False
        self.state, self.faults, self._first, self._fault_time = State.INACTIVE, Fault(0), Fault(0), 0
        return True


class Walls:
    """Walls in effect on a device, and those of the newest command.

    Args:
        profile: Properties of the device, with its `wall_maps`.

    Attributes:
        active: True while walls are in effect or pending, or their currents are to be taken back.
        guard: Guard of the spots at the walls' samples.
    """

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self.clear()

    def clear(self) -> None:
        """Remove all walls at once: the currents are cut."""
        self.active, self.guard = False, SpotGuard(self._profile.limits, self._profile.wall_period * 1e-9)
        self._walls: Sequence[WallMessage] = ()
        self._pending: Sequence[WallMessage] | None = None
        self._due = self._sampled_at = 0  # [ns]
        self._pose: Sequence[float] | None = None  # at the last sample
        self._speeds, self._forces = [0.0] * MOST_WALLS, [0.0] * MOST_WALLS
        self._peaks: tuple[Sequence[float], Sequence[float]] = ZERO, ZERO
        self._energy = self._stored = 0.0
        self._currents: Sequence[float] = ZERO  # at the last sample
        self._receding = 0  # samples in the controlled stop

    @property
    def unstable(self) -> bool:
        """True if the walls have returned more energy than they took, by more than allowed."""
        return self._energy - self._stored > self._profile.limits.energy

    def fault(self, walls: Sequence[WallMessage], spots: Sequence[float] | None, periods: int) -> Fault:
        """Return the fault of a command's walls, if any.

        Args:
            walls: All walls of the command.
            spots: Last spots [m], six; None without.
            periods: Sample periods for which edges may move.
        """
        profile, latest = self._profile, self._walls if self._pending is None else self._pending
        if not walls:
            return Fault(0)
        if spots is None or profile.wall_maps is None or profile.wall_problem(walls):
            return Fault.INVALID_COMMAND
        moved = profile.edge_problem(walls, latest, profile.wall_maps.pose(spots), periods)
        return Fault.INVALID_COMMAND if moved else Fault(0)

    def command(self, walls: Sequence[WallMessage], due: int, currents: Sequence[Sequence[float]]) -> None:
        """Replace the walls at a time [ns].

        A replacement that is still pending is made now, but replaced by that of the same answer, repeated.
        `currents` are those that the host's part may have from then on [A], six each.
        """
        if not (walls or self.active):
            return
        if self._pending is not None and due > self._due:
            self._switch()
        peak = [max(map(abs, coil)) for coil in zip(*currents)]
        self._peaks = self._peaks[self._pending is None] if self.active else peak, peak
        self._pending, self._due, self.active = walls, due, True

    def _switch(self) -> None:
        """Let the pending walls take effect; a wall on the same axis and side continues."""
        pending: Sequence[WallMessage] = self._pending or ()
        for index, wall in enumerate(pending):
            if index >= len(self._walls) or wall[:2] != self._walls[index][:2]:
                self._speeds[index] = self._forces[index] = 0.0
        self._walls, self._pending = pending, None

    def render(self, now: int, spots: Sequence[float], silent: bool, stopping: bool) -> Sequence[float]:
        """Return the currents of the walls at a sample [A], six.

        Inside f = -K (x - edge) - B v. While commands are missing a wall on both sides has no stiffness: it would pull
        to where its edge was. A sample that is not later than the last one has no speed: the currents stay.

        Args:
            now: Time of the sample [ns].
            spots: Measured spots [m], six.
            silent: True while commands are missing, and in a controlled stop.
            stopping: True in a controlled stop: edges recede.
        """
        maps, limits = self._profile.wall_maps, self._profile.limits
        assert maps is not None
        if self._pending is not None and now >= self._due:
            self._switch()
        if self._pose is not None and now <= self._sampled_at:
            self._sampled_at = now  # of a clock that was set back: the next sample is later
            return self._currents
        pose, forces = maps.pose(spots), [0.0] * 6
        before = pose if self._pose is None else self._pose
        # in samples, as the clock may be what failed
        receded = limits.recede * (self._receding * self._profile.wall_period * 1e-9)
        self._receding += stopping
        elapsed = (now - self._sampled_at if self._pose is not None else self._profile.wall_period) * 1e-9
        surplus, stored = max(self._energy - self._stored, 0.0), 0.0
        energy = self._energy - surplus * elapsed / _MEMORY
        for index, (axis, side, edge, stiffness, damping, cutoff) in enumerate(self._walls):
            edge -= side * (receded / limits.lever_of(axis))
            stiffness = 0.0 if silent and not side else stiffness
            moved, first, offset = pose[axis] - before[axis], before[axis] - edge, pose[axis] - edge
            speed, last = moved / elapsed, self._speeds[index]
            if cutoff:
                speed = last - math.expm1(-2.0 * math.pi * cutoff * elapsed) * (speed - last)
            inside = side * offset <= 0.0
            within = 0.5 * stiffness * offset * offset if inside else 0.0
            stored += within
            energy += self._forces[index] * moved + within
            energy -= 0.5 * stiffness * first * first if side * first <= 0.0 else 0.0
            self._speeds[index], force = speed, -(stiffness * offset + damping * speed) if inside else 0.0
            self._forces[index] = force
            forces[axis] += force
        a, b, c, d, e, f = forces
        currents = [p * a + q * b + r * c + s * d + t * e + u * f for p, q, r, s, t, u in maps.current_per_wrench]
        share = 1.0
        for current, peak, other in zip(currents, *self._peaks):
            room = max(limits.current_limit - max(peak, other), 0.0)
            if abs(current) > room:
                share = min(share, room / abs(current))
        if share < 1.0:  # reduced together, so that the direction stays
            currents, self._forces = [share * x for x in currents], [share * x for x in self._forces]
        self._pose, self._sampled_at, self._energy, self._stored = pose, now, max(energy, 0.0), stored
        self._currents = currents
        if not self._walls and self._pending is None:
            self.clear()
        return currents

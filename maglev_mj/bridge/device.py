"""A device at the other end of a wire, as far as its state goes: armed, disarmed, stopped, reset; and how it fails."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, Self

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.bridge.connection import Connection
from maglev_mj.bridge.fault import BlackBox, DeviceFault
from maglev_mj.bridge.wire import Fault, Operation, State, fault_names
from maglev_mj.errors import PlantError
from maglev_mj.frames import ZERO
from maglev_mj.net.udp import Link, LinkError
from maglev_mj.parameters import number

__all__ = ["RemoteDevice", "SampleCounter"]

_UNKNOWN = (float("nan"),) * 6
_WRAP = 0xFFFFFFFF


class SampleCounter:
    """Counts samples by the numbers that the device gives them.

    Args:
        period: Sample period [ns].

    Attributes:
        period: Sample period [ns].
        tick: Of the last sample, from 0 at the first that came.
        elapsed: Samples from the one before to the last.
        lost: Samples that did not arrive.
        skipped: Samples that nobody answered because a newer one was there.
    """

    def __init__(self, period: int) -> None:
        self.tick, self.elapsed, self.lost, self.skipped = -1, 0, 0, 0
        self.period, self._sequence, self._time = period, 0, 0

    def count(self, sequence: int, time: int, skipped: int) -> str:
        """Count a sample; return what is wrong with the device's clock, nothing where it keeps step.

        Args:
            sequence: Its number.
            time: Of the device's clock [ns].
            skipped: Older samples that came with it.
        """
        said = ""
        if self.tick < 0:
            self.tick = 0
        else:
            self.elapsed = (sequence - self._sequence) & _WRAP
            passed = time - self._time
            if abs(passed - self.elapsed * self.period) > self.period // 2:
                said = f"{passed * 1e-6:.3f} ms went by in {self.elapsed} samples of {self.period * 1e-6:.3f} ms"
            self.tick += self.elapsed
            missing = self.elapsed - 1
            if missing:
                self.skipped += min(skipped, missing)
                self.lost += missing - min(skipped, missing)
        self._sequence, self._time = sequence, time
        return said


class RemoteDevice:
    """The state of a device. All of it is for the thread that flies the device.

    Args:
        link: The wire; closed with the device.
        calibration: What is known of the device.
        key: With which frames are sealed.
        patience: How long to wait for an answer [s].
        folder: Where the last cycles before a fault are written.

    Attributes:
        state: Of the device, at the last sample.
        faults: Likewise.
        samples: Their count, and what is missing of them.

    Raises:
        HandshakeError: If no device answers, or it will not have this host.
        ParameterError: If the patience is not above 0.
    """

    def __init__(self, link: Link, calibration: Calibration, key: bytes | None, patience: float, folder: Path) -> None:
        self.calibration = calibration
        self._patience = number("patience", patience, above=0.0)
        self._box = BlackBox(folder)
        self._line = Connection(link, calibration.digest, key, self._patience)
        self.state, self.faults = State(self._line.welcome.state), Fault(0)
        self.samples = SampleCounter(self._line.welcome.period)
        self.last_currents: Sequence[float] = ZERO
        self._armed = False  # by this host, and nothing has ended it that was reported
        # the last sample, but for the pose, which may not be known
        self._row: tuple[Any, ...] = ()
        self._seen: Sequence[float] = _UNKNOWN

    def arm(self) -> None:
        """Let the currents flow. Where commands are missing, the device holds the flotor by those that carry it.

        Raises:
            PlantError: If the device refuses, as in the fault state.
        """
        self._ask(Operation.ARM, hover=self.calibration.hover.tolist())
        self.state, self._armed = State.ACTIVE, True

    def disarm(self) -> None:
        """Switch the currents off."""
        self._ask(Operation.DISARM)
        self._armed = False
        if self.state == State.ACTIVE:
            self.state = State.INACTIVE

    def estop(self) -> None:
        """Switch the currents off in whatever state, and latch that it was asked for; the next sample is a fault."""
        self._check_open()
        if self._line.estop() is None:
            raise PlantError(f"the device did not answer an emergency stop within {self._patience:g} s: cut its power")
        self.state, self.faults = State.FAULT, self.faults | Fault.ESTOP

    def reset(self) -> None:
        """Leave the fault state; a PlantError if the device refuses because its coils are too warm."""
        self._ask(Operation.RESET)
        self.state, self.faults, self._armed = State.INACTIVE, Fault(0), False

    def trip(self, faults: Fault) -> None:
        """Put the device into the fault state, whether or not the line is good enough for an answer."""
        self.state, self.faults = State.FAULT, self.faults | faults
        with suppress(LinkError):  # the watchdog does it where there is no line
            self._line.control(Operation.TRIP, faults=faults)

    def close(self) -> None:
        """Switch the currents off and let go of the device; safe to call at any time, and more than once."""
        self._armed = False
        self._line.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if self._armed and isinstance(error, Exception) and self.state == State.ACTIVE:
            with suppress(DeviceFault):
                self._fail(Fault.HOST, f"{type(error).__name__}: {error}")
        self.close()

    def _ask(self, operation: Operation, *, hover: Sequence[float] = ZERO) -> None:
        self._check_open()
        answer = self._line.control(operation, hover=hover)
        if answer is None:
            raise PlantError(f"the device did not answer {operation.name} within {self._patience:g} s")
        if answer.result:
            hint = "; see to it, then reset" if answer.state == State.FAULT else ""
            raise PlantError(
                f"the device refused {operation.name}: it is {_name(answer.state)}, faults "
                f"{fault_names(answer.faults)}{hint}"
            )

    def _check_open(self) -> None:
        if not self._line.open:
            raise PlantError("the plant is closed")

    def _adopt(self, state: int, faults: int) -> None:
        """Take over the state that the device says it is in, and complain of one that flying cannot go on in."""
        if state not in tuple(State):
            self._fail(Fault.HOST, f"the device says that it is in state {state}, which is none")
        before, self.state, self.faults = self.state, State(state), Fault(faults)
        if self.state == State.FAULT != before:
            self._fail(self.faults, "said by the device")
        if self.state == State.INACTIVE and before == State.ACTIVE:
            self._fail(Fault.HOST, "the device switched its currents off without being asked to")

    def _fail(self, faults: Fault, message: str) -> NoReturn:
        """Put the device into the fault state, keep the last cycles, and say so."""
        self._armed = False
        if self.state != State.FAULT or not self.faults & faults:
            self.trip(faults)
        faults |= self.faults  # such as an e-stop, after which it fell
        samples = self.samples
        about = {"tick": samples.tick, "lost": samples.lost, "skipped": samples.skipped, "period_ns": samples.period}
        if self._row:
            self._box.keep((*self._row, self._seen, self.last_currents, self.last_currents, 0.0))
        path = self._box.write(faults, message, about)
        raise DeviceFault(faults, message, path)


def _name(state: int) -> str:
    return State(state).name if state in tuple(State) else f"in state {state}"

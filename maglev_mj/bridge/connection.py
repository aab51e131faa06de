"""The host's end of a session: the handshake, requests that are repeated until answered, and the newest sample."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress

from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.wire import (
    VERSION,
    Codec,
    Command,
    Control,
    ControlAck,
    Estop,
    EstopAck,
    Frame,
    Hello,
    HelloAck,
    HelloStatus,
    Operation,
    StateReport,
    newer,
)
from maglev_mj.frames import ZERO
from maglev_mj.net.udp import Link, LinkError

__all__ = ["Connection"]

_AGAIN = 0.02
"""A request is repeated after so long without an answer [s]."""

_ESTOP_AGAIN = 0.005
"""An emergency stop is asked for again after so long without an answer [s]."""

_TAKEOVER = 1_000_000_000
"""A device gives up a host that says nothing for so long [ns], unless it flies."""


class Connection:
    """A session with a device.

    Args:
        link: The wire; closed with the connection.
        calibration: First 16 bytes of the hash of what the host knows of the device.
        key: With which frames are sealed.
        patience: How long to wait for an answer [s].

    Attributes:
        welcome: What the device said of itself.
        limits: What it bears.
        codec: Its frames, and what was dropped of them, by reason.
        open: Whether it has not been closed.
        skipped: Samples left out for the newer one that the last `state` returned.
        settled: When the device last did what it was asked for, by its own clock [ns]: what a sample from before that
            says of its state is old.

    Raises:
        HandshakeError: If there is no device, or it will not have this host.
    """

    def __init__(self, link: Link, calibration: bytes, key: bytes | None, patience: float) -> None:
        self._link, self._patience = link, patience
        self.codec = Codec(key)
        self._session, self._sequence, self._request = 0, 0, 0
        self._newest: int | None = None
        self._waiting: Frame | None = None
        self._last: Command | None = None
        self.skipped, self._overtaken, self.settled = 0, 0, 0
        self.open = True
        try:
            self.welcome = self._greet(calibration)
        except BaseException:
            self.open = False
            link.close()
            raise
        one = self.welcome
        self.limits = Limits(
            current=one.current_limit,
            continuous_current=one.continuous_current,
            thermal_time=one.thermal_time,
            spot=one.spot_limit,
            spot_speed=one.spot_speed,
            watchdog=one.watchdog * 1e-9,
            enable=one.enable * 1e-9,
            hover=one.hover_limit,
            frozen=one.frozen,
        )

    def command(self, command: Command) -> None:
        """Send currents."""
        self._last = command
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        link = self._link
        link.send(self.codec.encode(self._session, self._sequence, link.now(), command))

    def state(self, timeout: float) -> Frame | None:
        """Return the newest sample, or None if none comes in time [s]."""
        frame, self._waiting = self._waiting, None
        self.skipped, self._overtaken = self._overtaken, 0
        link = self._link
        end = link.now() + int(timeout * 1e9)
        while frame is None:
            data = link.receive(max((end - link.now()) * 1e-9, 0.0))
            if data is None:
                return None
            frame = self._sample_in(data)
        if self.welcome.lockstep:
            return frame  # there is no newer one: the device waits for the answer to this
        while (data := link.receive(0.0)) is not None:
            if (later := self._sample_in(data)) is not None:
                frame = later
                self.skipped += 1
        return frame

    def control(self, operation: Operation, *, faults: int = 0, hover: Sequence[float] = ZERO) -> ControlAck | None:
        """Ask for a change of state until the device answers; None if it does not."""
        if not self.open:
            return None
        self._request += 1
        body = Control(self._request, operation, faults, tuple(hover))
        link = self._link
        end = link.now() + int(self._patience * 1e9)
        while link.now() < end:
            link.send(self.codec.encode(self._session, 0, link.now(), body))
            again = link.now() + int(_AGAIN * 1e9)
            while (left := again - link.now()) > 0:
                data = link.receive(left * 1e-9)
                if data is None:
                    break
                frame = self._trusted(data)
                if frame is None:
                    continue
                if isinstance(frame.body, ControlAck) and frame.body.request == self._request:
                    self.settled = frame.time
                    return frame.body
                if isinstance(frame.body, StateReport) and self._is_newer(frame):
                    self._overtaken += self._waiting is not None
                    self._waiting = frame  # a sample that came meanwhile is read later
        return None

    def estop(self) -> EstopAck | None:
        """Ask for an emergency stop until the device answers; None if it does not."""
        link, body = self._link, Estop(int.from_bytes(os.urandom(8), "little"))
        end = link.now() + int(self._patience * 1e9)
        while link.now() < end:
            link.send(self.codec.encode(0, 0, link.now(), body))
            again = link.now() + int(_ESTOP_AGAIN * 1e9)
            while (left := again - link.now()) > 0 and (data := link.receive(left * 1e-9)) is not None:
                frame = self.codec.decode(data)
                if frame is not None and isinstance(frame.body, EstopAck) and frame.body.request == body.request:
                    return frame.body
        return None

    def close(self) -> None:
        """End the session, if the device still listens, and close the link; a second time does nothing."""
        if self.open:
            try:
                with suppress(LinkError):  # there is nothing to be said to a line that is gone
                    self.control(Operation.BYE)
            finally:
                self.open = False
                self._link.close()

    def _greet(self, calibration: bytes) -> HelloAck:
        """Say hello until the device answers."""
        link, codec = self._link, self.codec
        nonce = int.from_bytes(os.urandom(8), "little")
        hello = Hello(nonce, calibration)
        end, busy = link.now() + int(self._patience * 1e9), False
        while link.now() < end + busy * _TAKEOVER:
            link.send(codec.encode(0, 0, link.now(), hello))
            again = link.now() + int(5.0 * _AGAIN * 1e9)
            while (left := again - link.now()) > 0 and (data := link.receive(left * 1e-9)) is not None:
                answer = self._welcome(data, nonce, calibration)
                if answer is not None and answer.status == HelloStatus.WELCOME:
                    return answer
                busy |= answer is not None
        if busy:
            raise HandshakeError("another host has the device")
        dropped = ", ".join(f"{count} for {reason}" for reason, count in codec.dropped.items())
        reason = f"; frames dropped: {dropped}" if dropped else ""
        raise HandshakeError(f"no device answered within {self._patience:g} s{reason}")

    def _welcome(self, data: bytes, nonce: int, calibration: bytes) -> HelloAck | None:
        """Return the answer to a HELLO, if data is that, and keep the session; complain where it is a command_fault."""
        self.codec.version_met = None
        frame = self.codec.decode(data)
        version = self.codec.version_met
        if frame is not None and isinstance(frame.body, HelloAck):
            answer = frame.body
            if answer.status == HelloStatus.VERSION:
                version = answer.version
            elif answer.nonce != nonce:
                return None
            elif answer.status == HelloStatus.CALIBRATION:
                raise HandshakeError(
                    f"the device's calibration is {answer.calibration.hex()}, this host's {calibration.hex()}"
                )
            else:
                self._session = frame.session
                return answer
        if version is not None:
            raise HandshakeError(f"the device speaks version {version} of the protocol, this host version {VERSION}")
        return None

    def _trusted(self, data: bytes) -> Frame | None:
        """Return a frame of this session."""
        frame = self.codec.decode(data)
        if frame is not None and frame.session != self._session:
            self.codec.dropped["session"] += 1
            return None
        return frame

    def _is_newer(self, frame: Frame) -> bool:
        newest = self._newest
        if newest == frame.sequence and self.welcome.lockstep and self._last is not None:
            self.command(self._last)  # the device waits, so the answer was lost
        if newest is not None and not newer(frame.sequence, newest):
            self.codec.dropped["old"] += 1
            return False
        self._newest = frame.sequence
        return True

    def _sample_in(self, data: bytes) -> Frame | None:
        """Return the sample in a frame, if it is newer than the last."""
        frame = self._trusted(data)
        if frame is None or not isinstance(frame.body, StateReport) or not self._is_newer(frame):
            return None
        return frame

"""Frames over a serial line, with COBS encoding.

A serial line needs pyserial (the extra `serial`); a pseudo-terminal does not.

Source: S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999.
"""

from __future__ import annotations

import os
import time
from collections import deque
from contextlib import suppress

from maglev_mj.errors import ParameterError, require
from maglev_mj.net.udp import Address, LinkError, readable

LONGEST = 4096
"""Largest number of bytes of a frame."""

_FLOOD = 1e-3  # longest reading of invalid data beyond the caller's timeout [s]
_CODES = [bytes([length + 1]) for length in range(255)]


def cobs_encode(data: bytes) -> bytes:
    """Return COBS-encoded data, without a zero byte.

    It is longer by 1 and by at most one more for every 254 bytes.
    """
    pieces: list[bytes] = []
    blocks = data.split(b"\0")
    for left, block in enumerate(blocks, 1 - len(blocks)):
        while len(block) > 253 + (left == 0):  # the last has no zero after it
            pieces += (b"\xff", block[:254])
            block = block[254:]
        pieces += (_CODES[len(block)], block)
    return b"".join(pieces)


def cobs_decode(data: bytes) -> bytes | None:
    """Return COBS-decoded data; None for an invalid encoding."""
    end = len(data)
    if not end or b"\0" in data:
        return None
    pieces = []
    start = 0
    while start < end:
        code = data[start]
        stop = start + code
        if stop > end:
            return None
        pieces.append(data[start + 1 : stop])
        if code < 255 and stop < end:
            pieces.append(b"\0")
        start = stop
    return b"".join(pieces)


class Deframer:
    """Splitter of a byte stream into frames.

    It resynchronizes after garbage.

    Attributes:
        frames: Received frames, oldest first; to be taken from the left.
        dropped: Number of invalid pieces.
    """

    def __init__(self) -> None:
        self.frames: deque[bytes] = deque()
        self.dropped = 0
        self._rest = b""
        self._lost = False

    def feed(self, data: bytes) -> None:
        """Add the next bytes."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        for piece in pieces:
            frame = None if self._lost or len(piece) > LONGEST else cobs_decode(piece)
            if frame is not None:
                self.frames.append(frame)
            elif piece or self._lost:
                self.dropped += 1
            self._lost = False
        if len(self._rest) > LONGEST:
            self._rest, self._lost = b"", True


class _Line:
    """Frames over a non-blocking file descriptor."""

    def __init__(self, descriptor: int, name: str) -> None:
        self._descriptor, self._name = descriptor, name
        self._deframer = Deframer()

    @property
    def dropped(self) -> int:
        """Number of invalid pieces between zero bytes."""
        return self._deframer.dropped

    def _write(self, data: bytes) -> None:
        """Send one frame; drop it if the buffer is full.

        Raises:
            LinkError: If the link has failed.
        """
        try:
            # the zero before it keeps noise, or a frame cut short for lack of room, from spoiling this one
            os.write(self._descriptor, b"\0" + cobs_encode(data) + b"\0")
        except BlockingIOError:
            pass  # no room: lost, as on any link
        except OSError as error:
            raise LinkError(f"{self._name} is gone: {error.strerror}") from None

    def _next(self, timeout: float) -> bytes | None:
        """See `Link.receive`."""
        frames = self._deframer.frames
        end = time.monotonic() + timeout
        while not frames:
            left = end - time.monotonic()
            if left < -_FLOOD or not readable(self._descriptor, left):
                return None
            self._deframer.feed(self._read())
        return frames.popleft()

    def _read(self) -> bytes:
        try:
            data = os.read(self._descriptor, LONGEST)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkError(f"{self._name} is gone: {error.strerror}") from None
        if not data:  # though it was readable
            raise LinkError(f"{self._name} is gone: end of file")
        return data


class SerialLink(_Line):
    """Link over a serial line, opened exclusively.

    Args:
        path: Path of the line, such as /dev/ttyUSB0.
        baud: Rate [1/s], above 0.

    Raises:
        MissingPackageError: If pyserial is not installed.
        ParameterError: If the line does not have that rate.
        LinkError: If it cannot be opened.
    """

    def __init__(self, path: str, baud: int) -> None:
        require(("serial",), "serial", "a serial line needs pyserial")
        from serial import Serial

        try:
            self._port = Serial(path, baud, timeout=0, exclusive=True)
        except ValueError:
            raise ParameterError(f"baud must be a rate that {path} has, not {baud!r}") from None
        except OSError as error:
            raise LinkError(f"cannot open serial://{path}: {error.strerror or error}") from None
        # without it some USB adapters hold bytes back for 16 ms; others, and a pty, do not know it
        with suppress(OSError, ValueError, AttributeError, NotImplementedError):
            self._port.set_low_latency_mode(True)
        super().__init__(self._port.fileno(), path)

    send, receive = _Line._write, _Line._next

    def now(self) -> int:
        """Return this machine's monotonic clock [ns]."""
        return time.monotonic_ns()

    def close(self) -> None:
        """Close the line; idempotent."""
        self._descriptor = -1  # a number that the system may hand out again
        with suppress(OSError):  # an adapter that was pulled out
            self._port.close()


class PtyServer(_Line):
    """Device's end of a simulated serial line, a pseudo-terminal.

    Any program may open the other end.

    Attributes:
        path: Path of the other end, for a `SerialLink`.
        address: Address of its only peer.

    Raises:
        LinkError: If the system has no pseudo-terminals.
    """

    def __init__(self) -> None:
        try:
            import tty

            master, self._slave = os.openpty()
        except (ImportError, AttributeError, OSError) as error:
            raise LinkError(f"no pseudo-terminal: {error}") from None
        tty.setraw(self._slave)  # kept open, or the line would be gone whenever the peer closes
        os.set_blocking(master, False)
        self.path = os.ttyname(self._slave)
        self.address: Address = (self.path, 0)
        self._open = True
        super().__init__(master, self.path)

    def receive(self, timeout: float) -> tuple[bytes, Address] | None:
        """Return the oldest frame and its sender, or None.

        It waits up to `timeout` [s]; 0 returns at once.
        """
        data = self._next(timeout)
        return None if data is None else (data, self.address)

    def send(self, data: bytes, address: Address) -> None:
        """Send one frame; drop it if the buffer is full."""
        self._write(data)

    def close(self) -> None:
        """Close both ends; idempotent."""
        if self._open:
            self._open = False
            os.close(self._descriptor)
            os.close(self._slave)
            self._descriptor = -1

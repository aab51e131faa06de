"""Six axes published at a socket to clients of a 3D mouse; see `Publisher`."""

from __future__ import annotations

import errno
import os
import socket
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.interop.spacenav.mapping import NO_BUTTONS, REST, Axes, Buttons, PoseAxes
from maglev_mj.interop.spacenav.protocol import BUTTONS, MOTIONS, Conversation, GarbageError, button_event, motion_event
from maglev_mj.session import Snapshot

_LONGEST = 107  # bytes: what a Unix socket's address has room for
_WAITING = 16
_SETTINGS, _DAEMONS = Path("/etc/spnavrc"), Path("/var/run/spnav.sock")


def default_path() -> Path:
    """Return the socket's default path.

    $SPNAV_SOCKET, or a path in $XDG_RUNTIME_DIR, or else one in the folder for temporary files.
    """
    if named := os.environ.get("SPNAV_SOCKET"):
        return Path(named)
    if folder := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(folder) / "maglev-spnav.sock"
    return Path(tempfile.gettempdir()) / f"maglev-spnav-{os.getuid()}.sock"


def searched_paths() -> list[Path]:
    """Return possible 3D mouse sockets, first choice first.

    Source: libspnav 1.0, `spnav_open`: $SPNAV_SOCKET, the first `socket = PATH` of /etc/spnavrc, /var/run/spnav.sock.
    """
    try:
        lines = _SETTINGS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    split = [line.strip().partition("=") for line in lines]
    set_there = [path.strip() for word, _, path in split if word.startswith("socket") and path.strip()]
    named = os.environ.get("SPNAV_SOCKET")
    return [*map(Path, [named] if named else []), *map(Path, set_there[:1]), _DAEMONS]


class Place:
    """Listening socket at a path, for this user alone.

    Mode 0600 from its first moment on.

    Args:
        path: Where; `default_path` by default. What a dead server has left there is replaced.

    Attributes:
        path: Where it is.
        listener: The socket, which never waits.

    Raises:
        ParameterError: If the path is too long, in no folder, something else's or a living server's.
        MaglevError: If this system has no such sockets, or refuses one.
    """

    def __init__(self, path: Path | None = None) -> None:
        if not hasattr(socket, "AF_UNIX"):
            raise MaglevError("spacenav needs Unix sockets, which this system does not have")
        path = default_path() if path is None else path
        if (length := len(os.fsencode(path))) > _LONGEST:
            raise ParameterError(f"socket must be a path of at most {_LONGEST} bytes, not {length}: {str(path)!r}")
        if not path.parent.is_dir():
            raise ParameterError(f"socket must be in a folder that there is, not {str(path)!r}")
        _clear(path)
        self.path, self.listener = path, _listener(path)
        self._own = _identity(path)

    def close(self) -> None:
        """Stop listening and remove the socket.

        Not if it is another's by now; a second call does nothing.
        """
        self.listener.close()
        if self._own is not None and _identity(self.path) == self._own:
            self.path.unlink(missing_ok=True)
        self._own = None


def _listener(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    mask = os.umask(0o177)
    try:
        listener.bind(os.fspath(path))
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise _taken(path) from None
        raise MaglevError(f"cannot listen at {path}: {error.strerror}") from None
    finally:
        os.umask(mask)
    listener.listen(_WAITING)
    listener.setblocking(False)
    return listener


def _clear(path: Path) -> None:
    """Remove the socket of a dead server."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise ParameterError(f"socket must be a path where nothing or a socket is, not {str(path)!r}")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.setblocking(False)
        refused = caller.connect_ex(os.fspath(path))
    if refused != errno.ECONNREFUSED:  # it answers, is busy, or is not ours to ask
        raise _taken(path)
    path.unlink(missing_ok=True)


def _taken(path: Path) -> ParameterError:
    return ParameterError(f"socket must be one that no other server has, not {str(path)!r}")


def _identity(path: Path) -> tuple[int, int] | None:
    """Return an identity that tells files of one path apart.

    None if there is no file.
    """
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


_MOST_CLIENTS = 16
_AT_ONCE = 512
_ROOM = 106_496  # bytes: with what Linux adds to each event, some 4 s of motion
_PATIENCE = 1.0
_LONGEST_PERIOD = 60_000
_FAREWELL = 0.2


class _Client:
    """One connected program; `gone` if it has left."""

    def __init__(self, line: socket.socket, now: float) -> None:
        self.line, self.talk, self.gone = line, Conversation(), False
        self._since = self._last = now
        self._asks = self._moves = False
        self._down = list(NO_BUTTONS)
        line.setblocking(False)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _ROOM)

    def listens(self, now: float) -> bool:
        """Whether it takes events now.

        libspnav takes whatever comes next for the answer to what it has asked. So until it has first asked it is told
        nothing, unless it is one that never does, and while it asks more it is told the answers alone.
        """
        begun = self.talk.begun or now - self._since > _PATIENCE
        return begun and not self._asks

    def tell(self, axes: tuple[int, ...], down: tuple[bool, ...], now: float) -> Iterator[bool]:
        """Send new motion and buttons; yield False without room.

        One more event says that nothing moves.

        What there was no room for is said again if it is still so, above all that nothing moves any more.
        """
        axes = self.talk.scaled(axes)
        if self.talk.mask & MOTIONS and (self._moves or axes != REST):
            period = min(round((now - self._last) * 1e3), _LONGEST_PERIOD)
            yield (told := self.send(motion_event(axes, period)))
            if told:
                self._moves, self._last = axes != REST, now
        for number, is_down in enumerate(down if self.talk.mask & BUTTONS else ()):
            if is_down != self._down[number]:
                yield (told := self.send(button_event(number, is_down)))
                if told:
                    self._down[number] = is_down

    def send(self, data: bytes) -> bool:
        """Send some bytes; return whether there was room for them."""
        try:
            return self.line.send(data) == len(data)
        except BlockingIOError:
            return False
        except OSError:
            self.gone = True
            return False

    def hear(self) -> bool:
        """Answer a client; return True while it stays valid."""
        self._asks = False
        try:
            data = self.line.recv(_AT_ONCE)
        except BlockingIOError:
            return True
        except OSError:
            data = b""
        if not data:
            self.gone = True
            return False
        try:
            answers = self.talk.hear(data)
        except GarbageError:
            return False
        self._asks = self.talk.version > 0
        return not answers or self.send(answers)


class SpacenavServer:
    """Publish six axes over spacenav's protocol at each snapshot.

    Nothing waits: a program misses the events for which its socket has no room, after about 4 s of motion unread. One
    that sends what is no request is let go. At rest there is one event of zeros and then none, as real devices do it;
    so it is where the scene is paused or has stopped.

    Args:
        path: Where the socket is; `default_path` by default.
        axes: What is told; deflections by default.
        buttons: Which buttons are down; none ever by default.
        clock: Returns real time [s].

    Attributes:
        path: Where the socket is.
        clients: Connected programs.
        sent: Events, to all programs together.
        missed: Events for which programs had no room.
        dropped: Programs let go because they sent rubbish.
        refused: Programs too many.

    Raises:
        ParameterError: If the path is one where no socket can be.
        MaglevError: If this system has none.

    Source: the protocol as libspnav 1.0 speaks it, https://spacenav.sourceforge.net.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        axes: Axes | None = None,
        buttons: Buttons | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.sent = self.missed = self.dropped = self.refused = 0
        self._axes, self._buttons, self._clock = axes or PoseAxes(), buttons or (lambda _: NO_BUTTONS), clock
        self.clients: list[_Client] = []
        self._place = Place(path)
        self.path = self._place.path

    def take(self) -> None:
        """Return None: programs ask for nothing here."""

    def show(self, snapshot: Snapshot) -> None:
        """Publish a snapshot; see `Publisher`."""
        now = self._clock()
        self._admit(now)
        self._receive()
        self._tell(self._axes(snapshot), self._buttons(snapshot), now)

    def close(self) -> None:
        """Send rest, disconnect all clients and remove the socket.

        A second call does nothing.

        Who is in motion has 0.2 s to come to rest: libspnav makes of a line that ends while it looks for events an
        endless loop, and of the last motion a lasting one.
        """
        before = self.sent
        self._tell(REST, NO_BUTTONS, self._clock())
        if self.sent > before:
            time.sleep(_FAREWELL)
        for client in self.clients:
            client.line.close()
        self.clients.clear()
        self._place.close()

    def _admit(self, now: float) -> None:
        """Accept waiting clients."""
        for _ in range(_MOST_CLIENTS):
            try:
                line, _ = self._place.listener.accept()
            except OSError:  # nobody waits, has gone again, or there are no descriptors left for it
                return
            if len(self.clients) < _MOST_CLIENTS:
                self.clients.append(_Client(line, now))
            else:
                line.close()
                self.refused += 1

    def _tell(self, axes: tuple[int, ...], down: tuple[bool, ...], now: float) -> None:
        for client in self.clients:
            for had_room in client.tell(axes, down, now) if client.listens(now) else ():
                self.sent += had_room
                self.missed += not had_room

    def _receive(self) -> None:
        """Hear each client; drop those gone or invalid."""
        kept = []
        for client in self.clients:
            if client.hear():
                kept.append(client)
            else:
                client.line.close()
                self.dropped += not client.gone
        self.clients = kept

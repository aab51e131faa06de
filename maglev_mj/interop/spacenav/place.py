"""Path of the socket, its creation and removal."""

from __future__ import annotations

import errno
import os
import socket
import stat
import tempfile
from pathlib import Path

from maglev_mj.errors import MaglevError, ParameterError

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
        lines = _SETTINGS.read_text(errors="replace").splitlines()
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

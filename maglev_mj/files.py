"""Files of users: text of any editor, strict JSON, and replacement of what a path leads to."""

from __future__ import annotations

import errno
import json
import os
import stat
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from maglev_mj.errors import ParameterError, one_line

LFS_POINTER = "version https://git-lfs"  # start of the text in place of a file


def read_text(path: Path) -> str:
    """Return the text of a file in UTF-8, with or without a byte order mark.

    Raises:
        ParameterError: If Git LFS has not fetched it.
        OSError, UnicodeError: If it cannot be read.
    """
    text = path.read_text(encoding="utf-8-sig")
    if text.startswith(LFS_POINTER):
        raise ParameterError("a Git LFS pointer: run git lfs pull")
    return text


def write_text(path: Path, text: str) -> None:
    """Write a file in UTF-8; see `errors_named`."""
    with errors_named(path):
        path.write_text(text, encoding="utf-8")


def temporary_folder() -> Path:
    """Return a new folder that is removed when this process ends; one that is killed leaves it."""
    import atexit  # imported here: rarely needed
    import shutil
    import tempfile

    folder = tempfile.mkdtemp(prefix="maglev_mj_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)  # where a library is loaded, Windows keeps it
    return Path(folder)


@contextmanager
def errors_named(path: Path) -> Iterator[None]:
    """Name the file in errors of this context: those of writing, such as onto a full disk, do not."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def parse_json(text: bytes | str, **options: Any) -> Any:
    """Parse JSON text, with options of `json.loads`.

    Raises:
        ParameterError: If it is not JSON, a number is NaN or Infinity, or a key of an object is repeated.
    """
    try:
        return json.loads(text, object_pairs_hook=_unique, **{"parse_constant": _reject_constant, **options})
    except ParameterError:
        raise
    except (ValueError, RecursionError) as error:
        raise ParameterError(f"not valid JSON: {error}") from None


def _reject_constant(constant: str) -> None:
    raise ParameterError(f"numbers must be finite (got {constant})")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(values := dict(pairs)) < len(pairs):
        ((name, count),) = Counter(name for name, _ in pairs).most_common(1)
        raise ParameterError(f"{one_line(name)} must be given once (got {count} times)")
    return values


def destination(path: Path) -> tuple[Path, int | None]:
    """Return the file to write for a path, links followed, and its mode; None for a new file.

    Raises:
        PermissionError: If it is read-only.
    """
    if not path.exists():
        if not path.resolve().parent.exists():
            raise FileNotFoundError(errno.ENOENT, "no such folder", str(path.resolve().parent))
        return path.resolve(), None
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    mode = path.stat().st_mode
    return (path.resolve() if stat.S_ISREG(mode) else path), mode  # the pipe of /dev/stdout has no path of its own


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary file; on success it replaces that of the path, links followed, or is copied into a device."""
    target, mode = destination(path)
    if special := mode is not None and not stat.S_ISREG(mode):
        from tempfile import TemporaryDirectory  # imported here: slow, rarely needed
    process = os.getpid()
    with errors_named(path), TemporaryDirectory() if special else nullcontext(target.parent) as folder:
        partial = Path(folder, f"{path.stem}.{process}.partial{path.suffix}")
        try:
            yield partial
            if process != os.getpid():
                return
            if special:
                target.write_bytes(partial.read_bytes())
                return
            if mode is not None:
                partial.chmod(stat.S_IMODE(mode))
            partial.replace(target)
        finally:
            if process == os.getpid():  # a forked process leaves it to its parent
                partial.unlink(missing_ok=True)

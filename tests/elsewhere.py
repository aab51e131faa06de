"""Windows' rules on files in use, pretended on Linux."""

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

START = "from tests.elsewhere import pretend; pretend(); "
"""Code for a program's first line, after which the rules hold in it."""


def pretend() -> None:
    """Pretend the rules in this process.

    A file that any process has open or mapped is neither renamed nor removed.
    """
    from maglev_mj.recording import journal

    for name in ("fork", "posix_fallocate", "nice", "set_blocking", "pipe2"):
        with suppress(AttributeError):
            delattr(os, name)
    Path.replace = _unless_in_use(Path.replace)  # type: ignore[method-assign]
    Path.unlink = _unless_in_use(Path.unlink)  # type: ignore[method-assign]
    os.replace = _unless_in_use(os.replace)
    journal._RENAMES_OPEN = False


def _unless_in_use(do: Callable[..., Any]) -> Callable[..., Any]:
    def done(path: Path, *arguments: Any, **named: Any) -> Any:
        if any(in_use(one) for one in (path, *arguments)):
            raise PermissionError(13, "The process cannot access the file because it is being used by another process")
        return do(path, *arguments, **named)

    return done


def in_use(path: Path) -> bool:
    """Return True if any process has a file open or mapped."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile, or is another user's
            if str(path) in (process / "maps").read_text():
                return True
            for number in os.listdir(process / "fd"):
                with suppress(OSError):
                    if os.readlink(process / "fd" / number) == str(path):
                        return True
    return False

"""Versions of the code behind a result.

Versions of packages, and a digest of the sources.
"""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import maglev_mj
from maglev_mj.lazy import has_engine, mujoco

Versions: TypeAlias = Mapping[str, str]
"""Versions by name; see `versions`."""

_PACKAGE = Path(__file__).resolve().parent
_ROOT = _PACKAGE.parent
MODELS = _PACKAGE / "model" if (_PACKAGE / "model").is_dir() else _ROOT / "model"
"""Folder of the MJCF files.

It is inside the installed package, or at the top of the repository.
"""

TEXT = "__text__"
"""Attribute of a user's module with its executed text."""


def versions() -> dict[str, str]:
    """Return the versions behind a result, ready for JSON.

    They are read once per process, in about 20 ms.

    Returns:
        maglev_mj, python, mujoco and numpy: their versions; "none" for mujoco if it is not installed.
        sources: First 16 digits of the SHA-256 of package and models: the same in a checkout and in its wheel.
    """
    return dict(_versions())


def versions_read(found: object) -> Versions | None:
    """Return versions read from a file, or None.

    None for anything else, such as text with terminal control characters.
    """
    plain = isinstance(found, dict) and all(isinstance(one, str) and one.isprintable() for one in found.values())
    return found if plain else None  # type: ignore[return-value]


def differences(theirs: Versions, ours: Versions) -> str:
    """Return the differing versions as text, or ""."""
    if not theirs:
        return "no versions"
    names = [name for name in ours if theirs.get(name) != ours[name]]
    return ", ".join(f"{name} {theirs.get(name) or 'unknown'} (here {ours.get(name) or 'unknown'})" for name in names)


def hash_of(text: str) -> str:
    """Return the first 16 digits of a text's SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def file_of(thing: Any) -> tuple[Path, str] | None:
    """Return path and text of a class's or function's file.

    It must be at the top level; None if there is no such file.

    The text is the executed one, if known.
    """
    module, name = sys.modules.get(thing.__module__), thing.__qualname__
    path = getattr(module, "__file__", None)
    if path is None or not name.isidentifier():
        return None
    text: str | None = getattr(module, TEXT, None)
    try:
        return Path(path), _read(path) if text is None else text
    except (OSError, ValueError):
        return None


@lru_cache(maxsize=64)
def _read(path: str) -> str:
    """Return a file's text as of its first reading.

    It is nearest to the text that was executed.
    """
    return Path(path).read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _versions() -> Versions:
    return {
        "maglev_mj": maglev_mj.__version__,
        "sources": _digest(),
        "python": platform.python_version(),
        "mujoco": mujoco.__version__ if has_engine() else "none",
        "numpy": np.__version__,
    }


def _digest() -> str:
    texts = [
        f"{path.relative_to(folder).as_posix()}\n{path.read_text(encoding='utf-8')}"  # the same with CRLF
        for folder, files in ((_PACKAGE, "*.py"), (MODELS, "*.xml"))
        for path in sorted(folder.rglob(files), key=Path.as_posix)
    ]
    return hash_of("\0".join(texts))

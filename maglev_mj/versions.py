"""Versions of packages and a digest of the sources, stored with each result."""

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
"""Folder of the MJCF files: in the installed package, or at the top of a clone."""

TEXT = "__text__"
"""Attribute of a user's module that holds its executed source text."""


def versions() -> dict[str, str]:
    """Return the versions of the code, ready for JSON; cached after about 20 ms.

    Returns:
        maglev_mj, python, mujoco and numpy: their versions; "none" for mujoco if it is not installed.
        sources: First 16 digits of the SHA-256 of package, models and devices; equal for a clone and its wheel.
    """
    return dict(_versions())


def validated_versions(value: object) -> Versions | None:
    """Validate versions read from a file; return None if they are not printable strings by name."""
    plain = isinstance(value, dict) and all(isinstance(x, str) and x.isprintable() for x in value.values())
    return value if plain else None  # type: ignore[return-value]


def differences(theirs: Versions, ours: Versions) -> str:
    """Return the differing versions as text; "" if all are equal."""
    if not theirs:
        return "no versions"
    names = [name for name in ours if theirs.get(name) != ours[name]]
    return ", ".join(f"{name} {theirs.get(name) or 'unknown'} (here {ours.get(name) or 'unknown'})" for name in names)


def hash_of(text: str) -> str:
    """Return the first 16 digits of a text's SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def file_of(thing: Any) -> tuple[Path, str] | None:
    """Return path and source text of a top-level class or function; None if it has no file.

    The text is the executed one, if available.
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
    """Return a file's text, cached at the first call: closest to the executed text."""
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
        f"{path.relative_to(folder).as_posix()}\n{path.read_text(encoding='utf-8')}"  # independent of line endings
        for folder, files in ((_PACKAGE, "*.py"), (MODELS, "*.xml"), (MODELS, "*.toml"))
        for path in sorted(folder.rglob(files), key=Path.as_posix)
    ]
    return hash_of("\0".join(texts))

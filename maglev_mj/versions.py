"""Versions of the code behind a result.

Versions of packages, git revision, and a digest of the sources.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

import maglev_mj
from maglev_mj.lazy import mujoco

__all__ = ["MODELS", "TEXT", "Versions", "differences", "file_of", "hash_of", "versions", "versions_read"]

Versions: TypeAlias = Mapping[str, str | bool | None]
"""Versions by name; see `versions`."""

_PACKAGE = Path(__file__).resolve().parent
_ROOT = _PACKAGE.parent
MODELS = _PACKAGE / "model" if (_PACKAGE / "model").is_dir() else _ROOT / "model"
"""Folder of the MJCF files.

It is inside the installed package, or at the top of the repository.
"""

TEXT = "__text__"
"""Attribute of a user's module with its executed text."""

_CODE = ("maglev_mj", "model", "scripts")
_PATIENCE = 5.0
_COMPARED = ("maglev_mj", "python", "mujoco", "numpy", "sources")


def versions() -> dict[str, str | bool | None]:
    """Return the versions behind a result, ready for JSON.

    They are read once per process, in about 20 ms.

    Returns:
        maglev_mj, python, mujoco and numpy: their versions.
        revision: Full git hash; None outside a checkout of this project, as in an installed wheel.
        changed: True if package, models or scripts differ from the revision; None without one.
        sources: First 16 digits of the SHA-256 of package and models, which also detects uncommitted changes.
    """
    return dict(_versions())


def versions_read(found: object) -> Versions | None:
    """Return versions read from a file, or None.

    None for anything else, such as text with terminal control characters.
    """
    if not isinstance(found, dict):
        return None
    plain = (
        value.isprintable() if isinstance(value, str) else value in (None, True, False) for value in found.values()
    )
    return found if all(plain) else None


def differences(theirs: Versions, ours: Versions) -> str:
    """Return the differing versions as text, or "".

    If one side has no revision, only the sources are compared.
    """
    if not theirs:
        return "no versions"
    names = [name for name in _COMPARED if theirs.get(name) != ours.get(name)]
    revisions = theirs.get("revision"), ours.get("revision")
    if None not in revisions and revisions[0] != revisions[1]:
        names.insert(0, "revision")
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
    revision, changed = _revision(_ROOT)
    return {
        "maglev_mj": maglev_mj.__version__,
        "revision": revision,
        "changed": changed,
        "sources": _digest(),
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
    }


def _revision(root: Path) -> tuple[str | None, bool | None]:
    """Return git revision and changed flag of a checkout.

    None and None for any other folder.
    """
    try:
        # the package may lie in another project's repository: as a wheel, or copied
        ours = (root / ".git").exists() and 'name = "maglev-mj"' in (root / "pyproject.toml").read_text("utf-8")
        if not ours:
            return None, None
        said = subprocess.run(
            ["git", "--no-optional-locks", "status", "--porcelain=v2", "--branch", "--", *_CODE],
            cwd=root,
            # a git hook sets these variables to another repository
            env={name: value for name, value in os.environ.items() if not name.startswith("GIT_")},
            capture_output=True,
            text=True,
            check=True,
            timeout=_PATIENCE,
        ).stdout.splitlines()
    except (OSError, ValueError, subprocess.SubprocessError):  # no git, or one that refuses
        return None, None
    revision = next(line.split()[-1] for line in said if line.startswith("# branch.oid"))
    return (None if revision == "(initial)" else revision), any(not line.startswith("#") for line in said)


def _digest() -> str:
    code = {path.relative_to(_PACKAGE).as_posix(): path for path in _PACKAGE.rglob("*.py")}
    code |= {f"model/{path.relative_to(MODELS).as_posix()}": path for path in MODELS.rglob("*.xml")}
    digest = hashlib.sha256()
    for name, path in sorted(code.items()):
        text = path.read_bytes().replace(b"\r\n", b"\n")  # as git checks it out elsewhere
        digest.update(f"{name} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:16]

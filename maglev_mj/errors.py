"""The errors this package raises, and messages that several share: the value, and what is allowed."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from maglev_mj.frames import Command, Sample

__all__ = [
    "DivergenceError",
    "MaglevError",
    "MissingPackageError",
    "ModelError",
    "ParameterError",
    "PlantError",
    "SensingError",
    "meant",
    "not_one_of",
    "require",
]


class MaglevError(Exception):
    """Base of every error raised on purpose by this package.

    Attributes:
        cycles: The last (sample, command) pairs before the error, oldest first; empty outside a control loop.
    """

    cycles: tuple[tuple[Sample, Command], ...] = ()


class ParameterError(MaglevError, ValueError):
    """A parameter is outside what is allowed, or has a shape that does not fit."""


class MissingPackageError(MaglevError):
    """A package of an extra is not installed."""


class ModelError(MaglevError):
    """A model file is missing, does not compile, or lacks a named element."""


class PlantError(MaglevError):
    """A plant cannot go on: it is closed, got a command that is not finite, or its engine warned."""


class SensingError(MaglevError):
    """No pose was found for what the sensors say."""


class DivergenceError(PlantError):
    """The flotor left its range by a wide margin, or its state is no longer a number.

    Attributes:
        partial: `Result` of the scene up to there; None outside a run of a scene.
    """

    partial: Any = None


def not_one_of(name: str, allowed: Iterable[str], given: object, also: str = "") -> str:
    """Return the message for a value that is none of those allowed.

    Args:
        name: Name of what was given.
        allowed: Texts that are allowed.
        given: The value.
        also: Further values allowed, in words.
    """
    known = list(allowed)
    return f"{name} must be one of {', '.join(known)}{also}, not {given!r}{meant(given, known)}"


def meant(given: object, allowed: Iterable[str]) -> str:
    """Return the end of a message that names the text most like a given one; empty for none."""
    near = get_close_matches(str(given), allowed, n=1)
    return f"; did you mean {near[0]}?" if near else ""


def require(packages: Iterable[str], extra: str, why: str) -> None:
    """Check that packages are installed.

    Args:
        packages: Names by which they are imported.
        extra: Extra of this package that installs them.
        why: Sentence on what needs them.

    Raises:
        MissingPackageError: If one is not.
    """
    if not all(map(find_spec, packages)):
        raise MissingPackageError(f"{why}: pip install 'maglev-mj[{extra}]'")

"""Errors of this package, and shared messages.

A message states the value and what is allowed.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from maglev_mj.frames import Command, Sample

_LONGEST = 200


class MaglevError(Exception):
    """Base class of all errors raised by this package.

    Attributes:
        cycles: The last (sample, command) pairs before the error, oldest first; empty outside a control loop.

    Example:
        >>> from maglev_mj import MaglevError, find_scene
        >>> try:
        ...     find_scene("absent")
        ... except MaglevError as error:
        ...     print(type(error).__name__)
        ParameterError
    """

    cycles: tuple[tuple[Sample, Command], ...] = ()


class ParameterError(MaglevError, ValueError):
    """Error of a parameter's value or shape.

    Example:
        >>> from maglev_mj import Timing
        >>> Timing(period=-0.005)
        Traceback (most recent call last):
            ...
        maglev_mj.errors.ParameterError: period must be a finite number above 0, not -0.005
    """


class MissingPackageError(MaglevError):
    """Error of an extra's missing package."""


class ModelError(ParameterError):
    """Error of a model file.

    The file is missing, does not compile, or lacks a named element.
    """


class PlantError(MaglevError):
    """Error of a plant that cannot continue.

    It is closed, got a command that is not finite, or its engine warned.

    Example:
        >>> from maglev_mj import ExactPlant, PlantError
        >>> plant = ExactPlant()
        >>> plant.close()
        >>> try:
        ...     plant.read()
        ... except PlantError as error:
        ...     print(error)
        the plant is closed
    """


class SensingError(MaglevError):
    """Error of sensor readings without a matching pose."""


class DivergenceError(PlantError):
    """Error of a flotor far outside its range.

    Its state may also be no number any more.

    Attributes:
        partial: `RunResult` of the scene up to the error; None outside a run of a scene.

    Example:
        >>> from maglev_mj import DivergenceError, find_scene, run
        >>> try:
        ...     run(find_scene("drop")(stiffness=50000.0, duration=5.0), plant="exact")
        ... except DivergenceError as error:
        ...     print(error.partial.times()[-1] < 5.0)  # the motion up to there
        True
    """

    partial: Any = None


def not_one_of(name: str, allowed: Iterable[str], given: object, also: str = "") -> str:
    """Return the message for a value that is not allowed.

    Args:
        name: Name of the parameter.
        allowed: Allowed texts.
        given: The value.
        also: Further allowed values, in words.
    """
    known = list(allowed)
    return f"{name} must be one of {', '.join(known)}{also}, not {one_line(given)}{meant(given, known)}"


def check_instance(name: str, value: object, kind: Any, allowed: str) -> None:
    """Check that an argument is of a class.

    Args:
        name: Name of the argument.
        value: The argument.
        kind: The class, or a union of classes.
        allowed: Allowed values, in words.

    Raises:
        ParameterError: If it is of another class.
    """
    if not isinstance(value, kind):
        raise ParameterError(f"{name} must be {allowed}, not {one_line(value)}")


def check_one_of(name: str, allowed: Collection[str], given: object, also: str = "") -> None:
    """Check that a value is one of the allowed texts; see `not_one_of`.

    Raises:
        ParameterError: If it is not.
    """
    if given not in allowed:
        raise ParameterError(not_one_of(name, allowed, given, also))


def file_path(value: Path | str) -> Path:
    """Return a file's path given as text or path.

    Raises:
        ParameterError: If it is neither.
    """
    from pathlib import Path  # a help needs none

    check_instance("path", value, str | os.PathLike, "the path of a file")
    return Path(value)


def named(cls: type) -> str:
    """Return a user's class with its file, for messages."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    return f"{cls.__name__} of {os.path.basename(file or cls.__module__)}"


def one_line(value: object) -> str:
    """Return a value as one short line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def meant(given: object, allowed: Iterable[str]) -> str:
    """Return the end of a message with the nearest text.

    It is empty if no allowed text is near.
    """
    near = get_close_matches(str(given).lower(), allowed, n=1, cutoff=0.7)
    return f"; did you mean {near[0]}?" if near else ""


def require(packages: Iterable[str], extra: str, why: str) -> None:
    """Check that packages are installed.

    Args:
        packages: Import names.
        extra: Extra of this package that installs them.
        why: Sentence on their purpose.

    Raises:
        MissingPackageError: If one is not installed.
    """
    if not all(map(_is_installed, packages)):
        raise MissingPackageError(f"{why}: {install_command(extra)}")


def _is_installed(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # of the package that it is in
        return False


def install_command(extra: str) -> str:
    """Return the command that installs an extra's packages for this Python."""
    import shlex
    from importlib.metadata import PackageNotFoundError, requires

    try:
        parts = [line.partition(";") for line in requires("maglev-mj") or ()]
    except PackageNotFoundError:  # not installed itself: run in a clone
        parts = []
    wanted = [name.strip() for name, _, marker in parts if f"extra == '{extra}'" in marker.replace('"', "'")]
    return shlex.join([sys.executable, "-m", "pip", "install", *(wanted or [f".[{extra}]"])])

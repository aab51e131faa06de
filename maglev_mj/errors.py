"""Errors of this package and their messages: what is allowed, and the value got."""

from __future__ import annotations

import copyreg
import os
import sys
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

_MAX_CHARACTERS, _MAX_MESSAGE = 200, 480


class MaglevError(Exception):
    """Base class of all errors raised by this package.

    Messages are truncated to 480 characters: their input may have any size.

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

    cycles: tuple[tuple[Any, Any], ...] = ()

    def __init__(self, *args: object) -> None:
        super().__init__(*(_truncated(part) if isinstance(part, str) else part for part in args))

    def __reduce__(self) -> tuple[Any, ...]:
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


def _truncated(text: str) -> str:
    """Return a text of at most 480 characters, cut in the middle: the end has the remedy."""
    return text if len(text) <= _MAX_MESSAGE else f"{text[: _MAX_MESSAGE - 141]}…{text[-140:]}"


class ParameterError(MaglevError, ValueError):
    """Invalid value or shape of a parameter.

    Example:
        >>> from maglev_mj import Timing
        >>> Timing(period=-0.005)
        Traceback (most recent call last):
            ...
        maglev_mj.errors.ParameterError: period must be between 1e-6 and 0.1 s (got -0.005)
    """


class KeywordError(ParameterError, TypeError):
    """Unknown or contradictory arguments of a public function or class."""


class TooManyCallsError(ParameterError):
    """A law without declared gains is called too often to be linearised numerically."""


class MissingPackageError(MaglevError):
    """An optional dependency is not installed."""


class ModelError(ParameterError):
    """A model file is missing, does not compile, or lacks a required element."""


class PlantError(MaglevError):
    """The plant cannot continue: it is closed, got a non-finite command, or the engine warned.

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
    """No pose matches the sensor readings."""


class DivergenceError(PlantError):
    """The simulation diverged: the flotor is far outside its range, or its state is NaN.

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


def choice_message(name: str, allowed: Iterable[str], given: object, also: str = "") -> str:
    """Return the error message for a value that is not among the choices.

    Args:
        name: Name of the parameter.
        allowed: The choices.
        given: The value got.
        also: Description of other allowed values.
    """
    choices = list(allowed)
    return f"{name} must be one of {', '.join(choices)}{also} (got {one_line(given)}){meant(given, choices)}"


def check_instance(name: str, value: object, kind: Any, allowed: str) -> None:
    """Check the type of an argument.

    Args:
        name: Name of the argument.
        value: The argument.
        kind: Allowed type, or a union of types.
        allowed: Description of the allowed values.

    Raises:
        ParameterError: If the type differs.
    """
    if not isinstance(value, kind):
        raise ParameterError(f"{name} must be {allowed} (got {one_line(value)})")


def check_one_of(name: str, allowed: Collection[str], given: object, also: str = "") -> None:
    """Check that a value is one of the choices; see `choice_message`.

    Raises:
        ParameterError: If it is not.
    """
    if given not in allowed:
        raise ParameterError(choice_message(name, allowed, given, also))


def file_path(value: Path | str) -> Path:
    """Return a path given as text or `Path`.

    Raises:
        ParameterError: If the value is neither.
    """
    from pathlib import Path  # imported here: --help does not need it

    check_instance("path", value, str | os.PathLike, "a file path")
    return Path(value)


def named(cls: type) -> str:
    """Return the name of a user-defined class with its file, for messages."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    return f"{cls.__name__} of {os.path.basename(file or cls.__module__)}"


def one_line(value: object) -> str:
    """Return the repr of a value on one line, truncated to 200 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _MAX_CHARACTERS else f"{text[: _MAX_CHARACTERS - 1]}…"


NO_MASK = "must have no masked values: fill them, or leave them out"
"""What arrays must have, for messages."""


def is_masked(value: Any) -> bool:
    """Return True if an array, also in lists, has masked values: NumPy computes with the numbers behind the mask."""
    if isinstance(value, list | tuple):
        kinds = set(map(type, value))
        return not kinds <= _PLAIN and any(map(is_masked, value))
    masks = sys.modules.get("numpy.ma")  # not imported by NumPy; a masked array has imported it
    return masks is not None and isinstance(value, masks.MaskedArray) and bool(masks.is_masked(value))


_PLAIN = {float, int, str, bool, type(None)}


def refuse_mask(name: str, value: object) -> None:
    """Raise ParameterError if an array, also in lists, has masked values."""
    if is_masked(value):
        raise ParameterError(f"{name} {NO_MASK} (got {one_line(value)})")


def meant(given: object, allowed: Iterable[str]) -> str:
    """Return "; did you mean X?" for the closest choice, or "" if none is close."""
    near = get_close_matches(str(given).lower(), allowed, n=1, cutoff=0.7)
    return f"; did you mean {near[0]}?" if near else ""


def require(packages: Iterable[str], extra: str, why: str) -> None:
    """Check that optional packages are installed.

    Args:
        packages: Import names.
        extra: Extra of this package that installs them.
        why: What they are needed for; begins the message.

    Raises:
        MissingPackageError: If one is missing.
    """
    if not all(map(_is_installed, packages)):
        raise MissingPackageError(f"{why}: {install_command(extra)}")


def _is_installed(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # the parent package is missing
        return False


def install_command(extra: str) -> str:
    """Return the pip command that installs an extra for this Python."""
    import shlex
    from importlib.metadata import PackageNotFoundError, requires

    try:
        parts = [line.partition(";") for line in requires("maglev-mj") or ()]
    except PackageNotFoundError:  # running from a clone, not installed
        parts = []
    packages = [name.strip() for name, _, marker in parts if f"extra == '{extra}'" in marker.replace('"', "'")]
    return shlex.join([sys.executable, "-m", "pip", "install", *(packages or [f".[{extra}]"])])

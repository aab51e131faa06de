"""Parameters: checks and declarations.

A failed check gives an error of one line; a declaration takes one line.
A class of declared parameters gets its checks, its JSON and its command-line options from the declarations.
"""

from __future__ import annotations

import inspect
import json
import math
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import (
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import MaglevError, ParameterError, check_one_of, not_one_of
from maglev_mj.frames import AXES, Array, Component

_NO_NUMBERS = bool, np.bool_, str, bytes
"""Types accepted by float(), but refused as numbers."""

_LARGEST = sys.float_info.max
_T = TypeVar("_T")


def flag(name: str, value: object) -> bool:
    """Return `value` as a bool.

    Raises:
        ParameterError: If it is neither True nor False.
    """
    if not isinstance(value, bool | np.bool_):
        raise ParameterError(f"{name} must be True or False, not {value!r}")
    return bool(value)


def number(
    name: str,
    value: object,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    below: float = math.inf,
    at_most: float = math.inf,
) -> float:
    """Return `value` as a finite float within the bounds.

    Raises:
        ParameterError: If it is not a number, not finite, or outside the bounds.
    """
    try:
        result = math.nan if isinstance(value, _NO_NUMBERS) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if not (above < result < below and at_least <= result <= at_most and math.isfinite(result)):
        bounds = {"above": above, "at least": at_least, "below": below, "at most": at_most}
        words = [f"{word} {bound:g}" for word, bound in bounds.items() if math.isfinite(bound)]
        allowed = "a finite number" + (" " + " and ".join(words) if words else "")
        raise ParameterError(f"{name} must be {allowed}, not {value!r}")
    return result


def whole(name: str, value: object, *, at_least: float = 0.0, at_most: float = 2.0**53) -> int:
    """Return `value` as an int within the bounds.

    Raises:
        ParameterError: If it is not a whole number, or outside the bounds.
    """
    result = number(name, value, at_least=at_least, at_most=at_most)
    if result != int(result):
        raise ParameterError(f"{name} must be a whole number, not {value!r}")
    return int(result)


def interval(
    name: str, value: Sequence[object], *, at_least: float = -math.inf, at_most: float = math.inf
) -> tuple[float, float]:
    """Return lower and upper end of a checked range.

    Raises:
        ParameterError: If the value is not two such numbers in this order.
    """
    try:
        ends = tuple(value)
    except TypeError:
        ends = ()
    if len(ends) != 2:
        raise ParameterError(f"{name} must be a lower and a higher value, not {value!r}")
    low, high = (number(name, end, at_least=at_least, at_most=at_most) for end in ends)
    if low > high:
        raise ParameterError(f"{name} must be from a lower to a higher value, not {low:g} to {high:g}")
    return low, high


def numbers(
    name: str,
    value: ArrayLike,
    *,
    at_least: float = -math.inf,
    above: float | None = None,
    at_most: float = math.inf,
    finite: bool = True,
) -> Array:
    """Return `value` as a float array with checked entries.

    Args:
        name: Name in the message.
        value: Number or array.
        at_least: Least value allowed.
        above: Exclusive lower bound; None for none.
        at_most: Largest value allowed.
        finite: False lets infinity pass; NaN never passes.

    Raises:
        ParameterError: If an entry is not a number, not finite, or outside the bounds.
    """
    if value.__class__ is float and max(at_least, -_LARGEST) <= value <= min(at_most, _LARGEST) and above is None:
        return np.array(value)  # most, at a third of the cost
    try:
        raw = np.asarray(value)
    except ValueError:  # rows of different lengths
        raw = np.asarray("")
    if raw.dtype.kind not in "fiu" or _has_flag(value):
        raise ParameterError(f"{name} must be a number or an array of numbers, not {value!r}")
    array = np.asarray(raw, dtype=np.float64)
    good = array >= at_least
    if finite:
        good &= np.isfinite(array)
    if not good.all():
        kind = "finite and " if finite else ""
        bound = f"at least {at_least:g}" if math.isfinite(at_least) else "a number"
        raise ParameterError(f"{name} must be {kind}{bound} everywhere, not {array[~good].flat[0]:g}")
    if above is not None and not (array > above).all():
        raise ParameterError(f"{name} must be above {above:g} everywhere, not {array.min():g}")
    if at_most < math.inf and not (array <= at_most).all():
        raise ParameterError(f"{name} must be at most {at_most:g} everywhere, not {array.max():g}")
    return array


def store(frozen: object, **values: Any) -> None:
    """Set attributes of a frozen dataclass, by name."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


def six(
    name: str, value: ArrayLike, batch: tuple[int, ...] = (), *, at_least: float = 0.0, finite: bool = False
) -> Array:
    """Return a checked parameter of the six axes, (6,) or (..., 6).

    (..., 6) is for the batch; a number applies to all axes.

    Raises:
        ParameterError: If an entry is too small or the shape does not fit.
    """
    array = numbers(name, value, at_least=at_least, finite=finite)
    if array.shape not in ((), (6,), (*batch, 6)):
        allowed = "(6,)" if not batch else f"(6,) or {(*batch, 6)}"
        raise ParameterError(f"{name} must be a number or have the shape {allowed}, not {array.shape}")
    return np.broadcast_to(array, (6,)) if array.ndim == 0 else array


def parsed_number(name: str, text: str) -> float:
    """Return the finite number given by a text.

    Raises:
        ParameterError: If the text is not a finite number.
    """
    try:
        return number(name, float(text))
    except ValueError:
        return number(name, text)


def axis_indices(axes: str | Sequence[str]) -> tuple[int, ...]:
    """Return the indices of one or several axis names.

    Raises:
        ParameterError: If a name is unknown or given twice, or there is no name.
    """
    names = (axes,) if isinstance(axes, str) or not isinstance(axes, Iterable) else tuple(axes)
    for name in names:
        check_one_of("axis", AXES, name)
    if not names or len(set(names)) != len(names):
        raise ParameterError(f"axes must be one or more different names of {', '.join(AXES)}, not {names!r}")
    return tuple(AXES.index(name) for name in names)


def batch_shape(what: str, values: Iterable[Array]) -> tuple[int, ...]:
    """Return the common batch shape of parameters (..., axes).

    Raises:
        ParameterError: If they do not fit one another.
    """
    shapes = [value.shape[:-1] for value in values]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"{what} parameters must fit one batch shape, not {sorted(set(shapes))}") from None


def common_shape(what: str, *shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the broadcast shape of shapes.

    Raises:
        ParameterError: If they do not broadcast.
    """
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"{what} must fit one shape, not {', '.join(map(str, sorted(set(shapes))))}") from None


def per_axis(name: str, values: Array, count: int) -> tuple[Component, ...]:
    """Split a checked parameter into one component per axis.

    A number applies to all axes; (count,) gives one per axis; (..., count) also one per device.

    Raises:
        ParameterError: If the last dimension is not `count`.
    """
    if values.ndim == 0:
        return (float(values),) * count
    if values.shape[-1] != count:
        raise ParameterError(f"{name} must have a last dimension of {count} (one for each axis), not {values.shape}")
    if values.ndim == 1:
        return tuple(values.tolist())
    return tuple(np.ascontiguousarray(np.moveaxis(values, -1, 0)))


def _has_flag(value: object) -> bool:
    """Return True for a bool among numbers."""
    return isinstance(value, bool | np.bool_) or (isinstance(value, list | tuple) and any(map(_has_flag, value)))


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Change of a value by one press of a key.

    Attributes:
        factor: Factor of a press, with the result to three digits; 0 for none.
        add: Step of a press, on a grid of the same size.
        among: Values to step through.
        least: Lower limit of the keys; the parameter's own bounds may be wider.
        most: Upper limit of the keys.
        inverse: True if the keys act on the inverse, such as a rate for a period: "up" then reduces the value.
        word: Name in actions; the parameter's name by default.

    Example:
        >>> Turn(factor=1.25)(6000.0, 1), Turn(add=0.5)(2.0, -1)
        (7500.0, 1.5)
    """

    factor: float = 0.0
    add: float = 0.0
    among: Sequence[float] = ()
    least: float = -math.inf
    most: float = math.inf
    inverse: bool = False
    word: str = ""

    def __post_init__(self) -> None:
        flag("inverse", self.inverse)

    @property
    def has_keys(self) -> bool:
        """True if keys change the value."""
        return bool(self.factor or self.add or self.among)

    def __call__(self, value: float, way: int) -> float:
        """Return the value after a press, 1 up, -1 down."""
        if self.among:
            now = 1.0 / value if self.inverse else value
            nearest = min(range(len(self.among)), key=lambda place: abs(self.among[place] - now))
            chosen = self.among[min(max(nearest + way, 0), len(self.among) - 1)]
            return 1.0 / chosen if self.inverse else chosen
        if self.add:
            turned = (round(value / self.add) + way) * self.add
        else:
            # three digits, so that the value can be read and set again
            turned = float(f"{value * (self.factor if way > 0 else 1.0 / self.factor):.3g}")
        return min(max(turned, self.least), self.most)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One declared parameter.

    See `param` for the attributes not listed here.

    Attributes:
        name: Its name.
        kind: float, int, bool or str; object for a value that `parse` checks.
        bounds: Keywords of `number`.
    """

    name: str
    kind: type
    default: Any
    unit: str
    help: str
    bounds: Mapping[str, float]
    choices: Sequence[str]
    optional: bool
    derive: Callable[[Any], Any] | None
    parse: Callable[[Any], Any] | None
    live: Literal[False] | Turn
    along: bool

    def checked(self, value: Any) -> Any:
        """Return a checked value.

        Raises:
            ParameterError: If it is of another kind or outside its bounds.
        """
        if value is None and self.optional:
            return None
        if self.parse is not None:
            return self.parse(value)
        if self.kind is bool:
            return flag(self.name, value)
        if self.kind is str:
            if not isinstance(value, str) or (self.choices and value not in self.choices):
                what = not_one_of(self.name, self.choices, value)
                raise ParameterError(what if self.choices else f"{self.name} must be a text, not {value!r}")
            return value
        result = number(self.name, value, **self.bounds)
        if self.kind is int:
            if result != int(result):
                raise ParameterError(f"{self.name} must be a whole number, not {result:g}")
            return int(result)
        return result

    def from_text(self, text: str) -> Any:
        """Return the value given by a text, bounds unchecked.

        Raises:
            ParameterError: If it is of another kind.
        """
        if self.kind is object:
            raise ParameterError(f"{self.name} cannot be given as a word, not {text!r}")
        if self.optional and text.lower() == "none":
            return None
        if self.kind is str:
            return text
        if self.kind is bool:
            if text.lower() not in ("true", "false"):
                raise ParameterError(f"{self.name} must be true or false, not {text!r}")
            return text.lower() == "true"
        return parsed_number(self.name, text)


def param(
    help: str,
    unit: str = "",
    *,
    default: Any,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    choices: Sequence[str] = (),
    optional: bool = False,
    derive: Callable[[Any], Any] | None = None,
    parse: Callable[[Any], Any] | None = None,
    live: bool | Turn = False,
    along: bool = False,
) -> Any:
    """Declare a parameter in place of a field's default.

    Args:
        help: Short description.
        unit: Unit; empty for none.
        default: Default value; None if `derive` makes it.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        below: Exclusive upper bound.
        at_most: Inclusive upper bound.
        choices: Allowed texts; empty for any.
        optional: True if None is allowed.
        derive: Function that makes the default from the object, with its earlier parameters set.
        parse: Function that checks a value of another type than number, bool or text.
        live: True if it may change while the scene runs; a `Turn` sets the change by a key, a quarter by default.
        along: True if it is along the axis that the parameter `axis` chooses; its unit is that along a translation.

    Example:
        >>> class Ball(Parameters):
        ...     mass: float = param("moving mass", "kg", default=0.7, above=0.0)
        >>> Ball(mass=1.0).mass
        1.0
    """
    flag("optional", optional)
    flag("along", along)
    bounds = {"above": above, "at_least": at_least, "below": below, "at_most": at_most}
    declared = {
        "help": help,
        "unit": unit,
        "bounds": {name: bound for name, bound in bounds.items() if bound is not None},
        "choices": tuple(choices),
        "optional": optional,
        "derive": derive,
        "parse": parse,
        "live": Turn(factor=1.25) if live is True else live,
        "along": along,
    }
    return field(default=default, metadata={"param": declared})


def param_range(
    name: str,
    help: str,
    unit: str,
    *,
    default: tuple[float, float] | None,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> Any:
    """Declare a parameter of a lower and a higher value; see `param`.

    Args:
        name: Its name.
        help: Short description.
        unit: Unit; empty for none.
        default: Default values; None if it is optional.
        at_least: Inclusive lower bound of both.
        at_most: Inclusive upper bound of both.
    """
    parse = partial(interval, name, at_least=at_least, at_most=at_most)
    return param(help, unit, default=default, optional=default is None, parse=parse)


@dataclass_transform(kw_only_default=True, frozen_default=True, eq_default=True, field_specifiers=(param,))
class Parameters:
    """Base of frozen dataclasses of declared, checked parameters.

    Raises:
        ParameterError: If a value is of another kind or outside its bounds.
        TypeError: If a declaration itself is wrong, when the class is made.
    """

    _declared: ClassVar[Mapping[str, Parameter]] = {}
    _derived: ClassVar[frozenset[str]] = frozenset()  # of the class; an object has its own

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        _check_names(cls)
        dataclass(frozen=True, kw_only=True)(cls)
        hints = get_type_hints(cls)
        cls._declared = {item.name: _parameter(cls, item, hints[item.name]) for item in fields(cls)}  # type: ignore[arg-type]

    def __init__(self, **values: Any) -> None:  # each subclass gets its own
        raise TypeError("Parameters has none: make a subclass")

    def __post_init__(self) -> None:
        values, derived = vars(self), []
        checked = values.pop("_checked", ())  # by the object that this is a copy of: see `replace`
        for name, one in self._declared.items():
            if name in checked:
                continue
            if values[name] is None and one.derive is not None:
                derived.append(name)
                values[name] = one.derive(self)
            values[name] = one.checked(values[name])
        values["_derived"] = frozenset(derived)
        self.check()

    def check(self) -> None:
        """Check conditions on several parameters; raise ParameterError."""

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return the declared parameters, in order."""
        return tuple(cls._declared.values())

    @classmethod
    def parameter(cls, name: str) -> Parameter:
        """Return one parameter by name.

        Raises:
            ParameterError: If there is no such parameter.
        """
        if name not in cls._declared:
            raise ParameterError(not_one_of("parameter", cls._declared, name))
        return cls._declared[name]

    @classmethod
    def like(cls, name: str, **changes: Any) -> Any:
        """Declare a parameter of another class as this one does, but for changes; see `param`.

        Raises:
            ParameterError: If there is no such parameter.
        """
        one = cls.parameter(name)
        kept = {given: value for given, value in vars(one).items() if given not in ("name", "kind", "bounds")}
        return param(**{**kept, **one.bounds, **changes})

    def replace(self, **changes: Any) -> Self:
        """Return a copy with changes; derived values are derived again.

        The other values are not checked again by themselves.

        Raises:
            ParameterError: If there is no parameter of a name, or a value is outside its bounds.
        """
        for name in changes:
            self.parameter(name)
        copy = object.__new__(type(self))
        vars(copy).update(self.as_json() | dict.fromkeys(self._derived) | changes)
        vars(copy)["_checked"] = self._declared.keys() - self._derived - changes.keys()
        copy.__post_init__()
        return copy

    def independent_values(self) -> dict[str, Any]:
        """Return the values that are not derived, by name."""
        return {name: value for name, value in self.as_json().items() if name not in self._derived}

    def as_json(self) -> dict[str, Any]:
        """Return the values by name."""
        return {name: getattr(self, name) for name in self._declared}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Return the object with values by name.

        Raises:
            ParameterError: If there is no parameter of a name, or a value is outside its bounds.
        """
        for name in values:
            cls.parameter(name)
        return cls(**values)


def _check_names(cls: type[Parameters]) -> None:
    """Refuse parameters without type, or with a hidden name."""
    for name, value in vars(cls).items():
        bases = [base for base in cls.__mro__[1:] if name in vars(base)]
        declared = [getattr(base, "__dataclass_fields__", {}).get(name) for base in bases]
        was_one = any("param" in getattr(item, "metadata", ()) for item in declared)
        if "param" not in getattr(value, "metadata", ()):
            if was_one:
                raise TypeError(f"{cls.__name__}.{name} must be declared by param(...), as in {bases[0].__name__}")
        elif name not in inspect.get_annotations(cls):
            raise TypeError(f"{cls.__name__}.{name} needs a type: `{name}: float = param(...)`")
        elif bases and not was_one and not isinstance(vars(bases[0])[name], property):
            what = "a method" if callable(getattr(bases[0], name)) else "an attribute"
            raise TypeError(f"{cls.__name__}.{name} cannot be a parameter: it is {what} of {bases[0].__name__}")


def _parameter(cls: type, item: Any, hint: Any) -> Parameter:
    """Return the parameter declared by a field's type."""
    if "param" not in item.metadata:
        raise TypeError(f"{cls.__name__}.{item.name} must be declared by param(...), or be a ClassVar")
    declared = item.metadata["param"]
    kinds = [hint]
    if get_origin(hint) in (Union, types.UnionType):
        kinds = [part for part in get_args(hint) if part is not type(None)]
    if declared["parse"] is None and (len(kinds) != 1 or kinds[0] not in (float, int, bool, str)):
        raise TypeError(f"{cls.__name__}.{item.name} must be float, int, bool or str, or have a `parse`, not {hint}")
    return Parameter(name=item.name, kind=object if declared["parse"] else kinds[0], default=item.default, **declared)


def read_json(
    kind: str, path: str | Path, parse: Callable[[Any], _T], error: type[MaglevError] = ParameterError, **options: Any
) -> _T:
    """Read a JSON file and return what `parse` makes of it.

    Args:
        kind: Kind of the file, for messages.
        path: The file.
        parse: Function of the content.
        error: Type of the error that is raised.
        options: Options of `json.loads`.

    Raises:
        MaglevError: Of that type, if the file cannot be read or parsed; one line with file and reason.
    """
    try:
        return parse(json.loads(Path(path).read_text(encoding="utf-8"), **options))
    except OSError as failure:
        raise error(f"{kind} {str(path)!r} cannot be read: {failure.strerror}") from None
    except MaglevError as failure:
        raise error(f"{kind} {str(path)!r}: {failure}") from None
    except (ValueError, RecursionError) as failure:
        raise error(f"{kind} {str(path)!r} is not JSON: {failure}") from None

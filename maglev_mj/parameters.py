"""Parameter checks and declarations.

A class of declared parameters derives its checks, JSON and command-line options from the declarations.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache, partial
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

from maglev_mj.errors import (
    MaglevError,
    ParameterError,
    check_one_of,
    choice_message,
    file_path,
    one_line,
    refuse_mask,
)
from maglev_mj.files import parse_json, read_text
from maglev_mj.frames import AXES, Array, Component
from maglev_mj.keywords import check_constructor, checked, with_period
from maglev_mj.spec import MAX_DELAY, MAX_DELAY_PERIODS, MAX_PERIOD, MIN_PERIOD

MEASURED_MOTIONS = ".maglev", ".csv", ".txt", ".tsv", ".tab", ".dat", ".lvm", ".asc", ".log", ".gz"
"""Endings of files with a measured motion: recordings and tables."""
_NOT_NUMBERS = bool, np.bool_, str, bytes
"""Types that float() accepts but `number` rejects."""

SAMPLE_PERIOD: Any = {"at_least": MIN_PERIOD, "at_most": MAX_PERIOD, "unit": "s"}
LAG: Any = {"at_most": 0.01, "unit": "s"}
"""Bounds of a sample period and of a driver's time constant, as keywords of `number`."""

_LARGEST = sys.float_info.max
_T = TypeVar("_T")


def flag(name: str, value: object) -> bool:
    """Return `value` as a bool.

    Raises:
        ParameterError: If it is not a bool.
    """
    if not isinstance(value, bool | np.bool_):
        raise ParameterError(f"{name} must be True or False (got {value!r})")
    return bool(value)


def number(
    name: str,
    value: object,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    below: float = math.inf,
    at_most: float = math.inf,
    unit: str = "",
) -> float:
    """Return `value` as a finite float within the bounds; the unit is for the message.

    A time in seconds that was meant in milliseconds, or a period that is a rate, is named in the message.

    Raises:
        ParameterError: If it is not a number, not finite, or outside the bounds.
    """
    if hasattr(value, "mask"):
        refuse_mask(name, value)
    try:
        result = math.nan if isinstance(value, _NOT_NUMBERS) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if not (above < result < below and at_least <= result <= at_most and math.isfinite(result)):
        bounds = {"above": above} if above >= at_least else {"at least": at_least}  # the stricter of two
        bounds |= {"below": below} if below <= at_most else {"at most": at_most}
        limits = " and ".join(f"{word} {bound:g}" for word, bound in bounds.items() if math.isfinite(bound))
        limits = re.sub(r"e\+?(-?)0?(?=\d)", r"e\1", re.sub(r"^at least (\S+ and) at most", r"between \1", limits))
        allowed = [*["a finite number"] * (not limits or not math.isfinite(result)), *[limits] * bool(limits), unit]
        least = 0.5 if "delay" in name else 0.01  # networks delay by 20 to 200 ms
        guesses = {f"{result * 1e-3:g} s": result * 1e-3} if unit[:2] in ("s", "s,") and result >= least else {}
        if name == "period" and result > 0.0:
            guesses[f"a rate of {result:g} Hz"] = 1.0 / result
        near = [text for text, guess in guesses.items() if at_least <= guess <= at_most]
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        raise ParameterError(f"{name} must be {' '.join(filter(None, allowed))} (got {one_line(value)}){hint}")
    return result


def whole(name: str, value: object, *, at_least: float = 0.0, at_most: float = 2.0**53) -> int:
    """Return `value` as an int within the bounds.

    Raises:
        ParameterError: If it is not an integer, or outside the bounds.
    """
    result = number(name, value, at_least=at_least, at_most=at_most)
    if result != int(result):
        raise ParameterError(f"{name} must be an integer (got {value!r})")
    return int(result)


def interval(
    name: str, value: Sequence[object], *, at_least: float = -math.inf, at_most: float = math.inf, most: int = 0
) -> tuple[float, ...]:
    """Return (low, high) of a checked range, or (low, high, count) of values from low to high.

    Args:
        name: Name for the message.
        value: The range.
        at_least: Inclusive lower bound of both ends.
        at_most: Inclusive upper bound of both ends.
        most: Largest count; 0 for a range without one.

    Raises:
        ParameterError: If it is not two numbers within the bounds in ascending order, or the count is not within 1 and
            the largest.
    """
    try:
        ends = tuple(value)
    except TypeError:
        ends = ()
    if len(ends) not in ((2, 3) if most else (2,)):
        form = "(low, high) or (low, high, count)" if most else "a pair (low, high)"
        raise ParameterError(f"{name} must be {form} (got {value!r})")
    low, high = (number(name, end, at_least=at_least, at_most=at_most) for end in ends[:2])
    if low > high:
        raise ParameterError(f"{name} must be in ascending order, low to high (got {low:g} to {high:g})")
    return low, high, *(whole(f"count of {name}", count, at_least=1, at_most=most) for count in ends[2:])


def numbers(
    name: str,
    value: ArrayLike,
    *,
    shape: str = "",
    at_least: float = -math.inf,
    above: float | None = None,
    at_most: float = math.inf,
    finite: bool = True,
    unit: str = "",
) -> Array:
    """Return `value` as a float array with checked entries.

    Args:
        name: Name for the message.
        value: Number or array.
        shape: Allowed shapes, such as "(6,) or (N, 6)" or "(..., 6)"; empty for any.
        at_least: Inclusive lower bound.
        above: Exclusive lower bound; None for none.
        at_most: Inclusive upper bound.
        finite: False allows infinity; NaN is never allowed.
        unit: Unit for the message.

    Raises:
        ParameterError: If an entry is not a number, not finite, or outside the bounds, or the shape is another.
    """
    lower, plain = -math.inf if above is None else above, above is None and not shape
    if value.__class__ is float and plain and max(at_least, -_LARGEST) <= value <= min(at_most, _LARGEST):
        return np.array(value)  # fast path: a third of the cost
    if hasattr(value, "mask") or (isinstance(value, list | tuple) and not {float, int}.issuperset(map(type, value))):
        refuse_mask(name, value)
    try:
        raw = np.asarray(value)
        kinds = map(type, np.array(value, object).flat) if isinstance(value, list | tuple) else ()
    except ValueError:  # ragged rows
        raw, kinds = np.asarray(""), ()
    if raw.dtype.kind not in "fiu" or not {bool, np.bool_}.isdisjoint(kinds):  # NumPy takes [True, 1.0] for numbers
        raise ParameterError(f"{name} must be a number or an array of numbers (got {one_line(value)})")
    array = np.asarray(raw, dtype=np.float64)
    good = (array >= at_least) & (array <= at_most)
    if above is not None:
        good &= array > above
    if finite:
        good &= np.isfinite(array)
    if not good.all():
        number(name, float(array[~good].flat[0]), at_least=at_least, above=lower, at_most=at_most, unit=unit)
    if shape and not any(map(partial(_has_shape, array.shape), shape.split(" or "))):
        others = " or ".join(one for one in shape.split(" or ") if one != "()")
        allowed = ["be a number"] * ("()" in shape.split(" or ")) + [f"have shape {others}"] * bool(others)
        raise ParameterError(f"{name} must {' or '.join(allowed)} (got {array.shape})")
    return array


@lru_cache(maxsize=256)
def _has_shape(shape: tuple[int, ...], allowed: str) -> bool:
    sizes = re.findall(r"\w+|\.{3}", allowed)
    if sizes[:1] == ["..."]:
        sizes, shape = sizes[1:], shape[max(len(shape) - len(sizes) + 1, 0) :]
    return len(shape) == len(sizes) and all(name in (str(size), "N", "L", "M", "P") for size, name in zip(shape, sizes))


def transport_delay(value: ArrayLike, period: ArrayLike, name: str = "delay", where: str = "in a simulation") -> Array:
    """Return checked delays [s], (...,), of at most ten of the periods [s], (...,), as plants simulate them.

    Name and place are for messages. See `loop_delay` for those of theory.

    Raises:
        ParameterError: If one is not a number, is negative or too long, or the shapes do not match.
    """
    delays, periods = numbers(name, value, at_least=0.0), np.asarray(period)
    shape = common_shape("period and delay", periods.shape, delays.shape)
    if ((ratio := delays / periods) > MAX_DELAY_PERIODS * (1.0 + 1e-9)).any():
        delay, time = (float(np.broadcast_to(part, shape).flat[np.argmax(ratio)]) for part in (delays, periods))
        number(name, delay, at_most=MAX_DELAY_PERIODS * time, unit=f"s, {MAX_DELAY_PERIODS} periods {where}")
    return delays


def loop_delay(value: ArrayLike, period: ArrayLike) -> Array:
    """Return checked delays of a loop in theory [s], (...,), of at most 1 s.

    Raises:
        ParameterError: If one is not a number, is negative or too long, or the shapes do not match.
    """
    delays = numbers("delay", value, at_least=0.0, at_most=MAX_DELAY, unit="s")
    common_shape("period and delay", np.shape(period), delays.shape)
    return delays


def store(frozen: object, **values: Any) -> None:
    """Set attributes of a frozen dataclass, by name."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


def six(
    name: str, value: ArrayLike, batch: tuple[int, ...] = (), *, at_least: float = 0.0, finite: bool = False
) -> Array:
    """Return a checked parameter of the six axes, (6,) or (..., 6) for a batch; a number applies to all axes.

    Raises:
        ParameterError: If an entry is below the bound or the shape is wrong.
    """
    shape = "() or (6,)" + (f" or {(*batch, 6)}" if batch else "")
    array = numbers(name, value, shape=shape, at_least=at_least, finite=finite)
    return np.broadcast_to(array, (6,)) if array.ndim == 0 else array


def parsed_number(name: str, text: str) -> float:
    """Parse a finite number.

    Raises:
        ParameterError: If the text is not a finite number.
    """
    try:
        return number(name, float(text))
    except ValueError:
        return number(name, text)


def axis_indices(axes: str | Sequence[str]) -> tuple[int, ...]:
    """Return the indices of one or more axis names.

    Raises:
        ParameterError: If a name is unknown or repeated, or there is none.
    """
    names = (axes,) if isinstance(axes, str) or not isinstance(axes, Iterable) else tuple(axes)
    for name in names:
        check_one_of("axis", AXES, name)
    if not names or len(set(names)) != len(names):
        raise ParameterError(f"axes must be one or more of {', '.join(AXES)}, without duplicates (got {names!r})")
    return tuple(AXES.index(name) for name in names)


def batch_shape(what: str, values: Iterable[Array]) -> tuple[int, ...]:
    """Return the common batch shape of parameters (..., axes).

    Raises:
        ParameterError: If they do not broadcast.
    """
    shapes = [value.shape[:-1] for value in values]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"{what} parameters must share a batch shape (got {sorted(set(shapes))})") from None


def common_shape(what: str, *shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape to which all shapes broadcast.

    Raises:
        ParameterError: If they do not broadcast.
    """
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"{what} must share a shape (got {', '.join(map(str, sorted(set(shapes))))})") from None


def per_axis(name: str, values: Array, count: int) -> tuple[Component, ...]:
    """Split a checked parameter into one component per axis.

    A number applies to all axes; (count,) gives one per axis; (..., count) also one per device.

    Raises:
        ParameterError: If the last dimension is not `count`.
    """
    if values.ndim == 0:
        return (float(values),) * count
    if values.shape[-1] != count:
        raise ParameterError(f"{name} must have a last dimension of {count}, one per axis (got shape {values.shape})")
    if values.ndim == 1:
        return tuple(values.tolist())
    return tuple(np.ascontiguousarray(np.moveaxis(values, -1, 0)))


@checked
@dataclass(frozen=True, kw_only=True)
class Turn:
    """Change of a value by one key press.

    Attributes:
        factor: Factor per press; the result is rounded to three digits. 0 for none.
        add: Step per press; the result is a multiple of it. 0 for none.
        among: Values to step through.
        least: Lower limit for the keys; the parameter's bounds may be wider.
        most: Upper limit for the keys.
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
        if not self.least <= self.most:
            raise ParameterError(f"least must be at most {self.most:g}, the upper limit (got {self.least!r})")
        store(self, factor=number("factor", self.factor, at_least=0.0), add=number("add", self.add, at_least=0.0))

    @property
    def has_keys(self) -> bool:
        """True if keys change the value."""
        return bool(self.factor or self.add or self.among)

    @checked
    def __call__(self, value: float, way: int) -> float:
        """Return the value after a press, 1 up, -1 down."""
        if self.among:
            now = 1.0 / value if self.inverse else value
            nearest = min(range(len(self.among)), key=lambda index: abs(self.among[index] - now))
            chosen = self.among[min(max(nearest + way, 0), len(self.among) - 1)]
            return 1.0 / chosen if self.inverse else chosen
        if self.add:
            turned = (round(value / self.add) + way) * self.add
        else:
            # three digits: the displayed value is the exact value
            turned = float(f"{value * (self.factor if way > 0 else 1.0 / self.factor):.3g}")
        return min(max(turned, self.least), self.most)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Declared parameter; see `param` for the attributes not listed here.

    Attributes:
        name: Name of the field.
        kind: float, int, bool or str; object for a value checked by `parse`.
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
            ParameterError: If the type is wrong, or the value is outside its bounds.
        """
        if value is None and self.optional:
            return None
        if self.parse is not None:
            return self.parse(value)
        if self.kind is bool:
            return flag(self.name, value)
        if self.kind is str:
            if not isinstance(value, str) or (self.choices and value not in self.choices):
                message = choice_message(self.name, self.choices, value)
                raise ParameterError(message if self.choices else f"{self.name} must be a string (got {value!r})")
            return value
        result = number(self.name, value, **self.bounds, unit="" if self.along else self.unit)
        if self.kind is int:
            if result != int(result):
                raise ParameterError(f"{self.name} must be an integer (got {result:g})")
            return int(result)
        return result

    def usual(self, owner: Any) -> Any:
        """Return the default of an object with this parameter."""
        return self.default if self.derive is None or self.default is not None else self.derive(owner)

    def from_text(self, text: str) -> Any:
        """Parse a value; its bounds are not checked.

        Raises:
            ParameterError: If the text is not of the parameter's type.
        """
        if self.kind is object:
            raise ParameterError(f"{self.name} cannot be set from text (got {text!r})")
        if self.optional and text.lower() == "none":
            return None
        if self.kind is str:
            return text
        if self.kind is bool:
            if text.lower() not in ("true", "false"):
                raise ParameterError(f"{self.name} must be true or false (got {text!r})")
            return text.lower() == "true"
        return parsed_number(self.name, text)


@checked
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
        default: Default value; None if `derive` computes it.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        below: Exclusive upper bound.
        at_most: Inclusive upper bound.
        choices: Allowed strings; empty for any.
        optional: True if None is allowed.
        derive: Function that computes the default from the object, whose earlier parameters are set.
        parse: Function that checks a value of another type than number, bool or string.
        live: True if it may change while the scene runs, by 25 % per key press; a `Turn` for another step.
        along: True if it acts along the axis of the parameter `axis`; its unit is the one for a translation.

    Example:
        >>> class Ball(Parameters):
        ...     mass: float = param("moving mass", "kg", default=0.7, above=0.0)
        >>> Ball(mass=1.0).mass
        1.0
    """
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
    derive: Callable[[Any], Any] | None = None,
    optional: bool = False,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    most: int = 0,
) -> Any:
    """Declare a range parameter (low, high), or (low, high, count); see `param`.

    Args:
        name: Name of the field.
        help: Short description.
        unit: Unit; empty for none.
        default: Default range; None if it is optional, or derived.
        derive: Function that computes the default.
        optional: True if None is allowed, as without a default.
        at_least: Inclusive lower bound of both ends.
        at_most: Inclusive upper bound of both ends.
        most: Largest count of values from low to high, which is optional; 0 for a range without one.
    """
    parse = partial(interval, name, at_least=at_least, at_most=at_most, most=most)
    optional = optional or (default is None and derive is None)
    return param(help, unit, default=default, optional=optional, derive=derive, parse=parse)


@checked
@dataclass_transform(kw_only_default=True, frozen_default=True, eq_default=True, field_specifiers=(param,))
class Parameters:
    """Base class of frozen dataclasses of declared, checked parameters.

    Raises:
        ParameterError: If a value has the wrong type or is outside its bounds.
        TypeError: If a declaration is invalid, at class creation.
    """

    _declared: ClassVar[Mapping[str, Parameter]] = {}
    _derived: ClassVar[frozenset[str]] = frozenset()  # overridden per object

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        _check_names(cls)
        check_constructor(dataclass(frozen=True, kw_only=True)(cls))
        hints = get_type_hints(cls)
        cls._declared = {item.name: _parameter(cls, item, hints[item.name]) for item in fields(cls)}  # type: ignore[arg-type]

    def __init__(self, **values: Any) -> None:  # generated for each subclass
        raise TypeError("Parameters is abstract: define a subclass")

    def __post_init__(self) -> None:
        values, derived = vars(self), []
        checked, former = values.pop("_checked", ()), values.pop("_former", {})  # set by `replace`: of the original
        for name, parameter in self._declared.items():
            if name in checked:
                continue
            if values[name] is None and parameter.derive is not None:
                derived.append(name)
                values[name] = parameter.derive(self)
                if former.get(name) == values[name]:
                    continue
            values[name] = parameter.checked(values[name])
        values["_derived"] = frozenset(derived)
        self.check()

    def check(self) -> None:
        """Check conditions across parameters; raise ParameterError if one fails."""

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
            raise ParameterError(choice_message("parameter", cls._declared, name))
        return cls._declared[name]

    @classmethod
    def like(cls, name: str, **changes: Any) -> Any:
        """Return a declaration like one of this class, with changes; see `param`.

        Raises:
            ParameterError: If there is no such parameter.
        """
        parameter = cls.parameter(name)
        keywords = {key: value for key, value in vars(parameter).items() if key not in ("name", "kind", "bounds")}
        return param(**{**keywords, **parameter.bounds, **changes})

    def replace(self, **changes: Any) -> Self:
        """Return a copy with changes; derived values are recomputed, unchanged values are not rechecked.

        Raises:
            ParameterError: If a name is unknown, or a value is outside its bounds.
        """
        changes = with_period(self._declared, changes)
        for name in changes:
            self.parameter(name)
        copy = object.__new__(type(self))
        vars(copy).update(self.as_json() | dict.fromkeys(self._derived) | changes)
        vars(copy)["_checked"] = self._declared.keys() - self._derived - changes.keys()
        vars(copy)["_former"] = self.as_json()
        copy.__post_init__()
        return copy

    def independent_values(self) -> dict[str, Any]:
        """Return the explicitly set values, without derived ones, by name."""
        return {name: value for name, value in self.as_json().items() if name not in self._derived}

    def as_json(self) -> dict[str, Any]:
        """Return the values by name."""
        return {name: getattr(self, name) for name in self._declared}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Return an instance with these values by name.

        Raises:
            ParameterError: If a name is unknown, or a value is outside its bounds.
        """
        for name in values:
            cls.parameter(name)
        return cls(**values)


def _check_names(cls: type[Parameters]) -> None:
    """Reject parameters without a type annotation, or that shadow an attribute."""
    for name, value in vars(cls).items():
        bases = [base for base in cls.__mro__[1:] if name in vars(base)]
        declared = [getattr(base, "__dataclass_fields__", {}).get(name) for base in bases]
        overrides = any("param" in getattr(item, "metadata", ()) for item in declared)
        if "param" not in getattr(value, "metadata", ()):
            if overrides:
                raise TypeError(f"{cls.__name__}.{name} must be declared by param(...), as in {bases[0].__name__}")
        elif name not in inspect.get_annotations(cls):
            raise TypeError(f"{cls.__name__}.{name} needs a type annotation: `{name}: float = param(...)`")
        elif bases and not overrides and not isinstance(vars(bases[0])[name], property):
            kind = "a method" if callable(getattr(bases[0], name)) else "an attribute"
            raise TypeError(f"{cls.__name__}.{name} cannot be a parameter: it is {kind} of {bases[0].__name__}")


def _parameter(cls: type, item: Any, hint: Any) -> Parameter:
    """Return the parameter declared by a field's type."""
    if "param" not in item.metadata:
        raise TypeError(f"{cls.__name__}.{item.name} must be declared by param(...), or be a ClassVar")
    declared = item.metadata["param"]
    kinds = [hint]
    if get_origin(hint) in (Union, types.UnionType):
        kinds = [part for part in get_args(hint) if part is not type(None)]
    if declared["parse"] is None and (len(kinds) != 1 or kinds[0] not in (float, int, bool, str)):
        raise TypeError(f"{cls.__name__}.{item.name} must be float, int, bool or str, or have a `parse` (got {hint})")
    return Parameter(name=item.name, kind=object if declared["parse"] else kinds[0], default=item.default, **declared)


def read_json(
    kind: str, path: str | Path, parse: Callable[[Any], _T], error: type[MaglevError] = ParameterError, **options: Any
) -> _T:
    """Read and parse a JSON file, with options of `json.loads`; see `read_file`."""
    return read_file(kind, path, lambda text: parse(parse_json(text, parse_constant=float, **options)), error)


def read_file(
    kind: str,
    path: str | Path,
    parse: Callable[[Any], _T],
    error: type[MaglevError] = ParameterError,
    read: Callable[[Path], Any] = read_text,
) -> _T:
    """Read and parse a file.

    Args:
        kind: Kind of the file, for messages.
        path: The file.
        parse: Function of what `read` returns.
        error: Type of the error raised.
        read: Function that reads the file; text by default.

    Raises:
        MaglevError: Of type `error`, if the file cannot be read or parsed; one line with path and reason.
    """
    try:
        return parse(read(file_path(path)))
    except OSError as failure:
        raise error(f"{kind} {str(path)!r} cannot be read: {failure.strerror}") from None
    except (MaglevError, UnicodeError) as failure:
        raise error(f"{kind} {str(path)!r}: {failure}") from None

"""Base classes of control laws and of velocity estimators, and the simplest laws.

`Law` answers samples and describes itself; an `AxisLaw` consists of gains and one function.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar, NamedTuple, Protocol, Self, TypeAlias, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import MaglevError, ParameterError, named
from maglev_mj.frames import AXES, Array, Component, Six
from maglev_mj.parameters import axis_indices, batch_shape, flag, number, numbers, per_axis, store
from maglev_mj.spec import INERTIA


class LinearController(NamedTuple):
    """Linear discrete-time controller of one axis.

    q[k+1] = advance q[k] + take x[k]; output[k] = give q[k] + direct x[k].

    The position x is measured from the edge of the wall.

    Attributes:
        advance: (..., n, n).
        take: (..., n).
        give: (..., n).
        direct: (...,).
    """

    advance: Array
    take: Array
    give: Array
    direct: Array


Face: TypeAlias = tuple[int, float, Component]
"""One plane of a wall: axis index, normal, edge.

The index is into AXES. The axis is free while normal (x - edge) > 0.
"""


Answer: TypeAlias = tuple[Any, Six | None]
"""Next state of a law, and six components of its pulse or None."""


class Gains(NamedTuple):
    """Linearisation of a law in one of its states.

    Attributes:
        state: Name of the state: "always", "contact", "stuck" or another; several may hold at once, and then add up.
        stiffness: On the six axes [N/m, N m/rad], (..., 6).
        damping: On the six axes [N s/m, N m s/rad], (..., 6).
    """

    state: str
    stiffness: Array
    damping: Array


class Law:
    """Base class of control laws; subclasses define `__call__`.

    A law with memory defines `start` too. The other methods describe the law. By default a law has no faces, carries no
    weight and has no friction, and its stability is found numerically.

    Example:
        >>> from maglev_mj import Controller, Law, Sample
        >>> class Weight(Law):
        ...     def __call__(self, position, velocity, state, wrench):
        ...         wrench[2] += 6.867
        ...         return state, None
        >>> Controller([Weight()], period=0.005).step(Sample(0, 0.0, [0.0] * 6)).force[2]
        6.867
    """

    per_device: ClassVar[Sequence[str]] = ()
    """Names of fields that accept (N, axes) for N devices.

    A law that names any must answer N devices elementwise.
    """
    batch: tuple[int, ...] = ()
    """Batch shape of per-device parameters; () for common parameters."""
    pulse_width: float = 0.0
    """Duration of the law's force pulses [s]; 0 for none."""

    def start(self) -> Any:
        """Return the state before the first sample."""
        return None

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Answer one sample: add the held force to `wrench`.

        Args:
            position: Six position components [m, rad].
            velocity: Six velocity components [m/s, rad/s].
            state: State returned by the previous call, or `start()`.
            wrench: Six components [N, N m], the sum of all laws; the only argument that is changed.

        Returns:
            The next state, and six pulse components added to the held force for `pulse_width`, or None.
        """
        raise NotImplementedError

    def gains(self) -> Iterable[Gains] | None:
        """Return the law's linearisation in each of its states.

        None if it must be found numerically.
        """
        return None

    def faces(self) -> Sequence[Face]:
        """Return each plane of a wall."""
        return ()

    def signals(self, state: Any) -> Mapping[str, Sequence[Component]]:
        """Return state quantities by name, one component per axis.

        Empty before the first sample.
        """
        return {}

    def stick_positions(self, state: Any) -> Mapping[int, float]:
        """Return stick positions [m, rad] by index into AXES.

        NaN for a sliding axis; empty without friction.
        """
        return {}

    def carried(self) -> Array:
        """Return the constant weight-bearing wrench [N, N m], (..., 6).

        It renders nothing.
        """
        return np.zeros(len(AXES))


class VelocityEstimator(Protocol):
    """Interface of velocity estimators."""

    def __call__(self, position: Six, state: Any, period: float) -> tuple[Six, Any]:
        """Return six velocity components and the next state.

        `state` is None at the first sample.
        """


def gain(
    help: str = "",
    unit: str = "",
    *,
    default: Any = MISSING,
    above: float | None = None,
    at_least: float = 0.0,
    finite: bool = True,
) -> Any:
    """Declare a gain of an `AxisLaw`.

    Its value is one number, one number per axis, or (N, axes) for N devices.

    Args:
        help: Description.
        unit: Unit.
        default: Default value; without one the gain is a required argument.
        above: Exclusive lower bound; None for none.
        at_least: Inclusive lower bound; -inf for none.
        finite: False lets infinity pass.

    Example:
        >>> from maglev_mj import AxisLaw, gain
        >>> class Damper(AxisLaw):
        ...     damping: float = gain("damping", "N s/m", above=0.0)
        ...
        ...     def force(self, x, v, gains, state):
        ...         return -gains.damping * v
        >>> Damper(damping=30.0).damping
        30.0
    """
    bounds = {"above": above, "at_least": at_least, "finite": flag("finite", finite)}
    return field(default=default, metadata={"help": help, "unit": unit, "gain": bounds})


def setting(*, default: Any = MISSING, **bounds: float) -> Any:
    """Declare a number of an `AxisLaw`, the same on all axes, with bounds of `number`."""
    return field(default=default, metadata={"setting": bounds})


@dataclass_transform(
    kw_only_default=True, frozen_default=True, eq_default=False, field_specifiers=(gain, setting, field)
)
@dataclass(frozen=True, kw_only=True, eq=False)
class AxisLaw(Law):
    """Law with independent axes, defined by gains and `force`.

    No decorator is needed.

    Use + - * /, comparisons and numpy functions alone, no `if` on a coordinate and no `math`: one line then serves one
    device, as floats, and N devices, as arrays.

    Args:
        axes: Names from AXES; all six by default.

    Raises:
        ParameterError: If a gain is outside its bounds or of the wrong shape.

    Example:
        >>> from maglev_mj import AxisLaw, gain
        >>> class Spring(AxisLaw):
        ...     stiffness: float = gain("stiffness", "N/m")
        ...     damping: float = gain("damping", "N s/m", default=0.0)
        ...
        ...     def force(self, x, v, gains, state):
        ...         return -gains.stiffness * x - gains.damping * v
        >>> wrench = [0.0] * 6
        >>> Spring(axes="x", stiffness=3000.0)([1e-3, 0, 0, 0, 0, 0], [0.0] * 6, [None], wrench)
        ([None], None)
        >>> wrench
        [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    axes: str | Sequence[str] = AXES

    indices: tuple[int, ...] = field(init=False, repr=False)
    batch: tuple[int, ...] = field(init=False, repr=False)
    _each: tuple[tuple[int, Self], ...] = field(init=False, repr=False)
    """Index into AXES and the law of that axis alone.

    The gains of that law are components.
    """
    _title: ClassVar[str] = ""
    """Name in messages, if it is not that of the class."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        dataclass(frozen=True, kw_only=True, eq=False)(cls)
        cls.per_device = tuple(one.name for one in fields(cls) if "gain" in one.metadata)
        names = (name for name in inspect.get_annotations(cls) if name not in ("axes", "pulse_width"))
        if hidden := [name for name in names if hasattr(AxisLaw, name)]:
            raise ParameterError(f"{cls.__name__} must not have a gain called {hidden[0]}: a law has that itself")
        if not _takes(cls.force, 5):
            takes = inspect.signature(cls.force)
            raise ParameterError(f"{cls.__name__}.force must take (self, x, v, gains, state), not {takes}")

    def __post_init__(self) -> None:
        name, indices = self._title or type(self).__name__, axis_indices(self.axes)
        values: dict[str, Array] = {}
        for one in fields(self):
            if "gain" in one.metadata:
                values[one.name] = numbers(f"{name} {one.name}", getattr(self, one.name), **one.metadata["gain"])
            elif "setting" in one.metadata:
                number(one.name, getattr(self, one.name), **one.metadata["setting"])
        split = {one: per_axis(f"{name} {one}", array, len(indices)) for one, array in values.items()}
        common, each = {one.name: getattr(self, one.name) for one in fields(self) if one.init}, []
        for slot, index in enumerate(indices):
            alone = object.__new__(type(self))
            store(alone, **common | {gain: parts[slot] for gain, parts in split.items()})
            each.append((index, alone))
        store(self, indices=indices, batch=batch_shape(name, values.values()), _each=tuple(each))

    def start(self) -> Any:
        """Return the state before the first sample.

        It is None for each axis.
        """
        return (None,) * len(self._each)

    def force(self, x: Component, v: Component, gains: Self, state: Any) -> Any:
        """Return the force on one axis [N, N m].

        A law with memory returns the force and the next state.

        Args:
            x: Position [m, rad].
            v: Velocity [m/s, rad/s].
            gains: The gains of that axis, by name.
            state: The state of that axis; None at the first sample.
        """
        raise ParameterError(f"{named(type(self))} must define force(self, x, v, gains, state)")

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Answer one sample; see `Law`."""
        after, force = [], self.force
        for (axis, gains), before in zip(self._each, state):
            result = force(position[axis], velocity[axis], gains, before)
            if result.__class__ is tuple:
                result, before = result
            wrench[axis] = wrench[axis] + result
            after.append(before)
        return after, None

    def on_axes(self, values: Any) -> Array:
        """Return a gain on all six axes, (..., 6).

        It is 0 on axes without this law.
        """
        array = np.asarray(values, dtype=np.float64)
        spread = np.zeros((*array.shape[:-1], len(AXES)))
        spread[..., list(self.indices)] = array
        return spread


class FunctionLaw(Law):
    """Memoryless law defined by a function.

    The function takes six positions and six velocities and returns six wrench components.
    """

    def __init__(self, function: Callable[[Six, Six], Six]) -> None:
        self.function = function
        self.name = getattr(function, "__name__", type(function).__name__)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Answer one sample; see `Law`."""
        parts: Any = self.function(position, velocity)
        if isinstance(parts, np.ndarray) and parts.ndim == 1:
            parts = parts.tolist()
        try:
            x, y, z, rx, ry, rz = parts
        except (TypeError, ValueError):
            raise ParameterError(f"law {self.name} must return six wrench components, not {parts!r}") from None
        wrench[:] = (
            wrench[0] + x,
            wrench[1] + y,
            wrench[2] + z,
            wrench[3] + rx,
            wrench[4] + ry,
            wrench[5] + rz,
        )
        return None, None


def as_law(given: Law | Callable[..., Any]) -> Law:
    """Return a law, wrapping a function f(position, velocity).

    Raises:
        ParameterError: If the argument is neither a law nor such a function.
    """
    if isinstance(given, Law):
        return given
    if not isinstance(given, type) and callable(given) and _takes(given, 2):
        return FunctionLaw(given)
    raise ParameterError(f"a law must be a Law, an AxisLaw or a function f(position, velocity), not {given!r}")


def answer(law: Law, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
    """Return a law's checked answer to one sample.

    See `Law` for the arguments.

    Raises:
        ParameterError: If the law fails, changes its input, or returns a wrong shape or a value that is not finite.
    """
    name = f"law {getattr(law, 'name', type(law).__name__)}"
    before = [part if part.__class__ is float else np.array(part) for part in (*position, *velocity)]
    try:
        result = law(position, velocity, state, wrench)
    except MaglevError:
        raise
    except Exception as error:
        raise ParameterError(f"{name} fails: {type(error).__name__}: {error}") from error
    if not (isinstance(result, tuple) and len(result) == 2):
        raise ParameterError(f"{name} must return its next state and a pulse or None, not {result!r}")
    after = [*position, *velocity]
    if not (len(after) == len(before) and all(map(_same, after, before))):
        raise ParameterError(f"{name} must not change the position or velocity that it is given")
    batch = np.broadcast_shapes(*(np.shape(part) for part in before if part.__class__ is not float))
    _check(name, "wrench", wrench, batch)
    if result[1] is not None:
        _check(name, "pulse", result[1], batch)
    return result


def _same(one: Component, other: Component) -> bool:
    return one is other or (one == other if one.__class__ is other.__class__ is float else np.array_equal(one, other))


def _check(name: str, what: str, parts: Six, batch: tuple[int, ...]) -> None:
    """Raise ParameterError unless there are six finite components.

    Each is a number or has the batch shape.
    """
    if not hasattr(parts, "__len__") or len(parts) != len(AXES):
        raise ParameterError(f"{name} must leave six components of {what}, not {parts!r}")
    for axis, part in zip(AXES, parts):
        if part.__class__ is float and math.isfinite(part):
            continue  # this is the first tick of a run, and arrays take ten times as long
        array = np.asarray(part)
        if array.dtype.kind not in "fiu" or array.shape not in ((), batch):
            shape = f"shape {batch}" if batch else "a number"
            raise ParameterError(f"{name} must give a {what} of {shape} on {axis}, not {part!r}")
        if (wrong := array[~np.isfinite(array)]).size:
            raise ParameterError(f"{name} must give a finite {what} on {axis}, not {wrong.flat[0]}")


def _takes(function: Callable[..., Any], count: int) -> bool:
    """Return True if a function accepts `count` positional arguments."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except (TypeError, ValueError):
        return False
    return True


class Hold(AxisLaw):
    """PD hold of a target pose.

    f = stiffness (target - x) - damping v.

    Each parameter is a number for all of the law's axes, one number an axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        stiffness: Stiffness [N/m, N m/rad].
        damping: Damping [N s/m, N m s/rad].
        target: Target pose [m, rad].

    Raises:
        ParameterError: If a gain is negative, or a value is not finite or of the wrong shape.

    Example:
        >>> from maglev_mj import Controller, Hold, Sample
        >>> hold = Hold(axes=["x", "y"], stiffness=3000.0, damping=30.0)
        >>> Controller([hold], period=0.005).step(Sample(0, 0.0, [1e-3, 0, 0, 0, 0, 0])).force[0]
        -3.0
    """

    stiffness: ArrayLike = gain(unit="N/m, N m/rad")
    damping: ArrayLike = gain(unit="N s/m, N m s/rad")
    target: ArrayLike = gain(unit="m, rad", default=0.0, at_least=-math.inf)

    _gains: tuple[tuple[int, Component, Component, Component], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, _gains=tuple((axis, one.stiffness, one.damping, one.target) for axis, one in self._each))

    @classmethod
    def critically_damped(
        cls,
        axes: str | Sequence[str] = AXES,
        *,
        period: float,
        delay: float,
        inertia: ArrayLike | None = None,
        target: ArrayLike = 0.0,
    ) -> Self:
        """Return a critically damped hold with wide stability margin.

        The natural frequency is 1/4 rad over the time from sample to sample and on to the force, at most
        50 rad/s. It is stable for any delay; the tests check the eigenvalues.

        Args:
            axes: Names from AXES.
            period: Sample period [s].
            delay: Transport delay [s].
            inertia: Mass or moment of inertia on these axes [kg, kg m²]; the published device's by default.
            target: Pose held [m, rad].
        """
        reach = number("period", period, above=0.0) + number("delay", delay, at_least=0.0)
        frequency = min(50.0, 0.25 / reach)
        body = (
            np.array(INERTIA)[list(axis_indices(axes))]
            if inertia is None
            else numbers("inertia", inertia, at_least=0.0)
        )
        return cls(axes=axes, stiffness=body * frequency**2, damping=2.0 * body * frequency, target=target)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> tuple[Any, None]:
        """Answer one sample; see `Law`.

        Written out for speed: calling `force` for each axis takes a quarter of the tick more.
        """
        for axis, stiffness, damping, target in self._gains:
            wrench[axis] = wrench[axis] + (stiffness * (target - position[axis]) - damping * velocity[axis])
        return state, None

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping, always in effect."""
        return (Gains("always", self.on_axes(self.stiffness), self.on_axes(self.damping)),)


@dataclass(frozen=True, eq=False)
class Bias(Law):
    """Constant wrench added to the other laws.

    Args:
        wrench: The wrench [N, N m], (..., 6).

    Raises:
        ParameterError: If the wrench is not finite, or its last dimension is not six.

    Example:
        >>> from maglev_mj import Bias, Controller, Sample
        >>> weight = Bias([0.0, 0.0, 0.7 * 9.81, 0.0, 0.0, 0.0])
        >>> round(Controller([weight], period=0.005).step(Sample(0, 0.0, [0.0] * 6)).force[2], 3)
        6.867
    """

    per_device: ClassVar[Sequence[str]] = ("wrench",)

    wrench: ArrayLike

    batch: tuple[int, ...] = field(init=False)
    _parts: tuple[Component, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        wrench = numbers("bias wrench", self.wrench)
        if wrench.shape[-1:] != (len(AXES),):
            raise ParameterError(f"bias wrench must be (..., 6), not {wrench.shape}")
        store(self, batch=wrench.shape[:-1], _parts=per_axis("bias wrench", wrench, len(AXES)))

    def __call__(self, position: Six, velocity: Six, state: None, wrench: list[Component]) -> tuple[None, None]:
        """Answer one sample; see `Law`."""
        for axis, part in enumerate(self._parts):
            wrench[axis] = wrench[axis] + part
        return None, None

    def gains(self) -> Iterable[Gains]:
        """Return no gains.

        A constant wrench has neither stiffness nor damping.
        """
        return ()

    def carried(self) -> Array:
        """Return the wrench [N, N m], (..., 6)."""
        return np.asarray(self.wrench, dtype=np.float64)


def choose(mask: Component, yes: Component, no: Component) -> Component:
    """Select `yes` or `no` by a mask, elementwise.

    Floats and arrays are both accepted.
    """
    if isinstance(mask, bool | np.bool_):
        return yes if mask else no
    return np.where(mask, yes, no)


def apply(function: Callable[[Component], Component], value: Component) -> Component:
    """Apply a numpy function; a float stays a float.

    numpy's own function serves both cases, because the standard library's may round differently.
    """
    result = function(value)
    return float(result) if isinstance(value, float) else result

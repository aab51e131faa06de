"""Base classes of control laws and velocity estimators, and the simplest laws.

A `Law` maps samples to forces and describes itself; an `AxisLaw` consists of gains and one function.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar, NamedTuple, Protocol, Self, TypeAlias, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import MaglevError, ParameterError, named, refuse_mask
from maglev_mj.frames import AXES, Array, Component, DeviceWall, Six
from maglev_mj.keywords import check_constructor, checked, every_tick
from maglev_mj.parameters import SAMPLE_PERIOD, axis_indices, batch_shape, flag, number, numbers, per_axis, store
from maglev_mj.spec import INERTIA


class LinearController(NamedTuple):
    """Discrete-time state space model of a controller of one axis.

    q[k+1] = A q[k] + B x[k], y[k] = C q[k] + D x[k], with the position x measured from the edge of the wall.

    Attributes:
        advance: A, (..., n, n).
        take: B, (..., n).
        give: C, (..., n).
        direct: D, (...,).
    """

    advance: Array
    take: Array
    give: Array
    direct: Array


Face: TypeAlias = tuple[int, float, Component]
"""Wall plane: index into AXES, normal, edge; free space is normal (x - edge) > 0."""


Answer: TypeAlias = tuple[Any, Six | None]
"""Next state of a law, and six pulse components or None."""


class Gains(NamedTuple):
    """Linearisation of a law in one state.

    Attributes:
        state: Name of the state, such as "always", "contact" or "stuck"; gains of simultaneous states are summed.
        stiffness: On the six axes [N/m, N m/rad], (..., 6).
        damping: On the six axes [N s/m, N m s/rad], (..., 6).
    """

    state: str
    stiffness: Array
    damping: Array


class Law:
    """Base class of control laws; subclasses define `__call__`.

    A law with memory also defines `start`. The other methods describe the law; by default it has no wall faces, no
    weight compensation and no friction, and is linearised numerically.

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
    """Names of fields that accept (N, axes) for N devices; such a law must work elementwise on N devices."""
    batch: tuple[int, ...] = ()
    """Batch shape of per-device parameters; () for common parameters."""
    pulse_width: float = 0.0
    """Duration of the law's force pulses [s]; 0 for none."""
    on: str = "host"
    """Where the law is rendered: "device" for a law with `device_walls`."""

    def start(self) -> Any:
        """Return the state before the first sample."""
        return None

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Add the held force for one sample to `wrench`.

        Args:
            position: Six position components [m, rad].
            velocity: Six velocity components [m/s, rad/s].
            state: State returned by the previous call, or `start()`.
            wrench: Sum of all laws, six components [N, N m]; modified in place.

        Returns:
            The next state, and six pulse components added to the held force for `pulse_width`, or None.
        """
        raise NotImplementedError

    def skip(self, position: Six, velocity: Six, state: Any) -> Any:
        """Return the state after a lost sample, at an interpolated position; a law with pulses keeps it."""
        return state if self.pulse_width > 0.0 else self(position, velocity, state, [0.0] * len(AXES))[0]

    def gains(self) -> Iterable[Gains] | None:
        """Return the linearisation of the law in each state; None for numerical linearisation."""
        return None

    def faces(self) -> Sequence[Face]:
        """Return the wall planes."""
        return ()

    def device_walls(self, state: Any) -> Sequence[DeviceWall]:
        """Return the walls that the device renders from this sample on; not called on the host."""
        return ()

    def signals(self, state: Any) -> Mapping[str, Sequence[Component]]:
        """Return state quantities by name, one component per axis; empty before the first sample."""
        return {}

    def stick_positions(self, state: Any) -> Mapping[int, float]:
        """Return stick positions [m, rad] by index into AXES: NaN for a sliding axis, empty without friction."""
        return {}

    def carried(self) -> Array:
        """Return the weight compensation [N, N m], (..., 6): constant, and not part of the rendered environment."""
        return np.zeros(len(AXES))


class VelocityEstimator(Protocol):
    """Interface of velocity estimators; those of the package derive from `Estimator`."""

    def __call__(self, position: Six, state: Any, period: float) -> tuple[Six, Any]:
        """Return six velocity components and the next state (at first None); `period` is since the last sample [s]."""


@checked
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
        finite: False to accept infinity.

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
    bounds: dict[str, Any] = {"above": above, "at_least": at_least, "finite": flag("finite", finite)}
    if default is not MISSING:
        numbers("default", default, **bounds)
    return field(default=default, metadata={"help": help, "unit": unit, "gain": bounds})


def setting(*, default: Any = MISSING, **bounds: Any) -> Any:
    """Declare a parameter of an `AxisLaw` that is common to all axes; bounds as in `number`."""
    return field(default=default, metadata={"setting": bounds})


@checked(own="axes")
@dataclass_transform(
    kw_only_default=True, frozen_default=True, eq_default=False, field_specifiers=(gain, setting, field)
)
@dataclass(frozen=True, kw_only=True, eq=False)
class AxisLaw(Law):
    """Law with independent axes, defined by gains and `force`.

    Subclasses need no decorator. Use only + - * /, comparisons and numpy functions, no `if` on a coordinate and no
    `math`: the same line then works for one device (floats) and for N devices (arrays).

    Args:
        axes: Names from AXES; all six by default.

    Raises:
        ParameterError: If a gain is outside its bounds or has the wrong shape.

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
    """Index into AXES, and a copy of the law with the gains of that axis as components."""
    _title: ClassVar[str] = ""
    """Name in messages; that of the class by default."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        check_constructor(dataclass(frozen=True, kw_only=True, eq=False)(cls), own="axes")
        cls.per_device = tuple(entry.name for entry in fields(cls) if "gain" in entry.metadata)
        names = (name for name in inspect.get_annotations(cls) if name not in ("axes", "pulse_width", "on"))
        if hidden := [name for name in names if hasattr(AxisLaw, name)]:
            raise ParameterError(
                f"{cls.__name__} must not have a gain called {hidden[0]}: the name is an attribute of every law"
            )
        if not _takes(cls.force, 5):
            signature = inspect.signature(cls.force)
            raise ParameterError(f"{cls.__name__}.force must take (self, x, v, gains, state) (got {signature})")

    def __post_init__(self) -> None:
        name, indices = self._title or type(self).__name__, axis_indices(self.axes)
        values: dict[str, Array] = {}
        for entry in fields(self):
            if "gain" in entry.metadata:
                values[entry.name] = numbers(
                    f"{name} {entry.name}", getattr(self, entry.name), **entry.metadata["gain"]
                )
            elif "setting" in entry.metadata:
                number(entry.name, getattr(self, entry.name), **entry.metadata["setting"])
        split = {key: per_axis(f"{name} {key}", array, len(indices)) for key, array in values.items()}
        common, each = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.init}, []
        for slot, index in enumerate(indices):
            law = object.__new__(type(self))
            store(law, **common | {gain: parts[slot] for gain, parts in split.items()})
            each.append((index, law))
        store(self, indices=indices, batch=batch_shape(name, values.values()), _each=tuple(each))

    def start(self) -> Any:
        """Return the state before the first sample: None for each axis."""
        return (None,) * len(self._each)

    @every_tick
    def force(self, x: Component, v: Component, gains: Self, state: Any) -> Any:
        """Return the force on one axis [N, N m], or (force, next state) for a law with memory.

        Args:
            x: Position [m, rad].
            v: Velocity [m/s, rad/s].
            gains: Gains of the axis, as attributes.
            state: State of the axis; None at the first sample.
        """
        raise ParameterError(f"{named(type(self))} must define force(self, x, v, gains, state)")

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Add the forces for one sample; see `Law`."""
        following, force = [], self.force
        for (axis, gains), memory in zip(self._each, state):
            result = force(position[axis], velocity[axis], gains, memory)
            if result.__class__ is tuple:
                result, memory = result
            wrench[axis] = wrench[axis] + result
            following.append(memory)
        return following, None

    def on_axes(self, values: Any) -> Array:
        """Return a gain on all six axes, (..., 6), with 0 on axes without this law."""
        array = np.asarray(values, dtype=np.float64)
        spread = np.zeros((*array.shape[:-1], len(AXES)))
        spread[..., list(self.indices)] = array
        return spread


class FunctionLaw(Law):
    """Memoryless law defined by a function of six positions and six velocities that returns six wrench components."""

    def __init__(self, function: Callable[[Six, Six], Six]) -> None:
        self.function = function
        self.name = getattr(function, "__name__", type(function).__name__)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Add the wrench for one sample; see `Law`."""
        parts: Any = self.function(position, velocity)
        if isinstance(parts, np.ndarray) and parts.ndim == 1:
            parts = parts.tolist()
        try:
            x, y, z, rx, ry, rz = parts
        except (TypeError, ValueError):
            raise ParameterError(f"law {self.name} must return six wrench components (got {parts!r})") from None
        wrench[:] = (
            wrench[0] + x,
            wrench[1] + y,
            wrench[2] + z,
            wrench[3] + rx,
            wrench[4] + ry,
            wrench[5] + rz,
        )
        return None, None


def as_law(candidate: Law | Callable[..., Any]) -> Law:
    """Return a law; wrap a function f(position, velocity).

    Raises:
        ParameterError: If the argument is neither a law nor such a function.
    """
    if isinstance(candidate, Law):
        return candidate
    if not isinstance(candidate, type) and callable(candidate) and _takes(candidate, 2):
        return FunctionLaw(candidate)
    raise ParameterError(f"a law must be a Law, an AxisLaw or a function f(position, velocity) (got {candidate!r})")


def answer(law: Law, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
    """Call a law for one sample and check its result; arguments as in `Law`.

    Raises:
        ParameterError: If the law raises, modifies its input, or returns a wrong shape or a value that is not finite.
    """
    name = f"law {getattr(law, 'name', type(law).__name__)}"
    before = [*position, *velocity]
    if batch := shape_of(before):
        before = list(map(np.array, before))
    try:
        result = law(position, velocity, state, wrench)
    except MaglevError:
        raise
    except Exception as error:
        raise ParameterError(f"{name} raises {type(error).__name__}: {error}") from error
    if not (isinstance(result, tuple) and len(result) == 2):
        raise ParameterError(f"{name} must return (next state, pulse or None) (got {result!r})")
    after = [*position, *velocity]
    if not (len(after) == len(before) and all(map(np.array_equal, after, before)) if batch else after == before):
        raise ParameterError(f"{name} must not modify its arguments position and velocity")
    _check(name, "wrench", wrench, batch)
    if result[1] is not None:
        _check(name, "pulse", result[1], batch)
    return result


def shape_of(parts: Sequence[Component]) -> tuple[int, ...]:
    """Return the batch shape of components; () for floats."""
    if set(map(type, parts)) == {float}:
        return ()  # one device: arrays take ten times as long
    return np.broadcast_shapes(*map(np.shape, parts))


def _check(name: str, what: str, parts: Six, batch: tuple[int, ...]) -> None:
    """Raise ParameterError unless `parts` are six finite components, each a number or of the batch shape."""
    if not hasattr(parts, "__len__") or len(parts) != len(AXES):
        raise ParameterError(f"{name} must have six {what} components (got {parts!r})")
    if set(map(type, parts)) == {float} and math.isfinite(sum(parts)):
        return
    for axis, part in zip(AXES, parts):
        refuse_mask(f"{name}: {what} on {axis}", part)
        array = np.asarray(part)
        if array.dtype.kind not in "fiu" or array.shape not in ((), batch):
            shape = f"of shape {batch}" if batch else "a number"
            raise ParameterError(f"{name}: {what} on {axis} must be {shape} (got {part!r})")
        if (wrong := array[~np.isfinite(array)]).size:
            raise ParameterError(f"{name}: {what} on {axis} must be finite (got {wrong.flat[0]})")


def _takes(function: Callable[..., Any], count: int) -> bool:
    try:
        inspect.signature(function).bind(*[None] * count)
    except (TypeError, ValueError):
        return False
    return True


@checked
class Hold(AxisLaw):
    """PD hold of a target pose: f = k (x_t - x) - b v.

    Each parameter is a number, one number per axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        stiffness: Stiffness k [N/m, N m/rad].
        damping: Damping b [N s/m, N m s/rad].
        target: Target pose x_t [m, rad].

    Raises:
        ParameterError: If a gain is negative, or a value is not finite or has the wrong shape.

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
        store(self, _gains=tuple((axis, law.stiffness, law.damping, law.target) for axis, law in self._each))

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
        """Return a critically damped hold with a wide stability margin.

        The natural frequency is w = min(50 rad/s, 0.25 / (period + delay)), with k = m w² and b = 2 m w. The hold is
        stable at any delay; the tests check the eigenvalues.

        Args:
            axes: Names from AXES.
            period: Sample period [s].
            delay: Transport delay [s], up to 1 s: also for a device that answers late.
            inertia: Mass or moment of inertia m on these axes [kg, kg m²]; the published device's by default.
            target: Target pose [m, rad].
        """
        lag = number("period", period, **SAMPLE_PERIOD) + number("delay", delay, at_least=0.0, at_most=1.0, unit="s")
        frequency = min(50.0, 0.25 / lag)
        body = (
            np.array(INERTIA)[list(axis_indices(axes))]
            if inertia is None
            else numbers("inertia", inertia, at_least=0.0)
        )
        return cls(axes=axes, stiffness=body * frequency**2, damping=2.0 * body * frequency, target=target)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> tuple[Any, None]:
        """Add the forces for one sample; see `Law`.

        Written out for speed: calling `force` per axis would lengthen the tick by a quarter.
        """
        for axis, stiffness, damping, target in self._gains:
            wrench[axis] = wrench[axis] + (stiffness * (target - position[axis]) - damping * velocity[axis])
        return state, None

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping, which are always active."""
        return (Gains("always", self.on_axes(self.stiffness), self.on_axes(self.damping)),)


@checked
@dataclass(frozen=True, eq=False)
class Bias(Law):
    """Constant wrench, such as weight compensation.

    Args:
        wrench: Wrench [N, N m], (..., 6).

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
        wrench = numbers("bias wrench", self.wrench, shape="(..., 6)")
        store(self, batch=wrench.shape[:-1], _parts=per_axis("bias wrench", wrench, len(AXES)))

    def __call__(self, position: Six, velocity: Six, state: None, wrench: list[Component]) -> tuple[None, None]:
        """Add the wrench; see `Law`."""
        for axis, part in enumerate(self._parts):
            wrench[axis] = wrench[axis] + part
        return None, None

    def gains(self) -> Iterable[Gains]:
        """Return no gains: a constant wrench has no stiffness or damping."""
        return ()

    def carried(self) -> Array:
        """Return the wrench [N, N m], (..., 6)."""
        return np.asarray(self.wrench, dtype=np.float64)


def choose(mask: Component, yes: Component, no: Component) -> Component:
    """Return `np.where(mask, yes, no)`, for floats too."""
    if isinstance(mask, bool | np.bool_):
        return yes if mask else no
    return np.where(mask, yes, no)


def apply(function: Callable[[Component], Component], value: Component) -> Component:
    """Apply a numpy function; a float stays a float.

    Never the standard library's function for floats: it may round differently.
    """
    result = function(value)
    return float(result) if isinstance(value, float) else result

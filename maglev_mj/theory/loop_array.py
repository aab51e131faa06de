"""Closed loop of a sampled wall as one matrix, exact for any delay.

Between switches of the force the flotor obeys linear equations, so a matrix maps the state at one sample to that at the
next: state of flotor, hand and drivers, delayed commands, and state of the controller. The loop inside the wall is
stable if all eigenvalues of the matrix are inside the unit circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj import control
from maglev_mj.control import FiniteDifference, LinearController, VelocityEstimator
from maglev_mj.control.laws.velocity import Estimator
from maglev_mj.control.timeline import split_delay
from maglev_mj.errors import KeywordError, ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.keywords import checked, rate_of
from maglev_mj.lazy import public
from maglev_mj.parameters import LAG, SAMPLE_PERIOD, common_shape, loop_delay, number, numbers, store
from maglev_mj.plants.hand import Hand, Mode, get_hand, hand_of, motion, transition
from maglev_mj.spec import MAX_DELAY_PERIODS, Spec
from maglev_mj.theory.delay import ROUNDING, AnyDelay, Cut, CutOf, dominant_poles, first_delays
from maglev_mj.theory.frequencies import angles_of, peak
from maglev_mj.theory.two_rates import DeviceLaw, TwoRates, rates_of

_CHUNK, LOOPS, LONG, _MOST_PERIODS = 1 << 16, 256, 30, 1000
"""Loops computed at once, by matrices and at any delay; periods of delay up to which a matrix is used, and allowed."""
_TOGETHER = 1024
_DIVIDES = "device period must divide the host's, {0} s (got {1.period:g})"
_ALMOST = 1.0 - 2e-9
"""Largest fraction that does not count as a whole period."""
_NAMES = {"inertia": "mass", "law": "design"}
"""Names of a `Loop` for two fields of `LoopArray`."""
_BATCHED = "period", "delay", "mass", "prediction", "own_damping", "driver_lag"

Design: TypeAlias = Callable[[Array, Array, Array], LinearController]
"""Function from stiffness, damping and sample period, (...,) each, to the linear controller inside the wall."""


class LinearisedLaw(NamedTuple):
    """Law linearised at a stiffness and damping, as a `Design`.

    With other gains its memory scales with the stiffness and keeps its length in samples; a finite difference adds the
    rest of the damping.
    """

    controller: LinearController
    stiffness: float
    damping: float

    def __call__(self, stiffness: Array, damping: Array, period: Array) -> LinearController:
        """Return the law with other gains."""
        law, share = self.controller, np.asarray(stiffness / self.stiffness)
        more = (damping - share * self.damping) / period
        advance = np.pad(law.advance, (0, 1))
        give = np.concatenate([share[..., None] * law.give, more[..., None]], axis=-1)
        return LinearController(advance, np.append(law.take, 1.0), give, share * law.direct - more)


class LoopKeywords(TypedDict, total=False):
    """Keywords of the stability functions: those of `LoopArray`, and `inertia` and `law` as `Loop` names two."""

    period: ArrayLike
    rate: ArrayLike
    delay: ArrayLike
    mass: ArrayLike
    hand: Hand | str | None
    driver_lag: ArrayLike
    velocity: VelocityEstimator | None
    prediction: ArrayLike
    design: Design | None
    own_damping: ArrayLike
    mode: Mode | None
    device: DeviceLaw | None
    inertia: ArrayLike
    law: Design | None


def sampled_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords of `LoopArray` of these, in which mass and design may have their names in a `Loop`."""
    for name, other in _NAMES.items():
        if name in fields and other in fields:
            raise KeywordError(f"{other} and {name} must not both be given")
    return {_NAMES.get(name, name): value for name, value in fields.items()}


def is_linear(estimator: object) -> bool:
    """Return True for a linear velocity estimator, which has a state space model `linear(period)`."""
    return hasattr(estimator, "linear")


def pd(velocity: VelocityEstimator | None = None, prediction: ArrayLike = 0.0) -> Design:
    """Return the PD wall of eq. (3) as a design.

    Args:
        velocity: Linear velocity estimator; the finite difference by default.
        prediction: Prediction time of the position along that velocity [s]: half a period for `HalfSampleWall`.

    Raises:
        ParameterError: If the estimator is not linear.
    """
    estimator: Any = velocity or FiniteDifference()
    if not is_linear(estimator):
        names = ", ".join(kind.__name__ for kind in public(control, Estimator) if is_linear(kind))
        names += ", or your own with linear(period)"
        raise ParameterError(f"velocity must be a linear estimator: {names} (got {estimator!r})")
    ahead = numbers("prediction", prediction, at_least=0.0)

    def design(stiffness: Array, damping: Array, period: Array) -> LinearController:
        speed = estimator.linear(period)
        gain = damping + stiffness * ahead
        give = -gain[..., None] * speed.give
        return LinearController(speed.advance, speed.take, give, -stiffness - gain * speed.direct)

    return design


class PdLaw(NamedTuple):
    """PD wall with any linear estimator, as a `Design` that can be printed and pickled; see `pd`."""

    velocity: VelocityEstimator

    def __call__(self, stiffness: Array, damping: Array, period: Array) -> LinearController:
        """Return the law with other gains."""
        return pd(self.velocity)(stiffness, damping, period)

    def as_json(self) -> dict[str, str]:
        """Return the estimator in words."""
        return {"velocity": repr(self.velocity)}


def rendered_stiffness(controller: LinearController, z: ArrayLike = 1.0) -> Array:
    """Return minus force over position of a linear wall [N/m], (...,): static, or complex at z on the unit circle."""
    still = np.asarray(z)[..., None, None] * np.eye(controller.advance.shape[-1]) - controller.advance
    memory = np.linalg.solve(still, controller.take[..., None])  # of the memory: most have one for all gains
    return np.asarray(-(np.matmul(controller.give[..., None, :], memory)[..., 0, 0] + controller.direct))


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class LoopArray:
    """Closed loop of a wall without its gains.

    Values are numbers, or arrays that broadcast with the gains.

    Args:
        period: Sample period T [s]; or `rate`, its reciprocal [Hz].
        delay: Time from a sample to the effect of its command [s], up to 1 s.
        mass: Mass of the flotor with its handle [kg].
        hand: Hand on the flotor, or a text for `get_hand`; None for a free flotor.
        driver_lag: Time constant of the current drivers [s]; 0 for none, of all loops.
        velocity: Linear velocity estimator of the PD wall; None for the finite difference.
        prediction: Prediction time of the PD wall's position along the velocity [s].
        design: Linear controller in place of the PD wall.
        own_damping: Viscous damping b of the device itself, a force -b v on its mean motion [N s/m].
        mode: Flexible mode; None for a rigid flotor.
        device: Law on the device, beside that of the host, to which gains, period, delay and velocity belong; None for
            none. Its matrix is that of a hyperperiod, `rates_of(...).host` host periods long.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    period: ArrayLike = 1.0 / Spec.control_rate.value
    delay: ArrayLike = Spec.transport_delay.value
    mass: ArrayLike = Spec.moving_mass.value
    hand: Hand | Any | None = None
    driver_lag: ArrayLike = 0.0
    velocity: VelocityEstimator | None = None
    prediction: ArrayLike = 0.0
    design: Design | None = None
    own_damping: ArrayLike = 0.0
    mode: Mode | None = None
    device: DeviceLaw | None = None
    rate: ArrayLike = rate_of("period")
    shape: tuple[int, ...] = field(init=False)
    """Broadcast shape of period, delay, mass, prediction, own damping, driver lag, hand and mode."""

    def __post_init__(self) -> None:
        period = numbers("period", self.period, **SAMPLE_PERIOD)
        store(self, period=period, delay=loop_delay(self.delay, period), hand=get_hand(self.hand))
        store(self, mass=numbers("mass", self.mass, above=0.0))
        store(self, prediction=numbers("prediction", self.prediction, at_least=0.0))
        store(self, own_damping=numbers("own_damping", self.own_damping, at_least=0.0))
        store(self, driver_lag=numbers("driver_lag", self.driver_lag, at_least=0.0, **LAG))
        if len(np.unique(np.asarray(self.driver_lag) > 0.0)) > 1:
            raise ParameterError("driver_lag must be 0 in all loops, or above 0 in all: it adds a state")
        shapes = [np.shape(getattr(self, name)) for name in _BATCHED]
        shapes += [part.shape for part in (self.hand, self.mode) if part is not None]
        store(self, shape=common_shape(f"{', '.join(_BATCHED)}, hand, mode", *shapes))

    def matrix(self, stiffness: ArrayLike, damping: ArrayLike) -> Array:
        """Return the closed-loop matrix (..., n, n).

        Its state is that of `motion`, then the delayed commands, newest first, then the controller's state; beside a
        device law that of `TwoRates`.

        Raises:
            ParameterError: If the delay is above 1000 periods.
        """
        if self.periods.max(initial=0.0) > _MOST_PERIODS:
            most = _MOST_PERIODS * float(np.min(self.period))
            raise ParameterError(
                f"delay must be at most {most:g} s, {_MOST_PERIODS} periods, for the matrix of the closed loop "
                f"(got {float(np.max(self.delay)):g})"
            )
        k, b = np.asarray(stiffness, dtype=np.float64), np.asarray(damping, dtype=np.float64)
        if self.device is not None:
            return self._hyperperiod(k, b)[..., :-1, :-1]
        law = self.law(k, b)
        phi, old, new, whole, waiting = self.flotor
        system = law.advance, law.take[..., None], law.give[..., None, :], law.direct[..., None, None]
        return loop_matrix(phi, old[..., None], new[..., None], whole, waiting, *system)

    def _hyperperiod(self, stiffness: Array, damping: Array) -> Array:
        """Return the matrix with a device law, (..., n + 1, n + 1); delays differ in the number of states, so pad."""
        shape = np.broadcast_shapes(stiffness.shape, damping.shape, self.shape)
        k, b = (np.broadcast_to(gain, shape).reshape(-1) for gain in (stiffness, damping))
        parts = [(rows, loop.two_rates().matrix(loop.law(k[rows], b[rows]))) for rows, loop in self.uniform(shape)]
        size = max(part.shape[-1] for _, part in parts)
        result = np.zeros((k.size, size, size))
        for rows, part in parts:
            own = np.r_[: part.shape[-1] - 1, size - 1]
            result[np.arange(k.size)[rows][:, None, None], own[:, None], own] = part
        return result.reshape(*shape, size, size)

    def uniform(self, shape: tuple[int, ...]) -> Iterator[tuple[Any, LoopArray]]:
        """Yield parts of equal period and delay, with their indices into the flattened gains of a shape."""
        times = [np.asarray(getattr(self, name)) for name in ("period", "delay")]
        if not any(part.ndim for part in times):
            yield slice(None), self.part(shape, slice(None))
            return
        pairs, index = np.unique(
            np.array([np.broadcast_to(part, shape).ravel() for part in times]), axis=1, return_inverse=True
        )
        for place, (period, delay) in enumerate(pairs.T.tolist()):
            rows = np.flatnonzero(index.reshape(-1) == place)
            yield rows, replace(self.part(shape, rows), period=period, delay=delay)

    def two_rates(self, phase: float = 0.0) -> TwoRates:
        """Return the maps of a hyperperiod beside a device law; period and delay must be numbers."""
        assert self.device is not None
        period, zero = float(np.asarray(self.period)), np.zeros(())
        rates, states = rates_of(period, self.device), self.law(zero, zero).advance.shape[-1]
        gains = map(np.asarray, (self.device.stiffness, self.device.damping, rates.period))
        device = self.device, pd(self.device.velocity)(*gains)
        return TwoRates(self.motion(), states, *device, period, float(np.asarray(self.delay)), rates, phase)

    @property
    def affine(self) -> bool:
        """True if the characteristic polynomial is linear in the gains: without a device law, or at a multiple rate."""
        if self.device is None:
            return True
        rates = [rates_of(period, self.device) for period in np.unique(self.period).tolist()]
        return all(one.host == len(one.phases) == 1 for one in rates)

    @property
    def periods(self) -> Array:
        """Whole periods of delay, (...,)."""
        return np.asarray(split_delay(np.asarray(self.delay), np.asarray(self.period))[0])

    @property
    def long(self) -> bool:
        """True if the delay of a loop is above 30 periods, where the poles are not computed by a matrix."""
        return bool((self.periods > LONG).any()) and self.affine

    @property
    def narrowed(self) -> float:
        """Share of the dampings up to 8 m/T that is searched: at a long delay stable ones are below about m/delay."""
        return min(1.0, 10.0 / float(self.periods.max())) if self.long else 1.0

    def batched(self) -> list[Array]:
        """Return the values that may be arrays."""
        values = [np.asarray(getattr(self, name)) for name in _BATCHED]
        for part in (self.hand, self.mode):
            values += [] if part is None else [np.asarray(value) for value in part.values]
        return values

    def cut_at_delay(self, stiffness: Array, damping: Array) -> tuple[Cut, Array, Mask]:
        """Return the cut loops of gains (P,) at the fraction of the own delay, whole periods (P,), and `cuts`' mask."""
        shape, period = stiffness.shape, np.asarray(self.period)
        whole, rest = split_delay(np.asarray(self.delay), period)
        index = np.arange(stiffness.size)
        cut_of, free = self.cuts(stiffness, damping)
        shares = np.broadcast_to(np.asarray(rest) / period, shape).reshape(-1)
        return cut_of(index, shares), np.broadcast_to(np.asarray(whole), shape).reshape(-1), free

    def stable(self, stiffness: ArrayLike, damping: ArrayLike, limit: float = 1.0) -> Mask:
        """Return True where the spectral radius is below a limit, broadcast over gains and loop."""
        if not (self.affine and self.periods.max(initial=0.0) > MAX_DELAY_PERIODS):
            return is_stable(self.spectral_radius(stiffness, damping), limit)
        k, b = self.broadcast(stiffness, damping)
        result = np.empty(k.size, dtype=bool)
        flat = (gain.reshape(-1) for gain in (k, b))
        stiff, damp = flat
        for start in range(0, k.size, LOOPS):
            part = slice(start, start + LOOPS)
            cut, whole, _ = self.part(k.shape, part).cut_at_delay(stiff[part], damp[part])
            none = np.zeros(len(whole), dtype=bool)
            cut = cut.outside(np.full(len(whole), limit * (1.0 - ROUNDING)), whole)
            result[part] = AnyDelay(cut, none).unstable(whole) == 0
        return result.reshape(k.shape)

    def poles(self, stiffness: ArrayLike, damping: ArrayLike, free: ArrayLike | None = None) -> NDArray[np.complex128]:
        """Return the poles, (..., n).

        Above 30 periods of delay these are the dominant pair and the poles of free motion, at 1, 0 for those there are
        not, (..., 4). Their number is that of declared gains by default.
        """
        if not self.long:
            return np.asarray(np.linalg.eigvals(self.matrix(stiffness, damping)).astype(np.complex128))
        k, b = self.broadcast(stiffness, damping)
        own = np.broadcast_to(self.free_poles(k, b) if free is None else free, k.shape).reshape(-1)
        cut, whole, _ = self.cut_at_delay(k, b)
        poles = dominant_poles(cut, whole, own)
        return np.stack([poles, poles.conj(), 1.0 * (own > 0), 1.0 * (own > 1)], axis=-1).reshape(*k.shape, 4)

    def free_poles(self, stiffness: Array, damping: Array) -> NDArray[np.int64]:
        """Return the number of poles at 1 of free motion: without stiffness one, without damping two."""
        beside, held = self.device or DeviceLaw(), self.hand is not None
        moves = (stiffness + beside.stiffness <= 0.0) & ~np.asarray(held)
        still = (damping + beside.damping <= 0.0) & (np.asarray(self.own_damping) <= 0.0)
        return np.where(moves, 1 + still, 0)

    def pole(self, stiffness: float, damping: float) -> tuple[float, float]:
        """Return spectral radius and frequency [Hz] of a single loop; see `frequency`."""
        return float(self.spectral_radius(stiffness, damping)), float(self.frequency(stiffness, damping))

    def frequency(self, stiffness: ArrayLike, damping: ArrayLike) -> Array:
        """Return the frequency of the dominant pole [Hz], broadcast over gains and loop.

        Beside a device law it is the mean over the hyperperiod, from event to event.
        """
        k, b = self.broadcast(stiffness, damping)
        if self.device is not None and not self.long:
            parts = [self.part(k.shape, index) for index in range(k.size)]
            gains = zip(parts, k.reshape(-1).tolist(), b.reshape(-1).tolist())
            return np.array([one._frequency_of_events(*pair) for one, *pair in gains]).reshape(k.shape)
        if self.long:
            dominant = self.poles(k, b)[..., 0]
        else:
            poles = np.linalg.eig(self.matrix(k, b)).eigenvalues
            dominant = np.take_along_axis(poles, np.abs(poles).argmax(axis=-1)[..., None], axis=-1)[..., 0]
        return np.asarray(np.abs(np.angle(dominant)) / (2.0 * np.pi * np.asarray(self.period)))

    def _frequency_of_events(self, stiffness: float, damping: float) -> float:
        """Return the frequency of a single loop beside a device law [Hz]."""
        poles, vectors = np.linalg.eig(self.matrix(stiffness, damping))
        worst = np.argmax(np.abs(poles))
        times, positions = self.response(stiffness, damping, np.append(vectors[:, worst], 0.0))
        turns = np.unwrap(np.angle(positions[np.diff(times, prepend=-1.0) > 0.0]))
        return abs(float(turns[-1] - turns[0])) / (2.0 * np.pi * float(times[-1]))

    def response(
        self, stiffness: float, damping: float, state: Array | None = None, span: float = 0.0
    ) -> tuple[Array, Array]:
        """Return times [s] and positions from a state, (N,) each, over at least a span and a (hyper)period.

        Args:
            stiffness: Stiffness of a single loop.
            damping: Its damping.
            state: State, of `matrix` or `two_rates`; None for a displacement by 1 at which the controllers rest.
            span: Duration [s].
        """
        law, period = self.law(np.asarray(stiffness), np.asarray(damping)), float(np.asarray(self.period))
        if self.long and state is None:
            return self._delayed_response(np.asarray(stiffness), np.asarray(damping), span)
        if self.device is None:
            steps, durations = [self.matrix(stiffness, damping)], np.array([period])
            memories = [(len(steps[0]) - law.advance.shape[-1], law)]
        else:
            both = self.two_rates()
            steps, durations, memories = both.steps(law), both.durations, both.memories(law)
        if state is None:
            state = np.zeros(len(steps[0]))
            state[0] = 1.0
            for first, one in memories:
                last = first + len(one.advance)
                state[first:last] = np.linalg.solve(np.eye(len(one.advance)) - one.advance, one.take)
        times, positions = [0.0], [state[0]]
        while times[-1] < span or len(times) <= len(steps):
            for step, duration in zip(steps, durations.tolist()):
                state = step @ state
                times.append(times[-1] + duration)
                positions.append(state[0])
        return np.array(times), np.array(positions)

    def _delayed_response(self, stiffness: Array, damping: Array, span: float) -> tuple[Array, Array]:
        """Return the response to a displacement, sample by sample; see `response`."""
        cut, (whole,), _ = self.cut_at_delay(stiffness, damping)
        (advance,), (take,), (give,), period = *cut, float(np.asarray(self.period))
        late, law = int(whole), self.law(stiffness, damping)
        states, count = len(law.take), max(math.ceil(span / period), 1) + 1
        state, positions, commands = np.zeros(len(take)), np.zeros(count), np.zeros(count)
        state[0] = 1.0
        state[len(take) - states :] = np.linalg.solve(np.eye(states) - law.advance, law.take)
        for index in range(count):
            positions[index], commands[index] = state[0], -give @ state
            state = advance @ state + take * (commands[index - late] if index >= late else 0.0)
        return period * np.arange(float(count)), positions

    def compliances(self, stiffness: ArrayLike, damping: ArrayLike, frequencies: Sequence[float]) -> Iterator[Array]:
        """Yield the compliance, sampled position over hand force, at each frequency [m/N], complex (...,).

        The hand's force is constant from sample to sample.

        Args:
            stiffness: Wall stiffness [N/m], (...,).
            damping: Wall damping [N s/m], (...,).
            frequencies: Frequencies [Hz], below half the sample rate; the period must be a number.

        Raises:
            ParameterError: If the rate of a device law is no multiple of the host's.
        """
        forced = self.forced(stiffness, damping)
        for frequency in frequencies:
            angle = 2.0 * np.pi * number("frequency", frequency) * float(np.asarray(self.period))
            yield forced.compliance(np.array([angle]))[..., 0]

    def forced(self, stiffness: ArrayLike, damping: ArrayLike) -> Forced:
        """Return the loop under a force of the hand that is constant from sample to sample; see `compliances`."""
        if not self.affine:
            assert self.device is not None
            raise ParameterError(_DIVIDES.format(self.period, self.device))
        return self.driven(stiffness, damping)

    def driven(self, stiffness: ArrayLike, damping: ArrayLike) -> Forced:
        """Return the loop under a force of the hand that is constant over a (hyper)period."""
        k, b = (np.asarray(gain, dtype=np.float64) for gain in (stiffness, damping))
        if self.device is not None:
            whole = self._hyperperiod(k, b)
            matrix, inputs = whole[..., :-1, :-1], whole[..., :-1, -1]
        else:
            matrix = self.matrix(k, b)
            _, push = transition(*self.motion(), self.period)
            inputs = np.zeros((*push.shape[:-2], matrix.shape[-1]))
            inputs[..., : push.shape[-2]] = push[..., 1]
        return Forced(matrix, np.broadcast_to(inputs, matrix.shape[:-1]))

    def law(self, stiffness: Array, damping: Array) -> LinearController:
        """Return the linear controller of gains (...,)."""
        return (self.design or pd(self.velocity, self.prediction))(stiffness, damping, np.asarray(self.period))

    def motion(self) -> tuple[Array, Array]:
        """Return the flotor's continuous-time state space model; see `plants.hand.motion`."""
        return motion(self.mass, self.hand, self.driver_lag, self.own_damping, self.mode)

    @cached_property  # a diagnosis asks a loop several times
    def flotor(self) -> tuple[Array, Array, Array, Array, int]:
        """Flotor's state transition over a period, and its inputs.

        Transition (..., n, n), input vectors of the commands before and after the switch (..., n) each, whole periods
        in the delay (...,), and the largest number of delayed commands.
        """
        period, delay = np.asarray(self.period), np.asarray(self.delay)
        whole, remainder = map(np.asarray, split_delay(delay, period))
        a, b = self.motion()
        before, old = transition(a, b[..., :1], remainder)
        after, new = transition(a, b[..., :1], period - remainder)
        waiting = int((whole + (remainder > 0.0)).max())
        return after @ before, (after @ old)[..., 0], new[..., 0], whole, waiting

    def cut(self, stiffness: Array, damping: Array, fractions: Array) -> Cut:
        """Return the loop of gains (P,), cut at the host's command, with fractions of a period as delay, (P,).

        The own delay does not matter. Beside a device law its rate must be a multiple of the host's.
        """
        period = np.broadcast_to(np.asarray(self.period), fractions.shape)
        law = self.law(stiffness, damping)
        count, states = len(fractions), law.advance.shape[-1]
        if self.device is None:
            a, b = self.motion()
            before, old = transition(a, b[..., :1], fractions * period)
            after, new = transition(a, b[..., :1], (1.0 - fractions) * period)
            size = before.shape[-1]
            beside, command = np.zeros((count, size + 1, size + 1)), np.ones((count, size + 1))
            beside[:, :size, :size], beside[:, :size, size:] = after @ before, after @ old
            command[:, :size] = new[..., 0]
        else:
            beside, command = self._beside_device(fractions)
            size = beside.shape[-1] - 1
        advance = np.zeros((count, size + 1 + states, size + 1 + states))
        advance[:, : size + 1, : size + 1], advance[:, size + 1 :, 0] = beside, law.take
        advance[:, size + 1 :, size + 1 :] = law.advance
        give = np.zeros((count, size + 1 + states))
        give[:, 0], give[:, size + 1 :] = -law.direct, -law.give
        return Cut(advance, np.pad(command, ((0, 0), (0, states))), give)

    def cuts(self, stiffness: Array, damping: Array) -> tuple[CutOf, Mask]:
        """Return the cut loops of gains as `CutOf`, flattened, and whether each has poles of free motion."""
        shape, (k, b) = stiffness.shape, (gain.reshape(-1) for gain in (stiffness, damping))
        held = 0.0 if self.device is None else self.device.stiffness
        return lambda index, fractions: self.part(shape, index).cut(k[index], b[index], fractions), k + held <= 0.0

    def _beside_device(self, fractions: Array) -> tuple[Array, Array]:
        """Return the maps of flotor, device law and host's command in effect over a host period, and of a command."""
        maps: Array | None = None
        late = np.minimum(fractions, _ALMOST) * np.asarray(self.period)  # of a whole period there are more states
        for rows, loop in replace(self, delay=late).uniform(fractions.shape):
            both = loop.two_rates()
            (between,), own = both.between(), both.of_host
            kept = np.delete(np.arange(between.shape[-1] - 1), own[1:])
            part = np.broadcast_to(between, (len(np.arange(len(fractions))[rows]), *between.shape[-2:]))
            maps = np.zeros((len(fractions), len(kept), len(kept) + 1)) if maps is None else maps
            maps[rows] = part[:, kept[:, None], np.append(kept, own[1])]
        assert maps is not None
        return maps[..., :-1], maps[..., -1]

    def spectral_radius(self, stiffness: ArrayLike, damping: ArrayLike) -> Array:
        """Return the spectral radius, broadcast over gains and loop."""
        gains = self.broadcast(stiffness, damping)
        shape, (k, b) = gains[0].shape, (gain.reshape(-1) for gain in gains)
        result = np.empty(k.size)
        if self.long:
            far = np.broadcast_to(self.periods > LONG, shape).reshape(-1)
            for rows in filter(len, np.array_split(np.flatnonzero(far), 1 + far.size // LOOPS)):
                cut, whole, _ = self.part(shape, rows).cut_at_delay(k[rows], b[rows])
                none = np.zeros(len(rows))
                result[rows] = np.abs(dominant_poles(cut, whole, none))
            if (rows := np.flatnonzero(~far)).size:
                result[rows] = self.part(shape, rows).spectral_radius(k[rows], b[rows])
            return result.reshape(shape)
        if self.device is not None:
            for rows, loop in self.uniform(shape):
                rates, law = rates_of(float(np.asarray(loop.period)), self.device), loop.law(k[rows], b[rows])
                radii = [_largest(loop.two_rates(phase).matrix(law)[..., :-1, :-1]) for phase in rates.phases]
                result[rows] = np.max(radii, axis=0) ** (1.0 / rates.host)
            return result.reshape(shape)
        for start in range(0, k.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            result[part] = _largest(self.part(shape, part).matrix(k[part], b[part]))
        return result.reshape(shape)

    def broadcast(self, stiffness: ArrayLike, damping: ArrayLike) -> tuple[Array, Array]:
        """Return checked stiffness and damping, broadcast with the loop."""
        k, b = numbers("stiffness", stiffness, at_least=0.0), numbers("damping", damping, at_least=0.0)
        shape = common_shape("stiffness, damping and loop", k.shape, b.shape, self.shape)
        return np.broadcast_to(k, shape), np.broadcast_to(b, shape)

    def _each(self, change: Callable[[Array], Array]) -> LoopArray:
        """Return the loop with each array changed by a function."""
        hand, mode = self.hand, self.mode
        if hand is not None:
            hand = hand_of([*map(change, hand.values[: 5 if hand.soft else 3])])
        if mode is not None:
            mode = Mode(*map(change, mode.values))
        copy = object.__new__(type(self))  # not `replace`: the values are checked
        values: Any = {name: change(np.asarray(getattr(self, name))) for name in _BATCHED}
        shapes = [np.shape(value) for value in values.values()] + [part.shape for part in (hand, mode) if part]
        own = {name: value for name, value in vars(self).items() if name != "flotor"}  # that of the arrays before
        vars(copy).update(own, hand=hand, mode=mode, shape=np.broadcast_shapes(*shapes), **values)
        return copy

    def part(self, shape: tuple[int, ...], part: Any) -> LoopArray:
        """Return the loop for a slice or indices of the flattened gains."""
        if not self.shape:
            return self
        return self._each(lambda value: np.broadcast_to(value, shape).reshape(-1)[part] if value.ndim else value)

    def widened(self) -> LoopArray:
        """Return the loop with a trailing dimension of 1 added to each array, for a search along it."""
        return self._each(lambda value: value[..., None] if value.ndim else value) if self.shape else self

    @property
    def moving_mass(self) -> Array:
        """Mass of flotor and hand together [kg]."""
        hand_mass = 0.0 if self.hand is None else self.hand.mass
        return np.asarray(np.asarray(self.mass) + hand_mass)


class Forced(NamedTuple):
    """Closed loop with an input: matrix (..., n, n), and effect of a unit force of the hand in a period (..., n)."""

    matrix: Array
    inputs: Array

    @property
    def poles(self) -> Array:
        """Poles, (..., n)."""
        return np.asarray(np.linalg.eigvals(self.matrix))

    def compliance(self, angles: Array) -> Array:
        """Return the sampled position over the force at angles (..., M) per sample [m/N], complex (..., M)."""
        turn = np.exp(1j * np.asarray(angles))[..., None, None]
        system = turn * np.eye(self.matrix.shape[-1]) - self.matrix[..., None, :, :]
        return np.asarray(np.linalg.solve(system, self.inputs[..., None, :, None])[..., 0, 0])

    def magnitude(self, angles: Array) -> Array:
        """Return the magnitude of the compliance [m/N], (..., M)."""
        return np.abs(self.compliance(angles))


def _largest(matrices: Array) -> Array:
    return np.asarray(np.abs(np.linalg.eigvals(matrices)).max(axis=-1))


def loop_matrix(
    phi: Array,
    old: Array,
    new: Array,
    whole: Array,
    waiting: int,
    advance: Array,
    take: Array,
    give: Array,
    direct: Array,
) -> Array:
    """Return the closed loop of a flotor with n positions and a linear controller, (..., S, S).

    State: the flotor's, positions first; the delayed commands, newest first, n of each; the controller's.

    Args:
        phi: Flotor's state transition over a period, (..., f, f).
        old: Input matrix of the commands before the switch, (..., f, n).
        new: Input matrix of those after it, (..., f, n).
        whole: Whole periods in the delay, (...,).
        waiting: Largest number of delayed commands.
        advance: Controller's transition, (..., s, s).
        take: Its input matrix, (..., s, n).
        give: Its output matrix, (..., n, s).
        direct: Its feedthrough, (..., n, n).
    """
    first, n = old.shape[-2:]
    delayed = slice(first, first + n * waiting)
    states = slice(delayed.stop, delayed.stop + advance.shape[-1])
    shape = np.broadcast_shapes(*(part.shape[:-2] for part in (phi, old, new, advance, give, direct)), whole.shape)
    m = np.zeros((*shape, states.stop, states.stop))
    command = np.zeros((*shape, n, states.stop))
    command[..., :n], command[..., states] = direct, give
    m[..., :first, :first] = phi
    for age in range(waiting + 1):  # the command `age` samples old
        now, before = ((whole == age)[..., None, None], (whole + 1 == age)[..., None, None])
        share = np.where(now, new, 0.0) + np.where(before, old, 0.0)
        if age:
            m[..., :first, first + n * (age - 1) : first + n * age] += share
        else:
            for axis in range(n):
                m[..., :first, :] += share[..., axis, None] * command[..., None, axis, :]
    if waiting:
        m[..., first : first + n, :] = command
        m[..., first + n : delayed.stop, first : delayed.stop - n] = np.eye(n * (waiting - 1))
    m[..., states, :n], m[..., states, states] = take, advance
    return m


_HALVED = 45, 1  # steps and points of a refinement to rounding


def bracket(grid: Array, true: Mask) -> tuple[Array, Array]:
    """Return the grid points before and at the first true one, (...,) each; infinity without one."""
    first = np.argmax(true, axis=-1)[..., None]
    ends = (np.take_along_axis(grid, np.maximum(index, 0), axis=-1)[..., 0] for index in (first - 1, first))
    low, high = (np.where(true.any(axis=-1), end, np.inf) for end in ends)
    return low, high


def bisect(holds: Callable[[Array], Mask], low: Array, high: Array, steps: int, points: int = 1) -> Array:
    """Return the least argument of a monotonic condition that is true at `high`, (...,); infinity if that is.

    Args:
        holds: Condition of arguments (...,), or (points, ...) if there are several points.
        low: Lower end, (...,).
        high: Upper end, (...,).
        steps: Number of steps; each divides the interval by points + 1.
        points: Arguments tried in a step: many cost little more than one where they are computed together.
    """
    finite = np.isfinite(high)
    low, high = np.where(finite, low, 0.0), np.where(finite, high, 0.0)
    if points == 1:
        for _ in range(steps):
            middle = 0.5 * (low + high)
            true = holds(middle)
            low, high = np.where(true, low, middle), np.where(true, middle, high)
        return np.where(finite, high, np.inf)
    shares = np.arange(points + 2).reshape(-1, *[1] * low.ndim) / (points + 1)
    for _ in range(steps):
        grid = low + (high - low) * shares
        first = np.argmax(np.concatenate([holds(grid[1:-1]), np.ones((1, *low.shape), dtype=bool)]), axis=0)[None]
        low, high = (np.take_along_axis(grid, first + side, axis=0)[0] for side in (0, 1))
    return np.where(finite, high, np.inf)


def is_stable(spectral_radius: ArrayLike, limit: ArrayLike = 1.0) -> Mask:
    """Return True for a spectral radius below the limit by more than rounding."""
    return np.asarray(spectral_radius) < np.asarray(limit) * (1.0 - ROUNDING)


@checked
def spectral_radius(stiffness: ArrayLike, damping: ArrayLike, **loop: Unpack[LoopKeywords]) -> Array:
    """Return the spectral radius of the closed loop inside the wall; stable below 1.

    Args:
        stiffness: Wall stiffness [N/m], (...,).
        damping: Wall damping [N s/m], (...,).
        loop: Keywords of `LoopArray`; they broadcast with the gains.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return LoopArray(**sampled_fields(loop)).spectral_radius(stiffness, damping)


@checked
def critical_delay(stiffness: ArrayLike, damping: ArrayLike, **loop: Unpack[LoopKeywords]) -> Array:
    """Return the critical delay: the shortest at which a wall is unstable [s].

    Args:
        stiffness: Wall stiffness [N/m], (...,).
        damping: Wall damping [N s/m], (...,).
        loop: Keywords of `LoopArray` except the delay; they broadcast with the gains.

    Returns:
        The delay (...,): 0 if the wall is unstable without delay, infinity if it is stable at any delay (the loop gain
        is below 1 at every frequency). NaN above 10 periods beside a device law at a rate that is not a multiple of the
        host's. The free motion of a wall without stiffness is no instability.

    Raises:
        ParameterError: If a value is outside its bounds, or a delay is passed.

    Example:
        >>> from maglev_mj import critical_delay
        >>> 1e3 * critical_delay([6000.0, 9000.0], 80.0, period=0.005, mass=0.7).round(4)  # [ms]
        array([3.3, 1.9])
    """
    if "delay" in loop:
        raise ParameterError(f"critical_delay accepts no delay, because it returns one (got {loop['delay']!r})")
    loop["delay"] = 0.0
    around = LoopArray(**sampled_fields(loop))
    return critical_delay_of(around, *around.broadcast(stiffness, damping))


def critical_delay_of(around: LoopArray, stiffness: Array, damping: Array, free: Mask | None = None) -> Array:
    """Return the critical delay of a LoopArray without delay [s], for gains of its shape; see `critical_delay`.

    `free` is True where poles at 1 of free motion do not count, (N,); by default without stiffness.
    """
    if not around.affine:
        return _stepped_delay(around, stiffness, damping)
    cut_of, moves = around.cuts(stiffness, damping)
    free = moves if free is None else free
    result = np.zeros(free.size)
    for rows in filter(len, np.array_split(np.arange(free.size), 1 + free.size // LOOPS)):
        chosen = rows

        def part(index: NDArray[Any], shares: Array, chosen: NDArray[Any] = chosen) -> Cut:
            return cut_of(chosen[index], shares)

        result[rows] = first_delays(part, free.reshape(-1)[rows])
    return np.asarray(result.reshape(stiffness.shape) * np.asarray(around.period))


def _stepped_delay(around: LoopArray, stiffness: Array, damping: Array) -> Array:
    """Return the critical delay by a grid of up to ten periods and bisection; NaN above."""
    k, b = stiffness[..., None], damping[..., None]
    shape = k.shape[:-1]
    limit = np.where(k > 0.0, 1.0, 1.0 + 1e-6)  # free motion is a root at 1
    wide = around.widened()
    period = np.broadcast_to(np.asarray(wide.period), (*shape, 1))
    low, high = np.full((2, *shape), np.inf)
    for whole in range(MAX_DELAY_PERIODS):
        grid = period * np.linspace(whole, whole + 1, 41)
        unstable = ~is_stable(replace(wide, delay=grid).spectral_radius(k, b), limit)
        low, high = np.where(np.isinf(high), bracket(grid, unstable), (low, high))
        if np.isfinite(high).all():
            break

    def unstable_at(delay: Array) -> Mask:
        return ~is_stable(replace(wide, delay=delay[..., None]).spectral_radius(k, b), limit)[..., 0]

    found = bisect(unstable_at, low, high, *_HALVED)
    return np.where(np.isfinite(found), found, np.nan)


@checked
def least_dynamic_stiffness(
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    frequencies: Sequence[float] | None = None,
    **loop: Unpack[LoopKeywords],
) -> Array:
    """Return the least dynamic stiffness: hand force over displacement, least over frequencies [N/m].

    It combines stiffness and stability margin: a wall near its stability boundary is compliant at its resonance. 0 for
    an unstable wall.

    Args:
        stiffness: Wall stiffness [N/m], (...,).
        damping: Wall damping [N s/m], (...,).
        frequencies: Frequencies [Hz]; None for all up to half the sample rate, see `theory.frequencies`.
        loop: Keywords of `LoopArray`; the period must be a number.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    around = LoopArray(**sampled_fields(loop))
    if np.ndim(around.period):
        raise ParameterError(f"period must be a number (got shape {np.shape(around.period)})")
    stable = is_stable(around.spectral_radius(stiffness, damping))
    half = 0.5 / float(np.asarray(around.period))
    if frequencies is not None and not len(frequencies):
        raise ParameterError("frequencies must not be empty")
    chosen = [number("frequency", frequency, at_least=0.0, below=half) for frequency in frequencies or ()]
    result = np.zeros(stable.size)
    where = np.flatnonzero(stable)  # an unstable wall has no steady state
    gains = [np.broadcast_to(gain, stable.shape).reshape(-1) for gain in (stiffness, damping)]
    for start in range(0, where.size, _TOGETHER):
        rows = where[start : start + _TOGETHER]
        forced = around.part(stable.shape, rows).forced(*(gain[rows] for gain in gains))
        if frequencies is None:
            _, compliance = peak(forced.magnitude, angles_of(forced.poles))
        else:
            compliance = np.abs(forced.compliance(np.pi / half * np.array(chosen))).max(axis=-1)
        result[rows] = 1.0 / compliance
    return result.reshape(stable.shape)

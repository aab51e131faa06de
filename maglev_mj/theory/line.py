"""Delay that varies from sample to sample, and lost samples: worst case and mean square of one loop.

The state at a sample is that of flotor and controller, the commands on their way, and the command in effect. The map to
the next sample depends on when the next command takes effect, or that it is lost; see `Maps`. Source: derived for this
project.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import groupby, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control.timeline import split_delay
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import interval, number, numbers, store, whole
from maglev_mj.plants.hand import transition
from maglev_mj.result import plain
from maglev_mj.spec import MAX_DELAY, MAX_DELAY_PERIODS
from maglev_mj.theory.delay import ROUNDING
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import is_stable

MOST_IN_A_ROW = 64
"""Lost samples in a row up to which their limit is searched."""

_ROUNDS, _TURN, _SLOWER, _SHARPER = 400, 1.0, 15.0, 20.0
"""Descent to the least norm: steps, first size, steps until half of it, first sharpness of the maximum."""
_ACTIVE, _ROUNDS_OF_ALL, _ENOUGH = 24, 4, 1.0 - 1e-3
"""Maps that a descent begins with and adds, the worst of all, in so many rounds; norm that is enough of a quick one."""
_BALANCED, _POWERS, _LEAST_FORM = 3, 30, 1e-7
"""Rounds of balancing the states; start of the descent: powers of the map of forms, share of its least eigenvalue."""
_LENGTH, _WIDTH = 8, 1500
"""Blocks in a searched sequence, and products of each length."""
_DEPTH, _PRODUCTS = 60, 60_000
"""Length of products in a proof, and their number: 60 000 of order 4 take 0.3 s."""
_REMAINDER = 72.0 * math.sqrt(3.0)
"""Divisor of the error of a quadratic through both ends and the middle of h: h³ max |f'''| over it."""
_PART, _MOST_PARTS, _TERMS = 2.0, 32, 60
"""Width of a part of a range of delays times the flotor's fastest rate, most parts, and terms of a Taylor series."""
_UNIFORM = 24
"""Gauss points of a uniform delay: three are exact for a free mass."""
_MOST_STATES = 32
"""Largest order of a map: its mean square has 528 rows, whose eigenvalues take 0.2 s."""
_REAL = 1e-7
"""Relative imaginary part of a real root."""


@checked
@dataclass(frozen=True, kw_only=True)
class LossyLine:
    """Line between a sample and the effect of its command, whose delay may vary, and which may lose commands.

    Args:
        jitter: Least and largest delay [s], at each sample any in between; None for the constant delay of a loop.
        loss: Probability that a command is lost, independent of others; its predecessor stays in effect.
        lost_in_a_row: Largest number of lost commands in a row in the worst case; None if it is not limited.
        measured: Measured delays within the jitter [s], (N,), for the mean square; None for uniform ones.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    jitter: Sequence[float] | None = None
    loss: float = 0.0
    lost_in_a_row: int | None = None
    measured: Array | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.jitter is not None:
            store(self, jitter=interval("jitter", self.jitter, at_least=0.0, at_most=MAX_DELAY))
        number("loss", self.loss, at_least=0.0, below=1.0)
        if self.lost_in_a_row is not None:
            whole("lost_in_a_row", self.lost_in_a_row, at_most=MOST_IN_A_ROW)

    @classmethod
    def of_delays(cls, delays: ArrayLike, period: float, loss: float = 0.0) -> LossyLine:
        """Return the line of measured delays; one more than a period above the least counts as lost, as newer ones act.

        Args:
            delays: Delays of commands that took effect [s], (N,).
            period: Sample period [s].
            loss: Share of samples without such a delay.

        Raises:
            ParameterError: If there is no delay.
        """
        every = np.sort(numbers("delays", delays, shape="(N,)", at_least=0.0))
        if not every.size:
            raise ParameterError("delays must not be empty")
        kept = every[every <= every[0] + period]
        lost = 1.0 - (1.0 - loss) * len(kept) / len(every)
        return cls(jitter=(float(kept[0]), float(kept[-1])), loss=lost, measured=kept)


class Event(NamedTuple):
    """What happens in a period: the late command takes effect `late` [s] after the sample, the next one `delay` [s].

    `delay` is infinite if that is in the next period, NaN if the command is lost.
    """

    late: float
    delay: float


_LOST = Event(0.0, math.nan)
"""Loss after which no command is late."""


class Maps:
    """Maps from sample to sample of a loop whose delay varies by at most a period.

    State: the flotor's, the controller's, commands on their way, newest first, the last received command, if it may
    take effect in the second period, and the command in effect. With G(t) the effect of a unit force in the last t of a
    period, a command that replaces another one at d adds G(T - d) times their difference: maps are affine in G.

    Args:
        loop: The loop.
        low: Least delay [s].
        high: Largest delay [s], at most a period more.
    """

    def __init__(self, loop: Loop, low: float, high: float) -> None:
        loop = loop.in_question if loop.linear is not None else loop  # on one axis
        array, zero = loop.array(), np.asarray
        self.period = loop.period
        self.whole = int(split_delay(low, loop.period)[0])
        self.first = max(low - self.whole * loop.period, 0.0)
        last = max(high - self.whole * loop.period, self.first)
        self.crosses = last > loop.period * (1.0 + ROUNDING)
        self.last, self.latest = min(last, loop.period), last - loop.period if self.crosses else 0.0
        a, b = array.motion()
        self.slope, self._push = a, b[..., :1]
        law = array.law(zero(loop.stiffness), zero(loop.damping))
        order, states = len(a), len(law.advance)
        size = order + states + self.whole + self.crosses + 1
        rows = np.eye(size)
        self._flotor, memory, queue = slice(order), slice(order, order + states), order + states
        command = np.zeros(size)
        command[0], command[memory] = law.direct, law.give
        held, new = rows[-1], rows[queue + self.whole - 1] if self.whole else command
        current = rows[-2] if self.crosses else held
        base = np.zeros((size, size))
        phi, _ = transition(a, self._push, loop.period)
        base[:order, :order] = phi
        base[:order] += np.outer(self.effects([loop.period])[0], held)
        base[memory, 0], base[memory, memory] = law.take, law.advance
        if self.whole:
            base[queue] = command
            base[queue + 1 : queue + self.whole] = rows[queue : queue + self.whole - 1]
        self._rows = (current - held, new - current)
        self._received, self._pending, self._lost = (base.copy() for _ in range(3))
        for one, effect, received in (
            (self._received, new, new),
            (self._pending, current, new),
            (self._lost, current, current),
        ):
            if self.crosses:
                one[-2] = received
            one[-1] = effect
        self.order = size

    def effects(self, remaining: ArrayLike) -> Array:
        """Return the effect G of a unit force for durations up to the next sample [s], (K,), on the flotor, (K, f)."""
        return np.asarray(transition(self.slope, self._push, remaining)[1][..., 0])

    def received(self, late: Array, new: Array) -> Array:
        """Return the maps of effects G of the late and the next command, (K, f) and (L, f), all pairs, (K L, n, n)."""
        result = np.repeat(self._after(self._received, late), len(new), axis=0)
        result[:, self._flotor] += np.tile(new, (len(late), 1))[:, :, None] * self._rows[1]
        return result

    def pending(self, late: Array) -> Array:
        """Return the maps if the next command takes effect a period later, (K, n, n)."""
        return self._after(self._pending, late)

    def lost(self, late: Array) -> Array:
        """Return the maps if the next command is lost, (K, n, n)."""
        return self._after(self._lost, late)

    def _after(self, base: Array, late: Array) -> Array:
        result = np.repeat(base[None], len(late), axis=0)
        if self.crosses:
            result[:, self._flotor] += late[:, :, None] * self._rows[0]
        return result

    def of(self, event: Event) -> Array:
        """Return the map of a period, (n, n)."""
        late = self.effects([self.period - event.late])
        if math.isnan(event.delay):
            return np.asarray(self.lost(late)[0])
        if math.isinf(event.delay):
            return np.asarray(self.pending(late)[0])
        return np.asarray(self.received(late, self.effects([self.period - event.delay]))[0])

    def parts(self, start: float, end: float) -> int:
        """Return the number of parts into which delays from start to end are divided; one is exact for a free mass."""
        if self.exact:
            return 1
        rate = float(np.abs(np.linalg.eigvals(self.slope)).max())
        return min(max(math.ceil((end - start) * rate / _PART), 1), _MOST_PARTS)

    @property
    def exact(self) -> bool:
        """True if G is a quadratic of time, as for a free mass."""
        return not (self.slope @ self.slope @ self._push).any()

    def hull(self, start: float, end: float) -> Array:
        """Return points whose convex hull has G of all delays from start to end, but for a `remainder`, (K, f).

        On each part a quadratic lies in the triangle of its Bernstein coefficients: both ends, and twice the middle
        less their mean.
        """
        if end <= start:
            return self.effects([self.period - start])
        every = self.effects(self.period - np.linspace(start, end, 2 * self.parts(start, end) + 1))
        ends = every[::2]
        return np.concatenate([ends, 2.0 * every[1::2] - 0.5 * (ends[:-1] + ends[1:])])

    def remainder(self, start: float, end: float, coordinates: Array) -> float:
        """Return a bound of the distance of G from the hull, in some coordinates of the state, (n, n)."""
        if self.exact or end <= start:
            return 0.0
        change, parts = coordinates[:, self._flotor], self.parts(start, end)
        width = (end - start) / parts
        middles = self.period - start - width * (np.arange(parts) + 0.5)
        third = (transition(self.slope, self._push, middles)[0] @ self.slope @ self.slope @ self._push)[..., 0].T
        sizes = np.zeros(parts)  # of the Taylor series about the middle of each part
        for power in range(_TERMS):
            sizes += np.linalg.norm(change @ third, axis=0)
            third = self.slope @ third * (0.5 * width / (power + 1.0))
        rate = 0.5 * width * float(np.linalg.norm(self.slope, 2))
        tail = np.linalg.norm(change, 2) * np.linalg.norm(third, axis=0) * math.exp(rate)
        return float((sizes + tail).max()) * width**3 / _REMAINDER

    def errors(self, coordinates: Array) -> tuple[float, float]:
        """Return bounds of the norm of what the hulls of late and of next commands leave out of a map."""
        inverse = np.linalg.inv(coordinates)
        late = self.remainder(0.0, self.latest, coordinates) * float(np.linalg.norm(self._rows[0] @ inverse))
        new = self.remainder(self.first, self.last, coordinates) * float(np.linalg.norm(self._rows[1] @ inverse))
        return late, new


class WorstCase(NamedTuple):
    """Verdict on every sequence of delays and losses.

    Attributes:
        stable: True if every sequence is stable, False if one is unstable, None if not decided (between the bounds).
        growth: Largest growth per sample of a repeated sequence: a lower bound, above 1 only if unstable.
        sequence: That sequence, the delay of each command [s]; None for a lost one.
        norm: Least common norm of the maps, an upper bound; NaN if not computed.
        products: Number of products of maps that prove stability where the norm does not; 0 if not needed.
        length: Factors in the longest of these.
    """

    stable: bool | None
    growth: float
    sequence: tuple[float | None, ...]
    norm: float = math.nan
    products: int = 0
    length: int = 0

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.stable is None:
            return f"not decided (between the bounds: growth x {self.growth:.6f} a sample seen, norm {self.norm:.2f})"
        if self.stable:
            bound = f"common norm below {math.ceil(100.0 * self.norm) / 100.0:g}"
            proof = f"all products of up to {self.length} maps decay" if self.products else bound
            return f"stable for every sequence (proved: {proof})"
        return f"destabilised by {self.cycle}, repeated: grows x {self.growth:.4f} a sample"

    @property
    def cycle(self) -> str:
        """The sequence in words."""
        parts = [
            (None if delay is None else f"{1e3 * delay:.4g}", sum(1 for _ in same))
            for delay, same in groupby(self.sequence)
        ]
        if len(parts) == 1 and parts[0][0] is not None:
            return f"a constant delay of {parts[0][0]} ms"
        words = [
            f"{count} lost" if delay is None else f"{delay} ms" + f" ({count} times)" * (count > 1)
            for delay, count in parts
        ]
        return f"delays of {', '.join(words)}"


class _Blocks(NamedTuple):
    """Maps whose products in any order bound all motions: a command that arrives, then up to N that are lost.

    Attributes:
        maps: The maps, (V, n, n).
        after: Map of the lost commands of each, (V, n, n), and of all but the first of them.
        rest: See `after`.
        first: Map of the arriving command, (V, n, n).
        number: Number of lost commands of each, (V,).
    """

    maps: Array
    after: Array
    rest: Array
    first: Array
    number: NDArray[np.int64]

    def errors(self, maps: Maps, coordinates: Array) -> Array:
        """Return bounds of the norm of what the hulls leave out of each, (V,)."""
        if maps.exact:
            return np.zeros(len(self.maps))
        inverse, (late, new) = np.linalg.inv(coordinates), maps.errors(coordinates)
        first, after, rest = (
            np.linalg.norm(coordinates @ part @ inverse, 2, axis=(1, 2)) for part in (self.first, self.after, self.rest)
        )
        beside = np.where(self.number > 0, rest * late * (first + late + new), 0.0)
        return np.asarray(after * (late + new) + beside)


def _blocks(maps: Maps, most: int) -> _Blocks:
    late, new = maps.hull(0.0, maps.latest), maps.hull(maps.first, maps.last)
    heads = [(maps.received(late, new), maps.lost(late[:1]))]
    if maps.crosses:
        heads.append((maps.pending(late), maps.lost(late)))  # the command may be late when the next one is lost
    still, one, parts = heads[0][1][0], np.eye(maps.order), []
    for number_lost in range(most + 1):
        for first, lost in heads:
            afters = one @ lost if number_lost else one[None]
            rest = np.broadcast_to(one, (len(afters) * len(first), *one.shape))
            after, before = np.repeat(afters, len(first), axis=0), np.tile(first, (len(afters), 1, 1))
            parts.append((after @ before, after, rest, before, np.full(len(after), number_lost)))
        one = still @ one if number_lost else one
    return _Blocks(*map(np.concatenate, zip(*parts, strict=True)))


def _balance(matrices: Array) -> Array:
    """Return scales of the states, powers of two, that make rows and columns of equal size, (n,)."""
    sizes = np.abs(matrices).sum(axis=0)
    np.fill_diagonal(sizes, 0.0)
    scales = np.ones(len(sizes))
    for _ in range(_BALANCED):
        for index in range(len(sizes)):
            row, column = (
                (sizes[index] * scales / scales[index]).sum(),
                (sizes[:, index] / scales).sum() * scales[index],
            )
            if row > 0.0 and column > 0.0:
                scales[index] *= math.sqrt(row / column)
    return scales


def least_norm(matrices: Array, enough: float = 0.0) -> tuple[float, Array]:
    """Return the least common norm of maps, the largest 2-norm of R M R^-1, and its coordinates R.

    A descent along exp(t S), on which the logarithm of a norm is convex, with S the weighted sum of u u' - v v' of the
    largest singular pairs: there are no local minima.

    Args:
        matrices: The maps M, (V, n, n).
        enough: Norm at which to stop.
    """
    scales = _balance(matrices)
    own = matrices * scales / scales[:, None]
    size = len(scales)
    form = np.eye(size)
    for _ in range(_POWERS):  # to the dominant eigenvector of X -> sum M' X M
        form = (np.swapaxes(own, 1, 2) @ form @ own).sum(axis=0)
        form = form / np.trace(form) + _LEAST_FORM * np.eye(size) / size
    change = np.linalg.cholesky(form).T
    inverse = np.linalg.inv(change)
    best = (math.inf, change)
    for step in range(_ROUNDS):
        left, sizes, right = np.linalg.svd(change @ own @ inverse)
        largest = sizes[:, 0]
        worst = float(largest.max())
        if worst < best[0]:
            best = (worst, change)
            if worst < enough:
                break
        weights = np.exp((_SHARPER + step) * np.log(largest / worst))
        weights /= weights.sum()
        u, v = left[:, :, 0], right[:, 0]
        slope = (u.T * weights) @ u - (v.T * weights) @ v
        values, vectors = np.linalg.eigh(slope)
        stretch = np.exp(_TURN / (1.0 + step / _SLOWER) * values)
        change, inverse = (vectors / stretch) @ vectors.T @ change, inverse @ (vectors * stretch) @ vectors.T
    return best[0], best[1] / scales


def _search(maps: Maps, most: int) -> tuple[float, tuple[float | None, ...]]:
    """Return the largest growth per sample of short repeated sequences, and the delays of that sequence [s]."""
    lates = [0.0, 0.5 * maps.latest, maps.latest] if maps.crosses else [0.0]
    delays = [*np.unique([maps.first, 0.5 * (maps.first + maps.last), maps.last]).tolist()]
    delays += [math.inf] * maps.crosses
    heads = {Event(late, delay): maps.of(Event(late, delay)) for late, delay in product(lates, delays)}
    tails = {Event(late, math.nan): maps.of(Event(late, math.nan)) for late in lates}
    events: list[tuple[Event, ...]] = [(head,) for head in heads]
    blocks, rest = [*heads.values()], np.eye(maps.order)
    for count in range(most):
        for head, last in product(heads, tails):
            if last.late and not math.isinf(head.delay):
                continue  # no command is late
            events.append((head, last, *[_LOST] * count))
            blocks.append(rest @ tails[last] @ heads[head])
        rest = tails[_LOST] @ rest
    alphabet, lengths = np.array(blocks), np.array([*map(len, events)])
    scales = _balance(alphabet)
    alphabet = alphabet * scales / scales[:, None]
    words, spans, level = np.arange(len(events))[:, None], lengths, alphabet
    growth, best = 0.0, words[0]
    for _ in range(_LENGTH):
        radii = np.abs(np.linalg.eigvals(level)).max(axis=1) ** (1.0 / spans)
        index = int(radii.argmax())
        if radii[index] > growth * (1.0 + ROUNDING):
            growth, best = float(radii[index]), words[index]
        if growth > 1.0 + ROUNDING:
            break
        kept = np.argsort(-np.linalg.norm(level, 2, axis=(1, 2)))[: max(_WIDTH // len(events), 8)]
        level = (alphabet[None] @ level[kept][:, None]).reshape(-1, maps.order, maps.order)
        words = np.concatenate(
            [np.repeat(words[kept], len(events), axis=0), np.tile(np.arange(len(events)), len(kept))[:, None]], axis=1
        )
        spans = np.repeat(spans[kept], len(events)) + np.tile(lengths, len(kept))
    cycle = [event for index in best for event in events[index]]
    return growth, tuple(_delay(maps, *pair) for pair in zip(cycle, cycle[1:] + cycle[:1], strict=True))


def _delay(maps: Maps, event: Event, following: Event) -> float | None:
    """Return the delay of the command of an event [s]; None if it is lost."""
    if math.isnan(event.delay):
        return None
    return maps.whole * maps.period + (maps.period + following.late if math.isinf(event.delay) else event.delay)


def worst_case(maps: Maps, most: int, *, quick: bool = False) -> WorstCase:
    """Return the verdict on every sequence of delays, with at most some commands lost in a row.

    Stable: by a common norm below 1, or by a tree of products that end below 1 in it. Unstable: by a sequence.

    Args:
        maps: The maps.
        most: Largest number of commands lost in a row.
        quick: True to give up sooner, and stop the descent as soon as the norm is below 1.
    """
    growth, sequence = _search(maps, most)
    if growth > 1.0 + ROUNDING:
        return WorstCase(False, growth, sequence)
    blocks = _blocks(maps, most)
    chosen = np.unique(np.linspace(0, len(blocks.maps) - 1, _ACTIVE).astype(int))
    for _ in range(_ROUNDS_OF_ALL):
        _, coordinates = least_norm(blocks.maps[chosen], _ENOUGH if quick else 0.0)
        small = coordinates @ blocks.maps @ np.linalg.inv(coordinates)
        sizes, errors = np.linalg.norm(small, 2, axis=(1, 2)), blocks.errors(maps, coordinates)
        norm = float((sizes + errors).max())
        if norm < 1.0 - ROUNDING:
            return WorstCase(True, growth, sequence, norm)
        more = np.union1d(chosen, np.argsort(-sizes)[:_ACTIVE])
        if len(more) == len(chosen):
            break
        chosen = more
    alive, beside, seen = np.eye(maps.order)[None], np.zeros(1), 0
    for length in range(1, _DEPTH + 1):
        large = np.linalg.norm(alive, 2, axis=(1, 2))
        products = (small[None] @ alive[:, None]).reshape(-1, maps.order, maps.order)
        left_out = (sizes[None] * beside[:, None] + errors[None] * (large + beside)[:, None]).reshape(-1)
        seen += len(products)
        kept = np.linalg.norm(products, 2, axis=(1, 2)) + left_out >= 1.0 - ROUNDING
        alive, beside = products[kept], left_out[kept]
        if not len(alive):
            return WorstCase(True, growth, sequence, norm, seen, length)
        if seen > (_PRODUCTS // 10 if quick else _PRODUCTS) or len(alive) * len(small) > _PRODUCTS:
            break
    return WorstCase(None, growth, sequence, norm, seen)


def _spread(effects: Array, weights: Array) -> Array:
    """Return points of equal weight with the mean and covariance of effects G (K, f): a mean square needs no more."""
    mean = weights @ effects
    values, vectors = np.linalg.eigh((effects - mean).T * weights @ (effects - mean))
    deviation = np.sqrt(len(values) * np.maximum(values, 0.0)) * vectors
    return np.asarray(np.concatenate([mean + deviation.T, mean - deviation.T]))


def _lift(matrices: Array) -> Array:
    """Return the mean of X -> M X M' on symmetric matrices X, by their upper triangles, (n (n + 1) / 2,) squared."""
    size = matrices.shape[-1]
    whole_map = np.einsum("kac,kbd->abcd", matrices, matrices, optimize=True) / len(matrices)
    row, column = np.triu_indices(size)
    upper = whole_map[row, column]
    return np.asarray(upper[:, row, column] + np.where(row == column, 0.0, upper[:, column, row]))


class MeanSquare:
    """Random delays and losses, independent from sample to sample.

    Args:
        maps: The maps.
        first: Delays in the period of the least delay [s], without whole periods, with their probabilities, (K,) each.
        second: Those in the next period, less one period, (L,) each.
    """

    def __init__(self, maps: Maps, first: tuple[Array, Array], second: tuple[Array, Array]) -> None:
        weights = first[1].sum(), second[1].sum()
        late = maps.effects([maps.period])
        if weights[1] > 0.0:
            late = _spread(maps.effects(maps.period - second[0]), second[1] / weights[1])
        self._received = np.zeros((maps.order * (maps.order + 1) // 2,) * 2)
        if weights[0] > 0.0:
            new = _spread(maps.effects(maps.period - first[0]), first[1] / weights[0])
            self._received = weights[0] / sum(weights) * _lift(maps.received(late, new))
        if weights[1] > 0.0:
            self._received = self._received + weights[1] / sum(weights) * _lift(maps.pending(late))
        self._lost = _lift(maps.lost(late))

    @classmethod
    def uniform(cls, maps: Maps) -> MeanSquare:
        """Return delays that are uniform over the range of the maps."""
        points, weights = np.polynomial.legendre.leggauss(_UNIFORM)
        middle, half = 0.5 * (maps.first + maps.last), 0.5 * (maps.last - maps.first)
        late, share = 0.5 * maps.latest, max(half, ROUNDING * maps.period)
        return cls(maps, (middle + half * points, share * weights), (late + late * points, late * weights))

    def growth(self, loss: float = 0.0) -> float:
        """Return the growth of the mean square of the state per sample, stable below 1, for a probability of loss."""
        total = (1.0 - loss) * self._received + loss * self._lost
        return float(np.abs(np.linalg.eigvals(total)).max())

    @property
    def critical_loss(self) -> float:
        """Probability of loss at which stability ends, 0 if unstable without loss; 1 if any below 1 is stable.

        The map of mean squares keeps positive forms positive, so that its spectral radius is an eigenvalue: stability
        ends where that is 1, the least positive root of det(I - A - p (B - A)) = 0.
        """
        if not is_stable(self.growth()):
            return 0.0
        rest = np.eye(len(self._lost)) - self._received
        roots = np.linalg.eigvals(np.linalg.solve(rest, self._lost - self._received))
        real = roots.real[np.abs(roots.imag) <= _REAL * np.abs(roots)]
        return min(1.0 / max(float(real.max(initial=0.0)), ROUNDING), 1.0)


class LongestLoss(NamedTuple):
    """Lost samples in a row: the most that are proved stable in any sequence, and the least that some destabilise.

    Attributes:
        stable: Number proved stable; -1 if not even the delays alone are.
        unstable: Least number that is unstable; None if none was found up to `MOST_IN_A_ROW`.
    """

    stable: int
    unstable: int | None

    @property
    def words(self) -> str:
        """Both in words."""
        proved = f"{self.stable} proved stable" if self.stable >= 0 else "none proved stable"
        if self.unstable is not None:
            return f"{proved}, {self.unstable} unstable" if self.unstable else "unstable without loss"
        return f"{proved} (searched to {MOST_IN_A_ROW})"


def longest_loss(maps: Maps) -> LongestLoss:
    """Return how many lost samples in a row are stable: sequences of more contain those of fewer."""
    stable, not_unstable = _last(lambda count: worst_case(maps, count, quick=True).stable, MOST_IN_A_ROW)
    return LongestLoss(stable, None if not_unstable == MOST_IN_A_ROW else not_unstable + 1)


def _last(verdict: Callable[[int], bool | None], most: int) -> tuple[int, int]:
    """Return the last of 0 to `most` that is stable, and the last that is not unstable, by bisection; -1 for none."""
    verdicts, ends = dict[int, bool | None](), list[int]()
    for accepted in ((True,), (True, None)):
        low, high, width = -1, most + 1, 1
        while high - low > 1:
            middle = min(low + width, (low + high) // 2)  # small ones cost less
            if middle not in verdicts:
                verdicts[middle] = verdict(middle)
            low, high = (middle, high) if verdicts[middle] in accepted else (low, middle)
            width *= 2
        ends.append(low)
    return ends[0], ends[1]


def _quick(verdicts: Sequence[LineVerdict], index: int) -> bool | None:
    chosen = verdicts[index]
    return worst_case(chosen._maps, chosen.line.lost_in_a_row or 0, quick=True).stable


@dataclass(frozen=True, eq=False)
class LineVerdict:
    """Stability of a loop over a line.

    Attributes:
        loop: The loop.
        line: The line.

    Example:
        >>> from maglev_mj.theory.line import LineVerdict, LossyLine
        >>> from maglev_mj.theory.loop import Loop
        >>> loop = Loop(stiffness=6000.0, damping=80.0, period=0.005, delay=0.0015, inertia=0.7)
        >>> found = LineVerdict(loop, LossyLine(jitter=(0.0, 0.003)))
        >>> found.worst_case.stable, round(found.mean_square, 4), round(found.critical_loss, 4)
        (True, 0.7785, 0.2106)
    """

    loop: Loop
    line: LossyLine

    @cached_property
    def reason(self) -> str:
        """Why the loop is not judged; empty if it is."""
        loop, (low, high) = self.loop, self.delays
        period, longest = loop.period, MAX_DELAY_PERIODS * loop.period
        if loop.reason:
            return loop.reason
        if loop.device is not None:
            return "a law on the device has a rate of its own"
        if len(loop.axes) > 1:
            return "its axes are coupled"
        if high - low > period * (1.0 + ROUNDING):
            return f"delays are more than a period, {1e3 * period:.4g} ms, apart"
        if high > longest * (1.0 + ROUNDING):
            return f"delays are above {MAX_DELAY_PERIODS} periods, {1e3 * longest:.4g} ms"
        return f"its law has a memory of more than {_MOST_STATES} states" if self._maps.order > _MOST_STATES else ""

    @property
    def delays(self) -> tuple[float, float]:
        """Least and largest delay [s]."""
        low, high = self.line.jitter or (self.loop.delay, self.loop.delay)
        return low, high

    @cached_property
    def _maps(self) -> Maps:
        return Maps(self.loop, *self.delays)

    @cached_property
    def _mean_square(self) -> MeanSquare:
        maps, measured = self._maps, self.line.measured
        if measured is None:
            return MeanSquare.uniform(maps)
        after = np.clip(measured - maps.whole * maps.period, maps.first, maps.last + maps.latest)
        later = after > maps.last
        return MeanSquare(maps, *((part, np.ones(len(part))) for part in (after[~later], after[later] - maps.last)))

    @cached_property
    def worst_case(self) -> WorstCase | None:
        """Verdict on every sequence; None if not judged, or with losses of which any number in a row may occur."""
        if self.reason or (self.line.loss and self.line.lost_in_a_row is None):
            return None
        return worst_case(self._maps, self.line.lost_in_a_row or 0)

    @cached_property
    def mean_square(self) -> float:
        """Growth of the mean square per sample if all draws are independent; NaN if not judged."""
        return math.nan if self.reason else self._mean_square.growth(self.line.loss)

    @cached_property
    def critical_loss(self) -> float:
        """Probability of loss up to which the mean square is stable; NaN if not judged."""
        return math.nan if self.reason else self._mean_square.critical_loss

    @cached_property
    def longest_loss(self) -> LongestLoss | None:
        """Lost samples in a row that are stable in every sequence; None if not judged."""
        return None if self.reason else longest_loss(self._maps)

    def regions(self, middles: Array, halves: Array) -> tuple[Array, Array]:
        """Return the verdicts on other, uniform delays, middle ± half [s], with the losses of the line, (H, M) each.

        A wider range contains the sequences of a narrower one, so the worst case is found by bisection.

        Args:
            middles: Middles of the ranges, (M,).
            halves: Half-widths, ascending, (H,).

        Returns:
            Worst case, without loss unless limited in a row: 1 for stable, 0 for not decided, -1 for unstable; and
            growth of the mean square. NaN for delays below 0, and where the loop is not judged.
        """
        worst, growth = np.full((2, len(halves), len(middles)), math.nan)
        for column, middle in enumerate(middles.tolist()):
            ends = [(max(middle - half, 0.0), middle + half) for half in halves.tolist() if half <= middle]
            found = [LineVerdict(self.loop, replace(self.line, jitter=one, measured=None)) for one in ends]
            judged = [one for one in found if not one.reason]
            if judged:
                growth[: len(judged), column] = [one.mean_square for one in judged]
                stable, undecided = _last(partial(_quick, judged), len(judged) - 1)
                rows = np.arange(len(judged))
                worst[: len(judged), column] = np.where(rows <= stable, 1, np.where(rows <= undecided, 0, -1))
        return worst, growth

    @property
    def setting(self) -> str:
        """Delays and losses in words."""
        low, high = (f"{1e3 * delay:.4g}" for delay in self.delays)
        words = [f"delay {low} to {high} ms" if low != high else f"delay {low} ms"]
        words += [f"{100.0 * self.line.loss:.3g} % lost"] * bool(self.line.loss)
        words += [f"at most {self.line.lost_in_a_row} lost in a row"] * (self.line.lost_in_a_row is not None)
        return ", ".join(words)

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Verdicts and limits, as names and words."""
        if self.reason:
            return (("over this line", f"not judged: {self.reason}"),)
        worst, runs = self.worst_case, self.longest_loss
        assert runs is not None
        loss = f"up to {100.0 * self.critical_loss:.4g} %" if self.critical_loss else "none"
        kind = "uniform" if self.line.measured is None else "as measured"
        growth = f"{kind}, independent: x {self.mean_square:.4f} a sample"
        mean = f"{_WORDS[self.is_stable]} in the mean square ({growth})"
        return (
            ("worst case", "not judged: state the most samples lost in a row" if worst is None else worst.words),
            ("random delay and loss", mean),
            ("stable random loss", loss),
            ("lost samples in a row", runs.words),
        )

    @property
    def warning(self) -> str:
        """What destabilises the loop over the line, in words; empty for nothing."""
        if self.reason:
            return ""
        worst = self.worst_case
        causes = [] if worst is None or worst.stable is not False else [worst.cycle]
        causes += ["random delays and losses"] * (not self.is_stable)
        return f"unstable over this line: {' and '.join(causes)}" if causes else ""

    @property
    def is_stable(self) -> bool:
        """True if the mean square is stable."""
        return bool(is_stable(self.mean_square))

    def as_json(self) -> dict[str, Any]:
        """Return line, verdicts and limits, ready for JSON."""
        names = "delays", "reason", "worst_case", "mean_square", "critical_loss", "longest_loss"
        stated = {name: getattr(self.line, name) for name in ("loss", "lost_in_a_row")}
        return stated | {name: plain(getattr(self, name)) for name in names}


def mean_square_line(loops: Iterable[Loop], line: LossyLine) -> str:
    """Return the verdict on the mean square of the worst of some loops over a line, in words; empty without a loop.

    Loops without stiffness are left out: in the free motion of a mass nothing decays.
    """
    held = [one for one in loops if one.acts and not one.free and not (one.linear is not None and one.linear.still)]
    every = [LineVerdict(one, line) for one in held]
    judged = [one for one in every if not one.reason]
    reasons = dict.fromkeys(one.reason for one in every if one.reason)
    worst = max(judged, key=lambda one: one.mean_square, default=None)
    if worst is not None and (not reasons or not worst.is_stable):
        verdict = f"{_WORDS[worst.is_stable]} in the mean square (x {worst.mean_square:.3f} a sample)"
        return f"line    {worst.setting}: {verdict}"
    return f"line    {every[0].setting}: not judged: {'; '.join(reasons)}" if every else ""


_WORDS = {True: "stable", False: "unstable"}

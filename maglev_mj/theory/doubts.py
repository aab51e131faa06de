"""Probes of laws that a linearisation at rest describes for small motion only, or not at all."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.control.laws.velocity import Estimator
from maglev_mj.control.stack import stacked_controller
from maglev_mj.errors import MaglevError, TooManyCallsError
from maglev_mj.frames import AXES, Array, Mask, Sample, components, unit_of
from maglev_mj.spec import GRAVITY
from maglev_mj.theory.linearise import SAMPLES_AT_REST, too_many_calls
from maglev_mj.theory.loop import Bound, Doubt
from maglev_mj.theory.loop_array import is_linear
from maglev_mj.theory.poses import DISPLACEMENT, SCALE, STRIDE

# The laws named here are in tests/theory/test_doubts.py, and need the value.
# -- scan of an axis, and search of a rest on it
_POINTS_OF_SCAN = 15
"""Positions of a scan: they bracket the rest, which bisection then finds; effort alone."""
_DISPLACEMENT_OF_SCAN = 1e-5
"""Displacement of the last sample that shows where a law answers to motion [m]."""
_SAMPLES_WITHOUT_MEMORY = 2
"""Samples of a scan of laws without memory; a second force that differs from the first one shows a memory."""
_SHARE_WITHOUT_LOAD = 0.1
"""Force of a rest without a load, as a share of the largest force on the axis: a smaller one is lost in a play."""
_MOST_POSITIONS, _ERROR_OF_REST = 40, 1e-2
"""Most positions of a search, to 1e-7 of the bracket, and relative error of the force at which it ends.

What is left after all is a jump. A law with 1 % of noise (Random) never comes closer; a probe needs no better rest.
"""

# -- displacements and times of the probes
_DISPLACEMENTS = 0.002, 0.02, 0.2
"""Displacements above the smallest one, `DISPLACEMENT`, as shares of the depth at rest; above the last a force may end.

At 10 µm as the smallest one a bristle slides (Dahl).
"""
_SAMPLES_OF_RETURN = 200
"""Samples until the end of a rest that begins with an excursion."""
_TRIED_RESTS = 3, SAMPLES_AT_REST, 41, 43, _SAMPLES_OF_RETURN, 512
"""Samples at rest that are tried: few (Burst), odd (EverySecond needs one of two), many (Timer), most (Fatigue)."""
_SAMPLES_OF_RESPONSE = 8
"""Samples recorded after a displacement: more than gates and medians look back (Gated, five)."""
_EXCURSION, _LEAST_EXCURSION = 2.0, 5e-4
"""Excursion to a deeper position: share of the depth, and distance added to it [m], so that a play is crossed."""
_SMALL_EXCURSION = 0.01
"""Share of an excursion to both sides, from which the effect of a linear memory on the whole one is known."""

# -- relative changes of a force
_ROUNDING_OF_FORCE = 1e-6
"""Change that is rounding: of a difference of forces, by the smallest displacement."""
_CHANGE_BY_REST = 1e-2
"""Change by another time at rest that counts, and force at the end of a response that is left of the largest one."""
_CHANGE_BY_EXCURSION = 1e-2
"""Change of the force at rest by an excursion that counts, unless it is that of a linear memory."""
_CHANGE_BY_SIZE = 0.25
"""Change of a response by its size that counts; below, a law is linear enough for its margin."""
_LEAST_PART = 1e-3
"""Least part of a response, static or decaying, that is compared at all: a smaller one does not move a margin."""

# -- sizes of motion up to which a verdict holds
_SMALL_MOTION, _SLOW_MOTION = 0.02, 0.05
"""Largest size in question, as a share of the depth, and speed, as a share of `reached_speed`.

A law that changes below is not judged; one that changes above is judged for motion up to there.
"""
_BISECTIONS_OF_SIZE = 8
"""Bisections of that size: a decade to 1 %, so that a message has two digits."""


# -- steps of the force of laws in fixed point
_POINTS_OF_STEPS, _SPANS_OF_STEPS = 65, 1e-7 * 8.0 ** np.arange(5)
"""Positions in a search of steps, and distances that they cover [m]: counts of 10 nm to 0.1 mm."""
_FEWEST_STEPS, _LEAST_STEP = 3, 2
"""Fewest steps in such a distance, and least number of positions between two: a law without counts has one at each."""
_BISECTIONS_OF_STEP = 8
"""Bisections of the position of a step: to 0.2 % of a count, printed with two digits."""


def reached_speed(reach: ArrayLike) -> Array:
    """Return the speed on each axis [m/s, rad/s], (6,), that crosses a range of motion in the time of a fall."""
    far = np.asarray(reach, dtype=np.float64)
    return np.asarray(2.0 * far / np.sqrt(2.0 * far[:3].max() / GRAVITY))


def doubts(
    controllers: Sequence[Controller],
    *,
    pose: ArrayLike,
    reach: ArrayLike,
    load: ArrayLike | None = None,
    axes: Iterable[int] = range(6),
) -> list[dict[int, Doubt]]:
    """Return what probes of each axis found, by index, for each controller.

    A flotor is held where the laws carry its weight, or else a tenth of their largest force. The probes repeat, rest
    for 3 to 512 samples, displace it by 0.1 µm to 20 % of the depth to both sides, for one sample and for good, come
    from deeper, and return from there at the speed of a fall. Axes on which only laws with declared gains act are not
    probed.

    Args:
        controllers: Controllers of equal period and velocity estimator, with laws for one device each; none is changed.
        pose: Pose of the other axes [m, rad], (6,).
        reach: Range of motion [m, rad], (6,).
        load: Constant external force, such as the weight [N, N m], (6,).
        axes: Indices into AXES.

    Raises:
        TooManyCallsError: If a controller would be called more than 50 000 times.
        MaglevError: If a law fails at a pose.

    Example:
        >>> from maglev_mj import Controller
        >>> push = lambda position, velocity: [0.0, 0.0, 12.0 * (position[2] < 0.0), 0.0, 0.0, 0.0]
        >>> far, weight = [0.0045] * 3 + [0.1] * 3, [0.0, 0.0, -6.867, 0.0, 0.0, 0.0]
        >>> (found,) = doubts([Controller([push], period=1e-3)], pose=[0.0] * 6, reach=far, load=weight)
        >>> found[2].reason
        'the weight is carried by a jump of force, 12 N at 0 mm'
    """
    far, chosen = np.asarray(reach, dtype=np.float64), list(axes)
    if isinstance(estimator := controllers[0].velocity, Estimator) and not is_linear(estimator):
        reason = f"the velocity estimator {type(estimator).__name__} is not linear"
        return [dict.fromkeys(chosen, Doubt(Bound(0.0), reason, True)) for _ in controllers]
    loads = np.zeros(len(AXES)) if load is None else np.asarray(load, dtype=np.float64)
    base, count = np.asarray(pose, dtype=np.float64), len(controllers)
    pairs = [(index, axis) for index in range(count) for axis in chosen]
    scan = _Scan.of(controllers, pairs, base, far)
    rows, targets, brackets = list[int](), list[float](), list[list[list[float]]]()
    static: list[tuple[int, float]] = []  # without a rest, such as friction alone
    for row in np.flatnonzero(scan.active).tolist():
        (index, axis), forces, x = pairs[row], scan.forces[row], scan.positions[row]
        found = [*_rests(forces, x, -loads[axis] - float(controllers[index].carried[axis]))]
        for target, *intervals in found:
            rows.append(row)
            targets.append(target)
            brackets.append([[*x[at : at + 2].tolist(), *forces[at : at + 2].tolist()] for at in intervals])
        if not found:
            static.append((row, float(x[scan.fastest[row]])))
    result: list[dict[int, Doubt]] = [{} for _ in controllers]
    if not rows and not static:
        return result
    devices = scan.devices.of([pairs[row] for row in [*rows, *(row for row, _ in static)]])
    probed = _probed(devices, np.array(targets), np.array(brackets).reshape(-1, 2, 4), static, far, loads)
    for (index, axis), doubt in zip(devices.pairs, probed, strict=True):
        result[index][axis] = _worse(result[index].get(axis), doubt)
    return result


def _worse(first: Doubt | None, second: Doubt) -> Doubt:
    if first is None:
        return second
    worst = min(first, second, key=lambda one: (not one.void, not one.reason, one.valid_to.beyond, float(one.valid_to)))
    return worst._replace(rests=first.rests + second.rests)


def _rests(forces: Array, x: Array, wanted: float) -> Iterable[tuple[float, int, int]]:
    """Yield forces at rest, one for each direction, and the intervals of positions of each and of its half."""
    for direction in (1.0, -1.0):
        most = float(np.nanmax(direction * forces))
        if not most > 0.0:
            continue
        size = _SHARE_WITHOUT_LOAD * most
        if direction * wanted > 0.0:  # a range that ends before the weight is carried: half of the largest force
            size = abs(wanted) if abs(wanted) < most else 0.5 * most
        falls, half = (
            np.flatnonzero((forces[:-1] >= one) & (one >= forces[1:]))
            for one in (direction * size, 0.5 * direction * size)
        )
        if falls.size:
            at = int(falls[np.argmin(np.abs(x[falls]))])
            half = half[half >= at] if direction > 0.0 else half[half <= at]
            yield direction * size, at, int(half[np.argmin(np.abs(half - at))]) if half.size else at


class _Devices:
    """Devices in parallel, each displaced on its own axis: positions on it go in, forces on it come out."""

    def __init__(
        self, controllers: Sequence[Controller], pairs: Sequence[tuple[int, int]], pose: Array, batch: bool
    ) -> None:
        self.controllers, self.pairs, self.pose, self.batch = controllers, pairs, pose, batch
        self.axes = np.array([axis for _, axis in pairs], dtype=np.intp)
        self._carried = np.array([controllers[index].carried[axis] for index, axis in pairs])
        self._rows = np.arange(len(pairs))
        self._each = [controllers[index] for index, _ in pairs]
        self._calls, self.samples = [0], _SAMPLES_WITHOUT_MEMORY
        if batch:
            together = stacked_controller(self._each)
            if together is None:
                raise ValueError("laws that cannot be stacked")
            self._each = [together]
        self.reset()

    def of(self, pairs: Sequence[tuple[int, int]]) -> _Devices:
        """Return devices of the same controllers for other pairs of controller and axis."""
        other = _Devices(self.controllers, pairs, self.pose, self.batch)
        other._calls, other.samples = self._calls, self.samples
        return other

    def reset(self) -> None:
        """Reset all states."""
        self._tick = 0
        self._live = [copy.copy(one) for one in self._each]
        for one in self._live:
            one.reset()

    def branch(self) -> _Devices:
        """Return the devices in their present states, which go on independently."""
        other = copy.copy(self)
        other._live = [copy.copy(one) for one in self._live]
        for new, old in zip(other._live, self._live):
            new._states, new._velocity_state = copy.deepcopy((old._states, old._velocity_state))
        return other

    def step(self, positions: Array) -> Array:
        """Return the forces at the next sample without weight compensation, (N,)."""
        poses = np.tile(self.pose, (len(self.axes), 1))
        poses[self._rows, self.axes] = positions
        tick, self._tick = self._tick, self._tick + 1
        if self.batch:
            force = self._live[0].step(Sample(tick, 0.0, components(poses))).force
            wrenches = np.array([np.broadcast_to(part, len(poses)) for part in force])
            return np.asarray(wrenches[self.axes, self._rows] - self._carried)
        self._calls[0] += len(poses)
        too_many_calls(self._calls[0], self.controllers)
        each = zip(self._live, poses.tolist(), self.axes.tolist())
        forces = [float(one.step(Sample(tick, 0.0, pose)).force[axis]) for one, pose, axis in each]
        return np.asarray(np.array(forces) - self._carried)

    def run(self, positions: Array, samples: int) -> Array:
        """Return the forces at positions held for some samples, (samples, N)."""
        return np.array([self.step(positions) for _ in range(samples)])

    def held(self, positions: Array) -> Array:
        """Return the mean of the last two forces after a rest from a new start, (N,)."""
        self.reset()
        return np.asarray(self.run(positions, self.samples)[-2:].mean(axis=0))


class _Scan(NamedTuple):
    """Forces along each axis for some pairs of controller and axis, R.

    Attributes:
        devices: The devices.
        positions: Positions, (R, G).
        forces: Forces at rest, (R, G).
        active: True where a law without declared gains, or with a velocity estimator that is not linear, acts, (R,).
        fastest: Index of the position with the largest change of force by motion, (R,).
    """

    devices: _Devices
    positions: Array
    forces: Array
    active: Mask
    fastest: Array

    @classmethod
    def of(
        cls, controllers: Sequence[Controller], pairs: Sequence[tuple[int, int]], pose: Array, reach: Array
    ) -> _Scan:
        """Return the scan."""
        far = reach[[axis for _, axis in pairs]]
        positions = np.linspace(-1.0, 1.0, _POINTS_OF_SCAN) * (STRIDE * far)[:, None]
        shift = _DISPLACEMENT_OF_SCAN * np.repeat(SCALE[[axis for _, axis in pairs]], _POINTS_OF_SCAN)
        each = [pair for pair in pairs for _ in range(_POINTS_OF_SCAN)]
        devices, forces = _scanned(controllers, each, pose, positions.ravel(), shift)
        declared = [
            Controller([law for law in one.laws if law.gains() is not None], period=one.period, velocity=one.velocity)
            for one in controllers
        ]
        stated = _scanned(declared, each, pose, positions.ravel(), shift)[1]
        with np.errstate(invalid="ignore"):
            differs = ~(np.abs(forces - stated) <= _ROUNDING_OF_FORCE * np.abs(forces).max(axis=0))
        linear = np.array([is_linear(controllers[index].velocity) for index, _ in pairs])
        active = differs.any(axis=0).reshape(-1, _POINTS_OF_SCAN).any(axis=1) | ~linear & forces.any(axis=0).reshape(
            -1, _POINTS_OF_SCAN
        ).any(axis=1)
        fastest = np.abs(forces[-1] - forces[-2]).reshape(-1, _POINTS_OF_SCAN).argmax(axis=1)
        acts = np.repeat(active, _POINTS_OF_SCAN)
        if acts.any() and ((forces[:-1] != forces[0]).any() or (forces[0] == stated[0]).all()):  # a memory
            devices.samples = SAMPLES_AT_REST
            rest = devices.of([pair for pair, act in zip(each, acts) if act])
            forces[:-1, acts] = rest.held(positions[active].ravel())
        return cls(devices, positions, forces[:-1].mean(axis=0).reshape(-1, _POINTS_OF_SCAN), active, fastest)


def _scanned(
    controllers: Sequence[Controller], pairs: Sequence[tuple[int, int]], pose: Array, positions: Array, shift: Array
) -> tuple[_Devices, Array]:
    """Return devices, in a batch if the laws accept arrays, and forces at two samples at rest and a displaced one."""

    def forces(devices: _Devices, at: slice) -> Array:
        first = devices.run(positions[at], _SAMPLES_WITHOUT_MEMORY)
        return np.vstack([first, devices.step(positions[at] + shift[at])])

    try:
        devices = _Devices(controllers, pairs, pose, True)
        rows = forces(devices, slice(None))
        single = forces(_Devices(controllers, pairs[-1:], pose, False), slice(-1, None))
        with np.errstate(invalid="ignore"):
            if not (np.abs(rows[:, -1:] - single) > _ROUNDING_OF_FORCE * np.abs(single).max(initial=1e-300)).any():
                return devices, rows
    except TooManyCallsError:
        raise
    except (MaglevError, TypeError, ValueError):  # a law that accepts floats only, as with math.sin or `if`
        pass
    devices = _Devices(controllers, pairs, pose, False)
    return devices, forces(devices, slice(None))


def _probed(
    devices: _Devices,
    targets: Array,
    brackets: Array,
    static: Sequence[tuple[int, float]],
    reach: Array,
    loads: Array,
) -> list[Doubt]:
    """Return what the probes found for each device.

    Args:
        devices: The devices.
        targets: Forces at rest of the first ones.
        brackets: Their positions and forces to both sides of the rest, and of half of the force, (R, 2, 4).
        static: Positions of the others, which have no rest.
        reach: Range of motion, (6,).
        loads: Load on each axis, (6,).
    """
    period = devices.controllers[0].period
    count, pairs = len(targets), devices.pairs
    x, depth = np.zeros((2, len(pairs)))
    jump, deeper = np.zeros(len(pairs)), np.zeros(len(pairs))
    if count:
        part = devices.of(pairs[:count])
        x[:count], jump[:count] = _searched(part, targets, brackets[:, 0])
        half = _searched(part, 0.5 * targets, brackets[:, 1])[0]
        depth[:count], deeper[:count] = 2.0 * np.abs(half - x[:count]), -np.sign(targets)
    if static:
        x[count:] = [at for _, at in static]
    scale, speed = SCALE[devices.axes], reached_speed(reach)[devices.axes]
    depth = np.maximum(
        np.where(depth > 0.0, depth, _SHARE_WITHOUT_LOAD * reach[devices.axes]), 10.0 * DISPLACEMENT * scale
    )
    room = STRIDE * reach[devices.axes] - np.abs(x)
    fall = np.where(deeper != 0.0, np.minimum(speed * period, room), 0.0)
    found = _Probes(devices, x, depth, deeper, np.minimum(DISPLACEMENT * scale, _DISPLACEMENTS[0] * depth), scale, fall)
    reasons = found.reasons()
    sizes, kinds = found.sizes()
    result = []
    for row, (_, axis) in enumerate(pairs):
        beyond = not kinds[row]
        limit = Bound(float(sizes[row]) / period, beyond)
        unit = 1e3 * x[row], unit_of("mm", AXES[axis])
        resolution = _resolution(devices, row, float(x[row])) if jump[row] or reasons[row] else 0.0
        if resolution:
            size = f"{1e6 * resolution:.2g} µ{unit_of('m', AXES[axis])}"
            reason = f"dead band: the force changes in steps of {size} alone"
            result.append(Doubt(limit, reason, True, (), float(x[row]), float(depth[row]), resolution))
        elif jump[row]:
            what = "the weight" if loads[axis] else "a load"
            force = f"{jump[row]:.3g} {unit_of('N', AXES[axis])} at {round(unit[0], 6):z.3g} {unit[1]}"
            result.append(Doubt(limit, f"{what} is carried by a jump of force, {force}", True))
        elif reasons[row]:
            result.append(Doubt(limit, reasons[row], True))
        else:
            least = _SMALL_MOTION * depth[row] if kinds[row] == "position" else _SLOW_MOTION * speed[row] * period
            small = not beyond and sizes[row] < least
            what = "slope of the force" if kinds[row] == "position" else "damping"
            reason = f"the {what} changes above {up_to(limit, period, AXES[axis])}"
            result.append(Doubt(limit, reason if small else "", rests=(float(x[row]),) * (row < count)))
    return result


def _resolution(devices: _Devices, row: int, x: float) -> float:
    """Return the least distance between steps of the force at rest, of a law in fixed point; 0 for another law."""
    pair = devices.pairs[row]
    grid = devices.of([pair] * _POINTS_OF_STEPS)
    grid.samples, grid._calls = SAMPLES_AT_REST, [0]
    for span in SCALE[pair[1]] * _SPANS_OF_STEPS:
        positions = x + span * np.linspace(0.0, 1.0, _POINTS_OF_STEPS)
        forces = grid.held(positions)
        steps = np.flatnonzero(np.diff(forces))
        if len(steps) < _FEWEST_STEPS:
            continue
        if np.diff(steps).min() < _LEAST_STEP:
            return 0.0
        some = devices.of([pair] * len(steps))
        some.samples, some._calls = SAMPLES_AT_REST, grid._calls
        low, high = positions[steps], positions[steps + 1]
        for _ in range(_BISECTIONS_OF_STEP):
            middle = 0.5 * (low + high)
            before = some.held(middle) == forces[steps]
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return float(np.diff(low).min())
    return 0.0


def up_to(limit: Bound, period: float, axis: str) -> str:
    """Return a speed in words, with its displacement in one sample."""
    size, unit = 1e6 * limit * period, unit_of("m", axis)
    return f"{1e3 * limit:.3g} m{unit}/s ({size:.3g} µ{unit} in a sample)"


def _searched(devices: _Devices, targets: Array, brackets: Array) -> tuple[Array, Array]:
    """Return positions with these forces at rest, and the size of the jump of force there; 0 for none."""
    low, high, above, below = brackets.T.copy()
    above, below = above - targets, below - targets
    tolerance = _ERROR_OF_REST * np.abs(targets)
    x, error = np.where(np.abs(above) < np.abs(below), low, high), np.minimum(np.abs(above), np.abs(below))
    for step in range(_MOST_POSITIONS):
        if (error <= tolerance).all():
            break
        share = above / np.where(above - below > 0.0, above - below, 1.0)
        middle = low + (high - low) * (np.clip(share, 0.01, 0.99) if step % 2 == 0 else 0.5)
        forces = devices.held(middle) - targets
        up = forces >= 0.0
        low, above = np.where(up, middle, low), np.where(up, forces, above)
        high, below = np.where(up, high, middle), np.where(up, below, forces)
        better = np.abs(forces) < error
        x, error = np.where(better, middle, x), np.where(better, np.abs(forces), error)
    jump = np.where(error > tolerance, above - below, 0.0)
    return np.where(jump > 0.0, 0.5 * (low + high), x), jump


class _Probes:
    """Probes of devices at rest; responses are forces per unit of a displacement held for 8 samples."""

    def __init__(
        self, devices: _Devices, x: Array, depth: Array, deeper: Array, tiny: Array, scale: Array, fall: Array
    ) -> None:
        self._fall = fall
        self._devices, self._x, self._depth, self._deeper, self._scale = devices, x, depth, deeper, scale
        self._steps = [tiny, *(share * depth for share in _DISPLACEMENTS)]
        devices.reset()
        devices.run(x, SAMPLES_AT_REST)
        self._rested = devices.branch()
        self._still = self._rested.branch().run(x, _SAMPLES_OF_RESPONSE)
        self._tiny = {sign: self._response(sign * tiny) for sign in (1.0, -0.5)}  # finds a sign of the velocity, too

    def _response(self, size: Array) -> Array:
        forces = self._rested.branch().run(self._x + size, _SAMPLES_OF_RESPONSE)
        return np.asarray((forces - self._still) / size)

    def reasons(self) -> list[str]:
        """Return why the linearisation says nothing on each device; empty for no reason."""
        x, size = self._x, self._steps[2]
        result = [""] * len(x)

        def refuse(wrong: Mask, reason: str) -> None:
            for row in np.flatnonzero(wrong).tolist():
                result[row] = result[row] or reason

        devices, rested, forces, gaps = self._devices, 0, dict[int, Array](), dict[int, Array]()
        devices.reset()
        response = self._response(size)
        for rest in _TRIED_RESTS:
            forces[rest] = devices.run(x, rest - rested)[-1]
            rested = rest
            still, moved = (devices.branch().run(x + step, _SAMPLES_OF_RESPONSE) for step in (0.0 * size, size))
            gaps[rest] = np.abs((moved - still) / size - response)
        most, end = np.abs(response).max(axis=0), np.abs(response[-1])
        refuse((gaps[SAMPLES_AT_REST] > _ROUNDING_OF_FORCE * most).any(axis=0), "the force does not repeat")
        for rest, gap in gaps.items():
            wrong = (gap > _CHANGE_BY_REST * most).any(axis=0) | (
                gap[-1] > np.maximum(_CHANGE_BY_REST * end, _ROUNDING_OF_FORCE * most)
            )
            refuse(wrong, f"the force depends on the number of samples at rest ({SAMPLES_AT_REST} or {rest})")
        refuse(self._returns(forces[_SAMPLES_OF_RETURN]), "the force at rest depends on the way there (hysteresis)")
        refuse(
            np.any(_differs(*self._tiny.values()), axis=0), "the force depends on the direction of the smallest motion"
        )
        refuse(self._summed(), "the force of a longer motion is not the sum of those of its samples")
        refuse(self._frozen(), "the force does not follow the smallest motion")
        return result

    def _summed(self) -> Mask:
        """Return True where responses do not add up: those to single samples, a step and a ramp.

        A median sees no single sample, and a gate on several speeds no step.
        """
        wrong = np.zeros(len(self._x), dtype=np.bool_)
        for shape, as_step in (
            (np.eye(_SAMPLES_OF_RESPONSE)[0], np.cumsum),
            (np.arange(1.0, _SAMPLES_OF_RESPONSE + 1.0), lambda ramp, axis: np.diff(ramp, axis=axis, prepend=0.0)),
        ):
            moved = self._rested.branch()
            forces = np.array([moved.step(self._x + share * self._steps[0]) for share in shape])
            step = as_step((forces - self._still) / self._steps[0], axis=0)
            wrong |= np.any(_differs(self._tiny[1.0], step), axis=0)
        return wrong

    def _frozen(self) -> Mask:
        """Return True where the smallest displacement leaves no force in the end, and a larger one does."""
        larger = [np.abs(self._response(size)[-1]) for size in self._steps[1:]]
        return np.asarray(np.abs(self._tiny[1.0][-1]) < _CHANGE_BY_REST * np.max(larger, axis=0))

    def _returns(self, rest: Array) -> Mask:
        """Return True where the force differs after an excursion, other than by a linear memory of its size.

        Args:
            rest: Force after as many samples without one.
        """
        excursion = self._deeper * (_EXCURSION * self._depth + _LEAST_EXCURSION * self._scale)
        force = np.maximum(np.abs(rest), np.abs(self._tiny[1.0][-1]) * self._depth)
        whole = self._left(excursion) - rest
        remains = np.abs(whole) > _CHANGE_BY_EXCURSION * force
        if not remains.any():
            return np.asarray(remains)
        there, back = (self._left(share * excursion) - rest for share in (_SMALL_EXCURSION, -_SMALL_EXCURSION))
        scale = _CHANGE_BY_SIZE * np.abs(whole)
        return np.asarray(
            remains
            & ((np.abs(whole - there / _SMALL_EXCURSION) > scale) | (np.abs(whole + back / _SMALL_EXCURSION) > scale))
        )

    def _left(self, excursion: Array) -> Array:
        """Return the force at rest after an excursion."""
        self._devices.reset()
        self._devices.run(self._x + excursion, SAMPLES_AT_REST)
        return np.asarray(self._devices.run(self._x, _SAMPLES_OF_RETURN - SAMPLES_AT_REST)[-1])

    def sizes(self) -> tuple[Array, list[str]]:
        """Return sizes up to which the laws are linear, and what changes above, "" for nothing up to the largest."""
        count = len(self._x)
        good, bad, kinds = self._steps[0].copy(), np.full(count, np.inf), [""] * count
        for size in (*self._steps[1:], np.maximum(self._fall, self._steps[-1])):
            wrong = self._kinds(size)
            for row in range(count):
                if not kinds[row] and wrong[row]:
                    kinds[row], bad[row] = wrong[row], size[row]
                elif not kinds[row]:
                    good[row] = max(good[row], size[row])
        if any(kinds):
            for _ in range(_BISECTIONS_OF_SIZE):
                middle = np.where(np.isfinite(bad), np.sqrt(good * np.where(np.isfinite(bad), bad, 1.0)), good)
                wrong = self._kinds(middle)
                for row in np.flatnonzero(np.isfinite(bad)).tolist():
                    if wrong[row]:
                        bad[row], kinds[row] = middle[row], wrong[row]
                    else:
                        good[row] = middle[row]
        return good, kinds

    def _kinds(self, size: Array) -> list[str]:
        """Return what differs from the smallest displacement: "speed", "position" or nothing.

        Above the largest share of the depth, where a force may end, only speeds on the way back from deeper positions.
        """
        speed, position = np.zeros((2, len(size)), dtype=bool)
        most = np.minimum(size, self._steps[-1])
        for sign, reference in self._tiny.items():
            fast, slow = _differs(reference, self._response(np.sign(sign) * most))
            speed, position = speed | fast, position | slow
        if (size > most).any():
            speed |= (size > most) & _differs(self._back(self._steps[0]), self._back(size))[0]
        return ["speed" if fast else "position" if slow else "" for fast, slow in zip(speed, position)]

    def _back(self, size: Array) -> Array:
        """Return the response to a step back from a rest at a deeper position."""
        still, moved = self._rested.branch(), self._rested.branch()
        still.run(self._x, SAMPLES_AT_REST)
        moved.run(self._x + self._deeper * size, SAMPLES_AT_REST)
        return np.asarray((moved.run(self._x, _SAMPLES_OF_RESPONSE) - still.run(self._x, _SAMPLES_OF_RESPONSE)) / size)


def _differs(first: Array, second: Array) -> tuple[Mask, Mask]:
    """Return where two responses (M, N) differ while they decay, as with the speed, and where at their ends, (N,)."""
    most = np.maximum(np.abs(first), np.abs(second)).max(axis=0)
    ends = np.maximum(np.abs(first[-1]), np.abs(second[-1]))
    change = np.abs(second[-1] - first[-1])
    position = (change > _CHANGE_BY_SIZE * ends) & (change > _LEAST_PART * most)
    before, after = first - first[-1], second - second[-1]
    change, moving = np.abs(after - before).max(axis=0), np.maximum(np.abs(before), np.abs(after)).max(axis=0)
    return (change > _CHANGE_BY_SIZE * moving) & (change > _LEAST_PART * most), position

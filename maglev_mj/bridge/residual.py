"""Residual of a flight: the acceleration that the currents do not explain, and the experiment that names its cause.

A hand that moves the laws can look like any fault. A passive test therefore only raises a suspicion; a suspicion starts
a probe: small currents with random signs, which no hand can imitate. Only what agrees with the probe is named.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Generator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.frames import ZERO, Array

Sums: TypeAlias = tuple[Sequence[float], Sequence[float]]
"""Integral of a wrench over a period, and of time times it: six each; `ZERO` itself if there was none."""

# Tested from both sides in tests/bridge/test_residual.py; right and wrong names: docs/explanation/flight_safety.md.
# -- steps and probe
_STEP_OF_RESIDUAL = 0.005
"""Step of the residual [s]; a longer period is its own step. A shorter one has more noise, as 1 / step ** 2."""
_MOST_BLOCKS, _SIGNS_OF_BLOCK = 8, (1.0, -1.0, -1.0, 1.0)
"""Most blocks of a probe, and its signs in one, a step each: neither speed nor path is left after a block."""
_LEAST_COVERAGE = 0.5
"""Least share of the best of the squared acceleration by two blocks on the axis that they move least.

A larger one leaves few signs to draw, which a hand could match; a smaller one leaves an axis without an answer.
"""
_MOST_PROBES, _PAUSE_OF_PROBES = 4, 0.5
"""Most probes of one suspicion; pause after them, and after three within a second that showed no fault [s]."""

# -- delays, in steps
_LONGEST_DELAY = 5
"""Longest delay that is named, 25 ms: a longer one would need more steps of each kind in memory."""
_NAMED_DELAYS = [*np.arange(0.3, 2.01, 0.1), *np.arange(2.25, _LONGEST_DELAY + 0.01, 0.25)]
"""Delays that a probe distinguishes."""
_SUSPECTED_DELAYS = [0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0]
"""Delays that raise a suspicion: fewer, as they are tried in each step."""

# -- suspicion of a delay or a reversed pose
_TIME_OF_SUSPICION = 0.06
"""Time constant of the sums of squared changes [s]."""
_LEAST_CHANGES, _LARGEST_CHANGE = 2.0, 40.0
"""Least sum of squared changes, and where one, of a blow, is cut, in squares of the probe: less is noise."""
_LEFT_BY_SUSPECT = 0.45
"""Largest share of that sum that a suspected cause leaves; a suspicion names nothing, so that it may be wrong."""
_NEAR_STOP, _TOUCHED_STOP = 0.9, 0.95
"""Share of the range from which a swing raises no suspicion; sum of shares from which a stop may be touched."""

# -- suspicion of a coil
_STEPS_COMPARED, _STEPS_BETWEEN = 2, 3
"""Steps before and after the failure of a coil that are compared, and steps between them."""
_STEPS_OF_FAILURE, _MOST_STEPS_FOLLOWED = 2 * _STEPS_COMPARED + _STEPS_BETWEEN, 8
"""All of them, and most steps in which a coil is followed."""
_LEFT_BY_SUSPECTED_COIL, _TOLERANCE_OF_SUSPECTED_LOSS = 0.15, 0.35
"""Largest share of the squared change that a suspected coil leaves, and tolerance of its loss."""

# -- missing force that follows a coil's own current: no finger does
_TOLERANCE_OF_LOSS, _EARLY_DIVISOR = 0.15, 3.0
"""Tolerance of the loss, and divisor of it and of the slope's in the first two steps, in which a finger may match."""
_LEFT_IN_OTHER_COILS = 0.01
"""Largest share of the square in other coils: a finger presses on all of them."""
_TOLERANCE_OF_SLOPE, _ERRORS_OF_SLOPE = 0.3, 5.0
"""Tolerance of the slope against changes of the current, and its least size in standard errors."""

# -- what a probe may name
_SIZES_NAMED = {
    "delay": (1.0, 1.0),
    "reversed": (1.0, 1.0),
    "coil": (0.35, 2.4),
    "mass": (-0.75, 2.0),
    "inertia": (-0.75, 2.0),
}
"""Least and largest size of each kind of cause: a coil that keeps more than 65 % of its force can be flown."""
_LEAST_STEPS_JUDGED, _MOST_STEPS_JUDGED = 3, 10
"""Fewest and latest steps of a probe that are judged: a cause may begin within the probe."""


class Evidence(NamedTuple):
    """Result of a probe for the cause that explains most of the residual.

    Attributes:
        kind: Kind of the cause: delay, reversed, coil, mass, inertia.
        place: Number of the coil.
        size: Delay in steps; share of the force that a coil lacks; relative error of 1 / mass or 1 / inertia.
        left: Share of the squared residual that the cause leaves.
        other: Least share that a cause of another kind leaves.
        faults: Least share that any delay, reversed pose or failed coil leaves.
        scale: Largest relative error of mass and inertia that fits best.
        t: Standard errors by which the answer to the probe alone exceeds that of a calibrated device.
        loud: True if the hand moves the flotor more than the probe does.
        clear: False if the flotor may have touched a stop, where coils seem to do nothing, or the opposite.
    """

    kind: str
    place: int
    size: float
    left: float
    other: float
    faults: float
    scale: float
    t: float
    loud: bool
    clear: bool


_LEFT_BY_CAUSE, _LEFT_AT_STOP = 0.4, 0.1
"""Largest share left by a named cause, also by a coil or a reversed pose where a stop may imitate it."""
_LEFT_IF_CALIBRATED, _ERROR_IF_CALIBRATED = 1.5, 0.2
"""As calibrated: least share left by every fault, and largest relative error of mass and inertia."""
_DISTANCE_OF_NEXT, _FACTOR_OF_CUT = 0.4, 2.0
"""Least distance of the next cause from the named one, relative; factor on it for a name that cuts the currents."""
_ERRORS_OF_NAME = 6.0
"""Least standard errors of a named cause: every step of a flight may be judged, and none may end it by chance."""
_LEAST_STEPS_IF_LOUD = 8
"""Fewest steps before a name while the hand moves the flotor more than the probe does: two blocks."""


def verdict(found: Evidence, steps: int) -> str:
    """Return the kind of the cause that a probe shows after some steps, "as calibrated", or "" if it does not tell."""
    if found.left > _LEFT_BY_CAUSE:
        return "as calibrated" if found.faults > _LEFT_IF_CALIBRATED and found.scale < _ERROR_IF_CALIBRATED else ""
    imitated = not found.clear and found.kind in ("coil", "reversed")
    distance = _DISTANCE_OF_NEXT * (_FACTOR_OF_CUT if found.kind == "reversed" else 1.0)
    if (imitated and found.left > _LEFT_AT_STOP) or found.other < (1.0 + distance) * found.left + 0.01:
        return ""
    return "" if found.t < _ERRORS_OF_NAME or (found.loud and steps < _LEAST_STEPS_IF_LOUD) else found.kind


class Causes:
    """Known causes of a residual, as linear maps of the driven acceleration.

    Args:
        calibration: Calibration of the device.
        unit: Acceleration per wrench, rotations at their radius of gyration, six.
        to_coils: Map from accelerations to currents [A], (6, 6).
        noise: Noise of a second difference of the acceleration [m/s²].
    """

    def __init__(self, calibration: Calibration, unit: Array, to_coils: Array, noise: float) -> None:
        self._noise, self._names = noise, [("delay", 0)] * len(_NAMED_DELAYS)
        maps = []
        pose = np.array(calibration.wall_maps.pose_per_spot)
        spots, lengths = np.linalg.inv(pose), calibration.body.inertia * unit
        every = range(6)
        groups = [*((s,) for s in every), (0, 1), (2, 3), (4, 5), (1, 5), (1, 3), (3, 5), (0, 2, 4), (1, 3, 5)]
        reversals = [np.diag(-2.0 * np.eye(6)[axis]) for axis in every]
        for group in groups:  # of spots with the opposite sign: single, of a diode, of an axis
            reversals.append(lengths[:, None] * (-2.0 * pose[:, group] @ spots[group, :]) / lengths)
        per_current = np.linalg.inv(to_coils)
        for kind, parts in (
            ("reversed", reversals),
            ("coil", [-np.outer(per_current[:, coil], to_coils[coil]) for coil in every]),
            ("mass", [np.diag([1.0] * 3 + [0.0] * 3)]),
            ("inertia", [np.diag([0.0] * 3 + [1.0] * 3)]),
        ):
            self._names += [(kind, index) for index in range(len(parts))]
            maps += [part.T for part in parts]
        self._maps = np.array(maps)
        lags = np.array(_NAMED_DELAYS)
        self._whole = np.floor(lags + 1e-9).astype(int)[:, None]
        self._part = (lags - self._whole[:, 0])[:, None, None]
        self._least, self._most = np.array([_SIZES_NAMED[kind] for kind, _ in self._names]).T
        kinds = np.array([kind for kind, _ in self._names])
        self._faults = (kinds != "mass") & (kinds != "inertia")
        # delays are one cause, and so are reversed poses; each coil is one
        self._same = {
            name: np.array([x == name or (x[0] == name[0] != "coil") for x in self._names]) for name in set(self._names)
        }

    def _responses(self, driven: Array, only: int | None = None) -> Array:
        """Return what each cause, or one, adds to the second differences of the acceleration, (causes, steps, 6)."""
        rows = np.arange(_LONGEST_DELAY + 1, len(driven))
        lags = len(self._whole)
        delays = slice(None) if only is None else slice(only, min(only + 1, lags))
        maps = slice(None) if only is None else slice(max(only - lags, 0), max(only + 1 - lags, 0))
        part, before = self._part[delays], rows - self._whole[delays]
        late = (1.0 - part) * driven[before] + part * driven[before - 1] - driven[rows]
        added = np.concatenate([late, driven[rows] @ self._maps[maps]])
        twice: Array = added[:, 2:] - 2.0 * added[:, 1:-1] + added[:, :-2]
        return twice

    def compare(
        self, measured: Array, driven: Array, probe: Array, clear: bool
    ) -> Generator[None, None, Evidence | None]:
        """Compare accelerations [m/s²], (N, 6) each, with all causes; yields twice before the result.

        Args:
            measured: Measured ones; NaN where a sample was lost.
            driven: Those that the currents drive.
            probe: Part of them that is the probe's: its signs are random, so that no hand agrees with it.
            clear: False if the flotor may have touched a stop.
        """
        residual = np.diff((measured - driven)[_LONGEST_DELAY + 1 :], 2, axis=0)
        fine = np.isfinite(residual).all(axis=1)
        if fine.sum() < _LEAST_STEPS_JUDGED - 1:
            return None
        e, x = residual[fine], self._responses(driven)[:, fine]
        yield
        size = self._spread(e)
        weight = 1.0 / (size**2 + 0.01 * float(size.max()) ** 2)
        scaled = e * weight
        own = (x**2 * weight).sum(axis=(1, 2))
        fitted = (x * scaled).sum(axis=(1, 2)) / np.where(own > 1e-9, own, np.inf)
        sizes = np.minimum(np.maximum(fitted, self._least), self._most)
        most = 16.0 * float(np.median((e * scaled).sum(axis=1)))  # a blow is a few large ones
        left = np.minimum(((e - sizes[:, None, None] * x) ** 2 * weight).sum(axis=2), most).sum(axis=1)
        shares = left / np.minimum((e * scaled).sum(axis=1), most).sum()
        best = int(shares.argmin())
        kind, index = self._names[best]
        yield
        answer = self._responses(probe, best)[0, fine]
        t, loud = self._agreement(e, x[best] - answer, answer, weight, math.copysign(1.0, sizes[best]))
        amount = float(_NAMED_DELAYS[best]) if kind == "delay" else float(sizes[best])
        other = float(shares[~self._same[kind, index]].min())
        faults, scale = float(shares[self._faults].min()), float(np.abs(fitted[~self._faults]).max())
        return Evidence(kind, index, amount, float(shares[best]), other, faults, scale, t, loud, clear)

    def _agreement(self, e: Array, laws: Array, probe: Array, weight: Array, sign: float) -> tuple[float, bool]:
        """Return the standard errors of the answer to the probe, and whether the rest of the residual is larger.

        The residual is taken as it is, or without the best multiple of what the laws answered. Both are valid, as the
        probe is random: the larger counts.
        """
        answers = []
        for part in (0.0, float((laws * e * weight).sum()) / max(float((laws**2 * weight).sum()), 1e-9)):
            left = e - part * laws
            theta = float((probe * left * weight).sum()) / max(float((probe**2 * weight).sum()), 1e-9)
            kept = theta * probe if part else 0.0
            rest = left - kept
            wide = self._spread(rest)
            clipped = np.minimum(np.maximum(rest, -3.0 * wide), 3.0 * wide) + kept
            scaled = probe / wide
            size = math.sqrt(float((scaled**2).sum()))
            t = sign * float((scaled * clipped / wide).sum()) / max(size, 1e-9)
            answers.append((t, float((rest**2).sum()) > float((probe**2).sum())))
        return max(answers)

    def _spread(self, rest: Array) -> Array:
        """Return the size of each axis, six; a blow is a few large ones."""
        squares: Array = rest**2
        largest = 9.0 * np.median(squares, axis=0)
        sizes: Array = np.sqrt(np.minimum(squares, largest).mean(axis=0) + self._noise**2)
        return sizes


def follows(missing: Array, current: Array, coil: int, steps: int, sizes: Array, noise: float) -> float:
    """Return the lost share of a coil's force, 1 or 2, if what is missing follows its current; else 0: no finger does.

    Args:
        missing: Currents whose force is missing [A], (N, 6).
        current: Currents of the coil [A], (N,).
        coil: The coil.
        steps: Steps since the coil was suspected.
        sizes: Acceleration per current of each coil [m/s² per A], six.
        noise: Noise of the acceleration [m/s²].
    """
    part = 1.0 if steps >= _STEPS_COMPARED else 1.0 / _EARLY_DIVISOR
    latest, flowing = missing[-max(steps + 1, _STEPS_COMPARED) :], current[-max(steps + 1, _STEPS_COMPARED) :]
    own = latest[:, coil]
    loss = -float(own @ flowing) / max(float(flowing @ flowing), 1e-12)
    if not min(abs(loss - 1.0), abs(loss - 2.0)) < part * _TOLERANCE_OF_LOSS:  # also for NaN
        return 0.0
    left = latest.copy()
    left[:, coil] += loss * flowing
    if float(((left * sizes) ** 2).sum()) > _LEFT_IN_OTHER_COILS * float(((latest * sizes) ** 2).sum()):
        return 0.0
    varied = flowing - flowing.mean()
    square = max(float(varied @ varied), 1e-12)
    slope = -float(own @ varied) / square
    error = max(math.sqrt(float((left[:, coil] ** 2).mean())), noise / sizes[coil]) / math.sqrt(square)
    if not (abs(slope - loss) < part * _TOLERANCE_OF_SLOPE * loss and slope > _ERRORS_OF_SLOPE * error):
        return 0.0
    # a coil fails at once, within one step; a finger presses more slowly
    lost, full = -missing[:, coil], loss * current
    between = (
        np.minimum(np.abs(lost), np.abs(lost - full)) > _TOLERANCE_OF_LOSS * np.abs(full) + 2.0 * noise / sizes[coil]
    )
    return loss if int(between.sum()) <= 1 else 0.0


class Residual:
    """Residual of a flight: measured minus driven acceleration, suspicions, probes and named causes.

    On six axes, every 5 ms: second differences of the pose over two steps minus the exactly weighted acceleration by
    the currents between; rotations at their radius of gyration. The weight cancels in the differences that are judged.

    Args:
        calibration: Calibration of the device.
        period: Sample period [s].
        delay: Time from an answer's arrival to its effect [s].
        seed: Seed of the signs.

    Attributes:
        watching: True after takeoff until the currents are off; otherwise nothing is suspected.
        delay: Largest delay of the sensor that was named [s].
        coil: Message about a coil that was named; "" without.
        reversed: True if the pose was found to move against the commands.
        outcomes: Number of probes by their outcome.
        amplitudes: Currents of a probe [A], six.
    """

    def __init__(self, calibration: Calibration, period: float, delay: float = 0.0, seed: int = 0) -> None:
        self._period, self._stride = period, max(1, round(_STEP_OF_RESIDUAL / period))
        self._step = step = self._stride * period
        self._parts = -(-3 // max(self._stride - 1, 1))  # of a judgement, in each sample between two steps
        body, coils, scale = calibration.body, calibration.coils, calibration.device.scale
        radii = np.sqrt(body.inertia / calibration.mass)
        self._unit = unit = 1.0 / (calibration.mass * radii)
        self._scaled = body.inertia * unit / step**2
        self._to_coils = np.linalg.inv(coils.wrench_per_current) / unit
        self._sizes = np.linalg.norm(coils.wrench_per_current * unit[:, None], axis=0)
        self._least, self._excited = scale.least, _LEAST_CHANGES * scale.probe**2
        self._largest = _LARGEST_CHANGE * scale.probe**2
        limit = calibration.base.coils.current_limit if calibration.base.coils is not None else math.inf
        self.amplitudes = np.minimum(scale.probe / self._sizes, 0.25 * limit)
        every = 1.0 - 2.0 * (np.arange(64)[:, None] >> np.arange(6) & 1)
        moved = (every * self.amplitudes @ (coils.wrench_per_current * unit[:, None]).T) ** 2
        least = (moved[:, None] + moved).min(axis=2)  # on the axis that two blocks move least
        self._pairs = list(every[np.argwhere(least >= _LEAST_COVERAGE * least.max())])
        self._noise = math.sqrt(70.0) * scale.noise / 6.0 / step**2
        self._causes = Causes(calibration, unit, self._to_coils, self._noise)
        self._range = calibration.base.reach
        # the effect of a sign should begin half a step from the grid, where its triangle does not cancel it
        self._phase = round(self._stride * (0.5 - (delay / step) % 1.0)) % self._stride
        lags = np.zeros((len(_SUSPECTED_DELAYS) + 2, _LONGEST_DELAY + 2))
        lags[0, 0], lags[-1, 0] = 1.0, -1.0
        for row, lag in enumerate(_SUSPECTED_DELAYS, 1):
            whole = int(lag)
            lags[row, whole], lags[row, whole + 1] = 1.0 - (lag - whole), lag - whole
        self._lags = lags
        self._fade = math.exp(-step / _TIME_OF_SUSPICION)
        self._random = random.Random(seed)
        self.reset()

    def reset(self) -> None:
        """Forget all samples, probes and names."""
        self.watching, self.delay, self.coil, self.reversed = False, 0.0, "", False
        self.outcomes: Counter[str] = Counter()
        self._clear: list[bool] = []
        self._tick = 0
        self._totals: list[Sums] = [(ZERO, ZERO), (ZERO, ZERO)]
        self._before: Array | None = None
        self._poses = np.full((3, 6), np.nan)
        # measured, driven and by the probe, newest last
        self._rows = np.zeros((_MOST_STEPS_JUDGED + _LONGEST_DELAY + 2, 3, 6))
        self._rows[:, 0] = np.nan
        self._sums = np.zeros(len(self._lags))
        self._signs: Array | None = None
        self._work: Generator[None, None, Evidence | None] | None = None
        self._again, self._wait, self._calm = 0, 0.0, [-math.inf] * 3
        self._coil: tuple[int, Array, int] | None = None  # suspected, what was missing before, and steps since

    def __str__(self) -> str:
        """Return the number of probes by their outcome; "" without."""
        if not self.outcomes:
            return ""
        count, most = self.outcomes.total(), float(self.amplitudes.max())
        named = ", ".join(f"{number} {kind}" for kind, number in sorted(self.outcomes.items()))
        return f"{count} probe{'s' * (count > 1)} of up to {most:.2g} A in each coil: {named}"

    def add(self, position: Sequence[float], driven: Sums, probe: Sums) -> None:
        """Add a pose, NaN if lost, and what the currents and the probe drove in the period before it."""
        begin = self._tick % self._stride * self._period
        for place, (impulse, moment) in enumerate((driven, probe)):
            if impulse is not ZERO:
                total, turned = self._totals[place]
                later = [q + m + begin * p for q, m, p in zip(turned, moment, impulse)]
                self._totals[place] = [t + p for t, p in zip(total, impulse)], later
        self._tick += 1
        if self._tick % self._stride == 0:
            self._add_step(position)
        elif self._work is not None:
            self._decide()

    def _add_step(self, position: Sequence[float]) -> None:
        now, step, poses, rows = np.array(self._totals), self._step, self._poses, self._rows
        before, self._before, self._totals = self._before, now, [(ZERO, ZERO), (ZERO, ZERO)]
        poses[:-1] = poses[1:]
        poses[-1] = position
        if before is None:
            return
        rows[:-1] = rows[1:]
        rows[-1, 0] = (poses[2] - 2.0 * poses[1] + poses[0]) * self._scaled
        rows[-1, 1:] = (before[:, 1] + step * now[:, 0] - now[:, 1]) * (self._unit / step**2)
        shares = np.abs(poses[-1]) / self._range
        self._clear = [
            *self._clear[1 - _MOST_STEPS_JUDGED :],
            bool(shares[:3].max() + shares[3:].max() < _TOUCHED_STOP),
        ]
        self._wait -= step
        if not self.watching:
            self._signs, self._work, self._coil, self._again = None, None, None, 0
            self._sums[:] = 0.0
            return
        suspected = self._suspects_coil()
        if self._signs is not None:
            self._examine()
        elif self._wait <= 0.0 and (self._again or suspected or self._suspects(bool((shares[:3] > _NEAR_STOP).any()))):
            self._begin()

    # ---- suspicion
    def _suspects(self, near: bool) -> bool:
        """Return True if a delay or a reversed pose would explain the changes of the last steps."""
        rows = self._rows
        change = rows[-1, 0] - rows[-2, 0]
        driven = rows[: -_LONGEST_DELAY - 4 : -1, 1]
        changes = driven[:-1] - driven[1:]
        squares = ((change - self._lags @ changes)[:, :3] ** 2).sum(axis=1)
        if not math.isfinite(float(squares.sum())):
            self._sums[:] = 0.0
            return False
        self._sums = sums = self._fade * self._sums + np.minimum(squares, self._largest)
        return bool(not near and sums[0] > self._excited and sums[1:].min() < _LEFT_BY_SUSPECT * sums[0])

    def _suspects_coil(self) -> bool:
        """Return True if one coil alone lacks its force, or twice that; name it if that follows its current."""
        if self._coil is None:
            rows = self._rows[-_STEPS_OF_FAILURE:]
            missing = (rows[:, 0] - rows[:, 1]) @ self._to_coils.T
            before = missing[:_STEPS_COMPARED].mean(axis=0)
            changes = missing[-_STEPS_COMPARED:] - before
            squares = (changes**2).sum(axis=0)
            coil, total = int(squares.argmax()), float(squares.sum())
            if not total > _STEPS_COMPARED * self._least**2:  # also for NaN, of a lost sample
                return False
            current = rows[:, 1] @ self._to_coils[coil]
            for driven in (current[-_STEPS_COMPARED:], current[-_STEPS_COMPARED:] - current[:_STEPS_COMPARED].mean()):
                own = max(float(driven @ driven), 1e-12)
                common = float(changes[:, coil] @ driven)
                tolerance = min(abs(common + loss * own) for loss in (1.0, 2.0))
                if (
                    tolerance < _TOLERANCE_OF_SUSPECTED_LOSS * own
                    and total - common**2 / own < _LEFT_BY_SUSPECTED_COIL * total
                ):
                    self._coil = coil, before, 0
                    break
            else:
                return False
        coil, before, steps = self._coil
        rows = self._rows[-steps - _STEPS_OF_FAILURE :]
        missing, current = (rows[:, 0] - rows[:, 1]) @ self._to_coils.T - before, rows[:, 1] @ self._to_coils[coil]
        if loss := follows(missing, current, coil, steps, self._sizes, self._noise):
            self._end("coil", coil, loss)
        self._coil = (coil, before, steps + 1) if steps < _MOST_STEPS_FOLLOWED and not loss else None
        return not loss

    # ---- probe
    def _begin(self) -> None:
        blocks = np.concatenate([self._random.choice(self._pairs) for _ in range(_MOST_BLOCKS // 2)])
        self._signs = (blocks[:, None, :] * np.array(_SIGNS_OF_BLOCK)[:, None]).reshape(-1, 6) * self.amplitudes
        self._began, self._steps, self._work = -1, 0, None

    def currents(self) -> Sequence[float] | None:
        """Return the currents of the probe for the next answer [A], six; None without."""
        if self._signs is None or not self.watching:
            return None
        if self._began < 0:
            if self._tick % self._stride != self._phase:
                return None
            self._began = self._tick
        place = (self._tick - self._began) // self._stride
        return self._signs[place].tolist() if place < len(self._signs) else None

    def _examine(self) -> None:
        """Examine one more step of a probe."""
        if self._began < 0:
            return
        self._steps += 1
        if self._steps >= _LEAST_STEPS_JUDGED:
            rows = self._rows[-(min(self._steps, _MOST_STEPS_JUDGED) + _LONGEST_DELAY + 2) :]
            clear = all(self._clear[-min(self._steps, _MOST_STEPS_JUDGED) :])
            self._work = self._causes.compare(rows[:, 0], rows[:, 1], rows[:, 2], clear)
            if self._stride == 1:
                self._decide()

    def _decide(self) -> None:
        """Continue the judgement of a step: in one sample at 200 Hz, in three at 1 kHz."""
        assert self._work is not None
        try:
            for _ in range(self._parts):
                next(self._work)
            return
        except StopIteration as result:
            found: Evidence | None = result.value
        self._work = None
        assert self._signs is not None
        if found is not None and (kind := verdict(found, self._steps)):
            self._end(kind, found.place, found.size)
        elif self._steps >= len(self._signs) + _LEAST_STEPS_JUDGED:
            self._end("inconclusive")

    def _end(self, kind: str, index: int = 0, size: float = 0.0) -> None:
        """End a probe with its outcome."""
        self.outcomes[kind] += 1
        again, self._again = self._again, 0
        self._signs, self._work, self._wait = None, None, 0.0
        self._sums[:] = 0.0
        if kind == "inconclusive":
            self._again = (again + 1) % _MOST_PROBES
            self._wait = 0.0 if self._again else _PAUSE_OF_PROBES
        elif kind == "as calibrated":
            self._calm = [*self._calm[1:], self._tick * self._period]
            self._wait = _PAUSE_OF_PROBES if self._calm[-1] - self._calm[0] < 1.0 else 0.0
        elif kind == "delay":
            self.delay = max(self.delay, size * self._step)
        elif kind == "coil":
            self.coil = f"coil {index} gives {100.0 * (1.0 - size):.0f} % of its calibrated force"
        elif kind == "reversed":
            self.reversed = True
        else:
            self._wait = _PAUSE_OF_PROBES

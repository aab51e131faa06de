"""Exact motion between samples.

It is stored at every switch of the force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component
from maglev_mj.parameters import numbers
from maglev_mj.result import Result


class TraceRecorder:
    """Recorder of the states at each switch.

    It makes arrays of them at the end.

    Args:
        time: Function from a tick and an offset [s] to the time [s].
        arrays: Function from K stored states to pose, twist and wrench, (K, ..., 6) each.
    """

    def __init__(
        self,
        time: Callable[[int, Component], Any],
        arrays: Callable[[Sequence[Any]], tuple[Array, Array, Array]],
    ) -> None:
        self._time, self._arrays = time, arrays
        self._rows: list[tuple[int, Component, Any]] = []

    def add(self, tick: int, offset: Component, state: Any) -> None:
        """Store the state at `offset` [s] after sample `tick`.

        The state must not change afterwards.
        """
        self._rows.append((tick, offset, state))

    def finish(self, tick: int, state: Any) -> Trace:
        """Return the trace up to the state at `tick`."""
        ticks, offsets, states = zip(*self._rows, (tick, 0.0, state))
        pose, twist, wrench = self._arrays(states)
        time = np.empty(pose.shape[:-1])
        for row, when in enumerate(map(self._time, ticks, offsets)):
            time[row] = when
        return Trace(time, pose, twist, wrench)


@dataclass(frozen=True, eq=False)
class Trace(Result):
    """Motion as knots at the switches of the wrench.

    Each knot has the state, and the wrench that acts until the next knot.

    Under a wrench that is constant between knots the motion is a parabola, which the cubic Hermite curve
    through position and velocity at both ends reproduces exactly; evaluation between knots adds no error. For
    rotations this is true about one axis at a time; about several axes the error is of second order in the angle.

    Attributes:
        time: Knot times since release [s], (K, ...).
        pose: Pose at the knots [m, rad], (K, ..., 6).
        twist: Velocity at the knots [m/s, rad/s], (K, ..., 6).
        wrench: Wrench of the actuators from each knot on [N, N m], (K, ..., 6), without gravity.
    """

    time: Array
    pose: Array
    twist: Array
    wrench: Array
    drawn_by: ClassVar = "maglev_mj.analysis.pictures:trace"

    def columns(self) -> dict[str, Array]:
        """Return the knots, a column for each coordinate, (K,) each.

        Such as `pose.z`.

        Raises:
            ParameterError: If the trace is not of one device on six axes.
        """
        if self.pose.ndim != 2 or self.pose.shape[1] != len(AXES):
            raise ParameterError(f"trace must be of one device on six axes, (K, 6), not {self.pose.shape}")
        parts = {"pose": self.pose, "twist": self.twist, "wrench": self.wrench}
        six = {f"{name}.{axis}": part[:, index] for name, part in parts.items() for index, axis in enumerate(AXES)}
        return {"time": self.time, **six}

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        units = {"pose": ("m", "rad"), "twist": ("m/s", "rad/s"), "wrench": ("N", "N m")}
        six = {f"{name}.{axis}": of[index // 3] for name, of in units.items() for index, axis in enumerate(AXES)}
        return {"time": "s", **six}

    def at(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Evaluate at given times.

        Args:
            time: Times since release [s], (M,), within the trace.

        Returns:
            Pose, twist and wrench, (M, ..., 6) each. At a switch the wrench is the one that begins there.

        Raises:
            ParameterError: If a time is outside the trace.
        """
        times = np.atleast_1d(numbers("time", time))
        if times.ndim > 1:
            raise ParameterError(f"time must be a number or (M,), not {times.shape}")
        first, last = float(self.time[0].max()), float(self.time[-1].min())
        if times.size and not (first - 1e-12 <= times.min() and times.max() <= last + 1e-12):
            raise ParameterError(f"time must be from {first:g} to {last:g}, not {times.min():g} to {times.max():g}")
        knots = self.time.reshape(len(self.time), -1)
        # a picosecond past the knot still counts as the knot: switch times and grid times round differently
        index = np.stack([np.searchsorted(column, times + 1e-12, side="right") - 1 for column in knots.T], axis=-1)
        index = np.clip(index, 0, len(knots) - 2).reshape(times.shape + self.time.shape[1:])
        start, end = (np.take_along_axis(self.time, index + shift, axis=0) for shift in (0, 1))
        width = np.where(end > start, end - start, 1.0)
        where = (times.reshape((-1,) + (1,) * (self.time.ndim - 1)) - start)[..., None]
        wide = index[..., None]
        x0, x1, v0, v1 = (
            np.take_along_axis(values, wide + shift, axis=0) for values in (self.pose, self.twist) for shift in (0, 1)
        )
        wrench = np.take_along_axis(self.wrench, wide, axis=0)
        h = width[..., None]
        s = where / h
        # the cubic beyond the parabola through x0, v0, v1; zero but for rounding under a constant wrench
        bend = (x1 - x0) - 0.5 * h * (v0 + v1)
        pose = x0 + h * s * (v0 + 0.5 * s * (v1 - v0)) + bend * s * s * (3.0 - 2.0 * s)
        twist = v0 + s * (v1 - v0) + bend * 6.0 * s * (1.0 - s) / h
        final = np.abs(times.reshape(where.shape[:1] + (1,) * (where.ndim - 1)) - self.time[-1][..., None]) <= 1e-12
        return pose, twist, np.where(final, self.wrench[-1], wrench)

    def along(self, axis: int) -> Trace:
        """Return one coordinate of the motion.

        The last dimension is 1.
        """
        parts = (part[..., axis : axis + 1] for part in (self.pose, self.twist, self.wrench))
        return Trace(self.time, *parts)

    def furthest(self) -> Array:
        """Return the largest distance from zero, (..., 6).

        On each coordinate [m, rad].

        Motion between knots is included; exact under a constant wrench.
        """
        places = np.concatenate([self.pose, self.turning_points()[1]])
        furthest: Array = np.abs(places).max(axis=0)
        return furthest

    def until(self, end: float) -> Trace:
        """Return the trace cut off at `end` [s].

        Later knots become copies of the state at the end.

        Raises:
            ParameterError: If `end` is outside the trace.
        """
        pose, twist, wrench = self.at(end)
        beyond = self.time > end
        wide = beyond[..., None]
        cut = Trace(
            np.where(beyond, end, self.time),
            np.where(wide, pose, self.pose),
            np.where(wide, twist, self.twist),
            np.where(wide, wrench, self.wrench),
        )
        keep = np.flatnonzero(~beyond.reshape(len(beyond), -1).all(axis=1))
        last = min(int(keep[-1]) + 2, len(beyond)) if keep.size else 1
        return Trace(cut.time[:last], cut.pose[:last], cut.twist[:last], cut.wrench[:last])

    def turning_points(self) -> tuple[Array, Array]:
        """Return times and poses of turning points between knots.

        Returns:
            Times and positions, (K - 1, ..., 6) each; for a coordinate without a turning point between two knots,
            those of the first knot. Exact under a constant wrench.
        """
        h = np.diff(self.time, axis=0)[..., None]
        v0, v1 = self.twist[:-1], self.twist[1:]
        turns = v0 * v1 < 0.0
        share = np.where(turns, v0 / np.where(turns, v0 - v1, 1.0), 0.0)
        return self.time[:-1][..., None] + share * h, self.pose[:-1] + 0.5 * share * h * v0

"""Check of a user's control law.

Its answer has finite components and changes nothing but the wrench; one device and a batch give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from maglev_mj.control.laws.base import Law, answer, as_law
from maglev_mj.control.laws.velocity import FiniteDifference
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, Component, components

_DEVICES, _SAMPLES, _PERIOD = 7, 60, 0.005
_REACH = np.array([4e-3] * 3 + [0.09] * 3)


def check_law(law: Law | Callable[..., Any]) -> None:
    """Check a law along random trajectories of seven devices.

    The trajectories are seeded and cover the motion range.

    Args:
        law: The law, or a function f(position, velocity), for one device.

    Raises:
        ParameterError: If an answer has a wrong shape or is not finite, the law changes its input, a repeated call
            gives another answer, one device and a batch differ in a bit, or the wrench is zero at every sample.

    Example:
        >>> from maglev_mj import Hold
        >>> check_law(Hold(axes="z", stiffness=3000.0, damping=50.0))
    """
    one = as_law(law)
    name = f"law {getattr(one, 'name', type(one).__name__)}"
    if one.batch:
        raise ParameterError(f"{name} must be of one device to be checked, not of shape {one.batch}")
    random = np.random.default_rng(0)
    phase, rate = random.uniform(0.0, 6.3, (2, _DEVICES, 6))
    paths = [_REACH * np.sin(phase + 0.1 * rate * tick) for tick in range(_SAMPLES)]
    single = np.stack([_answers(one, name, [path[device] for path in paths]) for device in range(_DEVICES)], axis=1)
    try:
        batch = _answers(one, name, paths)
    except MaglevError as error:
        raise ParameterError(f"{name} must take N devices as arrays: {error}") from None
    if not single.any():
        raise ParameterError(
            f"{name} must add to the wrench it is given, as in wrench[0] = wrench[0] + ..., not nothing"
        )
    if len(wrong := np.argwhere(single != batch)):
        tick, device, part = wrong[0]
        raise ParameterError(
            f"{name} must give one device and a batch the same bits: on {(AXES * 2)[part]}, at sample {tick}, it gives "
            f"{float(single[tick, device, part])!r} and {float(batch[tick, device, part])!r}"
        )


def _answers(law: Law, name: str, poses: Sequence[Array]) -> Array:
    """Return wrench and pulse at each sample, (M, ..., 12)."""
    estimate, state, seen, rows = FiniteDifference(), law.start(), None, []
    for pose in poses:
        position = components(pose)
        velocity, seen = estimate(position, seen, _PERIOD)
        first, again = (_row(law, position, velocity, state, pose.shape) for _ in range(2))
        if not np.array_equal(first[1], again[1]):
            raise ParameterError(
                f"{name} must answer the same state and sample alike each time: it keeps or changes a state"
            )
        state = again[0]
        rows.append(again[1])
    return np.array(rows)


def _row(
    law: Law, position: Sequence[Component], velocity: Sequence[Component], state: Any, shape: tuple[int, ...]
) -> tuple[Any, Array]:
    """Return the next state, and wrench and pulse, (..., 12)."""
    wrench: list[Component] = [0.0] * 6
    following, pulse = answer(law, list(position), list(velocity), state, wrench)
    row = np.empty((*shape[:-1], 12))
    for axis, part in enumerate((*wrench, *(pulse or (0.0,) * 6))):
        row[..., axis] = part
    return following, row

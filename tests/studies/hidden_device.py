"""Logs of hidden devices under a PD law, and their critical stiffness, from the equations of motion alone.

Nothing of the package is used: `equations` and `flow` are those of `exact_log`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from tests.studies.exact_log import Vector, equations, flow

_REACH = 0.01  # a log of an unstable loop ends here [m]


class Hidden(NamedTuple):
    """Device, in SI units: delay of its loop and sample period, what its body is, and its sensor."""

    period: float
    delay: float
    body: dict[str, Any]
    friction: float = 0.0
    quantum: float = 5e-6
    noise: float = 2e-6
    stop: float = math.inf
    limit: float = math.inf


def hidden(rng: np.random.Generator) -> Hidden:
    """Return a random device: 1 to 6 ms, 0.05 to 1.6 kg, delays to 2.4 periods, with own damping or friction or not."""
    period, mass = 10.0 ** rng.uniform(-3.0, -2.2), 10.0 ** rng.uniform(-1.3, 0.2)
    own = rng.choice([0.0, 1.0]) * mass / period * 10.0 ** rng.uniform(-3.0, -1.6)
    friction = rng.choice([0.0, 1.0]) * 10.0 ** rng.uniform(-2.5, -1.2) * mass
    sensor = {"quantum": rng.choice([1e-6, 5e-6, 1e-5]), "noise": rng.choice([1e-6, 2e-6, 4e-6])}
    return Hidden(period, period * rng.uniform(0.2, 2.4), {"mass": mass, "own": own}, friction, **sensor)


def radius(device: Hidden, stiffness: float, damping: float) -> float:
    """Return the spectral radius: body, commands under way, and the last position in one matrix."""
    a, force, sensed = equations(device.body)
    whole = math.floor(device.delay / device.period + 1e-9)
    rest = max(device.delay - whole * device.period, 0.0)
    (first, early), (second, late) = flow(a, force, rest), flow(a, force, device.period - rest)
    size, held = len(a), whole + 1
    step = np.zeros((size + held + 1, size + held + 1))  # body, commands newest first, last position
    step[:size, :size] = second @ first
    command = np.zeros(len(step))
    command[:size], command[-1] = -(stiffness + damping / device.period) * sensed, damping / device.period
    queue = np.zeros((held + 1, len(step)))  # in effect: that of `whole` samples ago, and the one before it
    queue[0], queue[1:, size : size + held] = command, np.eye(held)
    step[:size] += np.outer(late, queue[whole]) + np.outer(second @ early, queue[whole + 1])
    step[size : size + held], step[-1, :size] = queue[:held], sensed
    return float(np.abs(np.linalg.eigvals(step)).max())


def critical(device: Hidden, damping: float) -> float:
    """Return the stiffness up to which all softer walls are stable [N/m], by a grid and bisection."""
    grid = np.geomspace(1e-4, 4.0, 120) * device.body["mass"] / device.period**2
    bad = [index for index, stiffness in enumerate(grid) if radius(device, stiffness, damping) >= 1.0]
    if not bad or not bad[0]:
        return 0.0 if bad else float(grid[-1])
    low, high = grid[bad[0] - 1], grid[bad[0]]
    for _ in range(30):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if radius(device, middle, damping) < 1.0 else (low, middle)
    return float(low)


def log_of(device: Hidden, stiffness: float, damping: float, rng: np.random.Generator, count: int = 400,
           start: float = 2e-3, before: bool = False) -> Vector:  # fmt: skip
    """Return the measured positions after a release at a distance [m], (N,): with forces, or none, before it."""
    a, force, sensed = equations(device.body)
    whole = math.floor(device.delay / device.period + 1e-9)
    rest = max(device.delay - whole * device.period, 0.0)
    rough = device.friction > 0.0 or math.isfinite(device.stop)
    parts = 32 if rough else 1
    pieces = [flow(a, force, span / parts) for span in (rest, device.period - rest)]
    ground = np.eye(len(a))[1] / device.body["mass"]
    impulses = [flow(a, ground, span / parts)[1] for span in (rest, device.period - rest)]
    state, rows = start * np.eye(len(a))[0], list[float]()
    commands = [(-stiffness * start if before else 0.0)] * (whole + 1)
    last = math.nan
    for _ in range(count):
        raw = float(sensed @ state) + device.noise * rng.normal()
        seen = device.quantum * round(raw / device.quantum) if device.quantum else raw
        last = seen if math.isnan(last) else last
        wanted = -stiffness * seen - damping / device.period * (seen - last)
        commands.append(min(max(wanted, -device.limit), device.limit))
        last = seen
        if abs(seen) > _REACH:
            break
        rows.append(seen)
        for (phi, gamma), push, acting in zip(pieces, impulses, commands[-whole - 2 :][:2]):
            for _ in range(parts):
                extra = -2e4 * min(state[0] + device.stop, 0.0)  # beyond the rest, as a release is not in it
                if device.friction:
                    slide = float(np.clip(-state[1] / max(push[1], 1e-300), -device.friction, device.friction))
                    extra += slide  # at most what stops it
                state = phi @ state + gamma * acting + push * extra
    return np.array(rows)


def ring(device: Hidden, rng: np.random.Generator) -> tuple[float, float, Vector]:
    """Return gains at 0.6 of the critical stiffness with little damping, and a log with them."""
    free = device._replace(body={name: device.body[name] for name in ("mass", "own")})
    dampings = np.geomspace(0.03, 0.6, 6) * device.body["mass"] / device.period
    limits = [critical(free, float(damping)) for damping in dampings]
    best = int(np.argmax(limits))
    stiffness, damping = 0.6 * limits[best], 0.5 * float(dampings[best])
    return stiffness, damping, log_of(device, stiffness, damping, rng)

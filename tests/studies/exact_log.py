"""Logs of random sampled loops, simulated event by event from the equations of motion: independent of the package."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
ALIKE = 1e-12  # times that are one [s]


def flow(a: Vector, b: Vector, span: float) -> tuple[Vector, Vector]:
    """Return exp(a t) and its integral times b, by scaling and a Taylor series."""
    size = len(a)
    block = np.zeros((size + 1, size + 1))
    block[:size, :size], block[:size, size] = a * span / 2**12, b * span / 2**12
    total = term = np.eye(size + 1)
    for index in range(1, 10):
        term = term @ block / index
        total = total + term
    for _ in range(12):
        total = total @ total
    return total[:size, :size], total[:size, size]


def equations(body: dict[str, Any]) -> tuple[Vector, Vector, Vector]:
    """Return state space matrices, from commanded force to the sensed position, of a body with all that acts on it.

    States: position and speed; of a soft hand; deflection of the mode and its rate; force of the drivers.
    """
    hand, mode, lag, own = body.get("hand", ()), body.get("mode"), body.get("lag", 0.0), body.get("own", 0.0)
    soft = len(hand) == 5
    mass = body["mass"] + (hand[0] if hand and not soft else 0.0)
    size, first = 2 + 2 * soft + 2 * bool(mode) + bool(lag), 2 + 2 * soft
    a, force, sensed = np.zeros((size, size)), np.zeros(size), np.eye(size)[0]
    a[0, 1], a[1, 1], force[1] = 1.0, -own / mass, 1.0 / mass
    if hand and not soft:
        a[1, 0], a[1, 1] = -hand[2] / mass, -(own + hand[1]) / mass
    elif soft:
        other, arm_damping, arm, grip_damping, grip = hand
        pull = np.zeros(size)  # of the grip on the body
        pull[[0, 1, 2, 3]] = -grip, -grip_damping, grip, grip_damping
        a[1] += pull / mass
        a[2, 3] = 1.0
        a[3] = -pull / other
        a[3, 2] -= arm / other
        a[3, 3] -= arm_damping / other
    if mode:
        turn = 2.0 * math.pi * mode[0]
        a[first, first + 1], a[first + 1, first], a[first + 1, first + 1] = 1.0, -turn * turn, -2.0 * mode[1] * turn
        force[first + 1], sensed[first] = mode[2] / mass, 1.0
    if lag:
        a[:, -1] += force
        a[-1, -1], force = -1.0 / lag, np.eye(size)[-1] / lag
    return a, force, sensed


def exact_log(body: dict[str, Any], laws: list[dict[str, float]], step: float, count: int, largest: float) -> Vector:
    """Return positions at multiples of a step until the largest one, (N,): of PD laws with period, delay and cutoff."""
    a, force, sensed = equations(body)
    state, cache, now, rows = 1e-3 * np.eye(len(a))[0], dict[float, tuple[Vector, Vector]](), 0.0, list[float]()
    last, speed, acting = [1e-3] * len(laws), [0.0] * len(laws), [0.0] * len(laws)
    due: list[list[tuple[float, float]]] = [[] for _ in laws]
    ticks = [0] * len(laws)
    while len(rows) < count:
        times = [len(rows) * step, *(tick * law["period"] for tick, law in zip(ticks, laws))]
        times += [effects[0][0] for effects in due if effects]
        if (span := min(times) - now) > ALIKE:
            key = round(span, 13)
            if key not in cache:
                cache[key] = flow(a, force, span)
            phi, gamma = cache[key]
            state, now = phi @ state + gamma * sum(acting), min(times)
        position = float(sensed @ state)
        if len(rows) * step - now <= ALIKE:
            if not abs(position) < largest:
                break
            rows.append(position)
        for index, law in enumerate(laws):
            if ticks[index] * law["period"] - now <= ALIKE:
                raw = (position - last[index]) / law["period"]
                share = 1.0 - math.exp(-2.0 * math.pi * law["cutoff"] * law["period"]) if law.get("cutoff") else 1.0
                speed[index] += share * (raw - speed[index])
                last[index], ticks[index] = position, ticks[index] + 1
                due[index].append((now + law["delay"], -law["stiffness"] * position - law["damping"] * speed[index]))
            while due[index] and due[index][0][0] - now <= ALIKE:
                acting[index] = due[index].pop(0)[1]
    return np.array(rows)

"""Checks of walls on a device."""

from __future__ import annotations

from itertools import product
from typing import Any

from maglev_mj.bridge import wire
from maglev_mj.bridge.conformance.protocol import UNREAL
from maglev_mj.bridge.conformance.tester import Tester, case, check, constant, fail, shown
from maglev_mj.bridge.wire import Fault, Flag, State
from maglev_mj.frames import ZERO

_NO_WALLS = "not checked: the device renders no walls"
_PRESS = 0.44
"""Force of a wall that presses the flotor on its stop, as a share of the weight."""


def _pressing(t: Tester) -> tuple[wire.WallMessage, list[float]]:
    """Bring the device to ACTIVE; return a wall that presses the flotor on its stop, and its currents [A]."""
    t.bring(State.ACTIVE)
    depth = 0.8e-9 * t.welcome.edge_speed * t.welcome.period
    sizes = t.calibration.device.sizes
    force = _PRESS * sizes.mass * sizes.gravity
    stiffness = min(force / depth, t.welcome.stiffness_limit) if depth else 0.0
    edge = t.calibration.wall_maps.pose(t.last.body.spots)[2] - depth
    per_force = t.calibration.coils.current_per_wrench[:, 2]
    return wire.WallMessage(2, -1, edge, stiffness, 0.0, 0.0), (-stiffness * depth * per_force).tolist()


@check("walls of a CMD add their force at the diodes' pose, end with the CMDs that name them, and stand in silence")
def _walls(t: Tester) -> str:
    if not t.welcome.wall_period:
        return _NO_WALLS
    wall, currents = _pressing(t)
    for held in (ZERO, t.half):
        t.walls, t.law = (wall,), constant(held)
        t.close(t.states(6)[-1], [a + b for a, b in zip(held, currents)])
    t.walls = ()
    t.close(t.states(6)[-1], t.half)
    if not t.welcome.lockstep:
        for side, expected in ((-1, currents), (0, ZERO)):
            t.bring(State.ACTIVE)
            t.walls = (wall._replace(side=side),)
            t.states(6)
            t.answering = False
            frames = t.states(t.welcome.watchdog // t.welcome.period)
            waiting = [frame for frame in frames if frame.body.flags & Flag.HOLDING] or fail("HOLDING is never set")
            t.close(waiting[-1], [a + b for a, b in zip(t.half, expected)])
    return f"{shown(currents)} A for {wall.stiffness:.3g} N/m"


@check("a wall that is not finite, above its limits, around the flotor or jumping ends in INVALID_COMMAND")
def _wall_limits(t: Tester) -> str:
    if not t.welcome.wall_period:
        return _NO_WALLS
    step, most = 2e-9 * t.welcome.edge_speed * t.welcome.period, t.welcome.stiffness_limit
    bad: list[dict[str, Any]] = [{"axis": 6}, {"side": 2}, {"side": -2}, {"cutoff": -1.0}]
    bad += [{name: value} for name in ("edge", "stiffness", "damping", "cutoff") for value in UNREAL]
    bad += [
        {"stiffness": -1.0},
        {"stiffness": 1.001 * most},
        {"axis": 3, "stiffness": 1.01 * t.welcome.lever**2 * most},
    ]
    bad += [{"damping": -1.0}, {"damping": 1.001 * t.welcome.damping_limit}]
    for change in (*bad, {"edge": -step}, {"edge": step, "side": 1}, {"edge": step, "side": 0}, {"edge": step}):
        wall, _ = _pressing(t)
        if set(change) == {"edge"} and change["edge"] == step:  # of a wall that continues
            t.walls = (wall,)
            t.states(3)
        if "edge" in change:
            change = change | {"edge": wall.edge + change["edge"]}
        once: list[Any] = [ZERO, (), 0.0, (wall._replace(**change),)]
        t.once, t.walls = [once], ()
        with case(", ".join(f"{name} {value:g}" for name, value in change.items())):
            t.expect(State.FAULT, Fault.INVALID_COMMAND, 1)
    return f"INVALID_COMMAND, {len(bad) + 4} walls"


def _clear(t: Tester, side: int = -1) -> wire.WallMessage:
    """Bring the device to ACTIVE; return a wall without gains, 1 mm off the flotor, or at it if on both sides."""
    t.bring(State.ACTIVE)
    edge = t.calibration.wall_maps.pose(t.last.body.spots)[2] - 1e-3 * side
    return wire.WallMessage(2, side, edge, 0.0, 0.0, 0.0)


@check("walls that push the same way along an axis are within the limits together, or end in INVALID_COMMAND")
def _wall_sums(t: Tester) -> str:
    if not t.welcome.wall_period:
        return _NO_WALLS
    limits = {"stiffness": t.welcome.stiffness_limit, "damping": t.welcome.damping_limit}
    sums = ((-1,) * 4, 0.25), ((-1, 1), 1.0), ((-1, 0, 1), 0.5), ((-1,) * 4, 0.26), ((-1, 0), 0.51), ((0, 1), 0.51)
    for (name, limit), (sides, share) in product(limits.items(), sums):
        change: dict[str, Any] = {name: share * limit}
        walls = tuple(_clear(t, side)._replace(**change) for side in sides)
        once: list[Any] = [ZERO, (), 0.0, walls]
        t.once, renders = [once], share not in (0.26, 0.51)
        with case(f"walls on sides {shown(sides)}, {share:.0%} of the {name} limit each"):
            t.expect(State.ACTIVE if renders else State.FAULT, 0 if renders else Fault.INVALID_COMMAND, 1)
    return f"{2 * len(sums)} of {2 * len(sums)}"


@check("edges move with the newest answered sample: an answer to an older one moves none", real_time=True)
def _wall_edges(t: Tester) -> str:
    if not t.welcome.wall_period:
        return _NO_WALLS
    step, oldest = 1e-9 * t.welcome.edge_speed * t.welcome.period, t.welcome.stale // t.welcome.period - 1
    # ages of the answered samples, and positions of the edge in steps, at successive samples
    cases: list[tuple[tuple[int, float], ...]] = [((0, 0.0), (0, 1.0), (0, 2.0))]
    cases += [((0, 0.0), (age, 0.5)) for age in range(1, oldest + 1)]
    cases += [((0, 0.0), (age, 0.0), (0, 2.5)) for age in range(2, oldest + 1)]
    for answers in cases:
        wall = _clear(t)
        t.answering = False
        for age, moved in answers:
            t.states(1)
            t.command(t.last.sequence - age, ZERO, walls=(wall._replace(edge=wall.edge + moved * step),))
        t.answering, renders = answers is not cases[0], answers is cases[0]
        shares = ", ".join(f"{moved:g} steps answering {age} samples before" for age, moved in answers)
        with case(f"edge at {shares}"):
            t.expect(State.ACTIVE if renders else State.FAULT, 0 if renders else Fault.INVALID_COMMAND, 1)
    return f"{len(cases)} of {len(cases)}"

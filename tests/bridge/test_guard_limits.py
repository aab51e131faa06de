"""Every limit of the guards outside the observer, pinned from both sides.

Each row names a limit and a stimulus in units of it, in figures of the published joystick: at 0.9 it passes, at 1.1 it
trips. With the limit 20 % larger or smaller the row must fail; a count is changed by one.
"""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj import Sample
from maglev_mj.bridge import connection, flight_guards, landing, preflight, remote, safety
from maglev_mj.bridge.connection import SampleCounter
from maglev_mj.bridge.flight_guards import DelayGuard, PowerGuard, delay_limit
from maglev_mj.bridge.landing import Leader, RecentMotion, Swing, straight
from maglev_mj.bridge.safety import CoilGuard, FlotorGuard, HostLimits, Limits, Profile, SpotGuard, ThermalModel
from maglev_mj.bridge.twin import firmware
from maglev_mj.bridge.twin.firmware import Firmware, Walls
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Fault, Flag, Operation, WallMessage
from maglev_mj.device import published_device
from maglev_mj.errors import PlantError
from maglev_mj.scale import Scale
from tests.bridge.test_bridge import CENTRE, Rig
from tests.bridge.test_flight_guards import HEAVY
from tests.bridge.test_preflight import GOOD, JOYSTICK

ZERO = (0.0,) * 6
PERIOD = 0.005
DEVICE = published_device()


class World(NamedTuple):
    """Thresholds and limits of a device, one of them changed."""

    scale: Scale
    limits: Limits


class Pin(NamedTuple):
    """A limit, where it stands, and its stimulus: True if a share of it trips."""

    where: Any
    name: Any
    trips: Callable[[float, World], bool]

    def value(self, world: World) -> Any:
        """Return the limit."""
        if isinstance(self.where, str):
            return getattr(getattr(world, self.where), self.name)
        name, *places = self.name if isinstance(self.name, tuple) else (self.name,)
        value = getattr(self.where, name)
        for place in places:
            value = value[place]
        return value


def six(axis: int, value: float) -> tuple[float, ...]:
    return tuple(value if place == axis else 0.0 for place in range(6))


def flown(axis: int, far: float, *, elapsed: float = 0.0) -> Callable[[float, World], bool]:
    """Return a stimulus: a pose, or a step within a time, for the guard of the flotor."""

    def trips(share: float, world: World) -> bool:
        guard = FlotorGuard(HostLimits().scaled(world.scale), world.scale)
        guard.check(ZERO, 0.0)
        # far outside of the envelope no speed is said, and the reverse
        fault = Fault.FLOTOR_OVERSPEED if elapsed else Fault.BOUNDARY
        return fault in guard.check(six(axis, share * far), elapsed)

    return trips


def power(world: World, inertia: Sequence[float] = HEAVY, period: float = 1e-4) -> PowerGuard:
    return PowerGuard(period, inertia, world.scale)


def reversed_forces(guard: PowerGuard, size: float, count: int) -> str:
    """Alternate a force; return what the guard says of `2 count + 1` times its size in reversals."""
    said = ""
    for tick in range(count + 4):
        said = said or guard.check(ZERO, six(0, size * (tick > 0) * (-1) ** tick))
    return said


def pushed(guard: PowerGuard, energy: float, force: float = 1.0) -> bool:
    """Push along a path; return True if the guard says that the laws generate energy."""
    said = ""
    path = energy / abs(force)
    for x in np.linspace(0.0, path, 20):
        said = said or guard.check(six(0, float(x)), six(0, force))
    guard.check(six(0, path), ZERO)
    guard.check(ZERO, ZERO)
    return "generate energy" in said


def stored(share: float, world: World) -> bool:
    guard = power(world, period=1e-3)
    pushed(guard, 0.15, -1.0)  # put in by a hand
    for _ in range(3000):
        guard.check(ZERO, ZERO)
    return pushed(guard, share * (0.045 + 0.008))


def forgotten(share: float, world: World) -> bool:
    guard = power(world, period=1e-3)
    pushed(guard, 0.006)
    for _ in range(round(1099 / share)):
        guard.check(ZERO, ZERO)
    return pushed(guard, 0.006)


def remembered(share: float, world: World) -> bool:
    """Two bursts of 200 N, the second while 38 % of the first count."""
    guard = power(world, period=1e-3)
    said = reversed_forces(guard, 40.0, 2)
    for _ in range(round(192 / share)):
        guard.check(ZERO, ZERO)
    return bool(said or reversed_forces(guard, 40.0, 2))


def delays(place: int) -> tuple[Any, Any, Any]:
    """Return stimuli of a rule for late answers: count, window and delay."""
    count, window, factor = ((3, 5, 3.0), (8, 16, 1.25), (48, 64, 1.0))[place]
    late = 1.05 * factor * 3e-3

    def counted(share: float, world: World) -> bool:
        guard = DelayGuard(3e-3)
        return any([guard.check(late) for _ in range(count - (share < 1.0))])

    def spread(share: float, world: World) -> bool:
        guard, length = DelayGuard(3e-3), window + (share < 1.0)  # the last within the window, or just outside
        series = [late] * (count - 1) + [0.0] * (length - count) + [late]
        return any([guard.check(delay) for delay in series])

    def delayed(share: float, world: World) -> bool:
        guard = DelayGuard(3e-3)
        return any([guard.check(share * factor * 3e-3) for _ in range(count)])

    return counted, spread, delayed


def swung(speed: float, time: float) -> Callable[[float, World], bool]:
    def trips(share: float, world: World) -> bool:
        swing, fast, longest = Swing(world.scale.drop), speed, time
        fast, longest = (share * speed, time) if time > 0.1 else (speed, share * time)
        return any([swing.check([fast * 1e-3 * k, 0.0, 0.0], 1e-3 * k) for k in range(round(1e3 * longest) + 1)])

    return trips


def held(share: float, world: World) -> bool:
    guards = flight_guards.device_guards(world.limits, HostLimits(), PERIOD, world.scale)
    report = SimpleNamespace(flags=Flag.HOLDING, age=round(1e4 / share))
    (holding,) = (check for _, check in guards if getattr(check, "func", None) is flight_guards._holding)
    return holding(SimpleNamespace(active=True, report=report)) is not None  # type: ignore[arg-type]


def stamped(share: float, world: World) -> bool:
    counter = SampleCounter(5_000_000)
    counter.count(0, 0, 0)
    counter.count(1, 5_000_000 + round(share * 2_500_000), 0)
    return bool(counter.out_of_step)


def followed(command: float, error: Callable[[float], float], times: int = 3) -> Callable[[float, World], bool]:
    def trips(share: float, world: World) -> bool:
        guard, count = CoilGuard(world.limits), times if times == 3 else 3 - (share < 1.0)
        return any([guard.check(six(2, command), six(2, command + error(share))) for _ in range(count)])

    return trips


def read(current: float, rise: float) -> Callable[[float, World], bool]:
    return lambda share, world: bool(safety.reading_fault(world.limits, six(1, share * current), six(4, share * rise)))


def spotted(value: float, fault: Fault, *, speed: float | None = None) -> Callable[[float, World], bool]:
    def trips(share: float, world: World) -> bool:
        guard = SpotGuard(world.limits if speed is None else world.limits.replace(spot_speed=speed), PERIOD)
        guard.check(ZERO, 7, 0, 1)
        return fault in guard.check(six(3, share * value), 7, 1, 1)

    return trips


def frozen(share: float, world: World) -> bool:
    guard = SpotGuard(world.limits, PERIOD)
    return any([guard.check(ZERO, 7, count, 1) for count in range(31 - (share < 1.0))])


def warmed(share: float, world: World) -> bool:
    """6 A reach the limit of 3 A after -10 s ln(1 - 1/4)."""
    return ThermalModel(world.limits).add([(share * 2.8768, six(0, 6.0))]) >= 1.0


def warned(share: float, world: World) -> bool:
    sample = SimpleNamespace(active=True, report=SimpleNamespace(temperatures=ZERO), modelled=six(2, 0.8 * share))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        flight_guards._Temperatures()(sample)  # type: ignore[arg-type]
    return bool(caught)


def profile(limits: Limits, period: int = 5_000_000, **values: Any) -> Profile:
    return Profile(period=period, delay=0, calibration=b"", limits=limits, wall_period=1_000_000, **values)


def wall(axis: int = 0, edge: float = 0.0, stiffness: float = 0.0, damping: float = 0.0) -> list[WallMessage]:
    return [WallMessage(axis, 1, edge, stiffness, damping, 0.0)]


def walls(problem: Callable[[Profile, float], str]) -> Callable[[float, World], bool]:
    return lambda share, world: bool(problem(profile(world.limits), share))


def returned(share: float, world: World) -> bool:
    made = Walls(profile(world.limits))
    made._energy = 0.004 * share
    return made.unstable


def board(share: float, world: World) -> bool:
    made = Twin(TwinParameters(period=0.001, limits=world.limits, plant="exact")).board
    made.toggle(0)
    made.now = round(share * 10e6)
    return not made.enabled


def bench(world: World) -> Any:
    """Return a device with ideal amplifiers, armed and commanded."""
    from tests.bridge import test_firmware

    test_firmware.Bench.make = Firmware
    made = test_firmware.Bench(**{name: getattr(world.limits, name) for name in ("watchdog", "stale", "enable")})
    made.hello()
    made.sample()
    made.ask(Operation.ARM, stop=(*ZERO, 0.5, 1.0))
    made.sample()
    made.command()
    return made


def silent(share: float, world: World) -> bool:
    made = bench(world)
    for _ in range(round(share * 10)):
        made.sample()
    return Fault.WATCHDOG in made.device.faults


def gap(share: float, world: World) -> bool:
    made = bench(world)
    made.sample()
    made.now += round((0.2 if share < 1.0 else 0.8) * made.period)
    made.command()
    for _ in range(2 if share < 1.0 else 3):  # 1.8 or 2.2 periods after the command
        report = made.sample()
    return bool(report.flags & Flag.HOLDING)


def outdated(share: float, world: World) -> bool:
    made = bench(world)
    for _ in range(3):
        made.sample()
    made.now += round((share - 0.75) * 20e6)  # 15 ms after the sample that it answers, and that
    before = made.device.counts["old"]
    made.tick -= 3
    made.command()
    return bool(made.device.counts["old"] > before)


def long_stop(share: float, world: World) -> bool:
    made = bench(world)
    made.ask(Operation.DISARM)
    return bool(made.ask(Operation.ARM, stop=(*ZERO, share * 1.0, 1.0)).result)


def regained(share: float, world: World) -> bool:
    """Return True if generated energy of walls has decayed to a tenth after 2.303 s."""
    limits = world.limits.replace(current_limit=20.0)
    maps = TwinParameters(period=0.001, plant="exact").profile.wall_maps
    assert maps is not None
    made = Walls(profile(limits, 1_000_000, wall_maps=maps))
    made._energy, made._pose, made._walls = 0.01, maps.pose(maps.spots), wall(edge=-1.0)
    for tick in range(1, round(2303 * share)):
        made.render(tick * 1_000_000, maps.spots, False, False)
    return made._energy < 0.001


def rested(axis: int, fast: float) -> Callable[[float, World], bool]:
    def trips(share: float, world: World) -> bool:
        motion = RecentMotion(1e-3, world.scale)
        while not motion.full:
            tick = len(motion._samples)
            motion.add(Sample(tick, 0.0, [part * tick * 1e-3 for part in six(axis, share * fast)]))
        return not motion.at_rest

    return trips


def astray(axis: int, far: float) -> Callable[[float, World], bool]:
    def trips(share: float, world: World) -> bool:
        seen: list[Any] = []
        leader = Leader(Rig().plant.calibration, PERIOD, 0.002)
        leader._scale = world.scale
        leader.aim(straight(ZERO, ZERO, 1.0), seen.append)
        leader.step(Sample(0, 0.0, list(six(axis, share * far))))
        return bool(seen)

    return trips


def takes_off(hover: Any = None) -> None:
    raise PlantError("takes off")


def on_stop(share: float, world: World) -> bool:
    """Return True if a flotor lies low enough for a takeoff, at shares of 2.7 mm below the centre."""
    plant = Rig(pose=CENTRE).plant
    motion = RecentMotion(PERIOD, world.scale)
    while not motion.full:
        motion.add(Sample(len(motion._samples), 0.0, [0.0, 0.0, -0.0027 * share, 0.0, 0.0, 0.0]))
    plant._observed = lambda duration: motion  # type: ignore[method-assign]
    plant.arm = takes_off  # type: ignore[method-assign]
    with pytest.raises(PlantError) as caught:
        plant.takeoff()
    return "takes off" in str(caught.value)


def measured(**change: Callable[[float], float]) -> Callable[[float, World], bool]:
    return lambda share, world: bool(
        preflight._problem(JOYSTICK, replace(GOOD, **{name: value(share) for name, value in change.items()}), 0.003)  # type: ignore[arg-type]
    )


def seen_of(limits: Limits, **meter: float) -> bool:
    return bool(safety.off_fault(limits, DEVICE.change("coils", **meter) if meter else DEVICE))


def hovering(share: float, world: World) -> bool:
    own = HostLimits(max_current=1.1447 * 1.25 * (2.0 - share))
    return bool(safety.weight_fault(0.0, six(0, 1.1447), own, own.narrowed(Limits(hover_limit=1.3))))


G, S, C = flight_guards, safety, connection
RULES = [delays(place) for place in range(3)]
PINS: dict[str, Pin] = {
    # the flotor
    "position": Pin("scale", "envelope", flown(1, 5.5e-3)),
    "rotation": Pin("scale", "tilt", flown(3, math.radians(7.5))),
    "speed": Pin("scale", "speed", flown(0, 0.6 * PERIOD, elapsed=PERIOD)),
    "angular speed": Pin("scale", "spin", flown(5, 15.0 * PERIOD, elapsed=PERIOD)),
    # the laws
    "reversals": Pin("scale", "reversals", lambda share, world: bool(reversed_forces(power(world), 20.0 * share, 9))),
    "capped reversals": Pin(
        "scale", "capped", lambda s, world: bool(reversed_forces(power(world), 190.0 / 41.0 * s, 20))
    ),
    "cap": Pin("scale", "cap", lambda s, world: bool(reversed_forces(power(world), 6.5, round(18.5 * s)))),
    "memory of reversals": Pin(G, "_MEMORY", remembered),
    "generated energy": Pin("scale", "generated", lambda share, world: pushed(power(world), 0.008 * share)),
    "stored energy": Pin("scale", "stored", stored),
    "memory of energy": Pin(G, "_FORGOTTEN", forgotten),
    # the loop delay
    **{f"late answers, count {n}": Pin(G, ("_RULES", n, 0), rule[0]) for n, rule in enumerate(RULES)},
    **{f"late answers, window {n}": Pin(G, ("_RULES", n, 1), rule[1]) for n, rule in enumerate(RULES)},
    **{f"late answers, delay {n}": Pin(G, ("_RULES", n, 2), rule[2]) for n, rule in enumerate(RULES[:2])},
    "share of the critical delay": Pin(G, "_DELAY_SHARE", lambda s, world: 0.016 * s > delay_limit(0.02, 0.005)),
    "whole critical delay": Pin(
        G, "_FULL_SHARE", lambda s, world: 5e-3 * s > delay_limit(5.8e-3 if s > 1 else 5.2e-3, 0.005)
    ),
    "longest delay": Pin(G, "_LONGEST", lambda share, world: 0.024 * share > delay_limit(math.inf, 0.005)),
    # landing
    "speed in a landing": Pin("scale", "drop", swung(0.3, 0.2)),
    "time of that speed": Pin(landing, "_FAST_TIME", swung(0.5, 0.1)),
    # sensor, coils, clock
    "holding": Pin(G, "_HELD", held),
    "clock": Pin(C, "_MISMATCH", stamped),
    "current": Pin("limits", "off_current", followed(0.0, lambda share: 0.25 * share)),
    "current, share": Pin(S, "_TOLERANCE", followed(5.0, lambda share: 0.25 + 0.5 * share)),
    "current, count": Pin(CoilGuard, "_PATIENCE", followed(0.0, lambda share: 1.0, times=0)),
    "overcurrent": Pin(S, "_OVER", read(15.0, 0.0)),
    "hot": Pin(S, "_HOT", read(0.0, 2.0)),
    "cold": Pin(S, "_COLD", read(0.0, -0.01)),
    "spot": Pin("limits", "spot_limit", spotted(0.0209, Fault.SENSOR_OUT_OF_RANGE, speed=100.0)),
    "speed of a spot": Pin("limits", "spot_speed", spotted(1.0 * PERIOD, Fault.FLOTOR_OVERSPEED)),
    "jump of a spot": Pin(S, "_IMPLAUSIBLE", spotted(2.0 * PERIOD, Fault.SENSOR_OUT_OF_RANGE, speed=0.5)),
    "frozen": Pin("limits", "frozen", frozen),
    "heat": Pin("limits", "continuous_current", warmed),
    "heating": Pin("limits", "thermal_time", warmed),
    "warning": Pin(G, "WARNING_RISE", warned),
    # walls on the device
    "stiffness": Pin("limits", "stiffness_limit", walls(lambda p, s: p.wall_problem(wall(stiffness=1e5 * s)))),
    "damping": Pin("limits", "damping_limit", walls(lambda p, s: p.wall_problem(wall(damping=400.0 * s)))),
    "lever": Pin("limits", "lever", walls(lambda p, s: p.wall_problem(wall(3, stiffness=90.0 * s * s)))),
    "edge": Pin("limits", "edge_speed", walls(lambda p, s: p.edge_problem(wall(edge=5e-4 * s), (), ZERO, 1))),
    "energy of walls": Pin("limits", "energy", returned),
    "memory of walls": Pin(firmware, "_MEMORY", regained),
    # a silent host
    "watchdog": Pin("limits", "watchdog", silent),
    "enable line": Pin("limits", "enable", board),
    "gap": Pin(firmware, "_GAP", gap),
    "stale": Pin("limits", "stale", outdated),
    "stale, periods": Pin(S, "_STALE", lambda s, w: 0.02 * s > profile(Limits()).stated["stale"] * 1e-9),
    "longest stop": Pin(firmware, "_LONGEST_STOP", long_stop),
    # before takeoff
    "rest": Pin("scale", "rest", rested(0, 5e-3)),
    "rest of angles": Pin("scale", "rest_spin", rested(4, 0.1)),
    "path": Pin("scale", "path", astray(1, 2e-3)),
    "path of angles": Pin("scale", "path_angle", astray(5, math.radians(3.0))),
    "on the stop": Pin(remote, "_ON_STOP", on_stop),
    "clock rate": Pin(preflight, "_CLOCK", measured(clock=lambda share: 1.0 + 0.02 * share)),
    "answered": Pin(preflight, "_ANSWERED", measured(late=lambda share: round(50 * share))),
    "margin": Pin(preflight, "MARGIN", lambda share, world: 0.0015 + 7.5e-4 * share > GOOD.required_delay),
    "off lifts": Pin(S, "_LIFT", lambda share, world: seen_of(Limits(off_current=0.2861 * share))),
    "meter": Pin(S, "_METER_STEPS", lambda share, world: seen_of(Limits(), meter=0.25 / 3.0 * share)),
    "headroom": Pin(S, "_HEADROOM", hovering),
}

ELSEWHERE = {
    "LANDING_TIME": "a time of real stops, tests/bridge/test_stopping.py",
    "LANDING_DELAY": "stability of the hold of an early landing, test_flight_guards.py",
    "_WINDOW": "how speed at rest is measured, test_takeoff.py",
    "_BLOCKS": "the same",
    "_ROOM": "tests/test_device.py, from both sides",
    "_ROUNDING": "rounding on the wire",
    "_HEAVY": "rescales a sum",
    **dict.fromkeys(("_ACTIVE", "_CHANGED", "_NO_FAULT", "_AT_MOST", "_CONTINUOUS"), "no limit of its own"),
}
"""Numbers of the guards' modules that are no limit, or are pinned elsewhere."""


def placed(outer: Any, places: Sequence[int], value: Any) -> Any:
    """Return nested tuples with one value replaced."""
    if not places:
        return value
    first, *rest = places
    return (*outer[:first], placed(outer[first], rest, value), *outer[first + 1 :])


def world(pin: Pin, factor: float, monkeypatch: pytest.MonkeyPatch) -> World:
    """Return the published joystick with a limit times a factor; one of a module is changed there."""
    base = World(DEVICE.scale, safety.limits_of(DEVICE).replace(stale=0.02))
    value = pin.value(base)
    if factor != 1.0 and isinstance(value, int):  # a count
        value += max(1, round(0.2 * value)) * (1 if factor > 1.0 else -1)
    elif factor != 1.0:
        value *= factor
    if pin.where == "scale":
        return base._replace(scale=replace(base.scale, **{pin.name: value}))
    if pin.where == "limits":
        return base._replace(limits=base.limits.replace(**{pin.name: value}))
    name, *places = pin.name if isinstance(pin.name, tuple) else (pin.name,)
    monkeypatch.setattr(pin.where, name, placed(getattr(pin.where, name), places, value))
    return base


@pytest.mark.parametrize("name", PINS)
def test_a_limit_passes_below_trips_above_and_no_other_value_does_so(name: str) -> None:
    pin = PINS[name]
    for factor in (1.0, 0.8, 1.2):
        with pytest.MonkeyPatch.context() as monkeypatch:
            changed = world(pin, factor, monkeypatch)
            found = pin.trips(0.9, changed), pin.trips(1.1, changed)
        assert (found == (False, True)) == (factor == 1.0), (factor, found)


def test_every_number_of_the_guards_is_pinned() -> None:
    pinned = {name if isinstance(name, str) else name[0] for _, name, _ in PINS.values()}
    for module in (flight_guards, landing, safety):
        numbers = {
            name
            for name, value in vars(module).items()
            if name.isupper() and isinstance(value, (int, float, tuple)) and f"\n{name}" in inspect.getsource(module)
        }
        missing = {name for name in numbers if name not in pinned and name not in ELSEWHERE}
        assert not missing, f"pin {sorted(missing)} of {module.__name__} in PINS, or name its test in ELSEWHERE"

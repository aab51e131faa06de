"""Device card: impedances, virtual masses and forces that a device renders along a translation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control import Hold, LinearController
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.keywords import checked
from maglev_mj.plants import ExactPlant
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.hand import HANDS, get_hand
from maglev_mj.plants.model import body_of
from maglev_mj.result import Result, Table, capitalised, conditions_text, with_unit
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import SceneLike, get_scene
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.wall_scene import lagging
from maglev_mj.theory.boundary import StiffestWall, boundary_of, rigid_note, stiffest_of
from maglev_mj.theory.frequencies import angles_of, first_crossing
from maglev_mj.theory.held import Held, held_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import Design, Forced, LoopArray, bisect, is_stable
from maglev_mj.theory.loop_parameters import LoopParameters
from maglev_mj.theory.read import scene_hand, scene_lag
from maglev_mj.theory.two_rates import DeviceLaw, laws_on_device

_MASSES = np.geomspace(1e-3, 1e3, 4001)
_WINDOW, _LONGEST, _SETTLED = 400, 20_000, 1e-10
_LOSS = math.sqrt(0.5)
_NO_EFFECT = {
    "inertia": "a card is along a translation",
    "hand": "a card has a wall for each hand",
    "friction": "a card is of the linear loop",
    "quantum": "the resolution of the sensor is quantize, of the scene",
}
_WIDE = 0.3  # radius of gyration of a handle or stage that hints at a wrong unit [m]


@dataclass(frozen=True, eq=False)
class DeviceFigures(Result):
    """Figures of a device file.

    Attributes:
        device: The device.
    """

    device: Device

    units: ClassVar = {}
    derived: ClassVar = ("inertia", "range", "force_limit", "hover", "critical_stiffness")
    inertia = property(lambda self: self.device.inertia)
    range = property(lambda self: self.device.reach)
    force_limit = property(lambda self: self.device.force_limit)

    @property
    def hover(self) -> Array:
        """Hover currents at the centre [A], (6,); none without coils, (0,)."""
        if self.device.coils is None:
            return np.zeros(0)
        return CoilMap.of(self.device).currents(0.0 - body_of({"model": self.device}).load)

    @property
    def critical_stiffness(self) -> Array:
        """Critical stiffness of a wall on each translation, at the best damping [N/m], (3,)."""
        (loop,) = Loop.of(self.device, stiffness=0.0, damping=0.0)
        return np.full(3, float(stiffest_of(loop.array()).stiffness))

    def _headline(self) -> str:
        force, stiffness = self.force_limit[2], self.critical_stiffness[0]
        return f"{capitalised(self.device.name)}: {force:.3g} N along z; walls up to {stiffness:.0f} N/m without a hand"

    @property
    def warnings(self) -> list[str]:
        """See `Result`."""
        device, found = self.device, list[str]()
        load = np.abs(body_of({"model": device}).load)
        needed, unit, limits = load[:3], "N", {"force limit": device.force_limit[:3]}
        if (coils := device.coils) is not None:
            needed, unit = np.abs(self.hover), "A"
            limits = {name: np.array(getattr(coils, name)) for name in ("current_limit", "continuous_current")}
        for name, limit in limits.items():
            if np.any(needed > limit):
                limited = f"{name.replace('_', ' ')} of {limit.min():.3g} {unit}"
                found.append(f"weight needs {needed.max():.3g} {unit}, above the {limited}")
                break
        radius = float(np.sqrt(device.inertia[3:].max() / device.mass))
        if radius > _WIDE:
            found.append(f"radius of gyration is {radius:.3g} m: are mass and inertia in kg and kg m²?")
        return found

    def columns(self) -> dict[str, Array]:
        """Return mass and moments of inertia, range and force limit of each axis, (6,) each."""
        return {"inertia": self.inertia, "range": self.range, "force_limit": self.force_limit}

    def table(self) -> Table:
        """Return the figures of each axis; hover currents, condition number and critical stiffness below."""
        device, notes = self.device, list[str]()
        if device.coils is not None:
            condition = CoilMap.of(device).condition_number(math.sqrt(device.inertia[3] / device.mass))
            hover = ", ".join(f"{current:.3g}" for current in self.hover)
            notes += [f"hover currents: {hover} A", f"condition number of the coil map: {condition:.3g}"]
        rows = [(axis, *row) for axis, row in zip(AXES, np.transpose([*self.columns().values()]).tolist())]
        title = f"{device.name}: {device.mass:g} kg, {device.loop.rate:g} Hz, delay {device.delay * 1e3:g} ms"
        head = ("axis", "inertia [kg, kg m²]", "range [m, rad]", "force limit [N, N m]")
        return Table(title, head, rows, "\n".join(notes), warnings=self.warnings)


@dataclass(frozen=True, eq=False)
class DeviceCard(Result):
    """Card of a device along a translation.

    Arrays are by hand (H,), damping (B,) and frequency (F,).

    Attributes:
        title: Scene, rate, delay, mass and target wall in words.
        hands: Names of the hands, "none" for the free flotor.
        walls: Stiffest stable wall in each hand: the top of the Z-width.
        damping: Dampings of the curves [N s/m].
        limits: Largest stable stiffness of each hand [N/m], (H, B).
        impedance: Frequency [Hz], and magnitudes [N s/m] of the target impedance, damping + stiffness/(j omega), and of
            the rendered one in theory and in simulation on the exact plant; (4, F). NaN for an unstable wall, and with
            own damping, a mode or a device law, which the plant does not have.
        transparent: Frequency up to which the rendered impedance is within 3 dB of the target [Hz]; 0 for none.
        masses: Smallest and largest virtual mass behind a coupling of the target gains [kg], (H, 2); infinite from
            1000 kg on, NaN for none.
        force_bandwidth: Frequency at which hold and drivers lose 3 dB of a force [Hz].
        force_resolution: Step of the force by one step of the sensor, at the target gains [N].
        held: Verdict on the target wall free and in each hand.
        rigid: Rate up to which half of the rigid device's limit holds with a mode, in words; empty without one.
    """

    title: str
    hands: tuple[str, ...]
    walls: tuple[StiffestWall, ...]
    damping: Array
    limits: Array
    impedance: Array
    transparent: float
    masses: Array
    force_bandwidth: float
    force_resolution: float
    rigid: str
    held: Held
    derived: ClassVar = ("leaves_after",)
    units: ClassVar = {"frequency": "Hz", "target": "N s/m", "rendered": "N s/m", "simulated": "N s/m"}
    pictures: ClassVar = {"card": "maglev_mj.studies.pictures:device_card"}

    def _headline(self) -> str:
        free, *held = (f"{wall.stiffness:.0f} N/m" for wall in self.walls[:2])
        in_hand = f", {held[0]} with hand {self.hands[1]}" if held else ""
        transparent = f"transparent up to {self.transparent:.3g} Hz" if self.transparent else "not transparent"
        return f"Stiffest stable wall: {free} free{in_hand}; {transparent}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return self.title

    @property
    def leaves_after(self) -> float | None:
        """See `Held`."""
        return self.held.leaves_after

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the impedances over frequency."""
        return dict(zip(self.units, self.impedance))

    @property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        return ["target wall is unstable: no impedance"] * bool(np.isnan(self.impedance[2]).all())

    def table(self) -> Table:
        """Return figures, walls and masses of each hand, and impedances."""
        figures = [("transparency bandwidth (impedance within 3 dB of target)", self.transparent, "Hz")]
        figures += [("force bandwidth of zero-order hold and drivers, 3 dB", self.force_bandwidth, "Hz")]
        figures += [("force resolution (one sensor step)", self.force_resolution, "N")]
        hands = [
            (hand, *map(float, wall[:2]), *mass.tolist())
            for hand, wall, mass in zip(self.hands, self.walls, self.masses)
        ]
        heads = "hand", "stiffest wall [N/m]", "at damping [N s/m]", "min. virtual mass [kg]", "max. [kg]"
        title = "Stiffest stable wall; virtual masses stable behind the target's spring and damper (- for unlimited)"
        some = self.impedance.T[np.linspace(0, self.impedance.shape[1] - 1, 8).astype(int)].tolist()
        tables = (
            Table(title, heads, hands, self.rigid),
            Table(
                "Impedance at the handle: target (spring and damper), rendered and simulated (with the flotor)",
                [with_unit(*unit) for unit in self.units.items()],
                some,
            ),
        )
        head, held = ("", "value", "unit"), str(self.held)
        return Table(f"Device card: {self.title}", head, figures, held, below=tables, warnings=self.warnings)


@checked(own="scene")
def device_card(scene: SceneLike, device: LoopParameters | None = None) -> DeviceCard:
    """Return the card of a scene's device, by theory and by simulation on the exact plant.

    The target wall has the scene's stiffness and damping, the sensor its `quantize`; defaults are those of `drop` and
    of Table 1. The scene's wall or damper on the device, and its velocity filter, act beside all walls of the card.

    Args:
        scene: The scene, its class, or a text for `find_scene`.
        device: Values that replace the scene's; period, delay and mass are the scene's.

    Raises:
        ParameterError: If there is no such scene, or the delay is above ten periods, which plants do not simulate.

    Example:
        >>> from maglev_mj import device_card, find_scene
        >>> card = device_card(find_scene("drop")())
        >>> round(float(card.walls[0].stiffness))  # free
        10173
    """
    scene = get_scene(scene)
    scene.timing()  # simulated below
    k, b, quantum = (getattr(scene, name, 0.0) for name in ("stiffness", "damping", "quantize"))
    k, b, quantum = k or Drop().stiffness, b or Drop().damping, quantum or scene.hardware.sensor.resolution[2]
    own, target_loop = _target(scene, device, k, b)
    period, mass, host = target_loop.period, target_loop.inertia, (target_loop.stiffness, target_loop.damping)
    loops = [target_loop.array(hand=get_hand(name)) for name in HANDS]
    walls = tuple(map(stiffest_of, loops))
    damping = np.linspace(0.0, 1.3 * max(wall.damping for wall in walls) or 4.0 * mass / period, 121)
    limits = np.array([boundary_of(loop, damping) for loop in loops])
    cycles = np.unique(np.geomspace(1.0, 0.45 * _WINDOW, 120).round())
    frequency = cycles / (_WINDOW * period)
    omega = 2.0 * np.pi * frequency
    rendered = np.full(omega.shape, np.nan)
    if stable := bool(is_stable(loops[0].spectral_radius(*host))):
        rendered = 1.0 / (omega * np.abs([*loops[0].compliances(*host, frequency.tolist())]))
    target = np.hypot(b, k / omega)
    transparent = _transparent(loops[0].forced(*host), k, b, period) if stable else 0.0
    flown = np.full(omega.shape, np.nan)
    if stable and own.plain:
        flown = fly_impedance(scene, target_loop, cycles)
    impedance = np.array([frequency, target, rendered, flown])
    masses = np.array([mass_range(loop, k, b) for loop in loops])
    stated = None if device is None else device.driver_lag  # without: the drivers', also where the delay contains it
    lag = 2.0 * np.pi * (scene.hardware.driver.time_constant if stated is None else stated)
    attenuated = lambda f: np.sinc(f * period) < _LOSS * np.hypot(1.0, f * lag)  # noqa: E731
    bandwidth = float(bisect(attenuated, np.zeros(()), np.array(0.5 / period), 50))
    target_text = f"target wall {k:g} N/m, {b:g} N s/m{own.described}"
    title = conditions_text(scene.name, AXES[:3], [period], [scene.delay], f"{mass:g} kg", target_text)
    step = quantum * (k + b / (period if any(host) else own.device_period))
    rigid = rigid_note(loops[0]) if own.mode else ""
    held = held_of(target_loop, reach=scene.body.bounded.range, own=scene_hand(scene))
    curves = damping, limits, impedance, transparent, masses
    return DeviceCard(title, tuple(HANDS), walls, *curves, bandwidth, step, rigid, held)


def _target(
    scene: Scene, device: LoopParameters | None, stiffness: float, damping: float
) -> tuple[LoopParameters, Loop]:
    """Return the parameters of a card's loop, and the loop of its target wall.

    The host has no gains if the wall is on the device.
    """
    mass = float(scene.body.inertia[0])
    fixed: dict[str, Any] = {"period": scene.period, "delay": scene.delay, "mass": mass}
    if device is not None:
        stated = device.independent_values()
        for name, value in fixed.items():
            if not math.isclose(stated.get(name, value), value):
                raise ParameterError(f"{name} must be that of the scene, {value:g} (got {stated[name]:g})")
        device.refuse(_NO_EFFECT)
    else:
        device = LoopParameters()
    controller = scene.controller()
    walls = laws_on_device(controller, scene.device_clock) if controller.on_device else {}
    along = [law for axis, law in walls.items() if AXES[axis] in "xyz"]
    if along and device.device_law is None:
        law = max(along, key=lambda law: (law.stiffness, law.damping))
        names = "stiffness", "damping", "period", "delay", "cutoff"
        fixed |= {f"device_{name}": getattr(law, name) for name in names}
        if law.stiffness:  # the target wall itself
            stiffness, damping = 0.0, 0.0
    lag = scene_lag(scene) if device.driver_lag is None else device.driver_lag
    own = device.replace(**fixed, driver_lag=lag)
    return own, own.loop(stiffness=stiffness, damping=damping, axis="x", velocity=own.velocity or controller.velocity)


def _transparent(forced: Forced, stiffness: float, damping: float, period: float) -> float:
    """Return the frequency up to which the impedance is within 3 dB of the target's [Hz]."""

    def within(angles: Array) -> Array:
        wanted = np.hypot(stiffness, damping * angles / period)
        return np.asarray(-math.log(_LOSS) - np.abs(np.log(np.abs(forced.compliance(angles)) * wanted)))

    return float(first_crossing(within, angles_of(forced.poles))) / (2.0 * math.pi * period)


def fly_impedance(scene: Scene, loop: Loop, cycles: Array) -> Array:
    """Return the impedance on the exact plant under a sinusoidal hand force [N s/m].

    NaN for a wall that does not settle. One device per number of cycles in 400 samples; the force is constant between
    samples.
    """
    stiffness, damping, lag, spectral_radius = loop.stiffness, loop.damping, loop.driver_lag, loop.spectral_radius
    settle = math.ceil(math.log(_SETTLED) / math.log(spectral_radius)) if spectral_radius < 1.0 else _LONGEST
    if settle >= _LONGEST:
        return np.full(cycles.size, np.nan)
    none, turn, moved = np.zeros(cycles.size), 2.0 * np.pi * cycles / _WINDOW, list[Any]()
    start, hand = np.zeros((cycles.size, 6)), lambda tick, *_: [np.sin(turn * tick), *[none] * 5]
    law = Hold(axes="x", stiffness=stiffness, damping=damping)
    controller = Controller([law], period=scene.period, velocity=loop.velocity)
    own: Any = {"mass": loop.inertia, "pose": start, "gravity": 0.0, "hand_force": hand, **lagging(lag)}
    with ExactPlant(scene.timing(), **own) as plant:
        drive(plant, controller, settle + _WINDOW, observe=lambda sample, _: moved.append(sample.position[0]))
    swing = np.abs(np.fft.fft(moved[settle:], axis=0)[cycles.astype(int), np.arange(cycles.size)]) * 2.0 / _WINDOW
    return np.asarray(scene.period / (turn * swing))


def mass_range(loop: LoopArray, stiffness: float, damping: float) -> tuple[float, float]:
    """Return the smallest and largest virtual mass of the heaviest stable range [kg], to 0.4 %.

    The mass is simulated in the controller, coupled to the flotor by spring and damper.
    """
    gains = np.full(_MASSES.shape, stiffness), np.full(_MASSES.shape, damping)
    poles = np.linalg.eigvals(replace(loop, design=virtual_mass(_MASSES)).matrix(*gains))
    law = loop.device or DeviceLaw()
    free = loop.hand is None and not law.stiffness  # a pole at 1, and without any damping a double one
    drifts = free + (free and not law.damping and not np.any(loop.own_damping))
    order = np.argsort(np.abs(poles - 1.0))[:, drifts:]
    stable = is_stable(np.abs(np.take_along_axis(poles, order, axis=-1)).max(axis=-1))
    if not stable.any():
        return math.nan, math.nan
    last = np.flatnonzero(stable)[-1]
    first = np.max(np.flatnonzero(~stable[:last]), initial=-1) + 1
    return _MASSES[first], math.inf if stable[-1] else _MASSES[last]


def virtual_mass(mass: Array) -> Design:
    """Return the design of virtual masses, (M,) [kg], behind a spring and a damper.

    Its state is the flotor's last position, then position and velocity of the mass.
    """

    def design(stiffness: Array, damping: Array, period: Array) -> LinearController:
        parts = damping / period, stiffness, damping, -stiffness - damping / period
        force = np.stack(np.broadcast_arrays(*parts), axis=-1)
        states = np.zeros((mass.size, 3, 4))
        states[:, 0, 3] = 1.0
        states[:, 2] = [0.0, 0.0, 1.0, 0.0] - force * (period / mass)[:, None]
        states[:, 1] = [0.0, 1.0, 0.0, 0.0] + states[:, 2] * period
        return LinearController(states[..., :3], states[..., 3], force[..., :3], force[..., 3])

    return design

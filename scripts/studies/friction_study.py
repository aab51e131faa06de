"""Hard tests of friction laws: small load cycles, creeping loads, speed, closed cycles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maglev_mj.control import Friction
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.frames import AXES, Array, Command, Mask, Sample
from maglev_mj.plants import ExactPlant, Sensor, Timing
from maglev_mj.plants.hand import RecordedHand
from maglev_mj.scenes.run import run as run_scene
from maglev_mj.scenes.stick_slip import LAWS, VELOCITIES, StickSlip

STIFFNESS, DAMPING, BREAKAWAY, V_MIN = 6000.0, 80.0, 2.0, 0.005
"""Defaults from figure 8 [N/m, N s/m, N, m/s]."""


def friction_law(name: str, period: float, *, damping: float = DAMPING, stiffness: float = STIFFNESS) -> Friction:
    """Return a friction law along x by name.

    Of LAWS, with figure 8's breakaway force and v_min.
    """
    return LAWS[name](v_min=V_MIN, period=period, axes="x", stiffness=stiffness, damping=damping, breakaway=BREAKAWAY)


class LoadOutcome(NamedTuple):
    """Motion under a load, sample by sample: position [m], stick position [m], and True if stuck."""

    position: Array
    anchor: Array
    stuck: Mask

    @property
    def transitions(self) -> int:
        """Changes between stuck and sliding."""
        return int((self.stuck[1:] != self.stuck[:-1]).sum())


def under_load(
    name: str,
    forces: Array,
    *,
    period: float,
    delay: float,
    quantize: float = 0.0,
    velocity: str = "difference",
    stiffness: float = STIFFNESS,
) -> LoadOutcome:
    """Push on a flotor that a friction law holds.

    The push is a hand's, so it acts at once; what the law answers comes after the delay.

    Args:
        name: Name from LAWS.
        forces: What the hand exerts from each sample to the next [N], (K,); the run is as long.
        period: Sample period [s].
        delay: Transport delay [s].
        quantize: Resolution of the sensor [m].
        velocity: Name from VELOCITIES.
        stiffness: Stiffness of the law [N/m].
    """
    controller = Controller(
        [friction_law(name, period, stiffness=stiffness)], period=period, velocity=VELOCITIES[velocity](quantize)
    )
    wrenches = np.zeros((len(forces), len(AXES)))
    wrenches[:, 0] = forces
    rows: list[tuple[float, float, bool]] = []

    def observe(sample: Sample, _: Command) -> None:
        (anchor,), (stuck,) = controller.signals["stick_position"], controller.signals["stuck"]
        rows.append((sample.position[0], float(anchor), bool(stuck)))

    sensor = Sensor(quantum=[quantize, 0.0, 0.0, 0.0, 0.0, 0.0]) if quantize else None
    # a law that drifts does so beyond the device's range too: that is what is measured
    far = (1e6, 1e6)
    timing, hand = Timing(period=period, delay=delay), RecordedHand(wrenches)
    with ExactPlant(timing, gravity=0.0, sensor=sensor, escape=far, hand_force=hand) as plant:
        drive(plant, controller, len(forces), observe=observe)
    return LoadOutcome(*(np.array(column) for column in zip(*rows, strict=True)))


def creep(
    name: str,
    *,
    period: float,
    delay: float,
    cycles: int = 1000,
    mean: float = 0.3,
    amplitude: float = 0.3,
    quantize: float = 0.0,
) -> float:
    """Return the drift over small load cycles [m].

    The load is mean + amplitude sin, at 20 Hz; the first 20 cycles settle and are not counted.

    Args:
        name: Name from LAWS.
        period: Sample period [s].
        delay: Transport delay [s].
        cycles: Cycles counted.
        mean: Mean load [N].
        amplitude: Amplitude of the load [N].
        quantize: Resolution of the sensor [m].
    """
    length = round(0.05 / period)
    ticks = np.arange((cycles + 20) * length + 1)
    forces = mean + amplitude * np.sin(2.0 * np.pi * ticks / length)
    position = under_load(name, forces, period=period, delay=delay, quantize=quantize).position
    return float(position[-1] - position[20 * length])


def chatter(
    name: str,
    *,
    period: float,
    delay: float,
    load: float = 1.02 * BREAKAWAY,
    rise: float = 1.0,
    duration: float = 0.1,
    quantize: float = 0.0,
    velocity: str = "difference",
) -> int:
    """Count state changes under a slowly rising load.

    Args:
        name: Name from LAWS.
        period: Sample period [s].
        delay: Transport delay [s].
        load: Load at the end [N].
        rise: How long it takes to rise there from 0 [s].
        duration: How long it stays there [s].
        quantize: Resolution of the sensor [m].
        velocity: Name from VELOCITIES.
    """
    ticks = np.arange(round((rise + duration) / period))
    forces = load * np.minimum(ticks * period / rise, 1.0)
    outcome = under_load(name, forces, period=period, delay=delay, quantize=quantize, velocity=velocity)
    return outcome.transitions


def mean_friction(name: str, speed: float, *, period: float, travel: float = 0.02) -> float:
    """Return the mean friction against a steady motion [N]: viscous damping apart, after breakaway."""
    positions = np.arange(0.0, travel, speed * period)
    forces = _driven(friction_law(name, period, damping=0.0), positions, period)
    return float(-np.mean(forces[len(forces) // 4 :]))


def cycle_work(
    name: str,
    amplitude: float,
    *,
    period: float,
    delay: float,
    frequency: float = 5.0,
    cycles: int = 40,
    quantize: float = 0.0,
    damping: float = 0.0,
) -> float:
    """Return a law's work on a hand a cycle [J]; above 0 it makes energy.

    Each force takes effect after the delay and is held for one period, while the hand moves on. The first quarter of
    the cycles is not counted.

    Args:
        name: Name from LAWS.
        amplitude: Amplitude of the motion [m].
        period: Sample period [s].
        delay: Transport delay [s].
        frequency: Frequency of the motion [Hz].
        cycles: Cycles moved.
        quantize: Resolution of the sensor [m].
        damping: Viscous damping of the law [N s/m].
    """
    length = round(1.0 / frequency / period)
    phases = 2.0 * np.pi * np.arange(cycles * length + 1) / length
    seen = amplitude * np.sin(phases)
    if quantize:
        seen = np.rint(seen / quantize) * quantize
    # the hand moves as it will; it is the law's force that comes late
    positions = amplitude * np.sin(phases + 2.0 * np.pi * delay / (length * period))
    forces = _driven(friction_law(name, period, damping=damping), seen, period)
    first = cycles // 4
    return float(np.sum((forces[:-1] * np.diff(positions))[first * length :]) / (cycles - first))


def _driven(law: Friction, positions: Array, period: float) -> Array:
    """Return a law's force during a prescribed motion."""
    controller = Controller([law], period=period)
    forces = [
        controller.step(Sample(tick, tick * period, [place, 0.0, 0.0, 0.0, 0.0, 0.0])).force[0]
        for tick, place in enumerate(positions.tolist())
    ]
    return np.array(forces)


class SpringOutcome(NamedTuple):
    """Figure 8's case with one law: error and restlessness."""

    error: float
    """Greatest distance from the exact motion [m]; that of the friction that the law stands for."""
    final_error: float
    """The same at the end [m]."""
    transitions: int
    ripple: float


def against_exact(
    name: str, *, period: float, delay: float, quantize: float = 0.0, velocity: str = "difference"
) -> SpringOutcome:
    """Compare one law with exact friction in figure 8's case.

    Stick-slip and spring reset are held against Karnopp's friction, the others against Coulomb friction; see
    `StickSlip.exact`.

    Args:
        name: Name from LAWS.
        period: Sample period [s].
        delay: Transport delay [s].
        quantize: Resolution of the sensor [m].
        velocity: Name from VELOCITIES.
    """
    scene = StickSlip(law=name, period=period, delay=delay, quantize=quantize, velocity=velocity)
    result = run_scene(scene, plant="exact")
    series = result.series(1e-3)
    gap = np.abs(series["position"] - scene.exact(series["time"]).position)
    figures = result.figures
    return SpringOutcome(float(gap.max()), float(gap[-1]), figures["transitions"], figures["ripple"])

"""Friction laws compared, from 200 Hz to 5 kHz.

Figure 8's case and four hard tests, at the same delay.

Prints three tables, writes every figure to friction_laws.json and a picture to friction_laws.png.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.cli.output import script_options
from maglev_mj.colours import SERIES
from maglev_mj.control import Friction
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.frames import AXES, Array, Command, Mask, Sample
from maglev_mj.pictures import TITLE, name_curves, new_figure, save
from maglev_mj.plants import ExactPlant, Sensor, Timing
from maglev_mj.plants.hand import RecordedHand
from maglev_mj.scenes.run import run as run_scene
from maglev_mj.scenes.stick_slip import LAWS, VELOCITIES, Pull
from maglev_mj.spec import Spec
from maglev_mj.versions import versions

STIFFNESS, DAMPING, BREAKAWAY, V_MIN = 6000.0, 80.0, 2.0, 0.005
"""Defaults from figure 8 [N/m, N s/m, N, m/s]."""


def friction_law(name: str, period: float, *, damping: float = DAMPING, stiffness: float = STIFFNESS) -> Friction:
    """Return a law of LAWS along x, with figure 8's breakaway force and v_min."""
    return LAWS[name].of(
        v_min=V_MIN, period=period, axes="x", stiffness=stiffness, damping=damping, breakaway=BREAKAWAY
    )


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
        [friction_law(name, period, stiffness=stiffness)], period=period, velocity=VELOCITIES[velocity].of(quantize)
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
    `Pull.exact`.

    Args:
        name: Name from LAWS.
        period: Sample period [s].
        delay: Transport delay [s].
        quantize: Resolution of the sensor [m].
        velocity: Name from VELOCITIES.
    """
    scene = Pull(law=name, period=period, delay=delay, quantize=quantize, velocity=velocity)
    result = run_scene(scene, plant="exact")
    series = result.series(1e-3)
    gap = np.abs(series["position"] - scene.exact(series["time"]).position)
    figures = result.figures
    return SpringOutcome(float(gap.max()), float(gap[-1]), figures["transitions"], figures["ripple"])


CASES = (
    ("ideal, difference", 0.0, "difference"),
    ("5 µm, difference", 5e-6, "difference"),
    ("5 µm, low-pass", 5e-6, "low-pass"),
    ("5 µm, adaptive", 5e-6, "adaptive"),
)
DELAY = Spec.transport_delay.value


def fixed(value: float) -> str:
    """Return a figure with two digits; zero has no sign."""
    return f"{round(value, 2) + 0.0:.2f}"


def microseconds(name: str, period: float, count: int) -> float:
    """Return the law's cost a controller tick [µs]: the least of five runs."""
    samples = [Sample(k, k * period, [1e-3 * (k % 7), 0.0, 0.0, 0.0, 0.0, 0.0]) for k in range(count)]
    costs = []
    for _ in range(5):
        controller = Controller([friction_law(name, period)], period=period)
        start = time.perf_counter()
        for sample in samples:
            controller.step(sample)
        costs.append((time.perf_counter() - start) / len(samples) * 1e6)
    return min(costs)


def estimator_rows() -> list[dict[str, Any]]:
    """Return the cost of each velocity estimate on the 5 µm sensor at 1 kHz [µs]."""
    rows = []
    for velocity, make in VELOCITIES.items():
        estimator = make.of(5e-6)
        places = [[5e-6 * round(2.0 * tick), 0.0, 0.0, 0.0, 0.0, 0.0] for tick in range(500)]
        state: Any = None
        start = time.perf_counter()
        for place in places:
            _, state = estimator(place, state, 1e-3)
        rows.append({"velocity": velocity, "microseconds": (time.perf_counter() - start) / len(places) * 1e6})
    return rows


def spring_rows(rates: Sequence[int]) -> list[dict[str, Any]]:
    """Return figure 8's case for each law, rate, sensor and velocity estimate."""
    rows = []
    for name in LAWS:
        for rate in rates:
            for quantize, velocity in (
                (0.0, "difference"),
                (5e-6, "difference"),
                (5e-6, "low-pass"),
                (5e-6, "adaptive"),
            ):
                outcome = against_exact(name, period=1 / rate, delay=DELAY, quantize=quantize, velocity=velocity)
                rows.append(
                    {"law": name, "rate": rate, "quantize": quantize, "velocity": velocity, **outcome._asdict()}
                )
    return rows


def hard_rows(rates: Sequence[int], cycles: int) -> list[dict[str, Any]]:
    """Return the hard tests for each law, rate and sensor."""
    rows = []
    moved = min(cycles, 40)
    for name in LAWS:
        for rate in rates:
            period, cost = 1 / rate, microseconds(name, 1 / rate, 10 * cycles)
            for quantize in (0.0, 5e-6):
                rows.append(
                    {
                        "law": name,
                        "rate": rate,
                        "quantize": quantize,
                        "creep": creep(name, period=period, delay=DELAY, cycles=cycles, quantize=quantize),
                        "chatter": chatter(name, period=period, delay=DELAY, quantize=quantize),
                        "friction_slow": mean_friction(name, 0.01, period=period),
                        "friction_fast": mean_friction(name, 0.1, period=period),
                        "work_stuck": cycle_work(
                            name, 2e-4, period=period, delay=DELAY, quantize=quantize, cycles=moved
                        ),
                        "work_sliding": cycle_work(
                            name, 1e-3, period=period, delay=DELAY, quantize=quantize, cycles=moved
                        ),
                        "microseconds": cost,
                    }
                )
    return rows


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw each law's error over the rate, for an ideal and a quantized sensor.

    Args:
        rows: Each with law, rate [Hz], quantize [m], velocity (an estimator's name) and error [m].
        path: File to write.
    """
    cases = [(0.0, "difference"), (5e-6, "difference"), (5e-6, "low-pass"), (5e-6, "adaptive")]
    least = min(rows, key=lambda row: row["error"])
    head = f"Least error: {least['error'] * 1e3:.2g} mm with law {least['law']} at {least['rate']:g} Hz"
    figure, panels = new_figure(
        [head, "pull of figure 8 along x, delay 1.5 ms, 6000 N/m, 80 N s/m, breakaway 2 N"],
        2,
        2,
        6.6,
        sharex=True,
        sharey=True,
    )
    names = list(dict.fromkeys(row["law"] for row in rows))
    for panel, (quantize, velocity) in zip(panels, cases, strict=True):
        for name, color in zip(names, SERIES, strict=False):
            chosen = [r for r in rows if (r["law"], r["quantize"], r["velocity"]) == (name, quantize, velocity)]
            rates, errors = [r["rate"] for r in chosen], [r["error"] * 1e3 for r in chosen]
            panel.loglog(rates, errors, color=color, marker="o", markersize=4, linewidth=1.5, label=name)
        sensor = "ideal sensor" if quantize == 0.0 else "5 µm sensor"
        panel.set_title(f"{sensor}, {velocity}", **TITLE)
        ticks = sorted({row["rate"] for row in rows})
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.minorticks_off()
        panel.set_yticks([0.05, 0.1, 0.2, 0.5, 1.0], ["0.05", "0.1", "0.2", "0.5", "1"])
    for panel in panels[::2]:
        panel.set_ylabel("greatest error (mm)")
    for panel in panels[2:]:
        panel.set_xlabel("rate (Hz)")
    name_curves(figure, panels[:1])
    return save(figure, path)


def main() -> None:
    """Print the tables, write data and picture."""
    options = script_options(__doc__, quick="one rate and fewer load cycles")
    rates, cycles = ((200,), 5) if options.quick else ((200, 500, 1000, 2000, 5000), 200)
    springs, hard, costs = spring_rows(rates), hard_rows(rates, cycles), estimator_rows()
    data = {"spring": springs, "hard": hard, "velocity": costs, "versions": versions()}
    options.pictures.path("friction_laws", "json").write_text(json.dumps(data, indent=1) + "\n")

    print(f"Figure 8's case, delay {DELAY * 1e3:g} ms: greatest distance from exact friction in mm")
    print("(changes of state, ripple at the end in µm)")
    print(f"  {'law':<19}{'sensor, velocity':<20}" + "".join(f"{rate:>15} Hz" for rate in rates))
    for name in LAWS:
        for label, quantize, velocity in CASES:
            chosen = [r for r in springs if (r["law"], r["quantize"], r["velocity"]) == (name, quantize, velocity)]
            cells = "".join(
                f"{r['error'] * 1e3:>8.3f} ({r['transitions']:>2},{r['ripple'] * 1e6:>5.0f})" for r in chosen
            )
            print(f"  {name if velocity == 'difference' and not quantize else '':<19}{label:<20}{cells}")
    print()
    print(f"Hard tests: creep over {cycles} load cycles; changes of state at a load just above")
    print(
        "breakaway; mean friction at 10 and 100 mm/s; work a cycle, stuck and sliding (above 0: the law makes energy)"
    )
    print(
        f"  {'law':<19}{'rate, sensor':<16}{'creep µm':>11}{'changes':>9}{'10 mm/s N':>11}{'100 mm/s N':>12}"
        f"{'stuck µJ':>10}{'sliding µJ':>12}{'tick µs':>9}"
    )
    for r in hard:
        where = f"{r['rate']} Hz, {'5 µm' if r['quantize'] else 'ideal'}"
        friction = f"{fixed(r['friction_slow']):>11}{fixed(r['friction_fast']):>12}"
        work = f"{r['work_stuck'] * 1e6:>10.2f}{r['work_sliding'] * 1e6:>12.0f}"
        print(
            f"  {r['law']:<19}{where:<16}{fixed(r['creep'] * 1e6):>11}{r['chatter']:>9}{friction}{work}"
            f"{r['microseconds']:>9.1f}"
        )
    print()
    print(
        "A tick of each velocity estimate, all six axes: "
        + ", ".join(f"{r['velocity']} {r['microseconds']:.1f} µs" for r in costs)
    )
    print("wrote", options.pictures.path("friction_laws", "json"))
    print("wrote", draw(springs, options.pictures.path("friction_laws")))


if __name__ == "__main__":
    main()

"""Friction laws compared, from 200 Hz to 5 kHz.

Figure 8's case and four hard tests, at the same delay.

Prints three tables, writes every figure to friction_laws.json and a picture to friction_laws.png.
"""

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_study import against_exact, chatter, creep, cycle_work, friction_law, mean_friction
from maglev_mj import Controller, Sample
from maglev_mj.cli.pictures import script_options
from maglev_mj.colours import SERIES
from maglev_mj.pictures import TITLE, name_curves, new_figure, save
from maglev_mj.scenes.stick_slip import LAWS, VELOCITIES
from maglev_mj.spec import Spec
from maglev_mj.versions import versions

OPTIONS = script_options(__doc__, quick="two rates and fewer load cycles")
QUICK, PICTURES = OPTIONS.quick, OPTIONS.pictures
RATES = (200, 500) if QUICK else (200, 500, 1000, 2000, 5000)
CASES = (
    ("ideal, difference", 0.0, "difference"),
    ("5 µm, difference", 5e-6, "difference"),
    ("5 µm, low-pass", 5e-6, "low-pass"),
    ("5 µm, adaptive", 5e-6, "adaptive"),
)
DELAY = Spec.transport_delay.value
CYCLES = 10 if QUICK else 200


def fixed(value: float) -> str:
    """Return a figure with two digits; zero has no sign."""
    return f"{round(value, 2) + 0.0:.2f}"


def microseconds(name: str, period: float) -> float:
    """Return the law's cost a controller tick [µs]: the least of five runs."""
    samples = [Sample(k, k * period, [1e-3 * (k % 7), 0.0, 0.0, 0.0, 0.0, 0.0]) for k in range(200 if QUICK else 2000)]
    costs = []
    for _ in range(5):
        controller = Controller([friction_law(name, period)], period=period)
        start = time.perf_counter()
        for sample in samples:
            controller.step(sample)
        costs.append((time.perf_counter() - start) / len(samples) * 1e6)
    return min(costs)


def estimator_rows() -> list[dict[str, Any]]:
    """Return the cost of each velocity estimate [µs].

    A tick at 1 kHz over a slow motion on the 5 µm sensor.
    """
    rows = []
    for velocity, make in VELOCITIES.items():
        estimator = make(5e-6)
        places = [[5e-6 * round(2.0 * tick), 0.0, 0.0, 0.0, 0.0, 0.0] for tick in range(500)]
        state: Any = None
        start = time.perf_counter()
        for place in places:
            _, state = estimator(place, state, 1e-3)
        rows.append({"velocity": velocity, "microseconds": (time.perf_counter() - start) / len(places) * 1e6})
    return rows


def spring_rows() -> list[dict[str, Any]]:
    """Return figure 8's case for each combination.

    Of law, rate, sensor and, with the quantized one, velocity estimate.
    """
    rows = []
    for name in LAWS:
        for rate in RATES:
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


def hard_rows() -> list[dict[str, Any]]:
    """Return the hard tests for each law and rate.

    With the ideal sensor and the quantized one.
    """
    rows = []
    for name in LAWS:
        for rate in RATES:
            period, cost = 1 / rate, microseconds(name, 1 / rate)
            for quantize in (0.0, 5e-6):
                rows.append(
                    {
                        "law": name,
                        "rate": rate,
                        "quantize": quantize,
                        "creep": creep(name, period=period, delay=DELAY, cycles=CYCLES, quantize=quantize),
                        "chatter": chatter(name, period=period, delay=DELAY, quantize=quantize),
                        "friction_slow": mean_friction(name, 0.01, period=period),
                        "friction_fast": mean_friction(name, 0.1, period=period),
                        "work_stuck": cycle_work(name, 2e-4, period=period, delay=DELAY, quantize=quantize),
                        "work_sliding": cycle_work(name, 1e-3, period=period, delay=DELAY, quantize=quantize),
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
    figure, panels = new_figure(2, 2, 6.6, sharex=True, sharey=True)
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
    springs, hard, costs = spring_rows(), hard_rows(), estimator_rows()
    data = {"spring": springs, "hard": hard, "velocity": costs, "versions": versions()}
    PICTURES.path("friction_laws", "json").write_text(json.dumps(data, indent=1) + "\n")

    print(f"Figure 8's case, delay {DELAY * 1e3:g} ms: greatest distance from exact friction in mm")
    print("(changes of state, ripple at the end in µm)")
    print(f"  {'law':<19}{'sensor, velocity':<20}" + "".join(f"{rate:>15} Hz" for rate in RATES))
    for name in LAWS:
        for label, quantize, velocity in CASES:
            chosen = [r for r in springs if (r["law"], r["quantize"], r["velocity"]) == (name, quantize, velocity)]
            cells = "".join(
                f"{r['error'] * 1e3:>8.3f} ({r['transitions']:>2},{r['ripple'] * 1e6:>5.0f})" for r in chosen
            )
            print(f"  {name if velocity == 'difference' and not quantize else '':<19}{label:<20}{cells}")
    print()
    print(f"Hard tests: creep over {CYCLES} load cycles; changes of state at a load just above")
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
    print("wrote", PICTURES.path("friction_laws", "json"))
    print("wrote", draw(springs, PICTURES.path("friction_laws")))


if __name__ == "__main__":
    main()

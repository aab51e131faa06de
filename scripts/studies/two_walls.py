"""Two walls close together: rattling starts, by gap, delay and braking pulse."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array, Mask
from maglev_mj.pictures import SECOND, TITLE, name_curves, new_figure, save
from maglev_mj.spec import RANGE, Spec
from maglev_mj.versions import versions
from tests.theory.impacts import RATTLE, rattle

options = script_options(__doc__, quick="one pulse, fewer gaps, delays and starts")
pictures = options.pictures
quick = options.quick

# the paper's, that which stops the flotor within its 3 ms and no more, and none
PULSES = (220.0, Spec.moving_mass.value / 0.003 - 80.0, 0.0)[: 1 if quick else None]
GAPS = np.array([0.01, 0.03, 0.2, 2.0] if quick else [0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0])
DELAYS = np.array([0.0, 3.0] if quick else np.arange(13) * 0.25)
# 0.3 m/s is a fall through the device's whole range
SPEEDS, PHASES = (np.arange(1, 17) * 0.02)[:: 4 if quick else 1], np.arange(8)[:: 4 if quick else 1] / 8
STARTS, RANDOM_STARTS = SPEEDS.size * PHASES.size, 20 if quick else 2000
DURATION = 2.0 if quick else 16.0


def shares(pulse: float, delay: float) -> tuple[Array, Mask]:
    """Return the share of rattling starts in each gap, and whether one leaves the device's range."""
    gaps = GAPS[:, None, None] * 1e-3
    motion = rattle(gaps, SPEEDS[:, None], PHASES, pulse=pulse, delay=delay * 1e-3, duration=DURATION)
    return (motion.speed > RATTLE).mean(axis=(1, 2)), np.any(motion.furthest > RANGE[2], axis=(1, 2))


def widest(pulse: float, delay: float, seed: int) -> float:
    """Return the widest rattling gap among random starts [mm]; 0 for none."""
    random = np.random.default_rng(seed)
    gap = np.exp(random.uniform(np.log(1e-5), np.log(5e-3), RANDOM_STARTS))
    speed = random.uniform(0.02, 0.45, RANDOM_STARTS) * random.choice([-1.0, 1.0], RANDOM_STARTS)
    start, phase = random.uniform(-0.95, 0.95, RANDOM_STARTS), random.random(RANDOM_STARTS)
    motion = rattle(gap, speed, phase, starts=start, pulse=pulse, delay=delay * 1e-3, duration=DURATION)
    return float(gap[motion.speed > RATTLE].max(initial=0.0) * 1e3)


def draw(
    maps: Sequence[tuple[str, Array, Mask]], axes: tuple[Array, Array], labels: tuple[str, str, str], path: Path
) -> Path:
    """Draw two maps of shares side by side.

    Args:
        maps: Title, shares (M, N), and which cells leave the device's range (M, N), of each map.
        axes: Values of the rows (M,) and of the columns (N,).
        labels: Names of rows, columns and share.
        path: File to write.
    """
    rows, columns = axes
    deep = -(-len(maps) // 2)
    least = [next((f"from {y:g} ms" for y, row in zip(rows, share) if row.any()), "never") for _, share, _ in maps]
    found = ", ".join(f"{start} ({title})" for start, (title, *_) in zip(least, maps))
    head = f"Two walls rattle with a delay {found}", "two walls of 6000 N/m and 80 N s/m, 200 Hz, 60 N"
    figure, panels = new_figure(head, deep, 2, deep * (0.25 * len(rows) + 0.8) + 0.4, sharex=True, sharey=True)
    for panel, (title, share, outside) in zip(panels, maps):
        panel.grid(visible=False)
        panel.imshow(np.ma.masked_equal(share, 0.0), cmap="GnBu", vmin=-0.1, vmax=1.4, aspect="auto", origin="lower")
        for (row, column), value in np.ndenumerate(share):
            if value > 0.0:
                text = "1" if value == 1.0 else f"{value:.2f}".lstrip("0")
                panel.text(column, row, text, ha="center", va="center", fontsize=8.0)
        left_row, left_column = np.nonzero(outside)
        panel.plot(left_column + 0.32, left_row + 0.32, ".", color=SECOND, markersize=3.5)
        panel.set_xticks(range(len(columns)), [f"{value:g}" for value in columns], rotation=90)
        panel.set_yticks(range(len(rows)), [f"{value:g}" for value in rows])
        panel.set_xlabel(labels[1])
        panel.set_ylabel(labels[0])
        panel.set_title(title, **TITLE)
        panel.tick_params(labelbottom=True, labelleft=True)
    for panel in panels[len(maps) :]:
        panel.set_axis_off()
    words = f"dot: leaves the device's range; number: {labels[2]}; white: none"
    panels[0].plot([], [], ".", color=SECOND, markersize=5, label=words)
    name_curves(figure, panels[:1])
    return save(figure, path)


print("Two walls of 6000 N/m and 80 N s/m, 200 Hz, 60 N, pulse added to the damping for 3 ms. Share of the starts")
print(f"that rattle, still above {RATTLE * 1e3:g} mm/s after {DURATION:g} s, among {STARTS} from the middle:")
print(
    f"{SPEEDS.size} speeds of {SPEEDS[0]:g} to {SPEEDS[-1]:g} m/s at {PHASES.size} phases. Last column: the widest gap"
)
print(f"[mm] that rattles among {RANDOM_STARTS} random starts of 0.02 to 0.45 m/s, at any place between and any phase")
data: list[dict[str, Any]] = []
for pulse in PULSES:
    print(f"\npulse {pulse:.0f} N s/m, gap in mm")
    print("delay (ms)" + "".join(f"{gap:>6g}" for gap in GAPS) + "   random")
    for seed, delay in enumerate(DELAYS.tolist()):
        share, outside = shares(pulse, delay)
        most = widest(pulse, delay, seed)
        cells = [f"{one:.2f}" if one else "-" for one in share]
        print(f"{delay:>10g}" + "".join(f"{cell:>6}" for cell in cells) + f"{f'{most:.2f}' if most else '-':>9}")
        row = {"pulse": pulse, "delay": delay * 1e-3, "gaps": (GAPS * 1e-3).tolist()}
        data.append({**row, "share": share.tolist(), "outside": outside.tolist(), "widest_of_random": most * 1e-3})
text = json.dumps({"versions": versions(), "rows": data}, indent=1)
pictures.path("two_walls", "json").write_text(text + "\n")
print("wrote", pictures.path("two_walls", "json"))
maps = []
for pulse in PULSES:
    rows = [row for row in data if row["pulse"] == pulse]
    both = [np.array([row[name] for row in rows]) for name in ("share", "outside")]
    maps.append((f"pulse {pulse:.0f} N s/m" if pulse else "no pulse", both[0], both[1]))
names = ("delay (ms)", "gap (mm)", f"share of {STARTS} starts that rattle")
print("wrote", draw(maps, (DELAYS, GAPS), names, pictures.path("two_walls")))

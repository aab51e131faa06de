"""Fly over slow lines, with bad laws and with faults: the time to the end, and the flotor's speed.

    python scripts/studies/flights.py product | laws | good | takeoffs [--number 2000]
    python scripts/studies/flights.py record | attacks | tables
    python scripts/studies/flights.py faults [udp | serial] [NAME ...]
    python scripts/studies/flights.py flood --number 20

Flights of the twin in simulated time, by the twin's truth. `record` measures delays of this machine in real time, over
UDP, which `good` flies again; `faults` and `flood` fly in real time too, see `real_flights.py`. Each simulated flight
is a line of a file in `--out`; a second call continues where the first ended.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

import real_flights
from maglev_mj import find_scene, judge
from maglev_mj.bridge import Twin, TwinParameters
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.preflight import preflight
from maglev_mj.bridge.realtime import realtime
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.scenes import Scene
from maglev_mj.session import device_controller
from maglev_mj.spec import Spec
from maglev_mj.versions import versions
from real_flights import print_table
from tests.bridge.slow_lines import (
    HAND_BEGINS,
    PUSHES,
    SHAPES,
    STOP_REACHED,
    ChangedLaw,
    Flown,
    Line,
    fly,
    margin,
    residual,
    rounded,
)

Row = dict[str, Any]

SCENES = ("joystick", "drop", "press", "table", "box", "corner", "stick-slip", "six-axes")
FACTORS: dict[str, tuple[Any, ...]] = {
    "delay": (0, 1, 2, 3, 4, 5, 7, 10, 15, 20, 30, 45, 60),
    "shape": tuple(SHAPES),
    "scene": SCENES,
    "hand": ("none", "5", "8", "tap"),
    "moment": (0.3, 0.7, 1.1),
    "rate": (200, 1000),
}
"""Values of each factor.

Delay each way [ms], its begin after the hand's [s], samples a second.
"""

_TOLD = (0,), (1,), (2,), (3, 4, 5), (7, 10), (15, 20), (30, 45, 60)
"""Delays each way of the lines of a table [ms]."""

FREE, PRESSED, LONG = 0.30, 0.40, 0.15
"""Largest speed asked for, untouched and pressed [m/s], and longest time above the first [s]."""

_TAKEOFF, _DELAY = 1.15, Spec.transport_delay.value


# flights as lines of a file


def key(row: Row) -> str:
    """Return the text that tells a flight from others."""
    return json.dumps(row["cell"], sort_keys=True)


def read_rows(path: Path) -> list[Row]:
    """Return the flights of a file; none without it."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]


def go_on(path: Path, cells: Iterable[Row], evaluate: Callable[[Row], Row]) -> None:
    """Fly the cells that are not in the file, and add them."""
    known = {key(row) for row in read_rows(path)}
    for cell in cells:
        if key({"cell": cell}) not in known:
            row = json.dumps({"cell": cell, **evaluate(cell), "versions": versions()})
            with path.open("a", encoding="utf-8") as file:
                file.write(row + "\n")


def flight(name: str, **options: Any) -> Flown:
    """Fly once; the last cycles of a fault are not kept."""
    with tempfile.TemporaryDirectory() as folder:
        return fly(name, folder=folder, **options)


def outcome_kind(outcome: str) -> str:
    """Return the rule or fault that ended a flight."""
    rules = {
        "of the last 64": "48 of 64 late",
        "of the last 16": "8 of 16 late",
        "of the last 5": "3 of 5 late",
        "vibrate": "reversals",
        "generate energy": "energy",
    }
    swung = "swing in landing" if "in the landing" in outcome else ""
    cause = next((name for text, name in rules.items() if text in outcome), "")
    if not cause:
        names = re.findall(r"\b[A-Z]{3,}(?:_[A-Z]+)*\b", outcome)
        cause = "landed" if outcome == "landed" else " ".join(dict.fromkeys(names)) or outcome[:60]
    return f"{cause}, {swung}" if swung else cause


def figures(flown: Flown, since: float) -> Row:
    """Return the figures of a flight from a time on, or from its end."""
    since = min(since, flown.ended)
    rate = 1.0 / float(np.median(np.diff(flown.rows[:, 0])))
    rows, speeds = flown.after(since), flown.speeds(since)
    off = rows[rows[:, 14] != 1.0, 0]
    contact = np.abs(rows[:, 1:4]).max(axis=1) > STOP_REACHED
    fastest = int(speeds.argmax())
    active = speeds[rows[:, 14] == 1.0]
    return {
        "outcome": outcome_kind(flown.outcome),
        "speed": rounded(speeds.max()),
        "active": rounded(active.max(initial=0.0)),
        "fastest_at": rounded(rows[fastest, 0]),
        "fastest_active": bool(rows[fastest, 14] == 1.0),
        "at_stop": rounded(flown.at_stop(since)),
        "above": rounded((speeds > FREE).sum() / rate),
        "current": rounded(rows[:, 13].max(), 3),
        "ended": rounded(flown.ended),
        "off": rounded(float(off[0]) if off.size else math.nan),
        "touched": rounded(float(rows[contact, 0][0]) if contact.any() else math.nan),
        "reversals": rounded(flown.reversals, 2),
        "small": rounded(flown.small, 2),
        "energy": rounded(flown.energy, 5),
        "critical_delay": rounded(flown.critical_delay, 5) if math.isfinite(flown.critical_delay) else None,
    }


# 1. the product of delays, scenes, hands, moments and rates


def pairwise(factors: dict[str, tuple[Any, ...]], draw: random.Random) -> Iterator[Row]:
    """Yield cells that hold every pair of values, greedily."""
    names = list(factors)
    open_pairs = {
        (one, first, other, second)
        for one, other in combinations(names, 2)
        for first, second in product(factors[one], factors[other])
    }

    def pairs(cell: Row) -> set[tuple[str, Any, str, Any]]:
        return {(one, cell[one], other, cell[other]) for one, other in combinations(names, 2)}

    while open_pairs:
        one, first, other, second = min(open_pairs, key=repr)
        tries = [{name: draw.choice(factors[name]) for name in names} | {one: first, other: second} for _ in range(60)]
        best = max(tries, key=lambda cell: len(pairs(cell) & open_pairs))
        open_pairs -= pairs(best)
        yield best


def product_cells(number: int, seed: int = 33) -> Iterator[Row]:
    """Yield the pairwise cells, then random ones of the full product."""
    draw, flown, seen = random.Random(seed), 0, set[str]()
    cells = list(pairwise(FACTORS, draw))
    rest = [dict(zip(FACTORS, values)) for values in product(*FACTORS.values())]
    draw.shuffle(rest)
    for cell in [*cells, *rest]:
        text = json.dumps(cell, sort_keys=True)
        if text in seen:
            continue
        if flown >= number:
            return
        seen.add(text)
        flown += 1
        yield cell | {"seed": 70_000 + flown}


def fly_product(cell: Row) -> Row:
    """Fly a cell of the product; one that exceeds also without the delay."""
    rate, hand, draw = cell["rate"], cell["hand"], random.Random(cell["seed"])
    moment = HAND_BEGINS + cell["moment"]
    size, shape = cell["delay"] * 1e-3, SHAPES[cell["shape"]]
    seconds = moment - _TAKEOFF + (1.3 if cell["shape"] == "ramp" else 0.9)
    options: Row = {"rate": rate, "hand": hand, "seconds": seconds, "seed": cell["seed"]}
    flown = flight(cell["scene"], delay=lambda time: shape(size, time - moment, draw), **options)
    row = figures(flown, moment)
    spare = (flown.critical_delay - _DELAY) / 2.0
    late = [time for time, delay in flown.delays if time >= moment and delay > spare]
    row["late"] = rounded(late[0]) if late else None
    if row["speed"] > FREE:
        row["alone"] = figures(flight(cell["scene"], **options), moment)["speed"]
    return row


# 2. laws


@cache
def wall_of(name: str, rate: int, spectral_radius: float) -> float:
    """Return the stiffness at which a scene's spectral radius has a spectral radius [N/m]."""
    scene = find_scene(name)().replace(period=1.0 / rate, delay=_DELAY)
    low, high = 1.0, 1e8  # of the logarithm's middle
    for _ in range(60):
        middle = math.sqrt(low * high)
        root = judge(device_controller(scene.replace(stiffness=middle)), delay=_DELAY).spectral_radius
        low, high = (middle, high) if root < spectral_radius else (low, middle)
    return high


LAW_SCENES = ("joystick", "drop", "corner")
LAWS: dict[str, tuple[Any, ...]] = {
    "sign error": (0,),
    "chatter, each sample": (5, 10, 25),
    "chatter, each 2nd sample": (5, 10, 25),
    "chatter, each 5th sample": (5, 10, 25),
    "constant push": (5, 10, 20, 30),
    "wall of root": (1.02, 1.1, 1.3),
    "NaN": (0,),
    "raises": (0,),
    "sleeps once [ms]": (20, 40, 100),
    "sleeps at each sample [ms]": (20, 40),
    "spins": (0,),
}


def law_cells(seeds: Sequence[int]) -> Iterator[Row]:
    """Yield the cells of laws."""
    for kind, sizes in LAWS.items():
        hands = ("none", "5") if kind in ("sign error", "wall of root") else ("none",)
        for size, name, rate, seed, hand in product(sizes, LAW_SCENES, (200, 1000), seeds, hands):
            yield {"law": kind, "size": size, "scene": name, "rate": rate, "seed": seed, "hand": hand}


def pass_time(link: Any, seconds: float) -> None:
    """Let a host do nothing while the device samples."""
    end = link.time + round(seconds * 1e9)
    while (due := min(link._next_sample(), link._line.due)) <= end:
        link.time = max(link.time, due)
        if link._next_sample() <= link.time:
            link._sample()
        link._deliver()
    link.time = end


def fly_law(cell: Row) -> Row:
    """Fly a bad law, 0.5 s after takeoff; walls from the first contact on."""
    kind, size, name, rate = cell["law"], cell["size"], cell["scene"], cell["rate"]
    axis, sense = PUSHES[name]
    links: list[Any] = []
    begun: list[float] = []

    def sleep(seconds: float, error: bool = False) -> float:
        pass_time(links[0], seconds)
        if error:
            raise RuntimeError("it raises")
        return 0.0

    every = {"each sample": 1, "each 2nd sample": 2, "each 5th sample": 5}.get(kind.partition(", ")[2], 1)
    once = round(0.5 * rate) + 1
    acts: dict[str, Callable[[int, float], float]] = {
        "sign error": lambda tick, own: -2.0 * own,
        "chatter": lambda tick, own: size * (-1.0) ** (tick // every),
        "constant push": lambda tick, own: float(size * sense),
        "NaN": lambda tick, own: math.nan,
        "raises": lambda tick, own: sleep(0.0, error=True),
        "sleeps once [ms]": lambda tick, own: sleep(size * 1e-3) if tick == once else 0.0,
        "sleeps at each sample [ms]": lambda tick, own: sleep(size * 1e-3),
        "spins": lambda tick, own: sleep(1.0, error=True),
    }
    act = acts.get(kind.partition(",")[0])

    def change(tick: int, own: float) -> float:
        if not begun:
            begun.append(links[0].time * 1e-9)
        assert act is not None
        return act(tick, own)

    scene: Scene | None = None
    if kind == "wall of root":
        scene = find_scene(name)().replace(stiffness=wall_of(name, rate, size))
    law = None if act is None else partial(ChangedLaw, change=change, axis=axis)
    options: Row = {"scene": scene, "law": law, "critical_delay": margin(name, rate, _DELAY), "rate": rate}
    options |= {"hand": cell["hand"], "seed": cell["seed"], "seconds": 1.6 if rate == 1000 else 2.0}
    flown = flight(name, prepare=lambda twin, link: links.append(link), **options)
    since = begun[0] if begun else flown.began
    return {"begun": rounded(since), **figures(flown, since)}


# 3. good flights, over delays of a real machine


GOOD_HANDS = ("none", "2", "5", "8", "12", "20", "tap", "5~", "12~", "push")


def good_cells(number: int, seconds: float) -> Iterator[Row]:
    """Yield random flights of all scenes, hands, rates and loads."""
    draw = random.Random(34)
    choices = list(product(SCENES, GOOD_HANDS, (*[200] * 11, 1000), ("quiet", "busy")))
    for index in range(number):
        if index % len(choices) == 0:
            draw.shuffle(choices)
        name, hand, rate, load = choices[index % len(choices)]
        yield {"scene": name, "hand": hand, "rate": rate, "load": load, "seconds": seconds, "seed": 100_000 + index}


def fly_good(delays: dict[str, list[int]], cell: Row) -> Row:
    """Fly a good flight over recorded delays, after the check before takeoff.

    The delays begin at a random place of the recording; without one they are drawn: 0.3 ms and an exponential 0.15 ms
    each way. The line is measured for the first second; the scene flown is what the check before takeoff makes of it.
    """
    rate, seed = cell["rate"], cell["seed"]
    recorded, draw = delays.get(f"{cell['load']} {rate}", []), random.Random(seed)
    start = draw.randrange(len(recorded) or 1)

    def delay(time: float) -> float:
        if not recorded:
            return 3e-4 + draw.expovariate(1.0 / 1.5e-4)
        return recorded[(start + int(time * rate)) % len(recorded)] * 0.5e-6

    with tempfile.TemporaryDirectory() as folder:
        link = VirtualLink(Twin(TwinParameters(period=1.0 / rate, seed=seed), draw=lambda: 7))
        link._line = Line(delay)  # type: ignore[assignment]
        with RemotePlant(link, folder=folder) as plant:
            result = preflight(plant, find_scene(cell["scene"])())
        latency: Row = {"delay_95": rounded(result.report.delay_95, 6), "reduced": bool(result.reduction)}
        if result.problem:
            return {"refused": result.problem, **latency}
        options = {name: cell[name] for name in ("rate", "hand", "seconds", "seed")}
        options |= {"scene": result.scene, "critical_delay": result.critical_delay, "folder": folder}
        flown = fly(cell["scene"], delay=lambda time: delay(time + 1.0), **options)
    rms, largest = residual(flown, cell["scene"], cell["hand"], rate)
    time = rounded((flown.rows[:, 14] == 1.0).sum() / rate)
    return figures(flown, flown.began) | latency | {"said": flown.outcome, "time": time, "rms": rms, "largest": largest}


# 4. the check of the coils in takeoff

NOISES = (4e-7, 5e-6)
GAINS = {0.9: "at 90 %", 1e-3: "dead", -1.0: "reversed"}


def takeoff_cells() -> Iterator[Row]:
    """Yield takeoffs with good coils, then each coil weak, dead and reversed."""
    good = product((1.0,), (0,), SCENES, FACTORS["rate"], NOISES, range(7))
    bad = product(GAINS, range(6), ("joystick",), FACTORS["rate"], NOISES, range(20))
    names = "gain", "coil", "scene", "rate", "noise"
    for seed, values in enumerate([*good, *bad], 110_000):
        yield dict(zip(names, values)) | {"seed": seed}


def fly_takeoff(cell: Row) -> Row:
    """Take off with a coil of another gain, and land at once."""
    truth = Calibration.nominal()
    constants = truth.coils.force_constants.copy()
    constants[cell["coil"]] *= cell["gain"]
    truth = replace(truth, coils=replace(truth.coils, force_constants=constants))
    options = {name: cell[name] for name in ("rate", "seed", "noise")}
    flown = flight(cell["scene"], truth=truth, seconds=0.05, critical_delay=math.inf, **options)
    named = re.findall(r"coil (\d)", flown.outcome)
    return figures(flown, 0.0) | {"said": flown.outcome[:200], "named": named == [str(cell["coil"])]}


# 5. attacks of an earlier check, again


def frozen_spots(twin: Any, link: Any) -> None:
    """Freeze the spots 0.5 s after the hand's begin, but for a toggling last step."""
    read, seen = twin._read, list[list[float]]()

    def frozen(position: Any) -> list[float]:
        spots = list(read(position))
        if twin.tick * twin.parameters.period < HAND_BEGINS + 0.5:
            return spots
        seen.append(spots)
        return [spot + Spec.spot_resolution.value * (len(seen) % 2) for spot in seen[0]]

    twin._read = frozen


ATTACKS: dict[str, Row] = {
    "10 ms each way, untouched": {"delay": lambda time: 0.010 * (time >= HAND_BEGINS + 0.5)},
    "20 ms each way, untouched": {"delay": lambda time: 0.020 * (time >= HAND_BEGINS + 0.5)},
    "4 ms each way, 8 N hand": {"delay": lambda time: 0.004 * (time >= HAND_BEGINS + 0.5), "hand": "8"},
    "spots frozen but for a toggling bit, untouched": {"prepare": frozen_spots},
    "spots frozen but for a toggling bit, 5 N hand": {"prepare": frozen_spots, "hand": "5"},
}


def print_attacks() -> None:
    """Fly the attacks on the default scene, and print what they meet."""
    rows = []
    for name, options in ATTACKS.items():
        flown = flight("joystick", seed=91_000, **options)
        measured = figures(flown, HAND_BEGINS + 0.5)
        after = [measured[end] and round(1e3 * (measured[end] - HAND_BEGINS - 0.5)) for end in ("ended", "off")]
        outcome = flown.outcome.partition("; the last cycles")[0]
        rows.append((name, outcome, *after, measured["speed"], measured["current"]))
    print_table("attack", "end", "detected [ms]", "no current [ms]", "speed [m/s]", "current [A]", rows=rows)


# tables


def largest(rows: Iterable[Row], name: str, digits: int = 2) -> str:
    """Return the largest figure of that name as text."""
    values = [row[name] for row in rows if row[name] is not None]
    return f"{max(values):.{digits}f}" if values else ""


def spread(values: Sequence[float]) -> str:
    """Return median and largest of times [ms] as text."""
    return f"{1e3 * float(np.median(values)):.0f}, {1e3 * max(values):.0f}" if values else ""


def exceeds(row: Row) -> bool:
    """Return True if a flight of the product was faster than asked for."""
    if row["cell"]["hand"] == "none":
        return bool(row["speed"] > FREE)
    return bool(row["speed"] > PRESSED or row["above"] > LONG)


def is_cut(row: Row) -> bool:
    """Return True if a fault ended a flight."""
    return bool(re.search(r"[A-Z]{4}|swing", row["outcome"]))


def print_product(rows: list[Row]) -> None:
    """Print the product's tables."""
    print(f"\n{len(rows)} flights, {sum(map(exceeds, rows))} exceed")
    by_hand = [
        (
            hand,
            len(own),
            sum("late" in row["outcome"] and not is_cut(row) for row in own),
            sum(map(is_cut, own)),
            largest(own, "active", 3),
            largest(own, "speed", 3),
            largest(own, "at_stop", 3),
            largest(own, "above", 3),
            largest(own, "current", 1),
            sum(map(exceeds, own)),
        )
        for hand in FACTORS["hand"]
        if (own := [row for row in rows if row["cell"]["hand"] == hand])
    ]
    speeds = "speed with current [m/s]", "and after", "at the stop", "above 0.30 m/s [s]"
    print_table("hand", "flights", "landed early", "cut", *speeds, "current [A]", "exceed", rows=by_hand)
    by_delay = []
    for rate, delays in product(FACTORS["rate"], _TOLD):
        own = [row for row in rows if row["cell"]["delay"] in delays and row["cell"]["rate"] == rate]
        ended = [row for row in own if row["outcome"] != "landed" and row["late"] is not None]
        detection = [min(row["ended"], row["off"]) - row["late"] for row in ended]
        off = [row["off"] - row["late"] for row in ended]
        hands = [
            largest([row for row in own if row["cell"]["hand"] in kinds], "speed", 3)
            for kinds in (["none"], ["5", "8"], ["tap"])
        ]
        on, cut = sum(row["outcome"] == "landed" for row in own), sum(map(is_cut, own))
        listed = ", ".join(map(str, delays))
        by_delay.append((rate, listed, len(own), on, len(own) - on - cut, cut, spread(detection), spread(off), *hands))
    head = "rate", "each way [ms]", "flights", "flown on", "landed", "cut", "detected [ms]", "no current [ms]"
    print_table(*head, "untouched [m/s]", "pressed", "tapped", rows=by_delay)
    counts = Counter(row["outcome"] for row in rows)
    print_table("end", "flights", rows=counts.most_common())
    faster = sorted(filter(exceeds, rows), key=lambda row: (row["cell"]["hand"], -row["speed"]))
    print_table(
        *FACTORS,
        "end",
        "speed",
        "with current",
        "above 0.30 m/s [s]",
        "without delay",
        rows=(
            (
                *(row["cell"][name] for name in FACTORS),
                *(row[name] for name in ("outcome", "speed", "active", "above")),
                row.get("alone", ""),
            )
            for row in faster
        ),
    )


def print_laws(rows: list[Row]) -> None:
    """Print the table of laws."""
    table = []
    for kind, sizes in LAWS.items():
        for size in sizes:
            line: list[str] = []
            names: Counter[str] = Counter()
            for rate in FACTORS["rate"]:
                own = [
                    row for row in rows if [row["cell"][name] for name in ("law", "size", "rate")] == [kind, size, rate]
                ]
                ended = [row for row in own if row["outcome"] != "landed"]
                names.update(row["outcome"] for row in ended)
                times = spread([min(row["ended"], row["off"]) - row["begun"] for row in ended])
                line += [f"{len(ended)} of {len(own)}", times, largest(own, "active")]
            if any(line):
                table.append((kind, size or "", ", ".join(names), *line))
    head = (f"{name}, {rate} Hz" for rate in FACTORS["rate"] for name in ("ended", "after [ms]", "speed [m/s]"))
    print_table("law", "size", "by", *head, rows=table)


def print_good(rows: list[Row]) -> None:
    """Print the tables of good flights, and of the estimated hand."""
    refused = sum("refused" in row for row in rows)
    rows = [row for row in rows if "refused" not in row]
    reduced, hours = sum(row["reduced"] for row in rows), sum(row["time"] for row in rows) / 3600.0
    ended = Counter(row["outcome"] for row in rows)
    print(f"\n{refused} refused; {len(rows)} flights, {reduced} reduced, {hours:.2f} hours; {dict(ended)}")
    table, errors = [], []
    for rate, hand in product((200, 1000), GOOD_HANDS):
        own = [row for row in rows if (row["cell"]["rate"], row["cell"]["hand"]) == (rate, hand)]
        if not own:
            continue
        early = sum(row["outcome"] != "landed" for row in own)
        sums = largest(own, "reversals", 1), largest(own, "small", 1), f"{1e3 * max(row['energy'] for row in own):.1f}"
        table.append((rate, hand, len(own), early, *sums, largest(own, "active"), largest(own, "above", 3)))
        known = [row for row in own if row["rms"]]
        parts = [(*row["rms"], *row["largest"]) for row in known]
        if parts:
            force, torque, most, turned = np.array(parts).max(axis=0)
            middle = np.median([row["rms"][0] for row in known])
            figures = f"{middle:.3f}", f"{force:.3f}", f"{most:.3f}", f"{1e3 * torque:.2f}", f"{1e3 * turned:.2f}"
            errors.append((rate, hand, len(known), *figures))
    head = "flights", "ended early", "reversals [N]", "of 10 N", "energy [mJ]", "speed [m/s]", "above 0.30 m/s [s]"
    print_table("rate", "hand", *head, rows=table)
    errors_head = "rms [N], median", "rms, worst", "largest [N]", "rms [mN m], worst", "largest [mN m]"
    print_table("rate", "hand", "flights", *errors_head, rows=errors)


def print_takeoffs(rows: list[Row]) -> None:
    """Print the table of takeoffs."""
    table = []
    for gain, rate, noise in product((1.0, *GAINS), FACTORS["rate"], NOISES):
        names = {"gain": gain, "rate": rate, "noise": noise}.items()
        own = [row for row in rows if names <= row["cell"].items()]
        refused, lost = (sum(text in row["said"] for row in own) for text in ("no flight", "NOT_FOLLOWING"))
        missed = Counter(row["cell"]["coil"] for row in own if not row["named"])
        counts = len(own), refused, lost, sum(row["named"] for row in own), dict(missed) if gain < 1.0 else ""
        table.append((GAINS.get(gain, "good"), rate, f"{noise * 1e6:g}", *counts, largest(own, "speed")))
    head = "takeoffs", "refused", "lost", "the coil named", "not named", "speed [m/s]"
    print_table("coil", "rate", "noise [µm]", *head, rows=table)


PARTS: dict[str, tuple[Callable[..., Iterable[Row]], Callable[..., Row], Callable[[list[Row]], None]]] = {
    "product": (lambda given: product_cells(given.number), fly_product, print_product),
    "laws": (lambda given: list(law_cells(range(90_000, 90_000 + given.seeds)))[: given.number], fly_law, print_laws),
    "good": (
        lambda given: [cell for cell in good_cells(given.number, given.seconds) if given.rate in (0, cell["rate"])],
        fly_good,
        print_good,
    ),
    "takeoffs": (lambda given: list(takeoff_cells())[: given.number], fly_takeoff, print_takeoffs),
}
"""Cells, evaluation and tables of each part in simulated time."""


def main() -> None:
    """Fly one part of the study, or print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=(*PARTS, "record", "attacks", "tables", "faults", "flood"))
    parser.add_argument("names", nargs="*", help="lines and names of faults (all)")
    parser.add_argument("--number", type=int, default=2000, help="flights, earlier ones included, or of each flood")
    parser.add_argument("--seconds", type=float, default=2.0, help="duration of a good flight, or of a recording [s]")
    parser.add_argument("--rate", type=int, default=0, help="sample rate of the good flights [Hz]; 0 for both")
    parser.add_argument("--seeds", type=int, default=2, help="flights of each law, scene and rate")
    parser.add_argument("--out", type=Path, default=Path("figures/flight_safety"))
    given = parser.parse_args()
    folder: Path = given.out
    folder.mkdir(parents=True, exist_ok=True)
    if given.part in PARTS:
        cells, evaluate, _ = PARTS[given.part]
        if given.part == "good":
            delays = folder / "delays.json"
            evaluate = partial(evaluate, json.loads(delays.read_text(encoding="utf-8")) if delays.exists() else {})
        go_on(folder / f"{given.part}.jsonl", cells(given), evaluate)
    elif given.part == "record":
        real_flights.record_delays(folder / "delays.json", given.seconds)
    elif given.part == "faults":
        with realtime("ignore"):
            real_flights.campaign(given.names)
    elif given.part == "flood":
        with realtime("ignore"):
            real_flights.floods(given.number)
    elif given.part == "attacks":
        print_attacks()
    else:
        for name, (_, _, printed) in PARTS.items():
            if rows := read_rows(folder / f"{name}.jsonl"):
                printed(rows)


if __name__ == "__main__":
    main()

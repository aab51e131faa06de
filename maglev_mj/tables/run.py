"""Runs and phases of any scene as text.

Excesses over the device's limits are included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array, Mask, unit_of
from maglev_mj.scenes.run import Phases, RunResult
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import RANGE, Spec
from maglev_mj.terminal import WIDTH, wrapped

_NAME, _LEAST = 13, 12


def run_table(results: Mapping[str, RunResult], sweeps: Mapping[str, Phases], gap: float | None) -> str:
    """Return the figures of runs and their phases as text.

    Args:
        results: Run for each label; the parameters of the first head the table.
        sweeps: The same at many phases; may be empty.
        gap: Greatest distance between the two plants on the first run [m, rad]; None if not compared.
    """
    first = next(iter(results.values()))
    scene = first.scene
    exact = scene.compared(first)
    runs = {
        **{
            label: [figure.text(one.figures[name]) for name, figure in scene.figures.items()]
            for label, one in results.items()
        },
        **{
            label: [figure.text(told.get(name, np.nan)) for name, figure in scene.figures.items()]
            for label, told in exact.items()
        },
    }
    spreads = {
        label: [figure.spread(sweep.figures[name]) for name, figure in scene.figures.items()]
        for label, sweep in sweeps.items()
    }
    where = f"at phase {first.phase:g}" if scene.takes_phase else ""
    blocks = [(where + _rank(first, sweeps), runs)]
    if sweeps:
        count = next(iter(sweeps.values())).phases.size
        blocks.append((f"over {count} phases: median (5 to 95 %)", spreads))
    lines = [*_head(scene, first.plant), "", *_blocks(scene, blocks)]
    remarks = _missing(sweeps) + _beyond_force(results)
    remarks += _beyond_range(
        list(results), [one.trace.furthest() for one in results.values()], [one.furthest for one in sweeps.values()]
    )
    if gap is not None:
        remarks.append(f"MuJoCo and the exact plant differ by at most {gap:.1e} {unit_of('m', scene.axis)}")
    told = [line for remark in remarks for line in wrapped(remark, further="    ")]
    return "\n".join([*lines, *(["", *told] if told else [])])


def _head(scene: Scene, plant: str) -> list[str]:
    """Return the name and parameters of the scene."""
    shown = [f"{1.0 / scene.period:g} Hz", f"delay {scene.delay * 1e3:g} ms"]
    for one in scene.parameters():
        value = getattr(scene, one.name)
        if one.name in ("period", "delay") or one.kind in (object, bool) or value is None:
            continue
        text = (
            f"{value:.6g} {unit_of(one.unit, scene.axis, one.along)}".rstrip()
            if one.kind in (int, float)
            else str(value)
        )
        shown.append(f"{one.name.replace('_', ' ')} {text}")
    # a name, its number and its unit stay on one line
    lines = wrapped(", ".join(text.replace(" ", "\0") for text in shown))
    return [*wrapped(f"{Scene.describe(scene)}, plant {plant}", ""), *lines]


def _rank(first: RunResult, sweeps: Mapping[str, Phases]) -> str:
    """Return the rank of a run among its phases.

    A single phase has little meaning.
    """
    if not sweeps or not first.scene.figures:
        return ""
    name = next(iter(first.scene.figures))
    values = next(iter(sweeps.values())).figures[name]
    if values.ndim > 1:
        return ""
    below = float(np.mean(values < first.figures[name] - 1e-9))  # the two plants round differently
    return f", {name.replace('_', ' ')} above that of {100.0 * below:.0f} % of the phases"


def _blocks(scene: Scene, blocks: Sequence[tuple[str, Mapping[str, Sequence[str]]]]) -> list[str]:
    """Return a line for each figure, one cell per label.

    Columns beyond the width go on below.
    """
    names = [name.replace("_", " ") for name in scene.figures]
    units = [unit_of(figure.unit, scene.axis, figure.along) for figure in scene.figures.values()]
    left = max([_NAME, *map(len, names)]) + 2
    room = WIDTH - left - 2 - max(map(len, units), default=0)
    parts = [(title, _columns(columns)) for title, columns in blocks]
    heads = [(title.split(",")[0], sum(len(one[0]) for one in columns)) for title, columns in parts]
    # side by side only if each title fits over its columns
    if len(parts) > 1 and sum(width for _, width in heads) <= room and all(len(text) < width for text, width in heads):
        titles = "".join(f"{text:>{width}}" for text, width in heads)
        parts = [(" " * left + titles, [column for _, columns in parts for column in columns])]
    lines: list[str] = []
    for title, columns in parts:
        lines += [""] * bool(lines) + wrapped(title, "") * bool(title.strip())
        for some in _fitting(columns, room):
            head, *rows = ("".join(cells) for cells in zip(*some))
            lines.append(" " * left + head)
            lines += [f"  {name:<{left - 2}}{row}  {unit}".rstrip() for name, row, unit in zip(names, rows, units)]
    return lines


def _columns(columns: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """Return the cells of each label, equally wide, label first."""
    widths = [max(_LEAST, *(len(text) + 1 for text in (label, *texts))) for label, texts in columns.items()]
    return [[f"{text:>{width}}" for text in (label, *texts)] for width, (label, texts) in zip(widths, columns.items())]


def _fitting(columns: Sequence[list[str]], room: int) -> list[list[list[str]]]:
    """Return columns in groups that fit the width."""
    groups: list[list[list[str]]] = []
    for column in columns:
        if not groups or sum(len(one[0]) for one in [*groups[-1], column]) > room:
            groups.append([])
        groups[-1].append(column)
    return groups


def _missing(sweeps: Mapping[str, Phases]) -> list[str]:
    """Return a line for each figure missing at some phases."""
    lines = []
    for label, sweep in sweeps.items():
        for name, values in sweep.figures.items():
            there = int(np.isfinite(values).reshape(len(values), -1).all(axis=1).sum())
            if there < len(values):
                lines.append(f"{label}: {name.replace('_', ' ')} is there at {there} of {len(values)} phases")
    return lines


_ROUNDING = 1.0 + 1e-9


def _beyond_force(results: Mapping[str, RunResult]) -> list[str]:
    """Return any line on vertical forces beyond the device's."""
    device = Spec.largest_vertical_force.value
    # the last knot's force has not acted yet
    peaks = {label: float(np.abs(one.trace.wrench[:-1, 2]).max(initial=0.0)) for label, one in results.items()}
    beyond = [f"{label} {peak:.3g}" for label, peak in peaks.items() if peak > device * _ROUNDING]
    return [f"Above the device's {device:g} N (z): {', '.join(beyond)}"] if beyond else []


def _beyond_range(labels: Sequence[str], runs: Sequence[ArrayLike], sweeps: Sequence[ArrayLike] = ()) -> list[str]:
    """Return a line on motions beyond the device's range.

    Empty if there are none.

    Args:
        labels: Name of each run.
        runs: Greatest distance from the centre on each axis [m, rad], (6,) each.
        sweeps: The same for each phase of each run, (N, 6) each; may be empty.
    """
    texts, left = [], np.zeros(len(RANGE), dtype=bool)
    for index, (label, run) in enumerate(zip(labels, runs, strict=True)):
        swept = np.asarray(sweeps[index]) if sweeps else np.empty((0, len(RANGE)))
        furthest = np.vstack([np.asarray(run), swept]).max(axis=0)
        if not (outside := _outside(furthest)).any():
            continue
        left |= outside
        phases = int(_outside(swept).any(axis=1).sum())
        count = f" ({phases} of {len(swept)} phases)" if phases else ""
        texts.append(f"{label} {_distances(np.where(outside, furthest, 0.0))}{count}")
    if not texts:
        return []
    return [f"Beyond the range of {_distances(np.where(left, RANGE, 0.0))}: {', '.join(texts)}"]


def _outside(furthest: Array) -> Mask:
    """Return the axes that leave the device's range."""
    outside: Mask = furthest > np.array(RANGE) * _ROUNDING
    return outside


def _distances(furthest: Array) -> str:
    """Return the largest nonzero translation and rotation with units."""
    parts = [(furthest[:3].max() * 1e3, "mm"), (np.degrees(furthest[3:].max()), "deg")]
    return " and ".join(f"{value:.4g} {unit}" for value, unit in parts if value > 0.0)

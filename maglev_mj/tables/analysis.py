"""Analysis of a recording as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from maglev_mj.analysis import Analysed, Comparison, FaceFigures, StretchFigures
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.result import number_text
from maglev_mj.tables.identification import identified_lines
from maglev_mj.terminal import wrapped

_NAME, _CELL = 20, 8
_WALL = 7, 9, 7, 9, 8, 9, 9
_CONTACT = 10
_CONTACTS_SHOWN, _STICKS_SHOWN = 8, 8
_NOTHING = 1e-12


def analysis_table(analysed: Analysed, number: int, count: int) -> str:
    """Return the figures of a stretch as text.

    Those of its simulation stand beside them if they differ.

    Args:
        analysed: The stretch.
        number: Number of the stretch, from 1.
        count: Number of stretches in the recording.
    """
    figures, comparison = analysed.recorded.figures, analysed.comparison
    other = analysed.simulated
    if other is not None and comparison is not None and comparison.same:
        other = None  # a second column would say the same
    beside = None if other is None else other.figures
    lines = [*_head(analysed, number, count), *_faces(figures, beside), "", *_axes(figures, beside)]
    lines += _friction(figures)
    if comparison is not None:
        lines += ["", *_apart(comparison, figures.samples)]
    lines += ["", *identified_lines(analysed.identified)]
    return "\n".join(lines)


def _head(analysed: Analysed, number: int, count: int) -> list[str]:
    known, figures = analysed.metadata, analysed.recorded.figures
    which = f", stretch {number} of {count}" if count > 1 else ""
    return [
        *wrapped(f"Recording of {known.name}{which}", ""),
        f"  {figures.samples} samples at {1.0 / known.period:g} Hz, {figures.start:.4g} to {figures.end:.4g} s, "
        f"{figures.missed} missed, delay {known.delay * 1e3:g} ms",
    ]


def _faces(figures: StretchFigures, beside: StretchFigures | None) -> list[str]:
    """Return the figures of touched walls and their contacts."""
    if not figures.faces:
        return ["", "  no wall was touched" if figures.untouched else "  there are no walls"]
    lines = []
    for turning in (False, True):  # they have units of their own
        faces = [face for face in figures.faces if (face.axis >= 3) == turning]
        if faces:
            others = None if beside is None else {(one.axis, one.normal): one for one in beside.faces}
            lines += ["", *_walls(faces, others, turning=turning), "", *_contacts(faces, turning=turning)]
    if figures.untouched:
        lines += ["", f"  walls that were not touched: {figures.untouched}"]
    return lines


def _walls(
    faces: Sequence[FaceFigures], others: Mapping[tuple[int, float], FaceFigures] | None, *, turning: bool
) -> list[str]:
    """Return a row for each wall and for its simulation."""
    small, force, hard = (unit_of(unit, 3 * turning) for unit in ("mm", "N", "N/m" if turning else "N/mm"))
    lines = [
        _cells("wall", ("depth", "rebound", "peak", "settling", "rate", "extended", "contacts"), _WALL),
        _cells("", (small, small, force, "ms, 2 %", hard, hard), _WALL),
    ]
    for face in faces:
        lines.append(_cells(face.name, _wall(face, turning=turning), _WALL))
        if others is not None:
            other = others.get((face.axis, face.normal))
            texts = ["0.00", *["-"] * 5, "0"] if other is None else _wall(other, turning=turning)
            lines.append(_cells("  simulated", texts, _WALL))
    return lines


def _wall(face: FaceFigures, *, turning: bool) -> list[str]:
    hard = 1.0 if turning else 1e-3
    figures = (
        (face.penetration, 1e3),
        (face.rebound, 1e3),
        (face.peak_force, 1.0),
        (face.settling_time, 1e3),
        (face.hardness.rate, hard),
        (face.hardness.extended, hard),
    )
    return [*(number_text(float(figure) * scale, 3, 2) for figure, scale in figures), str(len(face.contacts))]


def _contacts(faces: Sequence[FaceFigures], *, turning: bool) -> list[str]:
    """Return a row per contact, the first ones, by time."""
    small, force = (unit_of(unit, 3 * turning) for unit in ("mm", "N"))
    lines = [
        _cells("contact", ("at", "for", "approach", "depth", "peak"), _CONTACT),
        _cells("", ("s", "ms", f"{small}/s", small, force), _CONTACT),
    ]
    rows = ((one.start, face.name, one) for face in faces for one in face.contacts)
    found = sorted(rows, key=lambda row: (round(row[0], 7), row[1]))  # rounding does not order those at the same time
    for start, name, one in found[:_CONTACTS_SHOWN]:
        figures = (one.duration, one.approach_speed, one.penetration)
        texts = [
            f"{start:.4f}",
            *(number_text(figure * 1e3, 3, 2) for figure in figures),
            number_text(one.peak_force, 3, 2),
        ]
        lines.append(_cells(name, texts, _CONTACT))
    if len(found) > _CONTACTS_SHOWN:
        lines.append(f"  and {len(found) - _CONTACTS_SHOWN} more: see --json")
    return lines


def _axes(figures: StretchFigures, beside: StretchFigures | None) -> list[str]:
    """Return travel and energy of each axis."""
    energy = figures.energy
    lines = [_cells("", AXES), _line("travel", figures.travel, 1e3, "mm, mrad")]
    lines.append(_line("energy taken", energy.taken, 1e3, "mJ"))
    if beside is not None:
        lines.append(_line("  simulated", beside.energy.taken, 1e3, "mJ"))
    lines.append(_line("  least", energy.least, 1e3, "mJ"))
    if np.isfinite(energy.hand).any():
        lines.append(_line("work of the hand", energy.hand, 1e3, "mJ"))
    else:
        lines.append(_line("unrecorded work", energy.others, 1e3, "mJ"))
    return [*lines, _line("unrecorded force", figures.unexplained, 1e3, "mN, mN m")]


def _friction(figures: StretchFigures) -> list[str]:
    """Return slips and stick positions of each axis with friction."""
    rubbing = [axis for axis, sticks in enumerate(figures.sticks) if sticks is not None]
    if not rubbing:
        return []
    names = [AXES[axis] if axis in rubbing else "" for axis in range(len(AXES))]
    slips = [str(figures.slips(axis)) if axis in rubbing else "" for axis in range(len(AXES))]
    longest = ["" for _ in AXES]
    for axis in rubbing:
        longest[axis] = number_text(max(stick.duration for stick in figures.sticks[axis] or ()) * 1e3, 3, 2)
    lines = ["", _cells("friction", names), _cells("slips", slips), _cells("longest stuck", longest, unit="ms")]
    for axis in rubbing:
        places = [f"{stick.position * 1e3:.3f}" for stick in figures.sticks[axis] or ()]
        more = f" and {len(places) - _STICKS_SHOWN} more" if len(places) > _STICKS_SHOWN else ""
        unit = unit_of("mm", axis)
        told = f"{', '.join(places[:_STICKS_SHOWN])}{more} {unit}"
        lines += wrapped(told, f"  {f'stuck at, {AXES[axis]}':<{_NAME}}  ", " " * (_NAME + 4))
    return lines


def _apart(comparison: Comparison, samples: int) -> list[str]:
    """Return the differences between recording and simulation."""
    lines = []
    if not comparison.same and comparison.compared:
        lines += [
            _cells("apart", AXES),
            _line("RMS", comparison.rms, 1e6, "µm, µrad"),
            _line("at most", comparison.most, 1e6, "µm, µrad"),
            _cells("  at", [_when(*one) for one in zip(comparison.most, comparison.when, strict=True)], unit="s"),
        ]
    lines.append(_line("one sample ahead", comparison.one_step, 1e6, "µm, µrad"))
    lines += wrapped(comparison.sentence)
    if 0 < comparison.compared < samples:
        lines.append(f"  the simulation failed after {comparison.compared} of {samples} samples")
    if comparison.device:
        lines += wrapped(
            "nobody measures a hand on the device, which parts the two; one sample ahead tells how good the model is"
        )
    return lines


def _when(most: float, when: float) -> str:
    return f"{when:.3f}" if most >= _NOTHING else "-"


def _line(label: str, values: Array, scale: float, unit: str) -> str:
    return _cells(label, [_small(value, scale) for value in values.tolist()], unit=unit)


def _cells(label: str, texts: Sequence[str], widths: int | Sequence[int] = _CELL, unit: str = "") -> str:
    each = [widths] * len(texts) if isinstance(widths, int) else widths
    return f"  {label:<{_NAME}}{''.join(f'{text:>{width}}' for text, width in zip(texts, each))}  {unit}".rstrip()


def _small(value: float, scale: float) -> str:
    """Return a figure as text, rounding errors as 0.

    No minus in front of a negligible value.
    """
    if abs(value) < _NOTHING:
        return "0"
    return number_text(value * scale, 3, 2)

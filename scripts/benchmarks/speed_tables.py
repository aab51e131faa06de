"""Tables of bench.py's figures for terminal and documentation: 80 columns of text, or Markdown."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from typing import Any

_NAME = 28
COUNTED = "devices", "ticks", "cells", "starts", "calls", "samples"


def machine() -> dict[str, Any]:
    """Return the machine of the measurements."""
    return {"processor": platform.machine(), "processors": os.cpu_count(), "system": platform.system()}


def heading(found: Mapping[str, Any]) -> str:
    """Return machine, versions and number of repeats, two lines."""
    here, code = found["machine"], found["versions"]
    return (
        f"{here['processors']} {here['processor']} processors, Python {code['python']}, MuJoCo {code['mujoco']}, "
        f"NumPy {code['numpy']}\nmedians, least to greatest of {found['repeats']} runs, in processes of their own"
    )


def grouped(figures: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return figures by first and further parts of their names."""
    groups: dict[str, dict[str, Any]] = {}
    for name, figure in merged(figures).items():
        head, _, rest = name.partition(": ")
        groups.setdefault(head if rest else "", {})[rest or head] = figure
    return groups


def merged(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures with one for all rows of a column that counts the same in each, such as devices."""
    heads: dict[str, dict[str, Any]] = {}
    for name, figure in figures.items():
        heads.setdefault(name.rpartition(": ")[0], {})[name] = figure
    found: dict[str, Any] = {}
    for head, some in heads.items():
        first = next(iter(some.values()))
        whole = head.endswith(COUNTED) and len(some) > 1 and all(figure == first for figure in some.values())
        found |= {f"{head}: all rows": first} if whole else some
    return found


def short(value: float) -> str:
    """Return a number to three digits, two with an exponent."""
    if value == 0.0 or 1e-3 <= abs(value) < 100.0:
        return f"{value:.3g}"
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e")


def median(spread: Mapping[str, float] | None) -> str:
    """Return the median of a spread; empty for none."""
    return "" if spread is None else short(spread["median"])


def ends(spread: Mapping[str, float] | None, between: str = " to ") -> str:
    """Return least and greatest of a spread: empty for none, or if both are equal."""
    low, high = ("", "") if spread is None else (short(spread["least"]), short(spread["greatest"]))
    return "" if low == high else f"{low}{between}{high}"


def terminal(name: str, section: Mapping[str, Any]) -> str:
    """Return a section as a table with ranges and ratios."""
    lines = ["", f"{name}: {section['title']}, {section['seconds']:.0f} s"]
    lines += [f"  {side}: {said}" for side, said in section["failed"].items()]
    compared = any("before" in figure for figure in section["figures"].values())
    if section["figures"]:
        columns = ("before", "after", "range", "ratio", "range") if compared else ("", "median", "range")
        lines.append(_row("", *columns))
    for head, figures in grouped(section["figures"]).items():
        lines += [f" {head}"] * bool(head)
        for label, figure in figures.items():
            before, after, ratio = (figure.get(key) for key in ("before", "after", "ratio"))
            cells = median(before), median(after), ends(after, "-"), median(ratio), ends(ratio, "-")
            lines += [f"  {label}", _row("", *cells)] if len(label) >= _NAME else [_row(label, *cells)]
    lines += [f"  {line}" for line in section["details"].get("missing", ())]
    return "\n".join(lines)


def _row(label: str, before: str, after: str, span: str, ratio: str = "", ratios: str = "") -> str:
    return f"  {label:<{_NAME}}{before:>8}{after:>8} {span:>13}{ratio:>7} {ratios:>12}".rstrip()


def times(sections: Mapping[str, Any]) -> str:
    """Return the times of the sections and their total."""
    taken = {name: section["seconds"] for name, section in sections.items()}
    listed = [f"  {name:<20}{seconds:7.0f} s" for name, seconds in {**taken, "together": sum(taken.values())}.items()]
    return "\n".join(["", "time taken", *listed])


def markdown(found: Mapping[str, Any]) -> str:
    """Return the documentation's tables, one a section."""
    parts = [heading(found).replace("\n", "; ") + "."]
    for name, section in found["sections"].items():
        if name == "options":
            parts.append(
                "### options over the plain loop (`options`)\n\n" + "\n".join(options_table(section["figures"]))
            )
        if section["figures"]:
            table = compared_table if any("ratio" in figure for figure in section["figures"].values()) else side_by_side
            parts.append(f"### {section['title']} (`{name}`)\n\n" + "\n".join(table(section["figures"])))
    return "\n\n".join(parts)


def compared_table(figures: Mapping[str, Any]) -> list[str]:
    """Return rows of before, after and ratio, with ranges."""
    lines = ["| | before | after | range | after / before | range |", "|---" * 6 + "|"]
    for head, some in grouped(figures).items():
        lines += [f"| *{head}* | | | | | |"] * bool(head)
        for label, figure in some.items():
            before, after, ratio = (figure.get(key) for key in ("before", "after", "ratio"))
            cells = label, median(before), median(after), ends(after), median(ratio), ends(ratio)
            lines.append("| " + " | ".join(cells) + " |")
    return lines


def options_table(figures: Mapping[str, Any]) -> list[str]:
    """Return a row each option, a column each plant: cost over the plain loop."""
    found: dict[str, dict[str, str]] = {}
    for name, figure in figures.items():
        plant, _, rest = name.partition(": over plain: ")
        if rest and "after" in figure and rest != "plain":
            before = f"{median(figure['before'])} → " if "before" in figure else ""
            found.setdefault(rest, {})[plant] = before + _spread(figure)
    plants = list(dict.fromkeys(plant for row in found.values() for plant in row))
    lines = ["| | " + " | ".join(plants) + " |", "|---" * (len(plants) + 1) + "|"]
    return lines + [
        f"| {name} | " + " | ".join(row.get(plant, "") for plant in plants) + " |" for name, row in found.items()
    ]


def side_by_side(figures: Mapping[str, Any]) -> list[str]:
    """Return a row each name, a column each group: one column if groups share no name."""
    groups = grouped(figures)
    names = dict.fromkeys(label for some in groups.values() for label in some)
    if len(names) == len(figures):
        lines = ["| | |", "|---|---|"]
        for head, some in groups.items():
            lines += [f"| *{head}* | |"] * bool(head)
            lines += [f"| {label} | {_spread(figure)} |" for label, figure in some.items()]
        return lines
    lines = ["| | " + " | ".join(groups) + " |", "|---" * (len(groups) + 1) + "|"]
    for label in names:
        lines.append(f"| {label} | " + " | ".join(_spread(some.get(label)) for some in groups.values()) + " |")
    return lines


def _spread(figure: Mapping[str, Any] | None) -> str:
    """Return median and range of the runs after; the median alone if they agree."""
    spread = None if figure is None else figure.get("after")
    if spread is None:
        return ""
    span = ends(spread)
    return f"{median(spread)} ({span})" if span else median(spread)


def aligned(title: str, table: Mapping[str, Mapping[str, float]]) -> str:
    """Return columns by heading as text: headings, then a line per row."""
    rows = list(dict.fromkeys(row for column in table.values() for row in column))
    first = max(map(len, [title, *rows]))
    lines = ["  ".join([title.ljust(first), *table])]
    for row in rows:
        cells = [(short(column[row]) if row in column else "").rjust(len(head)) for head, column in table.items()]
        lines.append("  ".join([row.ljust(first), *cells]).rstrip())
    return "\n".join(lines)

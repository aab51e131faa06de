"""Run the cases and compare their outputs with stored ones.

The commands of cases.json run in this process.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import json
import math
import os
import random
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import cache
from importlib.metadata import entry_points
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
KEYS = "keys"
ARITHMETIC = "arithmetic"
_RELATIVE, _ABSOLUTE = 1e-9, 1e-12
"""Tolerances on another machine; the absolute one in SI units."""

_ILL_CONDITIONED = {"stability", "sweep", "design", KEYS}
_RELATIVE_THERE = 1e-4
"""Tolerances of ill-conditioned values.

The position of an optimum and the boundary beside it, growth measured on 1 µm, and 400 runs in a row.
"""

_DECIDED_BY_ROUNDING = {"analyse", "replay"}
"""Cases with results that depend on rounding.

Their text and the status of a check show bitwise equality.
"""

_CHANGING = {"versions", "version", "other_versions", "began", "cost"}
"""JSON names with values that change between runs.

They depend on revision, date or speed of the machine.
"""

_CHOSEN_BY_COST = {"cheapest", "furthest", "steps"}
_ROUNDING_NOISE = {"comparison", "growing", "digest", "identified"}
"""JSON names of differences at rounding level.

Differences between equal runs, growing walls at the limit, digests, errors of fits.
"""

_PROGRESS = re.compile(r"(\S+ ?\S*: \d+ of \d+.*)?")
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


PRESSES = (
    *("wall", "pulse", "friction", "stiffness up", "stiffness down", "damping up", "damping down"),
    *("rate up", "rate down", "delay up", "delay down", "drop", "centre", "pause"),
)
"""Actions that all scenes with keys have."""


def cases() -> dict[str, str]:
    """Return the command line of each case."""
    found: dict[str, str] = json.loads((HERE / "cases.json").read_text())
    return found


def outcome(line: str) -> dict[str, Any]:
    """Run a command in an empty folder; return its outcome.

    Status, output and files.

    An argument @FILE is a file of recordings/, copied there.
    """
    (command,) = entry_points(group="console_scripts", name="maglev-mj")
    out, err = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder, chdir(folder), redirect_stdout(out), redirect_stderr(err):
        words, given = [], set()
        for word in line.split():
            if word.startswith("@"):
                source = HERE / "recordings" / word[1:]
                word = source.name
                shutil.copy(source if source.exists() else HERE / word, word)
                given.add(word)
            words.append(word)
        try:
            status = command.load()(words)
        except SystemExit as stop:
            status = stop.code
        files = {path.name: content(path) for path in sorted(Path().iterdir()) if path.name not in given}
    said = [] if words[0] == "fidelity" else out.getvalue().splitlines()  # a table of measured costs
    failed = [part for part in re.split(r"[\r\n]+", err.getvalue()) if not _PROGRESS.fullmatch(part)]
    return {"status": status, "stdout": said, "stderr": failed, "files": files}


def content(path: Path) -> Any:
    """Return a file's content without varying parts."""
    if path.suffix == ".json":
        return _lasting(json.loads(path.read_text()))
    if path.suffix == ".jsonl":
        return [_lasting(json.loads(line)) for line in sorted(path.read_text().splitlines())]
    if path.suffix == ".csv":
        with path.open(newline="") as file:
            names, *rows = csv.reader(file)
        return {name: [_number(row[place]) for row in rows] for place, name in enumerate(names)}
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {name: _array(arrays[name]) for name in arrays.files}
    assert path.suffix == ".mcap", path
    from tests.recorded import messages_in

    return [[topic, _lasting(message)] for topic, message in messages_in(path.read_bytes())]


def pressed(count: int = 400, seed: int = 16) -> list[dict[str, Any]]:
    """Return results of random actions in four scenes.

    Ticks, parameters and samples after each action.

    They act on a session without a window: the only use of the package besides its commands.
    """
    made = []
    for place, name in enumerate(("joystick", "table", "box", "corner")):
        made += _pressed(name, count // 4, seed + place)
    return made


def _pressed(name: str, count: int, seed: int) -> list[dict[str, Any]]:
    from maglev_mj.hand import SpringHand
    from maglev_mj.scenes import find_scene
    from maglev_mj.session import Pacer, Session

    draw, paused = random.Random(seed), False
    made: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        session = Session(
            find_scene(name)(), hand=SpringHand(), record=path, pacer=Pacer(budget=3600.0, patience=3600.0)
        )
        for _ in range(count):
            action = "pause" if paused and draw.random() < 0.5 else draw.choice(PRESSES)
            paused ^= action == "pause"
            session.act(action)
            if draw.random() < 0.5:
                pulls = [draw.uniform(-1.0, 1.0) for _ in range(6)]
                session.hand.target = [*(0.02 * pull for pull in pulls[:3]), *(0.3 * pull for pull in pulls[3:])]
            made.append({"action": action, "ticks": session.tick(draw.choice((1.0 / 60.0, 0.05)))})
        session.close()
        held = content(path)
    rows = [(setup, row) for place, setup in enumerate(held["header"]["setups"]) for row in _rows(held, place)]
    assert len(rows) == sum(one["ticks"] for one in made)
    for one in made:
        mine, rows = rows[: one["ticks"]], rows[one["ticks"] :]
        if mine:
            setup, (position, *_) = mine[-1]
            setup = setup.get("settings") or setup["parameters"]
            digest = hashlib.sha256(json.dumps([row for _, row in mine]).encode()).hexdigest()[:16]
            one |= {"setup": setup, "position": position, "digest": digest}
    return made


def _rows(held: Mapping[str, Any], stretch: int) -> list[Any]:
    """Return position, command, applied and hand at each sample."""
    return list(zip(*(held[f"{stretch}/{name}"] for name in ("position", "command", "applied", "hand")), strict=True))


def kept(group: str) -> dict[str, Any]:
    """Return the stored outputs of a group by name."""
    with gzip.open(HERE / "expected" / f"{group}.json.gz", "rt") as file:
        found: dict[str, Any] = json.load(file)
    return found


def keep(group: str, found: Mapping[str, Any]) -> None:
    """Store the outputs of a group.

    Equal outputs give equal bytes.
    """
    data = json.dumps(found, separators=(",", ":")).encode()
    (HERE / "expected" / f"{group}.json.gz").write_bytes(gzip.compress(data, 9, mtime=0))


def as_kept(found: Any) -> Any:
    """Return values as a file gives them back."""
    return json.loads(json.dumps(found))


def arithmetic() -> str:
    """Return a digest of this machine's arithmetic.

    Of libm, BLAS and numpy on some numbers.
    """
    values = np.random.default_rng(0).uniform(-2.0, 2.0, (60, 6, 6))
    waves = [wave(one) for one in values.ravel().tolist() for wave in (math.sin, math.cos, math.exp, math.atan)]
    arrays = [values @ values, np.linalg.eigvals(values), np.linalg.inv(values), np.exp(values), np.sin(values)]
    products = [one.ravel() @ other.ravel() for one, other in pairwise(values)]
    return hashlib.sha256(repr((waves, products, *(array.tolist() for array in arrays))).encode()).hexdigest()


@cache
def is_exact() -> bool:
    """Return True if numbers are compared bitwise.

    With MAGLEV_GOLDEN=exact, or on a machine like that of the files.
    """
    asked = os.environ.get("MAGLEV_GOLDEN", "")
    assert asked in ("", "exact", "near"), f"MAGLEV_GOLDEN must be exact or near, not {asked!r}"
    return asked == "exact" or (not asked and kept(ARITHMETIC)["digest"] == arithmetic())


def differences(group: str, old: Any, new: Any, *, exact: bool) -> list[str]:
    """Return the differences between two outcomes, one per line.

    Args:
        group: Group of the case, on which the bounds depend.
        old: What is kept.
        new: What is said now.
        exact: Compare numbers to the last bit; otherwise within the bounds, and tables by their words.
    """
    before, now = dict(_leaves(old)), dict(_leaves(new))
    if not exact:
        before, now = ({name: one for name, one in leaves.items() if _lasts(group, name)} for leaves in (before, now))
    lines = [f"{name} is gone" for name in before if name not in now]
    lines += [f"{name} is new" for name in now if name not in before]
    relative = 0.0 if exact else _RELATIVE_THERE if group in _ILL_CONDITIONED else _RELATIVE
    for name, value in before.items():
        if name in now and not _same(value, now[name], relative):
            lines.append(f"{name}: {value!r} -> {now[name]!r}")
    return lines


def _lasts(group: str, name: str) -> bool:
    """Return True if a value is machine-independent within the bounds."""
    parts = name.split(".")
    decided = group in _DECIDED_BY_ROUNDING and parts[0] in ("stdout", *(["status"] if group == "replay" else []))
    return not (decided or _ROUNDING_NOISE & set(parts))


def _same(old: Any, new: Any, relative: float) -> bool:
    if repr(old) == repr(new) or not relative or type(old) is not type(new):
        return repr(old) == repr(new)
    if isinstance(old, float):
        return bool(abs(new - old) <= max(relative * abs(old), _ABSOLUTE))
    # of a table: the files hold the numbers
    return isinstance(old, str) and _NUMBER.sub("#", old).split() == _NUMBER.sub("#", new).split()


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value under the way to it."""
    inner: Sequence[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        inner = list(value.items())
    elif isinstance(value, list):
        inner = list(enumerate(value))
    else:
        yield name, value
        return
    yield f"{name}.length", len(inner)
    for key, part in inner:
        yield from _leaves(part, f"{name}.{key}" if name else str(key))


def _lasting(value: Any) -> Any:
    if isinstance(value, list):
        return [_lasting(part) for part in value]
    if isinstance(value, dict):
        left_out = _CHANGING | (_CHOSEN_BY_COST if "cheapest" in value else set())
        return {name: _lasting(part) for name, part in value.items() if name not in left_out}
    return value


def _array(array: Any) -> Any:
    return _lasting(json.loads(str(array))) if array.dtype.kind == "U" else array.tolist()


def _number(text: str) -> Any:
    return float(text) if re.fullmatch(r"-?[\d.]+(e[+-]?\d+)?", text) else text

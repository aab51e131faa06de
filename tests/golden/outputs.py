"""Run the cases and compare their outputs with stored ones.

The commands of cases.json run in this process.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import random
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import cache
from importlib.metadata import entry_points
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
KEYS = "keys"
_RELATIVE, _ABSOLUTE = 1e-9, 1e-12
"""Tolerances of numbers; the absolute one in SI units."""

_ILL_CONDITIONED = {"stability", "sweep", "design", KEYS}
_RELATIVE_THERE = 1e-4
"""Tolerances of ill-conditioned values.

The position of an optimum and the boundary beside it, growth measured on 1 µm, and 400 runs in a row.
"""

_CHANGING = {"versions", "version", "other_versions", "began", "cost"}
"""JSON names with values that change between runs.

They depend on revision, date or speed of the machine.
"""

_ROUNDING_NOISE = {"comparison", "growing", "grows", "standard_error", "low", "high", "residual"}
"""JSON names of differences at rounding level.

Differences between equal runs, growing walls at the limit, errors of exact fits.
"""

_FITTED = 1e-5, 1e-9
"""Tolerances of identified values, whose normal equations are near singular while a flotor is stuck."""

_EQUALITY = re.compile(r"Replay of \d+ samples: |  \d+ of \d+ equal|    ")
"""Lines of a check that depend on the last bit."""

_LONG, _SOME = 24, 8
"""Longest list that is stored whole, and the number of parts stored of a longer one."""

_PROGRESS = re.compile(r"(\S+ ?\S*: \d+ of \d+.*)?")
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


PRESSES = (
    *("wall", "pulse", "friction", "stiffness up", "stiffness down", "damping up", "damping down"),
    *("rate up", "rate down", "delay up", "delay down", "drop", "centre", "pause"),
)
"""Actions that all scenes with keys have."""


@cache
def cases() -> dict[str, str]:
    """Return the command line of each case."""
    found: dict[str, str] = json.loads((HERE / "cases.json").read_text())
    return found


def outcome(line: str) -> dict[str, Any]:
    """Run a command in an empty folder; return its outcome.

    Status, output and files.

    An argument @FILE is a file of recordings/, copied there. Of commands joined by && the last one's is returned.
    """
    *earlier, last = line.split(" && ")
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for other in earlier:
            for name, data in _written_by(other).items():
                Path(name).write_bytes(data)
        words = [_copied(word[1:]) if word.startswith("@") else word for word in last.split()]
        inputs = {path.name for path in Path().iterdir()}
        status, out, err = _run(words)
        outputs = (path for path in sorted(Path().iterdir()) if path.is_file() and path.name not in inputs)
        files = {path.name: content(path) for path in outputs}
    said = out.replace(str(package_files("maglev_mj")), "maglev_mj").splitlines()  # no folder of a machine
    if words[0] == "replay" and status in (0, 1) and not earlier:  # a recording of another machine
        status, said = "0 or 1", [one for one in said if not _EQUALITY.match(one)]
    failed = [part for part in re.split(r"[\r\n]+", err) if not _PROGRESS.fullmatch(part)]
    return {"status": status, "stdout": said, "stderr": failed, "files": files}


def _run(words: list[str]) -> tuple[Any, str, str]:
    """Run a command in this process; return its status, output and errors."""
    (command,) = entry_points(group="console_scripts", name="maglev-mj")
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        try:
            status = command.load()(words)
        except SystemExit as stop:
            status = stop.code
    return status, out.getvalue(), err.getvalue()


@cache
def _written_by(line: str) -> dict[str, bytes]:
    """Return the files that a command writes, by name; each command runs once per process."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        status, _, errors = _run(line.split())
        assert status == 0, f"maglev-mj {line}: exit status {status}\n{errors}"
        return {path.name: path.read_bytes() for path in Path().iterdir()}


def _copied(name: str) -> str:
    """Copy a file of recordings/, or of this folder, to the current one; return its name."""
    source = HERE / "recordings" / name
    shutil.copy(source if source.exists() else HERE / name, source.name)
    return source.name


def content(path: Path) -> Any:
    """Return a file's content without varying parts."""
    return _lasting(json.loads(path.read_text()))


def pressed(count: int = 40, seed: int = 19) -> list[dict[str, Any]]:
    """Return results of random actions in the corner: ticks, parameters and samples after each.

    They act on a session without a window: the only use of the package besides its commands.
    """
    from maglev_mj.plants.hand import SpringHand
    from maglev_mj.recording import Recording
    from maglev_mj.scenes import find_scene
    from maglev_mj.session import Pacer, Session

    draw, paused = random.Random(seed), False
    made: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        path, pacer = Path(folder) / "run.maglev", Pacer(budget=3600.0, patience=3600.0)
        session = Session(find_scene("corner")(), hand_force=SpringHand(), record=path, pacer=pacer)
        for _ in range(count):
            action = "pause" if paused and draw.random() < 0.5 else draw.choice(PRESSES)
            paused ^= action == "pause"
            session.act(action)
            if draw.random() < 0.5:
                pulls = [draw.uniform(-1.0, 1.0) for _ in range(6)]
                session.hand.target = [*(0.02 * pull for pull in pulls[:3]), *(0.3 * pull for pull in pulls[3:])]
            made.append({"action": action, "ticks": session.tick(draw.choice((1.0 / 60.0, 0.05)))})
        session.close()
        segments = Recording.load(path).segments
    names = "position", "command", "applied", "hand"
    rows = [
        (segment.setup, row)
        for segment in segments
        for row in zip(*(segment.arrays[name].tolist() for name in names), strict=True)
    ]
    assert len(rows) == sum(one["ticks"] for one in made)
    for one in made:
        mine, rows = rows[: one["ticks"]], rows[one["ticks"] :]
        if mine:
            setup, (position, *_) = mine[-1]
            one |= {"setup": setup.get("settings") or setup["parameters"], "position": position}
    return made


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


def differences(group: str, old: Any, new: Any) -> list[str]:
    """Return the differences between two outcomes, one per line.

    Numbers are equal within the bounds of their group, and texts with their numbers left out.
    """
    before, now = ({name: one for name, one in _leaves(said) if _lasts(name)} for said in (old, new))
    lines = [f"{name} is gone" for name in before if name not in now]
    lines += [f"{name} is new" for name in now if name not in before]
    bounds = _RELATIVE_THERE if group in _ILL_CONDITIONED else _RELATIVE, _ABSOLUTE
    both = ((name, before[name], now[name]) for name in before if name in now)
    return lines + [
        f"{name}: {one!r} -> {other!r}"
        for name, one, other in both
        if not _same(one, other, *(_FITTED if ".identified." in name else bounds))
    ]


def _lasts(name: str) -> bool:
    """Return True if a value does not depend on rounding."""
    return not _ROUNDING_NOISE & set(name.split("."))


def _same(old: Any, new: Any, relative: float, absolute: float) -> bool:
    if isinstance(old, float) and isinstance(new, float):
        return bool(abs(new - old) <= max(relative * abs(old), absolute)) or repr(old) == repr(new)
    if isinstance(old, str) and isinstance(new, str):  # of a table: the files hold the numbers
        return _NUMBER.sub("#", old).split() == _NUMBER.sub("#", new).split()
    return repr(old) == repr(new)


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
    """Return a value without what varies; of a long list length, parts and sum."""
    if isinstance(value, list):
        parts = [_lasting(part) for part in value]
        if len(parts) <= _LONG:
            return parts
        some = [parts[place] for place in np.linspace(0, len(parts) - 1, _SOME).astype(int)]
        return {"length": len(parts), "some": some, "sum": math.fsum(map(abs, _numbers(parts)))}
    if isinstance(value, dict):
        return {name: _lasting(part) for name, part in value.items() if name not in _CHANGING}
    return value


def _numbers(value: Any) -> Iterator[float]:
    """Yield the finite numbers in a value that do not depend on rounding."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from () if name in _ROUNDING_NOISE else _numbers(part)
    elif isinstance(value, list):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, int | float) and math.isfinite(value):
        yield float(value)

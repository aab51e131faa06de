"""Results as JSON: to a file, or to standard output."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from maglev_mj.errors import DivergenceError
from maglev_mj.study import Record, StudyInterrupted

__all__ = ["keep_landed", "keep_partial", "write_json"]


def keep_partial(error: DivergenceError, options: argparse.Namespace) -> None:
    """Write what was recorded before the run diverged."""
    if error.partial is not None and options.json is not None:
        write_json(options.json, {**error.partial.as_json(), "diverged": str(error)})


def keep_landed(command: str, stopped: StudyInterrupted, path: Path | None, fallback: Path) -> None:
    """Say where the cells of a study that was stopped are, and put them there if they are in no file yet."""
    if path is None:
        path = fallback
        kept = Record(path)
        kept.add([(cell, result) for cell, result in stopped.landed if cell not in kept])
    print(
        f"maglev-mj {command}: stopped; {len(stopped.landed)} cells are in {path}, "
        f"the same command with --record {path} goes on from there",
        file=sys.stderr,
    )


def write_json(target: str, data: dict[str, Any]) -> None:
    """Write to a file, or to standard output where the target is "-"."""
    text = json.dumps(data, allow_nan=False)
    if target == "-":
        print(text)
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")

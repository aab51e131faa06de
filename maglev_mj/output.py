"""Results as JSON: to a file, or to standard output."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from maglev_mj.errors import DivergenceError

__all__ = ["keep_partial", "write_json"]


def keep_partial(error: DivergenceError, options: argparse.Namespace) -> None:
    """Write what was recorded before the run diverged."""
    if error.partial is not None and options.json is not None:
        write_json(options.json, {**error.partial.as_json(), "diverged": str(error)})


def write_json(target: str, data: dict[str, Any]) -> None:
    """Write to a file, or to standard output where the target is "-"."""
    text = json.dumps(data, allow_nan=False)
    if target == "-":
        print(text)
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")

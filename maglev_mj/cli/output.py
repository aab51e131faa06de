"""Output of results as JSON and pictures."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from maglev_mj.cli.pictures import check_folder, chosen_pictures
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.plots import PictureFolder
from maglev_mj.versions import versions

__all__ = [
    "check_file",
    "check_outputs",
    "check_recording",
    "keep_partial",
    "write_json",
    "write_results",
]


def keep_partial(error: DivergenceError, options: argparse.Namespace) -> None:
    """Write the results of a run until it diverged."""
    if error.partial is not None and options.json is not None:
        write_json(options.json, {**error.partial.as_json(), "diverged": str(error)})


def check_file(name: str, path: Path) -> None:
    """Check that a file can be written.

    Raises:
        ParameterError: If it is a folder, has no folder, or may not be written.
    """
    if path.is_dir() or not path.parent.is_dir():
        raise ParameterError(f"{name} must be a file in a folder that is there, not {str(path)!r}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ParameterError(f"{name} must be a file that may be written, not {str(path)!r}")


def check_recording(path: Path | None) -> None:
    """Check that a recording can be written.

    Args:
        path: File; None for no recording.

    Raises:
        ParameterError: If the file cannot be written, or has an unknown suffix.
        McapMissingError: If the package for its kind is not installed.
    """
    if path is not None:
        from maglev_mj.recording import check_name  # imported here: only this function needs the recording code

        check_name(path)
        check_file("record", path)


def check_outputs(*, json: str | None = None, record: Path | None = None, out: Path | None = None) -> None:
    """Check that all output files can be written.

    Done before a long run.

    Args:
        json: File for JSON, or "-".
        record: File for cells.
        out: Folder for other files.

    Raises:
        ParameterError: If a file is a folder, has no folder, may not be written, or is named twice.
    """
    files = {"record": record, "json": None if json in (None, "-") else Path(str(json))}
    for name, path in files.items():
        if path is not None:
            check_file(name, path)
    if record is not None and files["json"] is not None and record.resolve() == files["json"].resolve():
        raise ParameterError(f"json and record must be two files, not {str(record)!r} for both")
    if out is not None:
        check_folder(out)


def write_json(target: str, data: Mapping[str, Any]) -> None:
    """Write results and code versions as JSON.

    To standard output if the target is "-".
    """
    text = json.dumps({**data, "versions": versions()}, allow_nan=False)
    if target == "-":
        print(text)
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")


def write_results(
    options: argparse.Namespace,
    data: Callable[[], Mapping[str, Any]],
    text: Callable[[], str],
    draw: Callable[[PictureFolder], Sequence[Path]] = lambda pictures: (),
    written: Sequence[Path] = (),
) -> None:
    """Write JSON and pictures if chosen, and print the text.

    The text is left out if standard output has the JSON.

    Args:
        options: Parsed options.
        data: Function that returns the JSON data.
        text: Function that returns the table.
        draw: Function that draws into a folder and returns the files.
        written: Files written before, listed as well.
    """
    if options.json is not None:
        write_json(options.json, data())
    files = list(written)
    if (pictures := chosen_pictures(options)) is not None:
        files += draw(pictures)
    if options.json != "-":
        print(text())
        for path in files:
            print(f"  wrote {path}")

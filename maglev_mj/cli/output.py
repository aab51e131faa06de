"""Output of results as JSON and pictures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from maglev_mj.cli.pictures import chosen_pictures
from maglev_mj.errors import DivergenceError
from maglev_mj.pictures import PictureFolder
from maglev_mj.result import Result
from maglev_mj.versions import versions


def keep_partial(error: DivergenceError, options: argparse.Namespace) -> None:
    """Write the results of a run until it diverged."""
    if error.partial is not None and options.json is not None:
        write_json(options.json, {**error.partial.as_json(), "diverged": str(error)})


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


def write_result(options: argparse.Namespace, result: Result, picture: str = "") -> None:
    """Write a result as JSON and picture if chosen, and print its table.

    Args:
        options: Parsed options.
        result: The result.
        picture: Name of the picture's file, without an ending.
    """

    def draw(pictures: PictureFolder) -> Sequence[Path]:
        return [result.plot(pictures.path(picture))]

    write_results(options, result.as_json, lambda: str(result.table()), draw)

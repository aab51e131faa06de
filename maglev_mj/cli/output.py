"""Outputs of commands: checked before the work, then a progress bar, JSON, pictures and tables."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TextIO

from maglev_mj.cli.declare import Parser
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.errors import DivergenceError
    from maglev_mj.pictures import PictureFolder
    from maglev_mj.result import Result

_WIDTH, _SLIDER = 30, 6
_ERASED = "\r\x1b[K"

LAYOUT = Path(__file__).parents[1] / "recording" / "layout.json"
"""Layout file for Foxglove: device, walls, arrows, plots of position and force, log."""


class Progress:
    """Context manager that draws a progress bar.

    Call it with the finished and the total work.

    Args:
        label: Name of the work.
        stream: Output stream; standard error by default.
        quiet: Time before the first drawing [s].
        every: Time between two drawings [s].
    """

    def __init__(self, label: str, stream: TextIO | None = None, *, quiet: float = 2.0, every: float = 0.2) -> None:
        self._label, self._stream = label, stream or sys.stderr
        self._quiet, self._every = quiet, every
        self._began = self._start = time.monotonic()
        self._first = self._done = self._total = 0
        self._shown = False
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._draw, name="progress", daemon=True)

    def __enter__(self) -> Self:
        if self._stream.isatty():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join()
        with self.aside():
            pass

    def __call__(self, done: int, total: int) -> None:
        """Update the finished work.

        Less than before begins a second part.
        """
        with self._lock:
            if not self._total or done < self._done:
                self._start, self._first = time.monotonic(), done
            self._done, self._total = done, total

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Remove the bar while something else is printed."""
        with self._lock:
            if self._shown:
                self._stream.write(_ERASED)
                self._stream.flush()
                self._shown = False
            yield

    def _draw(self) -> None:
        wait = self._quiet
        while not self._over.wait(wait):
            wait = self._every
            with self._lock:
                self._stream.write(_ERASED + self._bar())
                self._stream.flush()
                self._shown = True

    def _bar(self) -> str:
        now = time.monotonic()
        if not self._total:
            place = int((now - self._began) / self._every) % (_WIDTH - _SLIDER + 1)
            bar = f"{'.' * place}{'#' * _SLIDER}".ljust(_WIDTH, ".")
            return f"[{bar}] {self._label}: {now - self._began:.0f} s"
        bar = ("#" * (_WIDTH * self._done // self._total)).ljust(_WIDTH, ".")
        fresh = self._done - self._first
        left = f", {(now - self._start) * (self._total - self._done) / fresh:.0f} s left" if fresh else ""
        return f"[{bar}] {self._label}: {self._done} of {self._total}{left}"


_OUTPUTS = "json", "record", "write", "identify", "out"
_FILES = "render", "export"
"""Commands whose `out` is a file."""


def check_outputs(options: argparse.Namespace) -> None:
    """Check that all outputs chosen by options can be written.

    The present folder as `out` is left out: files of a session have a second place.

    Args:
        options: Parsed options of any command.

    Raises:
        ParameterError: If a file is a folder, has no folder, may not be written, or is named twice, or if a recording
            has an unknown suffix.
        MissingPackageError: If the package for a recording is not installed.
    """
    files = {name: Path(path) for name in _OUTPUTS if (path := getattr(options, name, None)) not in (None, "-")}
    if "out" in files and options.command not in _FILES and (folder := files.pop("out")) != Path():
        check_folder("out", folder)
    if "record" in files and "workers" in options and not (cells := files.pop("record")).is_file():
        check_folder("record", cells)  # a file may be an old record, which the study refuses
        if "json" in files and files["json"].resolve() == cells.resolve():
            raise ParameterError(f"json and record must be a file and a folder, not {str(cells)!r} for both")
    check_files(files, getattr(options, "file", None))
    if "record" in files:
        from maglev_mj.recording import check_name  # only a recording needs that code

        check_name(files["record"])


def check_files(files: Mapping[str, Path], recording: Path | None = None) -> None:
    """Check that files can be written.

    Args:
        files: Option and file of each.
        recording: A recording that they must not replace.

    Raises:
        ParameterError: If one is a folder, has no folder, may not be written, is the recording, or is named twice.
    """
    for name, path in files.items():
        if path.is_dir() or not path.parent.is_dir():
            raise ParameterError(f"{name} must be a file in a folder that is there, not {str(path)!r}")
        if not (os.access(path, os.W_OK) if path.exists() else _takes_files(path.parent)):
            raise ParameterError(f"{name} must be a file that may be written, not {str(path)!r}")
        if recording is not None and path.resolve() == recording.resolve():
            raise ParameterError(f"{name} must be another file than the recording, not {str(path)!r}")
    if len({path.resolve() for path in files.values()}) < len(files):
        raise ParameterError(f"{' and '.join(files)} must be two files, not {str([*files.values()][-1])!r} for both")


def check_folder(name: str, path: Path) -> None:
    """Check that the folder of an option takes files, or can be made.

    Raises:
        ParameterError: If it is a file, or may not be written.
    """
    there = next(one for one in (path, *path.parents) if one.exists())
    if not there.is_dir():
        raise ParameterError(f"{name} must be a folder, not {str(path)!r}")
    if not _takes_files(there):
        raise ParameterError(f"{name} must be a folder that may be written, not {str(path)!r}")


def _takes_files(folder: Path) -> bool:
    """Return True if a file can be made in a folder, by making one."""
    import tempfile  # a help needs none

    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def keep_partial(error: DivergenceError, json: str | None) -> None:
    """Write the results of a run until it diverged."""
    if error.partial is not None and json is not None:
        write_json(json, {**error.partial.as_json(), "diverged": str(error)})


def write_json(target: str, data: Mapping[str, Any]) -> None:
    """Write results and code versions as JSON.

    To standard output if the target is "-".
    """
    import json

    from maglev_mj.versions import versions

    text = json.dumps({**data, "versions": versions()}, allow_nan=False)
    if target == "-":
        print(text)
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")


def write_results(
    json: str | None,
    data: Callable[[], Mapping[str, Any]],
    text: Callable[[], str],
    draw: Callable[[], Sequence[Path]] = tuple,
    written: Sequence[Path] = (),
) -> None:
    """Write JSON if chosen, draw pictures, and print the text.

    The text is left out if standard output has the JSON.

    Args:
        json: File of the JSON, or "-"; None for none.
        data: Function that returns the JSON data.
        text: Function that returns the table.
        draw: Function that draws and returns the files.
        written: Files written before, listed as well.
    """
    if json is not None:
        write_json(json, data())
    files = [*written, *draw()]
    if json != "-":
        print(text())
        for path in files:
            print_written(path)


def print_written(path: Path) -> None:
    """Print the path of a written file."""
    print(f"  wrote {path}")


def write_result(
    json: str | None,
    result: Result,
    pictures: PictureFolder | None = None,
    picture: str = "",
    written: Sequence[Path] = (),
) -> None:
    """Write a result as JSON and pictures if chosen, and print its table.

    Args:
        json: File of the JSON, or "-"; None for none.
        result: The result.
        pictures: Folder of the pictures; None for none.
        picture: Name of the picture's file, without an ending; empty for all `pictures` of the result, by name.
        written: Files written before, listed as well.
    """

    def draw() -> Sequence[Path]:
        named = {picture: {}} if picture else {name: {"picture": name} for name in getattr(result, "pictures", ())}
        return [] if pictures is None else [result.plot(pictures.path(name), **one) for name, one in named.items()]

    write_results(json, result.as_json, lambda: str(result.table()), draw, written)


FORMATS = "png", "pdf", "svg"
"""Formats of pictures: those of `maglev_mj.pictures`, which loads arrays."""


def add_pictures(parser: Parser, told: str = "write pictures to this folder", default: Path | None = None) -> None:
    """Add --out and --format.

    Args:
        parser: Parser of the command.
        told: Help of --out.
        default: Default folder; None for no pictures.
    """
    output = parser.group("output")
    output.add_argument("--out", metavar="DIR", type=Path, default=default, help=told)
    output.add_argument(
        "--format", metavar="NAME", choices=FORMATS, help=f"of pictures: {', '.join(FORMATS)} (default {FORMATS[0]})"
    )


def chosen_pictures(options: argparse.Namespace) -> PictureFolder | None:
    """Return the chosen picture folder; None for no pictures.

    Raises:
        ParameterError: If a format is given without a folder, or the folder is a file.
        MissingPackageError: If matplotlib is not installed.
    """
    folder = options.out
    if folder is None:
        if options.format is not None:
            raise ParameterError(f"format must be given with out, the folder of pictures, not {options.format!r} alone")
        return None
    from maglev_mj.pictures import PictureFolder, require  # with arrays, which a help does not need

    require()
    check_folder("out", folder)
    return PictureFolder(folder, options.format or FORMATS[0])


def script_options(
    description: str | None, quick: str | None = None, more: Callable[[Parser], object] = lambda parser: None
) -> argparse.Namespace:
    """Return the options of a script that draws.

    Args:
        description: Description of the script.
        quick: Help of `--quick`; None for a script without it.
        more: Called with the parser, for options of its own.

    Returns:
        `pictures`, a `PictureFolder`, and `quick`.
    """
    parser = Parser(description=description)
    add_pictures(parser, "write files to this folder (default figures)", Path("figures"))
    if quick is not None:
        parser.add_argument("--quick", action="store_true", help=quick)
    more(parser)
    options: argparse.Namespace = parser.parse_args()
    try:
        options.pictures = chosen_pictures(options)
    except ParameterError as error:
        parser.error(str(error))
    return options

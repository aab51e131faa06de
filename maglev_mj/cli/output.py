"""Outputs of commands: checks before the run, progress bar, JSON, charts and tables."""

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

from maglev_mj.cli.declare import Parser, number_option
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.errors import DivergenceError
    from maglev_mj.pictures import PictureFolder
    from maglev_mj.result import Result

_WIDTH, _SLIDER = 30, 6
_ERASED = "\r\x1b[K"

LAYOUT = Path(__file__).parents[1] / "recording" / "layout.json"
"""Foxglove layout: device, walls, arrows, plots of position and force, log."""


class Progress:
    """Progress bar as a context manager; call it with the finished and total amount of work.

    Args:
        label: Label of the bar.
        stream: Output stream; standard error by default.
        quiet: Time before the bar appears [s].
        every: Time between updates [s].
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
        """Update the progress; a smaller `done` than before restarts the estimate of the time left."""
        with self._lock:
            if not self._total or done < self._done:
                self._start, self._first = time.monotonic(), done
            self._done, self._total = done, total

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Hide the bar while something else is printed."""
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
            position = int((now - self._began) / self._every) % (_WIDTH - _SLIDER + 1)
            bar = f"{'.' * position}{'#' * _SLIDER}".ljust(_WIDTH, ".")
            return f"[{bar}] {self._label}: {now - self._began:.0f} s"
        bar = ("#" * (_WIDTH * self._done // self._total)).ljust(_WIDTH, ".")
        advance = self._done - self._first
        left = f", {(now - self._start) * (self._total - self._done) / advance:.0f} s left" if advance else ""
        return f"[{bar}] {self._label}: {self._done} of {self._total}{left}"


_OUTPUTS = "json", "record", "write", "identify", "out"
_FILES = "render", "convert"
"""Commands whose `out` is a file."""


def check_outputs(options: argparse.Namespace) -> None:
    """Check that all output paths are writable.

    The current folder as `out` is not checked: files of a session have a fallback folder.

    Args:
        options: Parsed options of any command.

    Raises:
        ParameterError: If a path is a folder, its folder does not exist, it is not writable, it is used twice, or a
            recording has an unknown suffix.
        MissingPackageError: If the package for a recording is not installed.
    """
    files = {name: Path(path) for name in _OUTPUTS if (path := getattr(options, name, None)) not in (None, "-")}
    if "out" in files and options.command not in _FILES and (folder := files.pop("out")) != Path():
        check_folder("out", folder)
    if "record" in files and "workers" in options and not (cells := files.pop("record")).is_file():
        check_folder("record", cells)  # a file may be a record of an old version, which the study rejects
        if "json" in files and files["json"].resolve() == cells.resolve():
            raise ParameterError(f"json and record must be different paths (got {str(cells)!r} for both)")
    check_files(files, getattr(options, "file", None))
    if "record" in files:
        from maglev_mj.recording import check_name  # imported here: only recordings need it

        check_name(files["record"])


def check_files(files: Mapping[str, Path], recording: Path | None = None) -> None:
    """Check that files can be written.

    Args:
        files: Path by option name.
        recording: Input recording that they must not overwrite.

    Raises:
        ParameterError: If a path is a folder, its folder does not exist, it is not writable, it is the recording, or it
            is used twice.
    """
    for name, path in files.items():
        if path.is_dir() or not path.resolve().parent.is_dir():
            raise ParameterError(f"{name} must be a file in an existing folder (got {str(path)!r})")
        if not (os.access(path, os.W_OK) if path.exists() else _is_writable(path.resolve().parent)):
            raise ParameterError(f"{name} must be a writable file (got {str(path)!r})")
        if recording is not None and path.resolve() == recording.resolve():
            raise ParameterError(f"{name} must not overwrite the recording (got {str(path)!r})")
    if len({path.resolve() for path in files.values()}) < len(files):
        raise ParameterError(f"{' and '.join(files)} must be different (got {str([*files.values()][-1])!r} for both)")


def check_folder(name: str, path: Path) -> None:
    """Check that a folder is writable or can be created.

    Raises:
        ParameterError: If it is a file or not writable.
    """
    existing = next(folder for folder in (path, *path.parents) if folder.exists())
    if not path.exists() and path.suffix[1:].lower() in FORMATS:
        raise ParameterError(f"{name} must be a folder; try --out . --format {path.suffix[1:]} (got {str(path)!r})")
    if not existing.is_dir():
        raise ParameterError(f"{name} must be a folder (got {str(path)!r})")
    if not _is_writable(existing):
        raise ParameterError(f"{name} must be a writable folder (got {str(path)!r})")


def _is_writable(folder: Path) -> bool:
    """Return True if a temporary file can be created in a folder."""
    import tempfile  # imported here: --help does not need it

    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def keep_partial(error: DivergenceError, json: str | None) -> None:
    """Print the warnings of a diverged run, and write its results up to the divergence."""
    if error.partial is None:
        return
    from maglev_mj.result import Table

    if warnings := list(error.partial.warnings):
        print(Table("", (), (), warnings=warnings), file=sys.stderr)
    if json is not None:
        write_json(json, {**error.partial.as_json(), "warnings": warnings, "diverged": str(error)})


def write_json(target: str, data: Mapping[str, Any]) -> None:
    """Write results and code versions as JSON to a file, or to standard output if the target is "-"."""
    import json

    from maglev_mj.files import write_text
    from maglev_mj.versions import versions

    text = json.dumps({**data, "versions": versions()}, allow_nan=False)
    if target == "-":
        print(text)
    else:
        write_text(Path(target), text + "\n")


def write_results(
    json: str | None,
    data: Callable[[], Mapping[str, Any]],
    text: Callable[[], str],
    draw: Callable[[], Sequence[Path]] = tuple,
    written: Sequence[Path] = (),
) -> None:
    """Write JSON, draw charts, and print the table unless JSON goes to standard output.

    Args:
        json: JSON file, or "-" for standard output; None for none.
        data: Function that returns the JSON data.
        text: Function that returns the table.
        draw: Function that draws the charts and returns their paths.
        written: Files already written, to be listed too.
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
    written: Sequence[Path] = (),
) -> None:
    """Write a result as JSON and charts if requested, and print its table.

    Args:
        json: JSON file, or "-" for standard output; None for none.
        result: The result.
        pictures: Output folder for charts; None for none.
        written: Files already written, to be listed too.
    """

    def draw() -> Sequence[Path]:
        return [] if pictures is None else [pictures.plot(result, picture=name) for name in result.pictures]

    with Progress("stability"):  # of a law without declared gains
        warnings = {"warnings": list(result.warnings)} if result.warnings else {}
    write_results(json, lambda: {**result.as_json(), **warnings}, lambda: str(result.table()), draw, written)


FORMATS = "png", "pdf", "svg"
"""Chart formats, as in `maglev_mj.pictures`; repeated here because that imports NumPy."""


def add_pictures(parser: Parser, help: str = "output folder for charts", default: Path | None = None) -> None:
    """Add --out, --format, --width and --bare.

    Args:
        parser: Parser of the command.
        help: Help of --out.
        default: Default folder; None for no charts.
    """
    if "--out" in parser._option_string_actions:  # of another function of the same command
        return
    output = parser.group("output")
    output.add_argument("--out", metavar="DIR", type=Path, default=default, help=help)
    output.add_argument(
        "--format", metavar="NAME", choices=FORMATS, help=f"chart format: {', '.join(FORMATS)} (default {FORMATS[0]})"
    )
    text = "width of a chart [inch], such as 3.4 for a column of a journal (default 8)"
    parser.yielding += [
        output.add_argument("--width", metavar="X", type=number_option, help=text),
        output.add_argument("--bare", action="store_true", help="omit headline and conditions, which a caption states"),
    ]


def chosen_pictures(options: argparse.Namespace) -> PictureFolder | None:
    """Return the output folder for charts; None for no charts.

    Raises:
        ParameterError: If a format, a width or `bare` is given without a folder, or the folder is a file.
        MissingPackageError: If matplotlib is not installed.
    """
    if options.width is not None:
        from maglev_mj.pictures import checked_width  # imported here: --help does not need NumPy

        checked_width(options.width)
    folder = options.out
    if folder is None:
        for name in ("format", "width", "bare"):
            if value := getattr(options, name):
                raise ParameterError(f"{name} requires out, the output folder (got {name} {value!r} alone)")
        return None
    from maglev_mj.pictures import PictureFolder, require  # imported here, as above

    require()
    check_folder("out", folder)
    return PictureFolder(folder, options.format or FORMATS[0], options.width, bool(options.bare))


def script_options(
    description: str | None, quick: str | None = None, more: Callable[[Parser], object] = lambda parser: None
) -> argparse.Namespace:
    """Return the options of a script that draws charts.

    Args:
        description: Description of the script.
        quick: Help of `--quick`; None for no such option.
        more: Function that adds the script's own options.

    Returns:
        `pictures`, a `PictureFolder`, and `quick`.
    """
    parser = Parser(description=description)
    add_pictures(parser, "output folder (default figures)", Path("figures"))
    if quick is not None:
        parser.add_argument("--quick", action="store_true", help=quick)
    more(parser)
    options: argparse.Namespace = parser.parse_args()
    try:
        options.pictures = chosen_pictures(options)
    except ParameterError as error:
        parser.error(str(error))
    return options

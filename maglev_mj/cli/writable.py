"""Checks that output files can be written, before a command's work."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from maglev_mj.errors import ParameterError

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
        check_folder(folder)
    for name, path in files.items():
        if path.is_dir() or not path.parent.is_dir():
            raise ParameterError(f"{name} must be a file in a folder that is there, not {str(path)!r}")
        if not (os.access(path, os.W_OK) if path.exists() else _takes_files(path.parent)):
            raise ParameterError(f"{name} must be a file that may be written, not {str(path)!r}")
        if "file" in options and path.resolve() == options.file.resolve():
            raise ParameterError(f"{name} must be another file than the recording, not {str(path)!r}")
    if len({path.resolve() for path in files.values()}) < len(files):
        raise ParameterError(f"{' and '.join(files)} must be two files, not {str([*files.values()][-1])!r} for both")
    if "record" in files and "workers" not in options:  # those of studies are of cells
        from maglev_mj.recording import check_name  # only a recording needs that code

        check_name(files["record"])


def check_folder(path: Path) -> None:
    """Check that a folder takes files, or can be made.

    Raises:
        ParameterError: If it is a file, or may not be written.
    """
    there = next(one for one in (path, *path.parents) if one.exists())
    if not there.is_dir():
        raise ParameterError(f"out must be a folder, not {str(path)!r}")
    if not _takes_files(there):
        raise ParameterError(f"out must be a folder that may be written, not {str(path)!r}")


def _takes_files(folder: Path) -> bool:
    """Return True if a file can be made in a folder, by making one."""
    import tempfile  # a help needs none

    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False

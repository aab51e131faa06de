"""Benchmarks of the program around the loop, one module per section.

A module has `measure(quick, **options)`, which returns tables by name: columns by heading, rows by name. It imports
only what its section needs, because bench.py also runs sections with earlier revisions of the package.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

Table = dict[str, dict[str, float]]
"""Columns by heading, rows by name."""

SECTIONS = {
    "answers": "answers of the theory, and maps in the engine",
    "start": "start of the program",
    "recorder": "the recorder",
    "cells": "cost of a sweep besides its cells, and sweeps killed at random moments",
    "bridge": "the host's share of a cycle, two processes in lockstep, latency in real time",
    "web": "cost of a browser to the control loop, and latency of a drag",
    "window": "frames of the window",
}
"""Titles of the sections by the name of their module."""


def child(module: str, *words: object) -> subprocess.Popen[str]:
    """Start a module of this package as a process, in a process group of its own."""
    command = [sys.executable, "-m", f"system.{module}", *map(str, words)]
    folder = Path(__file__).parent.parent
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True, start_new_session=True)


def beside(rows: Mapping[str, Mapping[str, float]]) -> Table:
    """Return columns of rows by name."""
    heads = dict.fromkeys(head for row in rows.values() for head in row)
    return {head: {name: row[head] for name, row in rows.items() if head in row} for head in heads}

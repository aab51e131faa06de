"""Options of studies with many cells: workers and records."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import count
from maglev_mj.errors import ParameterError
from maglev_mj.studies.cells import Record, StudyInterrupted, Workers, WorkersError, dask_workers, local_workers
from maglev_mj.versions import differences, versions


def add_workers(parser: Parser, record: str) -> None:
    """Add --record, --workers and --scheduler.

    Args:
        parser: Parser of the command.
        record: Purpose of the record, for the help.
    """
    parser.group("output").add_argument("--record", metavar="FILE", type=Path, help=f"{record}; one JSON object a line")
    group = parser.group("workers")
    group.add_argument("--workers", type=count, metavar="N", help="processes on this machine; 0 for this one alone")
    group.add_argument("--scheduler", metavar="ADDRESS", help="run on the Dask cluster of this scheduler instead")


def chosen_workers(options: argparse.Namespace, default: int | None) -> Workers:
    """Return the chosen workers.

    By default `default` processes; None for one per processor.
    """
    if options.scheduler is not None:
        if options.workers is not None:
            raise ParameterError(f"workers must be left to the scheduler where there is one, not {options.workers}")
        with warnings.catch_warnings(record=True) as said:
            workers = dask_workers(options.scheduler)
        for one in said:
            print(f"maglev-mj {options.command}: {one.message}", file=sys.stderr)
        return workers
    return local_workers(default if options.workers is None else options.workers)


@contextmanager
def cells_kept(path: Path | None, fallback: Path) -> Iterator[None]:
    """Write the cells of an interrupted study to a file.

    Only if they are not in a record yet; the error names the file.
    """
    try:
        yield
    except (StudyInterrupted, WorkersError) as stopped:
        if path is None:
            path = fallback
            kept = Record(path)
            kept.add([(cell, result) for cell, result in stopped.landed if cell not in kept])
        where = f"{len(stopped.landed)} cells are in {path}, the same command with --record {path} goes on from there"
        stopped.args = (f"{stopped}; {where}",)
        raise


def tell_of_others(command: str, others: Sequence[Mapping[str, Any]]) -> None:
    """Print on standard error that other code made some cells.

    Args:
        command: Name of the command.
        others: See `Record.others`.
    """
    if others:
        ours = versions()
        kinds = [f"{other['cells']} cells have {differences(other['versions'], ours)}" for other in others]
        more = f"; and {len(kinds) - 1} more kinds" if len(kinds) > 1 else ""
        print(f"maglev-mj {command}: the record is also by other code: {kinds[0]}{more}", file=sys.stderr)

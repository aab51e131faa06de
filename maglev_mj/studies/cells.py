"""Many cells of a study on many workers: what is done lands in a file, what is there is not done again.

A cell is a dict of plain values that says everything its result depends on. The record is one JSON object a line,
written by the parent alone, so a worker that dies takes nothing with it but the cells it had in hand. Each line names
the code that made it, as programs of several versions may share one record.
"""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeAlias

from maglev_mj.errors import ParameterError
from maglev_mj.versions import Versions, differences, versions, versions_read
from maglev_mj.workers import Workers, WorkersError, chosen_workers

__all__ = ["Cell", "Record", "StudyInterrupted", "run_cells"]

Cell: TypeAlias = dict[str, Any]

_ATTEMPTS = 2
_BEGINNING = '{"cell": {'


class StudyInterrupted(KeyboardInterrupt):
    """The study was stopped by hand.

    Attributes:
        landed: Cells and results so far.
    """

    def __init__(self, landed: list[tuple[Cell, Any]]) -> None:
        super().__init__("stopped")
        self.landed = landed


class Record:
    """Results by cell: in a file if there is one, in memory in any case.

    Args:
        path: JSON lines, read now and added to later; made when the first result lands. None for memory alone.

    Raises:
        ParameterError: If the file is no record.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._results: dict[bytes, Any] = {}
        self._others: dict[bytes, Versions] = {}  # of cells that other code made
        self._whole = True  # whether the file ends with a line's end
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        ours = versions()
        text = path.read_text(encoding="utf-8", errors="replace")
        self._whole = text.endswith("\n") or not text
        for line in text.splitlines():
            try:
                entry = json.loads(line)
                key = _key(entry["cell"])
                self._results[key] = entry["result"]
                self._others.pop(key, None)  # the newest line has it
                theirs = versions_read(entry.get("versions")) or {}
                if theirs != ours and differences(theirs, ours):
                    self._others[key] = theirs
            except (ValueError, TypeError, KeyError):
                # half a line is what a process leaves that dies as it writes; anything else is not a record
                if line.strip() and not line.startswith(_BEGINNING[: len(line)]):
                    raise ParameterError(f"record must hold one cell a line, not {line[:40]!r} in {path}") from None

    def __contains__(self, cell: Cell) -> bool:
        return _key(cell) in self._results

    def __getitem__(self, cell: Cell) -> Any:
        return self._results[_key(cell)]

    def others(self, cells: Sequence[Cell]) -> list[dict[str, Any]]:
        """Return the versions of other code, and the number of these cells it made, ready for JSON.

        Returns:
            For each such code `cells` and `versions`, which are empty where they are unknown.
        """
        if not self._others:
            return []
        found = Counter(
            json.dumps(self._others[key], sort_keys=True) for cell in cells if (key := _key(cell)) in self._others
        )
        return [{"cells": count, "versions": json.loads(text)} for text, count in found.items()]

    def add(self, pairs: Sequence[tuple[Cell, Any]]) -> None:
        """Keep results of this process's code, and write them where there is a file."""
        self._results.update((_key(cell), result) for cell, result in pairs)
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        made = versions()
        lines = [json.dumps({"cell": cell, "result": result, "versions": made}) + "\n" for cell, result in pairs]
        # one write to the end of the file, so that two programs with one record do not mix their lines
        with self.path.open("ab", buffering=0) as file:
            file.write((("" if self._whole else "\n") + "".join(lines)).encode())
        self._whole = True


def _key(cell: Mapping[str, Any]) -> bytes:
    """Return a digest of a cell: a million of them are small."""
    try:
        text = json.dumps(cell, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"a cell must hold values of JSON, not {cell!r}: {error}") from None
    return blake2b(text.encode(), digest_size=16).digest()


def run_cells(
    function: Callable[[list[Cell]], list[Any]],
    cells: Sequence[Cell],
    *,
    record: Record | None = None,
    workers: Workers | int | None = None,
    together: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Any]:
    """Return the result of each cell, computing those that the record lacks.

    Args:
        function: From some cells to a result for each, all JSON; importable by name, for it runs in other processes.
        cells: The study.
        record: Where results are kept; None for memory.
        workers: Where cells run: how many processes of this machine, or `dask_workers`; None for this process.
        together: How many cells make one job.
        progress: Told how many cells are done, and of how many.

    Returns:
        A result a cell, in order. A cell that kills its worker twice when it runs alone gets {"error": ...}, which
        is not recorded, so that a rerun tries again.

    Raises:
        ParameterError: If a cell is not JSON, or the function is none or returns anything but a result for each cell.
        StudyInterrupted: On Ctrl-C, after the jobs in hand have landed. They land too where a job fails with an error.
        WorkersError: If a cluster is gone, or one of its workers has other code.
    """
    if not callable(function):
        raise ParameterError(f"function must be one from cells to results, not {function!r}")
    study = _Study(function, record or Record(), chosen_workers(workers), progress)
    keys, found = [_key(cell) for cell in cells], study.record._results
    missing = list({key: cell for key, cell in zip(keys, cells, strict=True) if key not in found}.values())
    study.total = len(set(keys))
    study.done = study.total - len(missing)
    study.waiting.extend(missing[start : start + together] for start in range(0, len(missing), together))
    try:
        study.run()
    except KeyboardInterrupt:
        study.stop()
        raise StudyInterrupted(study.landed(cells)) from None
    except Exception as error:
        study.stop()
        cause = study.workers.cause(error)
        if isinstance(cause, WorkersError):
            cause.landed = study.landed(cells)
            raise cause from None
        raise
    finally:
        study.close()
    return [found[key] if key in found else study.dead[key] for key in keys]


class _Study:
    """The jobs of one study: waiting, in hand, and those under suspicion since a worker died."""

    def __init__(
        self,
        function: Callable[[list[Cell]], list[Any]],
        record: Record,
        workers: Workers,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.function, self.record, self.workers, self.progress = function, record, workers, progress
        self.total = self.done = 0
        self.waiting: deque[list[Cell]] = deque()
        self.suspects: deque[Cell] = deque()
        self.dead: dict[bytes, Any] = {}
        self._deaths: dict[bytes, int] = {}
        self._hand: dict[Future[list[Any]], list[Cell]] = {}
        self._pool: Executor | None = None

    def run(self) -> None:
        """Run everything."""
        while self.waiting or self.suspects or self._hand:
            alone = bool(self.suspects)
            self._hand_out(alone)
            finished, _ = wait(self._hand, return_when=FIRST_COMPLETED)
            broken = [job for future in finished if (job := self._land(future)) is not None]
            if broken:
                self._after_death(broken, alone)

    def stop(self) -> None:
        """Call back the jobs not begun, and wait for the others."""
        for future in list(self._hand):
            if future.cancel():
                del self._hand[future]
        wait(self._hand)
        for future in list(self._hand):
            with suppress(Exception):  # the first failure is on its way up already
                self._land(future)

    def landed(self, cells: Sequence[Cell]) -> list[tuple[Cell, Any]]:
        """Return those of the cells that are done, with their results."""
        return [(cell, self.record[cell]) for cell in cells if cell in self.record]

    def _hand_out(self, alone: bool) -> None:
        """Give out jobs up to the window; a suspect alone, so that a death has one culprit."""
        if self._pool is None:
            self._pool = self.workers.make()
        while len(self._hand) < (1 if alone else self.workers.window) and (self.suspects if alone else self.waiting):
            job = [self.suspects.popleft()] if alone else self.waiting.popleft()
            self._hand[self._pool.submit(self.function, job)] = job

    def _land(self, future: Future[list[Any]]) -> list[Cell] | None:
        """Keep the results of a job that is over; return the job if its worker died."""
        job = self._hand.pop(future)
        try:
            results = future.result()
        except self.workers.deaths:
            return job
        if not isinstance(results, Sequence) or len(results) != len(job):
            raise ParameterError(f"function must return a result for each of its {len(job)} cells, not {results!r}")
        self.record.add(list(zip(job, results, strict=True)))
        self._count(len(job))
        return None

    def _count(self, cells: int) -> None:
        self.done += cells
        if self.progress is not None:
            self.progress(self.done, self.total)

    def _after_death(self, broken: list[list[Cell]], alone: bool) -> None:
        """Let the rest of what was in hand end, make a new pool, and suspect what was lost."""
        wait(self._hand)
        broken += [job for future in list(self._hand) if (job := self._land(future)) is not None]
        self.close()
        for cell in (cell for job in broken for cell in job):
            deaths = self._deaths[_key(cell)] = self._deaths.get(_key(cell), 0) + alone
            if deaths < _ATTEMPTS:
                self.suspects.append(cell)
            else:
                self.dead[_key(cell)] = {"error": f"its worker died {deaths} times"}
                self._count(1)

    def close(self) -> None:
        """Let go of the workers."""
        if self._pool is not None:
            # idle workers end at once; a program that ends meanwhile would stumble over them
            self._pool.shutdown(wait=not self._hand, cancel_futures=True)
            self._pool = None

"""Cells of a study: computed by workers, kept in records.

Results are written to a file; recorded cells are not computed again.

A cell is a dict of plain values with everything its result depends on. The record has one JSON object per line. Only
the parent writes it, so a dying worker loses only the cells it was computing. Each line names the version of the code,
because programs of several versions may share one record.
"""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeAlias

from maglev_mj.errors import ParameterError, check_instance
from maglev_mj.versions import Versions, differences, versions, versions_read
from maglev_mj.workers import Workers, WorkersError, chosen_workers

Cell: TypeAlias = dict[str, Any]
"""Values of a cell by the parameter's name."""

_ATTEMPTS, _PATIENCE = 2, 1.0
_BEGINNING = '{"cell": {'


class StudyInterrupted(KeyboardInterrupt):
    """Study stopped by the user.

    Attributes:
        landed: Cells computed so far, with their results.
    """

    def __init__(self, landed: list[tuple[Cell, Any]]) -> None:
        super().__init__("stopped")
        self.landed = landed


class Record:
    """Results by cell, in memory and optionally in a file.

    Args:
        path: JSON lines, read now and appended to later; created with the first result. None for memory alone.

    Raises:
        ParameterError: If the file is not a record.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._results: dict[bytes, Any] = {}
        self._others: dict[bytes, Versions] = {}  # of cells made by other versions
        self._whole = True  # True if the file ends with a newline
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
                # a process that dies while writing leaves half a line; anything else is not a record
                if line.strip() and not line.startswith(_BEGINNING[: len(line)]):
                    raise ParameterError(f"record must hold one cell a line, not {line[:40]!r} in {path}") from None

    def __contains__(self, cell: Cell) -> bool:
        return _key(cell) in self._results

    def __getitem__(self, cell: Cell) -> Any:
        return self._results[_key(cell)]

    def others(self, cells: Sequence[Cell]) -> list[dict[str, Any]]:
        """Return other code versions with their cell counts.

        Ready for JSON; only the given cells count.

        Returns:
            For each such version `cells` and `versions`, which are empty if unknown.
        """
        if not self._others:
            return []
        found = Counter(
            json.dumps(self._others[key], sort_keys=True) for cell in cells if (key := _key(cell)) in self._others
        )
        return [{"cells": count, "versions": json.loads(text)} for text, count in found.items()]

    def add(self, pairs: Sequence[tuple[Cell, Any]]) -> None:
        """Store results of this process, in the file too."""
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
    """Return a short digest of a cell, to save memory."""
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
    """Return each cell's result, computing those not recorded.

    Args:
        function: Function from some cells to a result for each, all JSON; importable by name, because it runs in other
            processes.
        cells: The study.
        record: Record of the results; None for memory.
        workers: Workers that compute the cells, or a number of processes of this machine; None for this process.
        together: Number of cells in one job.
        progress: Function called with the number of cells done and the number of all.

    Returns:
        A result per cell, in order. A cell that kills its worker twice when it runs alone gets {"error": ...}, which
        is not recorded, so that a rerun tries again.

    Raises:
        ParameterError: If a cell is not JSON, or `function` is not a function that returns a result for each cell.
        StudyInterrupted: On Ctrl-C; running jobs have a second to finish. If a job fails, they all finish.
        WorkersError: If a cluster is gone, or one of its workers has other code.

    Example:
        >>> from maglev_mj import run_cells
        >>> cells = [{"k": 6000, "m": 0.5}, {"k": 6000, "m": 0.75}]
        >>> run_cells(lambda some: [cell["k"] / cell["m"] for cell in some], cells)
        [12000.0, 8000.0]
    """
    if not callable(function):
        raise ParameterError(f"function must be one from cells to results, not {function!r}")
    check_instance("cells", cells, Sequence, "a list of cells")
    study = _Study(function, record or Record(), chosen_workers(workers), progress)
    keys, found = [_key(cell) for cell in cells], study.record._results
    missing = list({key: cell for key, cell in zip(keys, cells, strict=True) if key not in found}.values())
    study.total = len(set(keys))
    study.done = study.total - len(missing)
    study.waiting.extend(missing[start : start + together] for start in range(0, len(missing), together))
    try:
        study.run()
    except KeyboardInterrupt:
        study.stop(_PATIENCE)
        study.close(wait=False)  # a job that was just handed out is in no hand yet
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
    """Jobs of one study: waiting, running, suspected.

    A job is suspected if it was running when a worker died.
    """

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
        """Run all jobs."""
        while self.waiting or self.suspects or self._hand:
            alone = bool(self.suspects)
            self._hand_out(alone)
            finished, _ = wait(self._hand, return_when=FIRST_COMPLETED)
            broken = [job for future in finished if (job := self._land(future)) is not None]
            if broken:
                self._after_death(broken, alone)

    def stop(self, patience: float | None = None) -> None:
        """Cancel waiting jobs, and wait for the running ones.

        Args:
            patience: Longest time to wait [s]; None for their end.
        """
        for future in list(self._hand):
            if future.cancel():
                del self._hand[future]
        for future in wait(self._hand, patience).done:
            with suppress(Exception):  # the first failure is raised already
                self._land(future)

    def landed(self, cells: Sequence[Cell]) -> list[tuple[Cell, Any]]:
        """Return the finished cells with their results."""
        return [(cell, self.record[cell]) for cell in cells if cell in self.record]

    def _hand_out(self, alone: bool) -> None:
        """Submit jobs up to the window.

        A suspect runs alone, so that a worker's death has one cause.
        """
        if self._pool is None:
            self._pool = self.workers.make()
        queue: deque[Any] = self.suspects if alone else self.waiting
        while len(self._hand) < (1 if alone else self.workers.window) and queue:
            job = [queue[0]] if alone else queue[0]
            try:
                self._hand[self._pool.submit(self.function, job)] = job
            except self.workers.deaths:  # since the last job landed; those in hand are lost too
                if not self._hand:
                    self.close()
                return
            queue.popleft()

    def _land(self, future: Future[list[Any]]) -> list[Cell] | None:
        """Store a finished job's results; return a lost job.

        A job is lost if its worker died; otherwise None is returned.
        """
        job = self._hand.pop(future)
        try:
            found = future.result()
        except self.workers.deaths:
            return job
        results = list(found) if isinstance(found, Iterable) else []
        if len(results) != len(job):
            raise ParameterError(f"function must return a result for each of its {len(job)} cells, not {found!r}")
        self.record.add(list(zip(job, results, strict=True)))
        self._count(len(job))
        return None

    def _count(self, cells: int) -> None:
        self.done += cells
        if self.progress is not None:
            self.progress(self.done, self.total)

    def _after_death(self, broken: list[list[Cell]], alone: bool) -> None:
        """Recover from a worker's death.

        The other running jobs end, the pool is closed, and lost jobs become suspects.
        """
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

    def close(self, wait: bool = True) -> None:
        """Release the workers."""
        if self._pool is not None:
            # idle workers end at once; otherwise they could disturb a program that ends meanwhile
            self._pool.shutdown(wait=wait and not self._hand, cancel_futures=True)
            self._pool = None

"""Cells of a study: computed by workers, kept in a record, never computed twice.

A cell is a dict of plain values with everything its result depends on. Workers get slices of the cells, and answer with
their results in columns. Only the parent writes the record, so a dying worker loses only the cells it was computing.

Workers are an executor of `concurrent.futures`: this process, processes of this machine, or a Dask cluster.
"""

from __future__ import annotations

import logging
import os
import signal
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.errors import MaglevError, ParameterError, check_instance, require
from maglev_mj.keywords import checked
from maglev_mj.lazy import stop_profiler
from maglev_mj.parameters import whole
from maglev_mj.process import process_start
from maglev_mj.studies.record import Cell, Columns, Record, pack
from maglev_mj.versions import Versions, differences, versions

_STOPPING, _CONNECTING, _WRITING = 1.0, 5.0, 1.0  # [s]


class StudyInterrupted(KeyboardInterrupt):
    """Study stopped by the user.

    Attributes:
        record: Results so far.
    """

    def __init__(self, record: Record) -> None:
        super().__init__("stopped")
        self.record = record


class WorkersError(MaglevError):
    """Error of lost workers or workers with other code.

    Attributes:
        record: Results so far, if a study had begun.
    """

    record: Record


class _Inline(Executor):
    """Executor that runs each job at once, in-process."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **keywords))
        except Exception as error:
            future.set_exception(error)
        return future


def _start_worker() -> None:
    """Prepare a worker process, which is a program of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where interrupts cannot be held
    stop_profiler()


class _Processes(Executor):
    """Pool of local processes that ignore Ctrl-C.

    They are spawned, because MuJoCo's threads do not survive a fork.
    """

    def __init__(self, count: int) -> None:
        from concurrent.futures import ProcessPoolExecutor  # not available in a browser
        from multiprocessing import get_context

        with process_start():  # its locks start the resource tracker
            self._pool = ProcessPoolExecutor(count, get_context("spawn"), initializer=_start_worker)

    def submit(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        with process_start():  # the processes start here
            return self._pool.submit(function, *args, **keywords)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        abandoned = {} if wait else dict(self._pool._processes or {})
        manager: Any = self._pool._executor_manager_thread
        self._pool.shutdown(wait, cancel_futures=cancel_futures)  # first: a cancelled job must not report a dead worker
        for process in abandoned.values():  # otherwise exit waits for their jobs
            process.kill()
        if manager is not None:  # it reports dead workers if it outlives this object
            manager.join()


class _Cluster(Executor):
    """Dask client as an executor that closes itself; each job checks its worker's code."""

    def __init__(self, client: Any) -> None:
        self._client, self._inner = client, client.get_executor(pure=False)

    def submit(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        future: Future[Any] = self._inner.submit(_run_with_code, versions(), function, *args, **keywords)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._inner.shutdown(wait=wait and not cancel_futures)
        self._client.close()


@dataclass(frozen=True)
class Workers:
    """Executor of cells with its properties.

    Attributes:
        make: Function that makes an executor, and a new one if the last has broken.
        window: Number of jobs submitted at a time.
        deaths: Errors of a dead worker, in contrast to a failed cell.
        cause: Function that returns a WorkersError if the workers caused a job's error, otherwise the error itself.
    """

    make: Callable[[], Executor]
    window: int
    deaths: tuple[type[BaseException], ...] = (BrokenExecutor,)
    cause: Callable[[Exception], Exception] = lambda error: error


@checked
def local_workers(count: int | None = None) -> Workers:
    """Return processes of this machine as workers.

    By default one per processor; 0 for none: jobs run in this process.

    Raises:
        ParameterError: If the count is not a whole number, or negative.

    Example:
        >>> from maglev_mj import local_workers
        >>> with local_workers(0).make() as pool:  # in this process
        ...     powers = list(pool.map(pow, [1, 2, 3], [2, 2, 2]))
        >>> powers
        [1, 4, 9]
    """
    if count is not None:
        count = whole("workers", count, at_most=np.inf)
    number = len(os.sched_getaffinity(0)) if count is None and hasattr(os, "sched_getaffinity") else count
    number = (os.cpu_count() or 1) if number is None else number
    return Workers(partial(_Processes, number), 2 * number) if number else Workers(_Inline, 1)


def chosen_workers(workers: Workers | int | None) -> Workers:
    """Return workers from a number of processes, workers, or None.

    A number gives processes of this machine; None gives this process.

    Raises:
        ParameterError: If it is something else.
    """
    if isinstance(workers, int | Integral):
        return local_workers(int(workers))
    if not isinstance(workers, Workers | None):
        raise ParameterError(f"workers must be a number of processes or dask_workers(...) (got {workers!r})")
    return workers or local_workers(0)


@checked
def dask_workers(address: str, *, files: Path | str | Sequence[Path | str] = ()) -> Workers:
    """Return the workers of a Dask cluster.

    A warning says that it has no workers yet; jobs wait for the first.

    Args:
        address: Address of its scheduler.
        files: User-defined modules that jobs import (.py, .zip or .egg); workers that join later get
            them too.

    Raises:
        ParameterError: If nothing answers there, or a file is missing or fails on import.
        WorkersError: If a worker has other code than this process; it names each.
        MissingPackageError: If Dask is not installed.

    Example:
        >>> from maglev_mj import dask_workers, find_scene, sweep
        >>> workers = dask_workers("tcp://scheduler:8786")  # doctest: +SKIP
        >>> found = sweep(find_scene("drop"), {"height": [0.001, 0.002]}, workers=workers)  # doctest: +SKIP
    """
    require(("distributed",), "distributed", "a cluster needs Dask")
    from distributed import KilledWorker

    # its tracebacks on a lost scheduler are replaced by the one line of `_cause`
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = _client(address)
    except (OSError, TimeoutError, ValueError) as error:
        raise ParameterError(f"scheduler must be the address of a Dask scheduler (got {address!r}): {error}") from None
    with client:
        threads = sum(client.nthreads().values())
        _check_code(client)
        for file in [files] if isinstance(files, Path | str) else files:
            _send(client, Path(file))
    if not threads:
        warnings.warn(f"the Dask scheduler at {address} has no workers yet: jobs wait for the first", stacklevel=2)
    return Workers(lambda: _Cluster(_client(address)), 4 * max(threads, 1), (KilledWorker,), partial(_cause, address))


@checked(own="cells function")
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
        function: Function from some cells to a result for each, all JSON (NaN is None); importable by name, because it
            runs in other processes.
        cells: The study.
        record: Record of the results; None for memory.
        workers: Workers that compute the cells, or a number of processes of this machine; None for this process.
        together: Number of cells in one job.
        progress: Function called with the number of cells done and the number of all.

    Returns:
        A result per cell, in order. A cell whose worker dies, and dies again when it runs alone, gets {"error": ...},
        which is not recorded, so that a rerun tries again.

    Raises:
        ParameterError: If a cell is not JSON, `function` is not a function that returns a result for each cell, or the
            record is of other cells or code.
        StudyInterrupted: On Ctrl-C; running jobs have a second to finish. If a job fails, they all finish.
        WorkersError: If workers die before their first job or have other code, or a cluster is gone.

    Example:
        >>> from maglev_mj import run_cells
        >>> cells = [{"k": 6000, "m": 0.5}, {"k": 6000, "m": 0.75}]
        >>> run_cells(lambda some: [cell["k"] / cell["m"] for cell in some], cells)
        [12000.0, 8000.0]
    """
    study = Study(function, cells, Record() if record is None else record, chosen_workers(workers), progress)
    return list(study.run(together))


@dataclass(eq=False)
class Study:
    """Cells of one study while they are computed.

    Args:
        function: See `run_cells`.
        cells: All cells; a job gets a slice of them.
        record: Results by cell.
        workers: Workers that compute the cells.
        progress: See `run_cells`.

    Attributes:
        done: Number of cells that are done, at first those of the record.
    """

    function: Callable[[Any], Any]
    cells: Sequence[Cell]
    record: Record
    workers: Workers
    progress: Callable[[int, int], None] | None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise ParameterError(f"function must map cells to results, not be {self.function!r}")
        check_instance("cells", self.cells, Sequence, "a list of cells")
        self.record.begin(self.cells)
        self._succeeded = False
        self.done = int(self.record.done.sum())

    def run(self, together: int) -> Record:
        """Return the results of all cells; see `run_cells`.

        Each cell lost with a worker is run again alone, so that its death has one cause.
        """
        jobs, lost = deque(self.record.missing(together)), list[int]()
        try:
            while jobs:
                lost += self._run_in_pool(jobs, self.workers.window)
                if lost and not self._succeeded:
                    self._check_workers()
            for index in lost:
                alone = deque([range(index, index + 1)])
                if self._run_in_pool(alone, 1) or alone:
                    self.record.put(np.array([index]), pack([{"error": "worker died twice"}]))
                    self._count(1)
        except KeyboardInterrupt:
            raise StudyInterrupted(self.record) from None
        except Exception as error:
            cause = self.workers.cause(error)
            if isinstance(cause, WorkersError):
                cause.record = self.record
                raise cause from None
            raise
        finally:
            self.record.flush()
        return self.record

    def _check_workers(self) -> None:
        """Raise a WorkersError if a worker dies of a job that does nothing."""
        pool = self.workers.make()
        try:
            pool.submit(int).result()
        except self.workers.deaths:
            raise WorkersError(
                "the worker processes died before their first job; a script that starts some must do so below "
                'if __name__ == "__main__":, because each of them runs the rest of the script again'
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)
        self._succeeded = True

    def _run_in_pool(self, jobs: deque[range], window: int) -> list[int]:
        """Run jobs in one pool until it breaks; return the cells lost with a worker."""
        pool, running = self.workers.make(), dict[Future[Columns], range]()
        lost, broken, stopped = list[int](), False, False
        try:
            while running or (jobs and not broken):
                while jobs and len(running) < window and not broken:
                    try:
                        some = self.cells[jobs[0].start : jobs[0].stop]
                        running[pool.submit(_in_columns, self.function, some)] = jobs[0]
                        jobs.popleft()
                    except self.workers.deaths:  # a worker died since the last result
                        broken = True
                for future in wait(running, _WRITING, FIRST_COMPLETED).done:
                    job = running.pop(future)
                    if not self._collect(future, job):
                        lost, broken = [*lost, *job], True
                self.record.flush(due=True)
        except BaseException as error:
            stopped = isinstance(error, KeyboardInterrupt)
            running = {future: job for future, job in running.items() if not future.cancel()}
            for future in wait(running, _STOPPING if stopped else None).done:
                with suppress(Exception):  # the first failure is raised below
                    self._collect(future, running.pop(future))
            raise
        finally:
            # wait for idle workers: they end at once. After an interrupt a job may be submitted but not in `running`
            pool.shutdown(wait=not (running or stopped), cancel_futures=True)
        return lost

    def _collect(self, future: Future[Columns], job: range) -> bool:
        """Store a finished job's results; return False if it is lost with its worker."""
        try:
            columns = future.result()
        except self.workers.deaths:
            return False
        self._succeeded = True
        self.record.add(job, columns)
        self._count(len(job))
        return True

    def _count(self, cells: int) -> None:
        self.done += cells
        if self.progress is not None:
            self.progress(self.done, len(self.cells))


def grid_columns(axes: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
    """Return the cells of a grid in columns, by the values of its axes; the last one varies fastest."""
    each = np.meshgrid(*map(np.asarray, axes.values()), indexing="ij")
    return {name: values.ravel() for name, values in zip(axes, each, strict=True)}


def _in_columns(function: Callable[[Any], Any], cells: Sequence[Cell]) -> Columns:
    """Return the results of some cells in columns."""
    output = function(cells)
    results = list(output) if isinstance(output, Iterable) else []
    if len(results) != len(cells):
        raise ParameterError(f"function must return one result per cell ({len(cells)}) (got {output!r})")
    return pack(results)


def _send(client: Any, file: Path) -> None:
    """Send a module to the workers, which import it."""
    try:
        if file.suffix not in (".py", ".zip", ".egg"):
            raise ValueError("not a .py, .zip or .egg file")
        client.upload_file(str(file))
    except Exception as error:  # an import can raise anything
        raise ParameterError(f"files must be modules that workers can import (got {str(file)!r}): {error}") from None


def _client(address: str) -> Any:
    """Return a connected Dask client.

    Raises OSError, TimeoutError or ValueError if there is no answer.
    """
    import asyncio  # slow to import

    from distributed import Client
    from distributed.core import connect

    async def probe() -> None:  # a client without a scheduler would keep reconnecting at exit
        connection = await connect(address, timeout=_CONNECTING)
        await connection.close()

    asyncio.run(probe())
    return Client(address, set_as_default=False)


def _check_code(client: Any) -> None:
    """Raise a WorkersError that names each worker of other code."""
    reports = client.run(versions, on_error="return")  # an older worker may lack the function
    wrong = {worker: _other(theirs) for worker, theirs in sorted(reports.items())}
    if mismatches := "; ".join(f"{worker}: {other}" for worker, other in wrong.items() if other):
        raise WorkersError(f"workers must run the code of this process: {mismatches}")


def _other(theirs: Versions | Exception) -> str:
    return f"code not available ({theirs})" if isinstance(theirs, Exception) else differences(theirs, versions())


def _cause(address: str, error: Exception) -> Exception:
    """Return the cause of a job's error.

    It is a WorkersError if the cluster is the cause, otherwise the error itself.
    """
    if isinstance(error, WorkersError):  # the job's own error names its worker
        return error
    try:
        with _client(address) as client:
            _check_code(client)
    except WorkersError as mismatch:
        return mismatch
    except (OSError, TimeoutError, ValueError):
        return WorkersError(f"the Dask scheduler at {address} is no longer reachable")
    # cancelled jobs mean that a new scheduler has replaced the old one
    return (
        WorkersError(f"the Dask scheduler at {address} has lost its jobs")
        if isinstance(error, CancelledError)
        else error
    )


def _run_with_code(code: Versions, function: Callable[..., Any], *args: Any, **keywords: Any) -> Any:
    """Run a job, unless this worker has other code.

    A worker that joined late was not checked before.
    """
    if other := differences(versions(), code):
        from distributed import get_worker

        raise WorkersError(f"workers must run the code of this process: {get_worker().address}: {other}")
    return function(*args, **keywords)

"""Workers of a study's jobs.

This process, processes of this machine, or a cluster.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, resource_tracker
from numbers import Integral
from pathlib import Path
from typing import Any

from maglev_mj.errors import MaglevError, ParameterError, require
from maglev_mj.interrupts import interrupts_held
from maglev_mj.versions import Versions, differences, versions

__all__ = ["Workers", "WorkersError", "chosen_workers", "dask_workers", "inline", "local_workers"]

_PATIENCE = 5.0


class WorkersError(MaglevError):
    """Error of lost workers or workers with other code.

    Attributes:
        landed: Cells and results of the study so far.
    """

    landed: Sequence[tuple[Any, Any]] = ()


class _Inline(Executor):
    """Executor that runs each job at once, in-process."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **keywords))
        except Exception as error:
            future.set_exception(error)
        return future


class _Processes(ProcessPoolExecutor):
    """Pool of local processes that ignore Ctrl-C.

    They are spawned, because MuJoCo's threads do not survive a fork.
    """

    def __init__(self, count: int) -> None:
        quiet = (signal.SIGINT, signal.SIG_IGN)  # for systems where interrupts cannot be held
        super().__init__(count, mp_context=get_context("spawn"), initializer=signal.signal, initargs=quiet)

    def submit(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        resource_tracker.ensure_running()  # its start would let interrupts through
        with interrupts_held():  # the processes start here
            return super().submit(function, *args, **keywords)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        given_up = {} if wait else dict(self._processes or {})
        manager: Any = self._executor_manager_thread
        super().shutdown(wait, cancel_futures=cancel_futures)  # first: of a cancelled job no death may be told
        for process in given_up.values():  # the end of the program would wait for their jobs
            process.kill()
        if manager is not None:  # which tells of deaths if this is gone before
            manager.join()


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
    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    cause: Callable[[Exception], Exception] = lambda error: error


def inline() -> Workers:
    """Return no workers: jobs run in this process."""
    return Workers(_Inline, 1)


def local_workers(count: int | None = None) -> Workers:
    """Return processes of this machine as workers.

    By default one per processor; 0 for none.

    Raises:
        ParameterError: If the count is negative.

    Example:
        >>> from maglev_mj import local_workers
        >>> with local_workers(0).make() as pool:  # in this process
        ...     powers = list(pool.map(pow, [1, 2, 3], [2, 2, 2]))
        >>> powers
        [1, 4, 9]
    """
    if count is not None and count < 0:
        raise ParameterError(f"workers must be at least 0, not {count}")
    number = len(os.sched_getaffinity(0)) if count is None and hasattr(os, "sched_getaffinity") else count
    number = (os.cpu_count() or 1) if number is None else number
    if number == 0:
        return inline()

    return Workers(lambda: _Processes(number), 2 * number)


def chosen_workers(workers: Workers | int | None) -> Workers:
    """Return workers from a number of processes, workers, or None.

    A number gives processes of this machine; None gives this process.

    Raises:
        ParameterError: If it is neither.
    """
    if isinstance(workers, int | Integral):
        return local_workers(int(workers))
    if not isinstance(workers, Workers | None):
        raise ParameterError(f"workers must be a number of processes or dask_workers(...), not {workers!r}")
    return workers or inline()


def dask_workers(address: str, *, files: Path | str | Sequence[Path | str] = ()) -> Workers:
    """Return the workers of a Dask cluster.

    Args:
        address: Address of its scheduler.
        files: Module, or modules, of the user's own that jobs import (.py, .zip or .egg); workers that join later get
            them too.

    Raises:
        ParameterError: If nothing answers there, or a file is not there or fails on import.
        WorkersError: If a worker has other code than this process; it names each.
        MissingPackageError: If Dask is not installed.

    Example:
        >>> from maglev_mj import dask_workers, find_scene, sweep
        >>> workers = dask_workers("tcp://scheduler:8786")  # doctest: +SKIP
        >>> found = sweep(find_scene("drop"), {"height": [0.001, 0.002]}, workers=workers)  # doctest: +SKIP
    """
    require(("distributed",), "distributed", "a cluster needs Dask")
    from distributed import KilledWorker

    # when it loses the scheduler it logs tracebacks; `_cause` reports it in one line
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = _client(address)
    except (OSError, TimeoutError, ValueError) as error:
        raise ParameterError(f"scheduler must be the address of a Dask scheduler, not {address!r}: {error}") from None
    with client:
        window = 4 * max(sum(client.nthreads().values()), 1)
        _check_code(client)
        for file in [files] if isinstance(files, Path | str) else files:
            _send(client, Path(file))
    return Workers(lambda: _Cluster(_client(address)), window, (KilledWorker,), partial(_cause, address))


def _send(client: Any, file: Path) -> None:
    """Send a module to the workers, which import it."""
    try:
        if file.suffix not in (".py", ".zip", ".egg"):
            raise ValueError("it is no .py, .zip or .egg")
        client.upload_file(str(file))
    except Exception as error:  # of the import, anything
        raise ParameterError(f"files must be modules that workers can import, not {str(file)!r}: {error}") from None


def _client(address: str) -> Any:
    """Return a connected Dask client.

    Raises OSError, TimeoutError or ValueError if there is no answer.
    """
    import asyncio  # as long to load as all of this module

    from distributed import Client
    from distributed.core import connect

    async def knock() -> None:  # a client without a scheduler would keep trying as the program ends
        door = await connect(address, timeout=_PATIENCE)
        await door.close()

    asyncio.run(knock())
    return Client(address, set_as_default=False)


def _check_code(client: Any) -> None:
    """Raise a WorkersError that names each worker of other code."""
    found = client.run(versions, on_error="return")  # an older worker may fail to
    wrong = {worker: _other(theirs) for worker, theirs in sorted(found.items())}
    if said := "; ".join(f"{worker}: {other}" for worker, other in wrong.items() if other):
        raise WorkersError(f"workers must have the code of this process: {said}")


def _other(theirs: Versions | Exception) -> str:
    return f"not known ({theirs})" if isinstance(theirs, Exception) else differences(theirs, versions())


def _cause(address: str, error: Exception) -> Exception:
    """Return the cause of a job's error.

    It is a WorkersError if the cluster is the cause, otherwise the error itself.
    """
    if isinstance(error, WorkersError):  # the job's own error names its worker
        return error
    try:
        with _client(address) as client:
            _check_code(client)
    except WorkersError as found:
        return found
    except (OSError, TimeoutError, ValueError):
        return WorkersError(f"the Dask scheduler at {address} is gone")
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

        raise WorkersError(f"workers must have the code of this process: {get_worker().address}: {other}")
    return function(*args, **keywords)


class _Cluster(Executor):
    """Dask client as an executor that closes itself."""

    def __init__(self, client: Any) -> None:
        self._client, self._inner = client, client.get_executor(pure=False)

    def submit(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Future[Any]:
        future: Future[Any] = self._inner.submit(_run_with_code, versions(), function, *args, **keywords)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._inner.shutdown(wait=wait and not cancel_futures)
        self._client.close()

"""Settings of every worker of the tests."""

from __future__ import annotations

import gc
import os
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads only wait, on cores that others need


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return one worker more than there are cores.

    Tests in real time mostly wait.
    """
    return (os.cpu_count() or 1) + 1


def pytest_configure(config: pytest.Config) -> None:
    """Import this worker's share of the test modules first.

    In a new checkout pytest compiles each of them, in 5 s altogether; others' shares are then compiled already.
    """
    worker, count = os.environ.get("PYTEST_XDIST_WORKER", ""), int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if worker and count > 1 and config.args == config.getini("testpaths"):
        modules = sorted(Path(__file__).parent.glob("test_*.py"), key=lambda path: path.stat().st_size)
        for module in modules[int(worker.removeprefix("gw")) :: count]:
            with suppress(Exception, pytest.skip.Exception):  # collection imports it again, and tells
                import_module(f"tests.{module.stem}")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Exclude tests and modules from garbage collection.

    They live to the end.
    """
    gc.freeze()

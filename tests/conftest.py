"""Settings of every worker of the tests."""

from __future__ import annotations

import gc
import os

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads only wait, on cores that others need
os.environ["LANGUAGE"] = "C"  # else each option of a command line is looked for in catalogues of translations


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return one worker more than there are cores.

    Tests in real time mostly wait.
    """
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Exclude a file's remains from garbage collection.

    Takeoffs and real-time loops collect garbage first: 0.1 s each in a process with all that the tests import.
    """
    if nextitem is None or item.path != nextitem.path:
        gc.collect()
        gc.freeze()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Exclude tests and modules from garbage collection."""
    gc.freeze()

"""Settings of every worker of the tests."""

from __future__ import annotations

import gc
import os

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads only wait, on cores that others need


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return one worker more than there are cores.

    Tests in real time mostly wait.
    """
    return (os.cpu_count() or 1) + 1


def pytest_collection_finish(session: pytest.Session) -> None:
    """Exclude tests and modules from garbage collection.

    They live to the end.
    """
    gc.freeze()

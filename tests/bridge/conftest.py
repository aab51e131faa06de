"""Working folder of the bridge's tests, and side processes that answer in this one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


class InProcess:
    """A side process that answers in this process, after some looks."""

    looks, started = 2, True

    def __init__(self, function: Callable[..., Any], *_: object) -> None:
        self._function = function

    def ask(self, *question: Any) -> None:
        self._question = question

    def answer(self) -> Any:
        self.looks -= 1
        return self._function(*self._question) if self.looks < 0 else None

    def close(self, patience: float) -> None:
        pass


@pytest.fixture(autouse=True)
def aside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check stability before takeoff in this process, where tests can replace its parts."""
    monkeypatch.setattr("maglev_mj.bridge.preflight.SideAnswers", InProcess)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write black boxes to a temporary folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path

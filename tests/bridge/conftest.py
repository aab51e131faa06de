"""Working folder of the bridge's tests."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write black boxes to a temporary folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path

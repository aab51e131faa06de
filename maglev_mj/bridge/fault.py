"""What a host says when a device will not go on: the fault by name, and the last cycles before it, on disk."""

from __future__ import annotations

import json
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from maglev_mj.bridge.wire import Fault, fault_names
from maglev_mj.errors import PlantError
from maglev_mj.frames import AXES
from maglev_mj.versions import versions

__all__ = ["BlackBox", "DeviceFault", "HandshakeError"]

_KEPT = 200
_COLUMNS = (
    *("sample", "time_ns", "state", "faults"),
    *(f"spot{place}" for place in range(6)),
    *AXES,
    *(f"{kind}{place}" for kind in ("held", "pulsed") for place in range(6)),
    "width",
)


class HandshakeError(PlantError):
    """No device answered, or the one that did will not have this host."""


class DeviceFault(PlantError):
    """The device is in the fault state, and its currents are zero.

    Attributes:
        faults: Why.
        path: File with the last 200 cycles; None where it could not be written.
    """

    def __init__(self, faults: Fault, message: str, path: Path | None) -> None:
        where = f"; the last cycles are in {path}" if path is not None else ""
        super().__init__(f"{fault_names(faults)}: {message}{where}")
        self.faults, self.path = faults, path


class BlackBox:
    """Keeps the last 200 cycles, and writes them when something has gone wrong.

    Args:
        folder: Where files go.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._versions = folder, versions()
        self._rows: deque[tuple[Any, ...]] = deque(maxlen=_KEPT)
        self.keep = self._rows.append

    def write(self, faults: Fault, message: str, about: Mapping[str, Any]) -> Path | None:
        """Write what is kept; to the temporary folder where the own one does not take it.

        Args:
            faults: What went wrong.
            message: The same for a person.
            about: Further values, ready for JSON.

        Returns:
            The file; None if there is no place for it at all.
        """
        text = json.dumps(
            {
                "format": "maglev_mj fault 1",
                "faults": fault_names(faults),
                "message": message,
                "versions": self._versions,
                **about,
                "columns": _COLUMNS,
                "cycles": [_flat(row) for row in self._rows],
            }
        )
        for folder in (self._folder, Path(tempfile.gettempdir())):
            with suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                return _write(folder, text)
        return None


def _write(folder: Path, text: str, now: Callable[[], float] = time.time) -> Path:
    stem = datetime.fromtimestamp(now()).strftime("maglev-fault-%Y%m%d-%H%M%S")
    count = 0
    while True:
        path = folder / (f"{stem}-{count}.json" if count else f"{stem}.json")
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text + "\n")
            return path
        except FileExistsError:
            count += 1


def _flat(row: Sequence[Any]) -> list[float | None]:
    """Return a cycle as plain numbers, None for what is none: JSON knows no NaN."""
    values: list[float | None] = []
    for part in row:
        for value in part if isinstance(part, (tuple, list)) else (part,):
            values.append(value if value - value == 0 else None)
    return values

"""The engine's viewer, for windows that change their model.

Its import needs a display.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import mujoco.viewer


class _Simulation(mujoco.viewer._Simulate):  # type: ignore[misc] # it has no types
    """The engine's simulation, which may be closed while it loads.

    A load waits for the drawing thread, which a closed window has ended: to destroy the simulation then would wait for
    the load, for ever, and hold the interpreter's lock meanwhile.

    Attributes:
        loading: True during a load; for good if the window was closed during it.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.loading, self._one = False, threading.Lock()

    def load(self, model: mujoco.MjModel, data: mujoco.MjData, path: str) -> None:
        """Load a model; wait until it is drawn."""
        with self._one:
            self.loading = True
        super().load(model, data, path)
        self.loading = False

    def destroy(self) -> None:
        """Destroy the simulation, unless it loads."""
        with self._one:
            if not self.loading:
                super().destroy()


def launch(model: mujoco.MjModel, data: mujoco.MjData, key_callback: Callable[[int], object]) -> Any:
    """Open a window on a model; return the engine's handle."""
    mujoco.viewer._Simulate = _Simulation
    return mujoco.viewer.launch_passive(model, data, key_callback=key_callback, show_left_ui=False, show_right_ui=False)

"""What a window shows of a device: a thread flies or serves it, and the window looks at it when it likes."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.hand import SpringHand
from maglev_mj.scenes import Scene, Settings
from maglev_mj.session import View

__all__ = ["Shown"]

_HISTORY = 2.0
_PATIENCE = 5.0
_ZERO = (0.0,) * 6


class Shown:
    """A device that lives in a thread of its own, for `viewer.window.show`: see `Showable`.

    Args:
        scene: What it looks like.
        settings: Of its laws, and its sample period.
        live: Runs the device until told to stop, on its own thread.
        stop: Tells it to.

    Attributes:
        hand: The mouse's.
        simulated: Time shown so far [s].
    """

    def __init__(
        self, scene: Scene, settings: Settings, live: Callable[[], object], stop: Callable[[], object]
    ) -> None:
        self.scene, self.settings = scene, settings
        self.hand = SpringHand()
        self.simulated = 0.0
        self.faces: Sequence[tuple[int, float, float]] = ()
        self.anchors: Array | None = None
        self.work, self.notes = 0.0, [""]
        self.failed: BaseException | None = None
        self._stop = stop
        self._state = (0.0, np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6))
        self._history: deque[tuple[float, ...]] = deque(maxlen=max(round(_HISTORY / settings.period), 2))
        self._ticks = self._seen = 0
        self._last = np.zeros(6)
        self._thread = threading.Thread(target=self._run, args=(live,), name="device", daemon=True)
        self._lock = threading.Lock()

    def start(self) -> None:
        """Let the device live."""
        self._thread.start()

    def keep(self, pose: Array, force: Array, effort: Sequence[float], currents: Sequence[float]) -> None:
        """Keep what there is to see after a sample; called by the device's thread.

        Args:
            pose: Of the flotor [m, rad], (6,).
            force: Wrench that the device holds beyond what carries the flotor [N, N m], (6,).
            effort: Wrench of the hand [N, N m], six.
            currents: In the coils [A], six.
        """
        time, axis = self._ticks * self.settings.period, self.scene.axis_index
        speed = (pose[axis] - self._last[axis]) / self.settings.period if self._ticks else 0.0
        hand = np.array(effort)
        self.work += float(hand @ (pose - self._last)) if self._ticks else 0.0
        self._last = pose
        with self._lock:
            self._state = time, pose, force, hand, np.array(currents)
            self._history.append((time, float(pose[axis]), float(speed), float(force[axis]), float(hand[axis])))
        self._ticks += 1

    def tick(self, elapsed: float) -> int:
        """Return how many samples there were since the last call; the device keeps its own time."""
        ticks, self._seen = self._ticks - self._seen, self._ticks
        self.simulated += ticks * self.settings.period
        return ticks

    def act(self, action: str) -> None:
        """Do nothing: a device is changed by whoever flies it."""

    def view(self) -> View:
        """Return what there is to see."""
        with self._lock:
            (time, pose, force, hand, currents), history = self._state, np.array(self._history).reshape(-1, 5)
        notes = [note for note in self.notes if note]
        if self.failed is not None:
            notes.append(f"STOPPED: {self.failed}")
        return View(
            scene=self.scene,
            settings=self.settings,
            time=time,
            pose=pose,
            force=force,
            hand=hand,
            currents=currents,
            faces=self.faces,
            anchors=self.anchors,
            history=history,
            work=self.work,
            taken=float("nan"),
            cost=0.0,
            missed=0,
            notes=notes,
        )

    def close(self) -> None:
        """Stop the device, and wait until it has."""
        self._stop()
        if self._thread.is_alive():
            self._thread.join(_PATIENCE)

    def _run(self, live: Callable[[], object]) -> None:
        try:
            live()
        except BaseException as error:
            self.failed = error

"""A scene that runs in real time and can be changed while it does; it knows neither window nor keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import ZERO
from maglev_mj.hand import SpringHand
from maglev_mj.scenes import SCENES, Settings, scene_called
from maglev_mj.scenes.parts import WEIGHT
from maglev_mj.session.actions import CHANGES
from maglev_mj.session.pacing import Pacer
from maglev_mj.session.publishers import Publisher, Publishers
from maglev_mj.session.snapshot import History, Snapshot
from maglev_mj.session.stretch import LiveStretch
from maglev_mj.session.tape import Tape

__all__ = ["ACTIONS", "Session"]

ACTIONS = (*CHANGES, "next scene", "drop", "centre", "pause", "record")
"""What `Session.act` knows."""

_MADE = -0.1


class Session:
    """A scene that runs in real time and can be changed while it does.

    Whatever is changed, plant and controller are made anew at the pose and speed of the moment, so that every stretch
    between two changes is a run like any other: it can be recorded, and run again.

    Args:
        scene: Name of the first scene.
        settings: In place of that scene's own.
        hand: The hand on it.
        folder: Where recordings go that a key begins.
        record: File to record to from the start; None for nothing until a key says so.
        pacer: Keeps up with real time.
        publishers: Ways to other programs; closed with the session.

    Attributes:
        simulated: Time simulated so far [s].

    Raises:
        ParameterError: If there is no such scene.
    """

    def __init__(
        self,
        scene: str = "joystick",
        *,
        settings: Settings | None = None,
        hand: SpringHand | None = None,
        folder: Path = Path(),
        record: Path | None = None,
        pacer: Pacer | None = None,
        publishers: Sequence[Publisher] = (),
    ) -> None:
        self.hand = hand or SpringHand()
        self.simulated = 0.0
        self._pacer = pacer or Pacer()
        self._scene = scene_called(scene)
        self._settings = settings or self._scene.settings
        self._history = History()
        self._tape = Tape(folder)
        if record is not None:
            self._tape.start(record)
        self._paused, self._stopped = False, ""
        self._publishers, self._ticks, self._since = Publishers(publishers), 0, 0
        self._stretch = self._begin(self._scene.pose)

    @property
    def recordings(self) -> Sequence[Path]:
        """Files written so far."""
        return self._tape.written

    def tick(self, elapsed: float) -> int:
        """Go on by as much as real time has, within the pacer's budget.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            How many control ticks were made; none while paused or stopped.
        """
        made, before = 0, self._ticks
        if self._paused or self._stopped:
            self._pacer.forgive()
            self._take_wanted()
        else:
            try:
                self._pacer.advance(elapsed, self._settings.period, self._one)
            except MaglevError as error:
                self._stopped = str(error)
                self._tape.failed(self._stopped)
            made = self._ticks - before
        self._tape.missed(self._pacer.missed)
        self._publishers.show(self.snapshot)
        return made

    def act(self, action: str) -> None:
        """Do one of ACTIONS.

        Raises:
            ParameterError: If it is none.
        """
        if action not in ACTIONS:
            raise ParameterError(f"action must be one of {', '.join(ACTIONS)}, not {action!r}")
        if action in CHANGES:
            self._settings = CHANGES[action](self._settings)
            self._go_on()
        elif action == "pause":
            self._paused = not self._paused
        elif action == "record":
            self._record()
        elif action == "next scene":
            names = list(SCENES)
            self._scene = SCENES[names[(names.index(self._scene.name) + 1) % len(names)]]
            self._settings = self._scene.settings
            self._restart(self._scene.pose)
        else:
            lift = action == "drop"
            weightless = False if lift else self._scene.settings.weightless
            self._settings = Settings.from_json({**self._settings.as_json(), "weightless": weightless})
            self._restart(self._scene.lifted if lift else self._scene.pose)

    def snapshot(self) -> Snapshot:
        """Return the picture of now."""
        stretch, settings = self._stretch, self._settings
        return Snapshot(
            scene=self._scene,
            settings=settings,
            since=self._since,
            delay=settings.delay,
            tick=self._ticks,
            time=stretch.time,
            pose=stretch.pose,
            force=stretch.rendered,
            hand=np.array(stretch.plant.hand_wrench),
            currents=stretch.plant.currents,
            faces=stretch.faces,
            anchors=stretch.anchors,
            history=self._history.rows,
            work=stretch.energy.hand,
            taken=stretch.energy.taken,
            cost=self._pacer.cost,
            missed=self._pacer.missed,
            state="stopped" if self._stopped else "paused" if self._paused else "running",
            reason=self._stopped,
            notes=self._notes(),
        )

    def close(self) -> None:
        """Keep what is recorded, and let go of the plant."""
        self._publishers.close()
        try:
            self._tape.stop()
        finally:
            self._stretch.plant.close()

    def _one(self) -> None:
        """Make one tick; stop a world that makes energy."""
        self._take_wanted()
        self._stretch.tick()
        self._ticks += 1
        self.simulated += self._settings.period
        if self._stretch.energy.stored < _MADE:
            made = -self._stretch.energy.stored
            raise MaglevError(f"the rendered world made {made * 1e3:.0f} mJ more than it took: it is unstable")

    def _take_wanted(self) -> None:
        """Go on under the settings that another program asks for; rate and delay are the person's here."""
        wanted = self._publishers.wanted()
        if wanted is not None:
            self._settings = replace(wanted, period=self._settings.period, delay=self._settings.delay)
            self._go_on()

    def _begin(self, pose: Sequence[float], *, going_on: bool = False) -> LiveStretch:
        """Return a new stretch, at rest or as the last one left it."""
        began, self._since = 0.0, self._ticks
        twist: Sequence[float] = ZERO
        wrench: Sequence[float] = WEIGHT if self._settings.weightless else ZERO
        if going_on:
            twist, wrench, began = self._stretch.twist.tolist(), self._stretch.force, self._stretch.time
        return LiveStretch(
            self._scene,
            self._settings,
            self.hand,
            pose=pose,
            twist=twist,
            wrench=wrench,
            file=self._tape.file,
            began=began,
            keep=self._history.add,
        )

    def _go_on(self) -> None:
        """Make plant and controller anew where the flotor is; one that was stopped starts again."""
        if self._stopped:
            self._restart(self._scene.pose)
        else:
            self._stretch = self._begin(self._stretch.pose.tolist(), going_on=True)

    def _restart(self, pose: Sequence[float]) -> None:
        self._stopped = ""
        self._history.clear()
        self._pacer.forgive()
        self._stretch = self._begin(pose)

    def _record(self) -> None:
        """Start recording, or end it."""
        if self._tape.file is None:
            self._tape.start()
        else:
            self._tape.stop()
        if not self._stopped:
            self._go_on()

    def _notes(self) -> list[str]:
        notes = []
        if self._stopped:
            notes.append(f"STOPPED: {self._stopped}")
        elif self._paused:
            notes.append("PAUSED")
        if self._pacer.late:
            notes.append("TOO SLOW: this machine cannot keep up, simulated time slows down")
        if self._tape.note:
            notes.append(self._tape.note)
        return notes

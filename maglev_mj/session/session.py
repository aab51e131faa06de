"""A scene that runs in real time and can be changed while it does; it knows neither window nor keys."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.hand import HandForce, SpringHand
from maglev_mj.parameters import number
from maglev_mj.recording import RecordingFile
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.session.actions import DEVICES_OWN, EMERGENCY_STOP, actions
from maglev_mj.session.admission import STEP_FORCE, check_step
from maglev_mj.session.live import centred, lifted
from maglev_mj.session.pacing import Pacer
from maglev_mj.session.snapshot import History, Publisher, Publishers, Snapshot
from maglev_mj.session.stretch import LiveStretch
from maglev_mj.session.tape import Tape

__all__ = ["Session"]

_OWN = "next scene", "drop", "centre", "pause", "record", EMERGENCY_STOP

_MADE = -0.1


class Session:
    """A scene that runs in real time and can be changed while it does.

    Whatever is changed, plant and controller are made anew at the pose and speed of the moment, so that every stretch
    between two changes is a run like any other: it can be recorded, and run again.

    Args:
        scene: The first scene; the joystick by default.
        hand: The hand on it; the mouse's by default.
        folder: Where recordings go that a key begins.
        record: File to record to from the start; None for nothing until a key says so.
        file: File that every sample goes to besides, such as a live server; left open.
        pacer: Keeps up with real time.
        publishers: Ways to other programs; closed with the session.
        step_force: Largest step of force that settings of other programs may make [N]; see `check_step`.

    Attributes:
        simulated: Time simulated so far [s].
    """

    def __init__(
        self,
        scene: Scene | None = None,
        *,
        hand: HandForce | None = None,
        folder: Path = Path(),
        record: Path | None = None,
        file: RecordingFile | None = None,
        pacer: Pacer | None = None,
        publishers: Sequence[Publisher] = (),
        step_force: float = STEP_FORCE,
    ) -> None:
        self._hand = hand or SpringHand()
        # the mouse moves no other
        self.hand = self._hand if isinstance(self._hand, SpringHand) else SpringHand()
        self.simulated = 0.0
        self._pacer = pacer or Pacer()
        self._scene = scene or find_scene("joystick")()
        own = type(self._scene)
        self._scenes = [find_scene(name) for name in BUILT_IN]
        if own not in self._scenes:
            self._scenes.insert(0, own)
        self._history = History()
        self._tape = Tape(folder, file)
        if record is not None:
            self._tape.start(record)
        self._paused, self._stopped = False, ""
        self._publishers, self._ticks, self._since = Publishers(publishers), 0, 0
        self._step_force = number("step_force", step_force, above=0.0)
        self._stretch = self._begin(self._scene.start().pose)

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
                self._pacer.advance(elapsed, self._scene.period, self._one)
            except MaglevError as error:
                self._stop(str(error))
            made = self._ticks - before
        self._tape.missed(self._pacer.missed)
        self._publishers.show(self.snapshot)
        return made

    @property
    def actions(self) -> Sequence[str]:
        """Names of what `act` does to the present scene."""
        return *actions(type(self._scene)), *_OWN

    def act(self, action: str) -> None:
        """Do one of `actions`.

        Raises:
            ParameterError: If it is none.
        """
        changes = actions(type(self._scene))
        if action in changes:
            self._scene = changes[action](self._scene)
            self._go_on()
        elif action == EMERGENCY_STOP:
            self._stop(EMERGENCY_STOP)
        elif action == "pause":
            self._paused = not self._paused
        elif action == "record":
            self._record()
        elif action == "next scene":
            place = self._scenes.index(type(self._scene)) + 1
            self._scene = self._scenes[place % len(self._scenes)]()
            self._restart(self._scene.start().pose)
        elif action == "drop":
            self._scene, pose = lifted(self._scene)
            self._restart(pose)
        elif action == "centre":
            self._scene = centred(self._scene)
            self._restart(self._scene.start().pose)
        else:
            raise ParameterError(f"action must be one of {', '.join(self.actions)}, not {action!r}")

    def snapshot(self) -> Snapshot:
        """Return the picture of now."""
        stretch = self._stretch
        return Snapshot(
            scene=self._scene,
            since=self._since,
            delay=self._scene.delay,
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

    def _stop(self, reason: str) -> None:
        """Stop until something is changed or centred."""
        if not self._stopped:
            self._stopped = reason
            self._tape.failed(reason)

    def _one(self) -> None:
        """Make one tick; stop a world that makes energy."""
        self._take_wanted()
        self._stretch.tick()
        self._ticks += 1
        self.simulated += self._scene.period
        if self._stretch.energy.stored < _MADE:
            made = -self._stretch.energy.stored
            raise MaglevError(f"the rendered world made {made * 1e3:.0f} mJ more than it took: it is unstable")

    def _take_wanted(self) -> None:
        """Go on with the parameters that another program asks for; rate and delay are the person's here."""
        if (wish := self._publishers.wanted()) is None:
            return
        try:
            scene = self._scene
            if type(wish.scene) is not type(scene):
                raise ParameterError(f"settings must be those of {scene.name}, not of {wish.scene.name}")
            wanted = wish.scene.replace(**{name: getattr(scene, name) for name in DEVICES_OWN})
            if not self._stopped:  # otherwise it starts anew
                stretch = self._stretch
                check_step(stretch.controller, wanted.controller(), stretch.pose.tolist(), self._step_force)
        except MaglevError as error:
            wish.answer(str(error))
            return
        self._scene = wanted
        self._go_on()
        wish.answer(self._since)

    def _begin(self, pose: Sequence[float], *, going_on: bool = False) -> LiveStretch:
        """Return a new stretch, at rest or as the last one left it."""
        began, self._since, start = 0.0, self._ticks, self._scene.start()
        twist, wrench = start.twist, start.wrench
        if going_on:
            twist, wrench, began = self._stretch.twist.tolist(), self._stretch.force, self._stretch.time
        return LiveStretch(
            self._scene,
            self._hand,
            pose=pose,
            twist=twist,
            wrench=wrench,
            file=self._tape.whole,
            began=began,
            keep=self._history.add,
        )

    def _go_on(self) -> None:
        """Make plant and controller anew where the flotor is; one that was stopped starts again."""
        if self._stopped:
            self._restart(self._scene.start().pose)
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

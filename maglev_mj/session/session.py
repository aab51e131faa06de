"""Scene running in real time, with changeable parameters and recordings.

Its actions have names; it knows neither window nor keys.
"""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, not_one_of
from maglev_mj.parameters import flag, number
from maglev_mj.plants.hand import HandForce, SpringHand, Trajectory
from maglev_mj.recording import RecordingError, RecordingFile, open_recording
from maglev_mj.recording.journal import SUFFIX
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.find import SceneLike, get_scene
from maglev_mj.scenes.interactive import WEIGHT
from maglev_mj.scenes.stability_check import STEP_FORCE, check_step, own_code_refused
from maglev_mj.session.actions import CHOOSES, EMERGENCY_STOP, actions, changed, settable
from maglev_mj.session.pacing import TIME_SCALES, Note, Pacer, next_scale
from maglev_mj.session.segment import KEPT, HandAgain, LiveSegment, Past
from maglev_mj.session.snapshot import SHOWN, Publisher, Publishers, Snapshot


class SessionRecorder:
    """Recordings of a session.

    Args:
        folder: Folder of the files.

    Attributes:
        written: Closed recordings.
        file: Open recording; None for none.
    """

    def __init__(self, folder: Path) -> None:
        self.written: list[Path] = []
        self.file: RecordingFile | None = None
        self._folder, self._failed, self._missed = folder, "", 0
        self._said = Note()
        self._closing: list[threading.Thread] = []
        self._broken: list[str] = []
        self._named: set[Path] = set()

    def start(self, path: Path | None = None) -> None:
        """Begin a recording.

        Args:
            path: Path of the file; None for a new name in the folder, or in the temporary folder if that cannot be
                written.

        Raises:
            OSError: If the file cannot be written.
        """
        if path is not None:
            self.file = open_recording(path)
            return
        try:
            self.file = open_recording(self._new_path(self._folder))
        except OSError:
            self.file = open_recording(self._new_path(Path(tempfile.gettempdir())))

    def stop(self) -> None:
        """End the recording; its file is closed in another thread."""
        if self.file is None:
            return
        file, self.file = self.file, None
        self._said.say("writing the recording")
        self._closing.append(threading.Thread(target=self._keep, args=(file,)))
        self._closing[-1].start()

    def close(self) -> None:
        """End the recording and wait for all files.

        Raises:
            RecordingError: If one is not whole; all are closed.
        """
        self.stop()
        for thread in self._closing:
            thread.join()
        if self._broken:
            raise RecordingError("; ".join(self._broken))

    def _keep(self, file: RecordingFile) -> None:
        """Close a file and report the outcome."""
        try:
            path = file.close()
        except RecordingError as error:  # the part before the error is on disk
            self._broken.append(str(error))
            self._failed = f"RECORDING: {error}"
            return
        self._said.say(f"wrote {path}" if path is not None else "nothing was recorded")
        if path is not None:
            self.written.append(path)

    def failed(self, why: str) -> None:
        """Set the reason of a stopped scene."""
        if self.file is not None:
            self.file.event("fault", why)

    def missed(self, count: int) -> None:
        """Set the number of ticks given up so far."""
        more, self._missed = count - self._missed, count
        if more and self.file is not None:
            self.file.event("missed", f"{more} ticks were given up: too slow", more)

    @property
    def notes(self) -> list[str]:
        """Recording status lines for the viewer.

        Success messages disappear after some seconds.
        """
        notes = [*filter(None, [self._failed]), *self._said.lines]
        if self.file is None:
            return notes
        try:
            self.file.check()
        except RecordingError as error:
            return [*notes, f"NOT RECORDING: {error}"]
        return [*notes, "RECORDING"]

    def _new_path(self, folder: Path) -> Path:
        """Return an unused name for a recording."""
        stem = datetime.now().strftime("maglev-%Y%m%d-%H%M%S")
        path, count = folder / f"{stem}{SUFFIX}", 1
        while path in self._named or path.exists():
            path, count = folder / f"{stem}-{count}{SUFFIX}", count + 1
        self._named.add(path)
        return path


def device_controller(scene: Scene) -> Controller:
    """Return a scene's controller for a device, with gravity compensation.

    Added only if the scene has no gravity.
    """
    controller = scene.controller()
    if scene.start().gravity:
        return controller
    return Controller([*controller.laws, Bias(WEIGHT)], period=scene.period, velocity=scene.velocity_estimator())


_LIFTED = 0.004  # height of a drop [m]
_MADE = -0.1
_BACK = 1.0  # by a key [s]
_RENEWED = 0.1
"""Shortest real time between two changes of parameters [s]."""


class Session:
    """Scene running in real time, with changeable parameters.

    After a change, plant and controller are rebuilt at the present pose and speed, so that every segment
    between two changes is a run like any other: it can be recorded, and run again.

    Args:
        scene: The first scene, or a text for `find_scene`; the joystick by default.
        hand: The hand on the flotor; the mouse's by default.
        folder: Folder of recordings started by a key.
        record: File to record to from the start; None for no recording until a key starts one.
        pacer: Scheduler of the ticks in real time.
        publishers: Publishers to other programs; closed with the session.
        step_force: Largest step of force by settings of other programs [N]; see `check_step`.

    Attributes:
        simulated: Simulated time so far [s].
        recordings: Files written so far.

    Example:
        >>> from maglev_mj import Session
        >>> session = Session()
        >>> ticks = session.tick(0.02)  # 20 ms at 200 Hz
        >>> session.close()
        >>> ticks
        4
    """

    def __init__(
        self,
        scene: SceneLike | None = None,
        *,
        hand: HandForce | None = None,
        folder: Path = Path(),
        record: Path | None = None,
        pacer: Pacer | None = None,
        publishers: Sequence[Publisher] = (),
        step_force: float = STEP_FORCE,
    ) -> None:
        self._hand = hand or SpringHand.of_mouse()
        # the mouse moves no other
        self.hand = self._hand if isinstance(self._hand, SpringHand) else SpringHand.of_mouse()
        self.simulated = 0.0
        self._pacer = pacer or Pacer()
        self._scene = get_scene("joystick" if scene is None else scene)
        own = type(self._scene)
        self._scenes = [find_scene(name) for name in BUILT_IN]
        if own not in self._scenes:
            self._scenes.insert(0, own)
        self._past, self._acting = Past(), self._hand
        self._recorder = SessionRecorder(folder)
        self.recordings: Sequence[Path] = self._recorder.written
        if record is not None:
            self._recorder.start(record)
        self._paused, self._stopped, self._steps = False, "", 0
        self._time_scale = 1.0
        self._changed, self._unchanged = False, _RENEWED
        self._publishers, self._ticks, self._since = Publishers(publishers), 0, 0
        self._pulses = 0
        self._step_force = number("step_force", step_force, above=0.0)
        self._segment = self._begin(self._scene.start().pose)

    def tick(self, elapsed: float) -> int:
        """Advance by elapsed real time, within the pacer's budget.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            Number of control ticks; 0 while paused or stopped.
        """
        before = self._ticks
        self._unchanged += number("elapsed", elapsed)
        try:
            held = not self._steps and self._unchanged < _RENEWED
            if self._past.rewound:
                if not self._stopped and (self._steps or not self._paused):
                    self._leave_past()
            elif self._changed and not (held or self._stopped):
                self._unchanged = 0.0
                self._go_on()
            if self._paused or self._stopped:
                self._pacer.forgive()
                self._take_wanted()
                while self._steps and not self._stopped:
                    self._steps -= 1
                    self._one()
            else:
                self._pacer.advance(elapsed * self._time_scale, self._segment.scene.period, self._one)
        except MaglevError as error:
            self._stop(str(error))
        ticks, self._steps = self._ticks - before, 0
        self._recorder.missed(self._pacer.missed)
        self._publishers.show(self.snapshot)
        return ticks

    @property
    def actions(self) -> Sequence[str]:
        """Names of the actions of the present scene."""
        return tuple(self._acts())

    def act(self, action: str) -> None:
        """Perform one of `actions`.

        Raises:
            ParameterError: If there is no such action.
        """
        acts = self._acts()
        if action not in acts:
            raise ParameterError(not_one_of("action", tuple(acts), action))
        acts[action]()

    def _acts(self) -> dict[str, Callable[[], object]]:
        """Return what each action does; that of the scene where it shares a name with one of the session's."""
        of_scene = {name: partial(self._adopt, name) for name in actions(type(self._scene))}
        of_session: dict[str, Callable[[], object]] = {
            "next scene": self._choose_next,
            "drop": self._drop,
            "centre": self._centre,
            "pause": lambda: self._pause(not self._paused),
            "step": self._step,
            "slower": partial(self._scale, "slower"),
            "faster": partial(self._scale, "faster"),
            "record": self._record,
            "rewind": lambda: self._show_past(self._segment.time - _BACK),
            "go on from here": partial(self._pause, False),
            "same hand again": partial(self._leave_past, again=True),
            EMERGENCY_STOP: partial(self._stop, EMERGENCY_STOP),
        }
        choices = {f"{CHOOSES}{cls.name}": partial(self._choose, cls) for cls in self._scenes}
        return of_scene | of_session | choices | of_scene

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change live parameters of the scene or the session.

        Period and delay are included.

        They take effect at the next tick. Of changes within 0.1 s only the newest takes effect, after that time.

        Args:
            parameters: Values by name; `time_scale` (simulated time for each second of real time, 0.001 to 1),
                `hand_stiffness` [N/m] and `rewind` are the session's. The last one shows, paused, the scene of so many
                seconds before the newest sample, 0 to 60, with the parameters of then; at most all that is kept.

        Raises:
            ParameterError: If there is no such live parameter, or the scene refuses a value; nothing changes then.
        """
        changes = dict(parameters)
        stiffness = number("hand_stiffness", changes.pop("hand_stiffness", self.hand.stiffness), at_least=0.0)
        least, most = TIME_SCALES[0], TIME_SCALES[-1]
        scale = number("time_scale", changes.pop("time_scale", self._time_scale), at_least=least, at_most=most)
        back = number("rewind", changes.pop("rewind", 0.0), at_least=0.0, at_most=KEPT)
        if "rewind" in parameters:
            self._show_past(self._past.bounds(self._segment.time)[1] - back)
        if changes:
            self._adopt(changes)
        self.hand.stiffness, self._time_scale = stiffness, scale

    def rewind(self, time: float, *, again: bool = False) -> None:
        """Go back to an earlier time, and go on from there.

        Up to a minute before now is kept, or since the last start, with every state: parameters are those of then.

        Args:
            time: Time of the session, as in a snapshot [s].
            again: True if the recorded hand acts again, up to now, before the live one; without a change of parameters
                the motion is then the same to the last bit.

        Raises:
            ParameterError: If that time is not kept.

        Example:
            >>> from maglev_mj import Session
            >>> session = Session("drop")
            >>> while session.snapshot().time < 0.399:
            ...     ticks = session.tick(0.005)
            >>> height = session.snapshot().pose[2]
            >>> session.rewind(0.1, again=True)
            >>> while session.snapshot().time < 0.399:
            ...     ticks = session.tick(0.005)
            >>> bool(session.snapshot().pose[2] == height)
            True
        """
        again = flag("again", again)
        least, most = self._past.bounds(self._segment.time)
        self._show_past(number("time", time, at_least=least, at_most=most))
        self._leave_past(again=again)

    def _show_past(self, time: float) -> None:
        """Show, paused, the scene of an earlier time [s], or of the earliest."""
        least, most = self._past.bounds(self._segment.time)
        self._segment = self._past.show(min(max(time, least), most), self._segment.time)
        self._scene, self._since = self._segment.scene, self._ticks
        self._paused, self._changed, self._stopped, self._steps = True, False, "", 0

    def _leave_past(self, *, again: bool = False) -> None:
        """Go on from the time shown, by the live hand or the recorded one."""
        rows, end = self._past.leave(self._segment.time)
        self._paused = self._steps > 0
        self._acting = HandAgain(rows, end, lambda: self._segment.time, self._hand) if again else self._hand
        if self._scene == self._segment.scene:
            self._changed = False
            self._segment.begin(self._acting, self._recorder.file, self._ticks)
            self._past.keep(self._segment)  # with where this part begins
        else:
            self._go_on()

    def snapshot(self) -> Snapshot:
        """Return the snapshot of now."""
        segment, target = self._segment, self.hand.goal
        return Snapshot(
            scene=self._scene,
            since=self._since,
            delay=self._scene.delay,
            tick=self._ticks,
            time=segment.time,
            pose=segment.pose,
            force=segment.rendered,
            hand=np.array(segment.plant.hand_wrench),
            stops=segment.plant.stop_wrench,
            target=None if isinstance(target, Trajectory) else target,
            hand_stiffness=self.hand.stiffness,
            currents=segment.plant.currents,
            faces=segment.controller.faces,
            anchors=segment.controller.stick_positions,
            history=self._past.history.last(SHOWN),
            work=segment.energy.hand,
            taken=segment.energy.taken,
            rewound=self._past.bounds(segment.time)[1] - segment.time,
            first=self._past.first,
            pulses=self._pulses,
            cost=self._pacer.cost,
            missed=self._pacer.missed,
            late=self._pacer.late,
            time_scale=self._time_scale,
            actions=self.actions,
            state="stopped" if self._stopped else "paused" if self._paused else "running",
            reason=self._stopped,
            notes=[*self._recorder.notes, *self._publishers.notes],
        )

    def close(self) -> None:
        """Close the recording, the publishers and the plant."""
        self._publishers.close()
        try:
            self._recorder.close()
        finally:
            self._segment.plant.close()

    def _stop(self, reason: str) -> None:
        """Stop until a change or a restart at the centre."""
        if self._stopped != reason:
            self._stopped = reason
            self._recorder.failed(reason)

    def _one(self) -> None:
        """Run one tick; stop an unstable scene."""
        self._take_wanted()
        self._segment.tick()
        self._ticks += 1
        self._pulses += self._segment.pulsed
        self.simulated += self._segment.scene.period
        if self._segment.energy.stored < _MADE:
            energy = -self._segment.energy.stored
            raise MaglevError(f"the rendered world made {energy * 1e3:.0f} mJ more than it took: it is unstable")
        if not self._segment.ticks % self._segment.every:
            self._past.keep(self._segment)

    def _take_wanted(self) -> None:
        """Apply the parameters that another program requests.

        Sample rate and delay stay the user's.
        """
        if (request := self._publishers.wanted()) is None:
            return
        try:
            scene = self._scene
            if self._stopped == EMERGENCY_STOP:  # the person goes on, no program
                raise ParameterError("settings must wait until the scene is started again: emergency stop")
            if type(request.scene) is not type(scene):
                raise ParameterError(f"settings must be those of {scene.name}, not of {request.scene.name}")
            if self._changed:  # the user's changes come first
                self._go_on()
            wanted = changed(scene, request.scene)
            if not self._stopped:  # otherwise it starts anew
                segment = self._segment
                check_step(segment.controller, wanted.controller(), segment.pose.tolist(), self._step_force)
        except MaglevError as error:
            request.reply(str(error))
            return
        self._scene = wanted
        self._go_on()
        request.reply(self._since)

    def _begin(self, pose: Sequence[float], *, going_on: bool = False) -> LiveSegment:
        """Return a new segment, at rest or continuing the last."""
        self._changed = False
        began, self._since, start = 0.0, self._ticks, self._scene.start()
        twist, wrench = start.twist, start.wrench
        if going_on:
            twist, wrench, began = self._segment.twist.tolist(), self._segment.force, self._segment.time
        segment = LiveSegment(
            self._scene,
            self._acting,
            pose=pose,
            twist=twist,
            wrench=wrench,
            file=self._recorder.file,
            began=began,
            first=self._since,
            keep=self._past.history.add,
        )
        self._past.keep(segment)
        return segment

    def _adopt(self, change: Mapping[str, Any] | str) -> None:
        """Change parameters from the next tick on.

        Raises:
            MaglevError: If its controller or its timing cannot be made.
        """
        with own_code_refused():
            scene = changed(self._scene, change, own=True, besides=("hand_stiffness", "time_scale", "rewind"))
            if scene == self._scene and not self._stopped:
                return
            scene.timing()
            scene.controller()
        self._scene = scene
        if self._stopped:
            self._go_on()
        else:
            self._changed = True

    def _pause(self, paused: bool) -> None:
        self._paused = paused

    def _step(self) -> None:
        """Run one tick while paused."""
        self._paused, self._steps = True, self._steps + 1

    def _scale(self, sense: str) -> None:
        self._time_scale = next_scale(self._time_scale, sense)

    def _choose(self, cls: type[Scene]) -> None:
        """Start another scene."""
        self._scene = cls()
        self._restart()

    def _choose_next(self) -> None:
        self._choose(self._scenes[(self._scenes.index(type(self._scene)) + 1) % len(self._scenes)])

    def _drop(self) -> None:
        """Let go of the flotor, with its weight, above the centre."""
        pose = self._scene.start().pose
        if "weightless" in settable(self._scene):
            self._scene = self._scene.replace(weightless=False)
        self._restart((*pose[:2], _LIFTED, *pose[3:]))

    def _centre(self) -> None:
        """Start again, with the default gravity compensation."""
        if "weightless" in settable(self._scene):
            self._scene = self._scene.replace(weightless=self._scene.parameter("weightless").default)
        self._restart()

    def _go_on(self) -> None:
        """Rebuild plant and controller in the present state, or restart."""
        if self._stopped:
            self._restart()
        elif not self._past.rewound:  # otherwise when it goes on
            self._segment = self._begin(self._segment.pose.tolist(), going_on=True)

    def _restart(self, pose: Sequence[float] | None = None) -> None:
        """Start the scene anew, at its own pose by default [m, rad]."""
        pose = self._scene.start().pose if pose is None else pose
        self._past.clear()
        self._acting = self._hand
        self._segment = self._begin(pose)
        self._stopped = ""
        self._pacer.forgive()

    def _record(self) -> None:
        """Start or end recording."""
        if self._recorder.file is None:
            self._recorder.start()
        else:
            self._recorder.stop()
        if not self._stopped:
            self._go_on()

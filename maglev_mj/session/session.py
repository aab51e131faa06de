"""Scene running in real time, with live parameters, recordings and named actions, independent of any viewer."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, check_instance, choice_message
from maglev_mj.keywords import checked
from maglev_mj.parameters import flag, number
from maglev_mj.plants.hand import HandForce, SpringHand, Trajectory
from maglev_mj.recording import RecordingError, RecordingFile, open_recording
from maglev_mj.recording.journal import SUFFIX
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.find import SceneLike, get_scene
from maglev_mj.scenes.stability_check import STEP_FORCE, check_step, user_errors_rejected
from maglev_mj.session.actions import EMERGENCY_STOP, SCENE_PREFIX, actions, changed, settable_parameters
from maglev_mj.session.pacing import TIME_SCALES, Note, Pacer, next_scale
from maglev_mj.session.segment import MAX_REWIND, LiveSegment, RepeatedHand, RewindBuffer
from maglev_mj.session.snapshot import SHOWN, Publisher, Publishers, Snapshot


class SessionRecorder:
    """Recordings of a session.

    Args:
        folder: Folder of the files.

    Attributes:
        written: Paths of the closed recordings.
        file: Open recording, or None.
    """

    def __init__(self, folder: Path) -> None:
        self.written: list[Path] = []
        self.file: RecordingFile | None = None
        self._folder, self._failed, self._missed = folder, "", 0
        self._note = Note()
        self._closing: list[threading.Thread] = []
        self._errors: list[str] = []
        self._used_paths: set[Path] = set()

    def start(self, path: Path | None = None) -> None:
        """Start a recording.

        Args:
            path: Path of the file; None for a new name in the folder, or in the temporary folder if the folder is not
                writable.

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
        """Stop the recording; its file is closed in another thread."""
        if self.file is None:
            return
        file, self.file = self.file, None
        self._note.say("writing the recording")
        self._closing.append(threading.Thread(target=self._close, args=(file,)))
        self._closing[-1].start()

    def close(self) -> None:
        """Stop the recording and wait until all files are closed.

        Raises:
            RecordingError: If a file is incomplete.
        """
        self.stop()
        for thread in self._closing:
            thread.join()
        if self._errors:
            raise RecordingError("; ".join(self._errors))

    def _close(self, file: RecordingFile) -> None:
        """Close a file and report the result."""
        try:
            path = file.close()
        except RecordingError as error:  # the part before the error is on the disk
            self._errors.append(str(error))
            self._failed = f"RECORDING: {error}"
            return
        self._note.say(f"wrote {path}" if path is not None else "nothing recorded: no samples")
        if path is not None:
            self.written.append(path)

    def failed(self, reason: str) -> None:
        """Record why the scene stopped."""
        if self.file is not None:
            self.file.event("fault", reason)

    def missed(self, count: int) -> None:
        """Set the total number of skipped ticks, and record new ones."""
        added, self._missed = count - self._missed, count
        if added and self.file is not None:
            self.file.event("missed", f"{added} ticks skipped: slower than real time", added)

    @property
    def notes(self) -> list[str]:
        """Status of the recording for the viewer; messages of success expire after some seconds."""
        notes = [*filter(None, [self._failed]), *self._note.lines]
        if self.file is None:
            return notes
        try:
            self.file.check()
        except RecordingError as error:
            return [*notes, f"NOT RECORDING: {error}"]
        return [*notes, "RECORDING"]

    def _new_path(self, folder: Path) -> Path:
        """Return an unused path for a recording."""
        stem = datetime.now().strftime("maglev-%Y%m%d-%H%M%S")
        path, count = folder / f"{stem}{SUFFIX}", 1
        while path in self._used_paths or path.exists():
            path, count = folder / f"{stem}-{count}{SUFFIX}", count + 1
        self._used_paths.add(path)
        return path


def device_controller(scene: Scene, weight: ArrayLike | None = None) -> Controller:
    """Return a scene's controller for a device, with its weight compensated unless the scene falls.

    Args:
        scene: The scene.
        weight: Wrench that compensates the weight [N, N m], (6,); None for that of the scene's device.
    """
    controller, load, own = scene.controller(), scene.body.load, scene.hardware.body
    missing = load - (own.mass * np.append(own.gravity, np.zeros(3)) if weight is None else -np.asarray(weight))
    if not missing.any() or (load.any() and not np.allclose(controller.carried, -load)):
        return controller
    return Controller([*controller.laws, Bias(missing)], period=scene.period, velocity=scene.velocity_estimator())


_DROP_HEIGHT = 0.004  # of the published joystick [m]
_ENERGY_LIMIT = -0.1  # stored energy below which the scene is stopped [J]
_REWIND_STEP = 1.0  # by a key [s]
_CHANGE_INTERVAL = 0.1
"""Shortest real time between two changes of parameters [s]."""


@checked(own="hand_force scene")
class Session:
    """Scene running in real time, with live parameters.

    A change rebuilds plant and controller at the current pose and speed, so that each segment between two changes is a
    complete run that can be recorded and replayed.

    Args:
        scene: The first scene, or a text for `find_scene`; by default the joystick.
        hand_force: The hand on the flotor; by default the mouse's.
        folder: Folder of recordings started by a key.
        record: File to record to from the start; None for no recording.
        pacer: Scheduler of the ticks in real time.
        publishers: Publishers to other programs; closed with the session.
        step_force: Largest force step by a change from another program [N]; see `check_step`.

    Attributes:
        simulated: Total simulated time [s].
        recordings: Paths of the recordings written so far.

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
        hand_force: HandForce | None = None,
        folder: Path = Path(),
        record: Path | None = None,
        pacer: Pacer | None = None,
        publishers: Sequence[Publisher] = (),
        step_force: float = STEP_FORCE,
    ) -> None:
        self._scene = get_scene("joystick" if scene is None else scene)
        self._hand = hand_force or SpringHand.of_mouse(device=self._scene.device)
        # the mouse moves only a spring
        self.hand = self._hand if isinstance(self._hand, SpringHand) else SpringHand.of_mouse(device=self._scene.device)
        self.simulated = 0.0
        self._pacer = pacer or Pacer()
        cls = type(self._scene)
        self._scenes = [find_scene(name) for name in BUILT_IN]
        if cls not in self._scenes:
            self._scenes.insert(0, cls)
        self._past, self._acting = RewindBuffer(), self._hand
        self._recorder = SessionRecorder(folder)
        self.recordings: Sequence[Path] = self._recorder.written
        if record is not None:
            self._recorder.start(record)
        self._paused, self._stopped, self._steps = False, "", 0
        self._time_scale = 1.0
        self._changed, self._unchanged = False, _CHANGE_INTERVAL
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
            hold = not self._steps and self._unchanged < _CHANGE_INTERVAL
            if self._past.rewound:
                if not self._stopped and (self._steps or not self._paused):
                    self._leave_past()
            elif self._changed and not (hold or self._stopped):
                self._unchanged = 0.0
                self._rebuild()
            if self._paused or self._stopped:
                self._pacer.clear_backlog()
                self._apply_request()
                while self._steps and not self._stopped:
                    self._steps -= 1
                    self._run_tick()
            else:
                self._pacer.advance(elapsed * self._time_scale, self._segment.scene.period, self._run_tick)
        except MaglevError as error:
            self._stop(str(error))
        ticks, self._steps = self._ticks - before, 0
        self._recorder.missed(self._pacer.missed)
        self._publishers.show(self.snapshot)
        return ticks

    @property
    def actions(self) -> Sequence[str]:
        """Names of the actions of the current scene."""
        return tuple(self._functions())

    def act(self, action: str) -> None:
        """Perform one of `actions`.

        Raises:
            ParameterError: If there is no such action.
        """
        functions = self._functions()
        if action not in functions:
            raise ParameterError(choice_message("action", tuple(functions), action))
        functions[action]()

    def _functions(self) -> dict[str, Callable[[], object]]:
        """Return the function of each action; the scene's actions override the session's."""
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
            "rewind": lambda: self._show_past(self._segment.time - _REWIND_STEP),
            "resume from here": partial(self._pause, False),
            "repeat the hand's motion": partial(self._leave_past, again=True),
            EMERGENCY_STOP: partial(self._stop, EMERGENCY_STOP),
        }
        choices = {f"{SCENE_PREFIX}{cls.name}": partial(self._choose, cls) for cls in self._scenes}
        return of_scene | of_session | choices | of_scene

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change live parameters of the scene, period and delay included, or of the session.

        They take effect at the next tick, but at most every 0.1 s: of several changes in between, the newest applies.

        Args:
            parameters: Values by name. Those of the session are `time_scale` (simulated over real time, 0.001 to 1),
                `hand_stiffness` [N/m] and `rewind` [s]: pause, and show the scene this long before the newest sample,
                with its parameters at that time (0 to 60; clamped to the available time).

        Raises:
            ParameterError: If a live parameter is unknown, or the scene refuses a value; then nothing changes.
        """
        check_instance("parameters", parameters, Mapping, "values by name")
        changes = dict(parameters)
        stiffness = number("hand_stiffness", changes.pop("hand_stiffness", self.hand.stiffness), at_least=0.0)
        lowest, highest = TIME_SCALES[0], TIME_SCALES[-1]
        scale = number("time_scale", changes.pop("time_scale", self._time_scale), at_least=lowest, at_most=highest)
        back = number("rewind", changes.pop("rewind", 0.0), at_least=0.0, at_most=MAX_REWIND)
        if "rewind" in parameters:
            self._show_past(self._past.bounds(self._segment.time)[1] - back)
        if changes:
            self._adopt(changes)
        self.hand.stiffness, self._time_scale = stiffness, scale

    def rewind(self, time: float, *, again: bool = False) -> None:
        """Rewind to an earlier time and resume from there, with all states and parameters of that time.

        The last minute is available, at most since the scene was last started.

        Args:
            time: Session time, as in a snapshot [s].
            again: True if the recorded hand acts up to the present time, then the live one; with unchanged parameters
                the motion is bitwise the same.

        Raises:
            ParameterError: If that time is not available.

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
        earliest, newest = self._past.bounds(self._segment.time)
        self._show_past(number("time", time, at_least=earliest, at_most=newest))
        self._leave_past(again=again)

    def _show_past(self, time: float) -> None:
        """Pause, and show the scene at an earlier time [s], clamped to the available range."""
        earliest, newest = self._past.bounds(self._segment.time)
        self._segment = self._past.show(min(max(time, earliest), newest), self._segment.time)
        self._scene, self._since = self._segment.scene, self._ticks
        self._paused, self._changed, self._stopped, self._steps = True, False, "", 0

    def _leave_past(self, *, again: bool = False) -> None:
        """Resume from the time shown, with the live or the recorded hand."""
        rows, end = self._past.leave(self._segment.time)
        self._paused = self._steps > 0
        self._acting = RepeatedHand(rows, end, lambda: self._segment.time, self._hand) if again else self._hand
        if self._scene == self._segment.scene:
            self._changed = False
            self._segment.begin(self._acting, self._recorder.file, self._ticks)
            self._past.keep(self._segment)  # includes the start of the resumed part
        else:
            self._rebuild()

    def snapshot(self) -> Snapshot:
        """Return the current snapshot."""
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
            hand_limit=getattr(self._acting, "force_limit", np.inf),
            stops=segment.plant.stop_wrench,
            target=None if isinstance(target, Trajectory) else target,
            hand_stiffness=self.hand.stiffness,
            currents=np.zeros(6) if segment.plant.device.coils is None else segment.plant.currents,
            faces=segment.controller.faces,
            anchors=segment.controller.stick_positions,
            beside=segment.scene.beside_poses(segment.controller.states),
            history=self._past.history.last(SHOWN),
            work=segment.energy.hand,
            taken=segment.energy.taken,
            rewound=self._past.bounds(segment.time)[1] - segment.time,
            first=self._past.first,
            pulses=self._pulses,
            cost=self._pacer.cost,
            missed=self._pacer.missed,
            overloaded=self._pacer.overloaded,
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
        """Stop until a change of parameters or a restart."""
        if self._stopped != reason:
            self._stopped = reason
            self._recorder.failed(reason)

    def _run_tick(self) -> None:
        """Run one tick; raise MaglevError if the scene is unstable."""
        self._apply_request()
        self._segment.tick()
        self._ticks += 1
        self._pulses += self._segment.pulsed
        self.simulated += self._segment.scene.period
        if self._segment.energy.stored < _ENERGY_LIMIT:
            source = "wall" if self._segment.controller.faces else "laws"
            raise MaglevError(f"unstable: the {source} generated {-self._segment.energy.stored * 1e3:.0f} mJ")
        if not self._segment.ticks % self._segment.every:
            self._past.keep(self._segment)

    def _apply_request(self) -> None:
        """Apply the parameters requested by another program, except sample period and delay."""
        if (request := self._publishers.wanted()) is None:
            return
        try:
            scene = self._scene
            if self._stopped == EMERGENCY_STOP:  # only the user may restart
                raise ParameterError("settings are refused after an emergency stop, until the user restarts the scene")
            if type(request.scene) is not type(scene):
                raise ParameterError(f"settings must be of scene {scene.name} (got {request.scene.name})")
            if self._changed:  # apply the user's changes first
                self._rebuild()
            requested = changed(scene, request.scene)
            if not self._stopped:  # otherwise it restarts from its initial pose
                segment = self._segment
                check_step(segment.controller, requested.controller(), segment.pose.tolist(), self._step_force)
        except MaglevError as error:
            request.reply(str(error))
            return
        self._scene = requested
        self._rebuild()
        request.reply(self._since)

    def _begin(self, pose: Sequence[float], *, resume: bool = False) -> LiveSegment:
        """Return a new segment, from the scene's start or the current motion."""
        self._changed = False
        began, self._since, start = 0.0, self._ticks, self._scene.start()
        twist, wrench = start.twist, start.wrench
        if resume:
            twist, wrench, began = self._segment.twist.tolist(), self._segment.wrench.tolist(), self._segment.time
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
            MaglevError: If controller or timing cannot be constructed.
        """
        with user_errors_rejected():
            scene = changed(self._scene, change, own=True, besides=("hand_stiffness", "time_scale", "rewind"))
            if scene == self._scene and not self._stopped:
                return
            scene.timing()
            scene.controller()
        self._scene = scene
        if self._stopped:
            self._rebuild()
        else:
            self._changed = True

    def _pause(self, paused: bool) -> None:
        self._paused = paused

    def _step(self) -> None:
        """Run one tick while paused."""
        self._paused, self._steps = True, self._steps + 1

    def _scale(self, action: str) -> None:
        self._time_scale = next_scale(self._time_scale, action)

    def _choose(self, cls: type[Scene]) -> None:
        """Start another scene."""
        self._scene = cls()
        self._restart()

    def _choose_next(self) -> None:
        self._choose(self._scenes[(self._scenes.index(type(self._scene)) + 1) % len(self._scenes)])

    def _drop(self) -> None:
        """Restart above the centre without weight compensation."""
        pose = self._scene.start().pose
        if "weightless" in settable_parameters(self._scene):
            self._scene = self._scene.replace(weightless=False)
        self._restart((*pose[:2], _DROP_HEIGHT * float(self._scene.hardware.range_ratio[2]), *pose[3:]))

    def _centre(self) -> None:
        """Restart with the default weight compensation."""
        if "weightless" in settable_parameters(self._scene):
            self._scene = self._scene.replace(weightless=self._scene.parameter("weightless").default)
        self._restart()

    def _rebuild(self) -> None:
        """Rebuild plant and controller in the current state, or restart a stopped scene."""
        if self._stopped:
            self._restart()
        elif not self._past.rewound:  # otherwise when it resumes
            self._segment = self._begin(self._segment.pose.tolist(), resume=True)

    def _restart(self, pose: Sequence[float] | None = None) -> None:
        """Restart the scene at a pose [m, rad], by default its initial pose."""
        pose = self._scene.start().pose if pose is None else pose
        self._past.clear()
        self._acting = self._hand
        self._segment = self._begin(pose)
        self._stopped = ""
        self._pacer.clear_backlog()

    def _record(self) -> None:
        """Start or stop recording."""
        if self._recorder.file is None:
            self._recorder.start()
        else:
            self._recorder.stop()
        if not self._stopped:
            self._rebuild()

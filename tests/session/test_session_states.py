"""Promises of a session, whatever a person and a program do in whichever order."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from maglev_mj.recording import Recording
from maglev_mj.recording.verify import verify
from maglev_mj.recording.writer import JournalFile
from maglev_mj.scenes import BUILT_IN, Scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import EMERGENCY_STOP, TIME_SCALES, ChangeRequest, Pacer, Session, Snapshot
from maglev_mj.session.actions import actions
from maglev_mj.session.replay import rebuild

LIVELY = st.sampled_from([0.005, 0.02, 0.06])
SLIDERS = st.fixed_dictionaries(
    {},
    optional={
        "stiffness": st.sampled_from([2000.0, 3000.0, 4500.0]),
        "damping": st.sampled_from([40.0, 60.0]),
        "friction": st.booleans(),
        "wall": st.booleans(),
        "period": st.sampled_from([0.005, 0.004]),
        "delay": st.sampled_from([0.0, 0.0015]),
    },
)
KEYS = st.sampled_from(["wall", "pulse", "friction", "stiffness down", "damping up", "rate up", "delay down"])


class Program:
    """Program that asks for a scene once, and keeps what it is told."""

    def __init__(self) -> None:
        self.wanted: Scene | None = None
        self.answers: list[int | str] = []

    def take(self) -> ChangeRequest | None:
        """Return the request, once."""
        scene, self.wanted = self.wanted, None
        return None if scene is None else ChangeRequest(scene, self.answers.append)

    def show(self, snapshot: Snapshot) -> None:
        """Ignore a snapshot."""

    def close(self) -> None:
        """Do nothing."""


class Noted(JournalFile):
    """Journal that keeps its events."""

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        super().__init__(path, wait=wait)
        self.events = list[str]()

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """See `RecordingFile`."""
        self.events.append(f"{kind}: {text}")
        super().event(kind, text, missed)


class SessionStates(RuleBasedStateMachine):
    """A session beside a model of what it promises."""

    @initialize()
    def begin(self) -> None:
        """Start a session that no slow machine can make late."""
        self.folder = tempfile.TemporaryDirectory()
        self.opened = patch("maglev_mj.session.session.open_recording", self.opened_file)
        self.opened.start()
        self.files, self.program = list[Noted](), Program()
        self.session = Session(
            Joystick(),
            folder=Path(self.folder.name),
            pacer=Pacer(budget=60.0, patience=3600.0),
            publishers=[self.program],
            record=Path(self.folder.name, "first"),
        )
        self.scene: Scene = Joystick()
        self.stopped, self.paused, self.steps = "", False, 0
        self.ticks, self.due, self.scale = 0, 0.0, 1.0
        self.recording, self.recorded, self.emergencies = True, 0, 0

    def opened_file(self, path: Path) -> Noted:
        """Open a recording whose events are noted, also without a sample."""
        self.files.append(Noted(path, wait=True))
        return self.files[-1]

    def restarted(self, scene: Scene) -> None:
        """Note that a scene has started anew."""
        self.scene, self.stopped, self.due = scene, "", self.session.simulated

    @rule(elapsed=LIVELY)
    def tick(self, elapsed: float) -> None:
        """Let real time pass: no tick is lost, none is made where there must be none."""
        steps, self.steps = self.steps, 0
        before = self.session.snapshot()
        made = self.session.tick(elapsed)
        after = self.session.snapshot()
        self.ticks += made
        self.recorded += made if self.recording else 0
        if after.reason and not self.stopped:  # an unstable scene stops by itself
            assert after.reason.startswith("unstable: ")
            self.stopped = after.reason
        elif self.stopped:
            assert made == 0 and (after.pose == before.pose).all()
        elif self.paused:
            assert made == steps
            self.due = self.session.simulated
        else:
            self.due += elapsed * self.scale
            assert -1e-9 <= self.due - self.session.simulated <= max(0.005, self.scene.period) + 1e-9

    @precondition(lambda self: not self.stopped and not self.paused)
    @rule()
    def rest(self) -> None:
        """Let the time pass after which the last value is in force."""
        for _ in range(2):
            self.tick(0.11)
        if not self.stopped:
            assert self.session._segment.scene == self.scene

    @rule(x=st.sampled_from([-2e-3, 0.0, 3e-3, 8e-3]), held=st.booleans())
    def move_hand(self, x: float, held: bool) -> None:
        """Move the hand, or release the flotor."""
        self.session.hand.target = [x, 0.0, 0.0, 0.0, 0.0, 0.0] if held else None

    @rule(values=SLIDERS)
    def slide(self, values: dict[str, Any]) -> None:
        """Move sliders: the newest values are shown at once, and the flotor does not jump."""
        live = {one.name for one in self.scene.parameters() if one.live}
        values = {name: value for name, value in values.items() if name in live}
        self.change(self.scene.replace(**values), lambda: self.session.change(values))

    @rule(key=KEYS)
    def press_key(self, key: str) -> None:
        """Press the key of a parameter, where the scene has it."""
        own = actions(type(self.scene))
        if key in own:
            self.change(own[key](self.scene), lambda: self.session.act(key))

    def change(self, scene: Scene, task: Any) -> None:
        """Change parameters, and compare with the scene that should be shown."""
        before = self.session.snapshot()
        task()
        after = self.session.snapshot()
        assert after.scene == scene
        if self.stopped and (scene != self.scene or after.state != "stopped"):
            self.restarted(scene)
        elif not self.stopped:
            assert (after.pose == before.pose).all() and after.time == before.time
        self.scene = scene

    @rule(action=st.sampled_from(["pause", "step", "slower", "faster"]))
    def press_button(self, action: str) -> None:
        """Pause, step or change the pace, which starts nothing that was stopped."""
        self.session.act(action)
        if action == "pause":
            self.paused = not self.paused
        elif action == "step":
            self.paused, self.steps = True, self.steps + 1
        else:
            place = TIME_SCALES.index(self.scale) + (1 if action == "faster" else -1)
            self.scale = TIME_SCALES[min(max(place, 0), len(TIME_SCALES) - 1)]

    @rule(back=st.sampled_from([0.0, 0.03, 0.4]), again=st.booleans())
    def rewind(self, back: float, again: bool) -> None:
        """Go back, which pauses, to the scene of then; let the hand act again."""
        before = self.session.snapshot()
        self.session.change({"rewind": back})
        shown = self.session.snapshot()
        assert before.time - back - shown.scene.period <= shown.time + (before.rewound or 0.0) or not shown.time
        self.scene, self.stopped, self.steps, self.paused = shown.scene, "", 0, True
        self.due = self.session.simulated
        if again:
            self.session.act("repeat the hand's motion")
            self.paused = False

    @rule(action=st.sampled_from(["centre", "drop", "next scene", *(f"scene {name}" for name in BUILT_IN)]))
    def start(self, action: str) -> None:
        """Start this scene or another one, which ends every stop."""
        names = list(BUILT_IN)
        expected = {"next scene": names[(names.index(self.scene.name) + 1) % len(names)]}
        self.session.act(action)
        scene = self.session.snapshot().scene
        assert scene.name == expected.get(action, action.removeprefix("scene ") if " " in action else self.scene.name)
        if action in ("centre", "drop") and "weightless" in scene.as_json():
            assert scene.as_json()["weightless"] is (action == "centre")
        assert self.session.snapshot().time == 0.0
        self.restarted(scene)

    @rule()
    def stop(self) -> None:
        """Press the emergency stop, which is recorded once however often it is pressed."""
        self.emergencies += self.recording and self.stopped != EMERGENCY_STOP
        self.session.act(EMERGENCY_STOP)
        self.stopped = EMERGENCY_STOP

    @rule()
    def record(self) -> None:
        """Start or end a recording."""
        self.session.act("record")
        self.recording = not self.recording

    @rule(stiffness=st.sampled_from([2500.0, 3500.0]))
    def ask(self, stiffness: float) -> None:
        """Let a program ask for a value, which ends no emergency stop and sets no rate."""
        if "stiffness" not in self.scene.as_json():
            return
        self.program.wanted = self.scene.replace(stiffness=stiffness, period=0.001, delay=0.003)
        told = len(self.program.answers)
        self.tick(0.05)
        if len(self.program.answers) == told:  # nothing runs that could take it, or not yet
            self.program.wanted = None
            return
        answer = self.program.answers[-1]
        if isinstance(answer, int):
            self.scene = self.scene.replace(stiffness=stiffness)
            if self.stopped and self.session.snapshot().state != "stopped":
                self.restarted(self.scene)
        elif self.stopped == EMERGENCY_STOP:
            assert answer == "settings are refused after an emergency stop, until the user restarts the scene"

    @invariant()
    def is_as_it_should_be(self) -> None:
        """Compare what the session shows with the model."""
        shown = self.session.snapshot()
        assert shown.scene == self.scene and shown.tick == self.ticks and shown.time_scale == self.scale
        assert shown.state == ("stopped" if self.stopped else "paused" if self.paused else "running")
        assert shown.reason == self.stopped
        assert ("RECORDING" in shown.notes) == self.recording

    def teardown(self) -> None:
        """Close the session: every recorded tick is in its files, and runs again bit for bit."""
        if not hasattr(self, "session"):
            return
        self.session.close()
        self.opened.stop()
        told = [event for file in self.files for event in file.events if event.endswith(EMERGENCY_STOP)]
        assert len(told) == self.emergencies
        files = [Recording.load(path) for path in self.session.recordings]
        assert sum(file.ticks for file in files) == self.recorded
        for file in files:
            for segment in file.segments:
                if isinstance(segment.setup["plant"], dict):  # after a rewind it begins in the middle of a run
                    assert verify(replace(file, segments=[segment]), rebuild).same
        self.folder.cleanup()
        assert np.isfinite(self.session.snapshot().pose).all()


SETTINGS = settings(
    max_examples=3,
    stateful_step_count=30,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestSessionStates = SessionStates.TestCase
TestSessionStates.settings = SETTINGS


@pytest.mark.study
class TestMoreSessionStates(SessionStates.TestCase):  # type: ignore[valid-type, misc]
    """The same over more examples."""

    settings = settings(SETTINGS, max_examples=40)

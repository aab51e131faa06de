"""Sessions without a window: pacing, actions, energy, recording."""

from collections.abc import Callable
from itertools import combinations, product
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES, Controller, cli
from maglev_mj.control import Hold, Law, StickSlip, Wall
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import param
from maglev_mj.plants import MuJoCoPlant, Timing
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.trace import EnergyAccount
from maglev_mj.recording import Recording
from maglev_mj.recording.verify import verify
from maglev_mj.recording.writer import JournalFile
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Joystick, wall
from maglev_mj.scenes.press import Press
from maglev_mj.session import (
    Pacer,
    Session,
    Snapshot,
    live_plant,
    real_time,
    settable_parameters,
)
from maglev_mj.session.actions import actions
from maglev_mj.session.margin import STABILITY
from maglev_mj.session.replay import rebuild
from maglev_mj.spec import RANGE, Spec
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.views.readings import readings
from maglev_mj.views.viewer_process import RemoteViewer
from tests.published import INERTIA
from tests.session.test_session_states import Program

FRAME = 1.0 / 60.0


class Clock:
    """Clock that advances only by the cost of ticks."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def paced(cost: float, frames: int, *, period: float = 0.005, elapsed: float = FRAME, **limits: float) -> Any:
    """Return a used pacer and its ticks per frame."""
    clock = Clock()
    pacer = Pacer(clock=clock, **limits)

    def tick() -> None:
        clock.now += cost

    return pacer, [pacer.advance(elapsed, period, tick) for _ in range(frames)]


@pytest.mark.parametrize("period", [0.005, 0.0005])
def test_a_machine_that_keeps_up_misses_no_tick(period: float) -> None:
    pacer, made = paced(1e-5, 1200, period=period)
    assert abs(sum(made) - 1200 * FRAME / period) <= 1.0
    assert max(made) - min(made) <= 1
    assert (pacer.missed, pacer.overloaded) == (0, False)
    assert pacer.cost == pytest.approx(1e-5)


def test_a_stall_is_caught_up_frame_by_frame_within_the_budget() -> None:
    clock, made = Clock(), []
    pacer = Pacer(clock=clock, budget=0.012, patience=0.5)

    def tick() -> None:
        clock.now += 0.001

    for elapsed in (FRAME, 0.4, *[FRAME] * 20):
        start = clock.now
        made.append(pacer.advance(elapsed, 0.005, tick))
        assert clock.now - start <= 0.012 + 0.001
    assert made[1] == 12  # the budget, though 80 are due
    assert abs(sum(made) - (0.4 + 21 * FRAME) / 0.005) <= 1.0
    assert pacer.missed == 0


def test_a_machine_that_cannot_keep_up_slows_down_and_says_so() -> None:
    pacer, made = paced(0.010, 600)  # two ticks fill the budget, three and a third are due
    assert set(made[60:]) == {2}
    assert pacer.overloaded
    due = 600 * FRAME / 0.005
    assert sum(made) + pacer.missed == pytest.approx(due - 0.5 / 0.005, abs=2.0)
    assert pacer.backlog <= 0.5 + 0.005


def test_what_is_forgiven_is_not_caught_up() -> None:
    pacer, _ = paced(0.010, 10)
    assert pacer.backlog > 0.05
    pacer.clear_backlog()
    assert pacer.advance(0.0, 0.005, lambda: None) == 0


def test_real_time_ends_when_it_is_over_and_forgets_a_suspension(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()

    def sleep(step: float) -> None:
        clock.now += 30.0 if 0.1 < clock.now < 0.2 else step

    monkeypatch.setattr("time.sleep", sleep)
    turns = list(real_time(31.0, 0.02, clock))
    assert max(elapsed for elapsed, _ in turns) == 1.0  # of the 30 s, one
    assert turns[0] == (0.0, 0.0) and turns[-1][1] == pytest.approx(31.0, abs=0.03)
    assert len(turns) == pytest.approx(1.0 / 0.02, abs=4)


def after(session: Session, seconds: float) -> Session:
    """Let a session go on."""
    for _ in range(round(seconds / FRAME)):
        session.tick(FRAME)
    return session


def made(scene: str | Scene = "joystick", **options: Any) -> Session:
    """Return a session that no slow machine can make late."""
    scene = find_scene(scene)() if isinstance(scene, str) else scene
    return Session(scene, pacer=Pacer(budget=60.0, patience=3600.0), **options)


def stored_at_start(scene: Scene) -> float:
    """Return the initial energy in a scene's springs [J]."""
    springs = [law for law in scene.laws() if isinstance(law, Hold)]
    away = [
        np.asarray(law.target) - np.array(scene.start().pose)[[AXES.index(axis) for axis in law.axes]]
        for law in springs
    ]
    return sum(float((0.5 * np.asarray(law.stiffness) * way**2).sum()) for law, way in zip(springs, away, strict=True))


SHOWN = ("drop", "press", "corner")  # a fall, an arm that moves along, a spring that is drawn
SCENES = [
    pytest.param(name, period, marks=[] if name in SHOWN and period == 0.005 else pytest.mark.study)
    for name in BUILT_IN
    for period in (0.005, 0.001)
]


@pytest.mark.parametrize(("name", "period"), SCENES)
def test_every_scene_runs_in_its_scripted_hand_and_takes_energy(name: str, period: float) -> None:
    scene = find_scene(name)(period=period, delay=min(0.0015, 0.5 * period))
    hand = scene.scripted_hand()
    session = after(made(scene, hand_force=hand), scene.end + 0.6)
    view = session.snapshot()
    assert not view.notes
    assert view.taken > -stored_at_start(scene) - 1e-4
    assert np.abs(view.pose[:3]).max() < 0.0046
    if hand is not None:
        assert abs(view.work) > 1e-4


def of_scene(**values: Any) -> Callable[[Snapshot, Snapshot], bool]:
    """Return the check that an action gives the joystick these parameters, and changes nothing else."""
    return lambda before, after: (after.scene, after.time) == (Joystick().replace(**values), before.time)


def of_session(**values: Any) -> Callable[[Snapshot, Snapshot], bool]:
    """Return the check that an action gives a snapshot these values, and no other scene."""
    return lambda before, after: (
        after.scene == before.scene and all(getattr(after, name) == value for name, value in values.items())
    )


def starts(name: str) -> Callable[[Snapshot, Snapshot], bool]:
    """Return the check that an action starts a scene."""
    return lambda before, after: (after.scene.name, after.time) == (name, 0.0)


ACTS: dict[str, Callable[[Snapshot, Snapshot], bool]] = {
    "rate up": lambda before, after: after.scene.period < before.scene.period,
    "rate down": lambda before, after: after.scene.period > before.scene.period,
    "delay up": lambda before, after: after.scene.delay > before.scene.delay,
    "delay down": lambda before, after: after.scene.delay < before.scene.delay,
    "wall": of_scene(wall=False),
    "wall on": of_scene(wall_on="device"),
    "pulse": of_scene(pulse=False),
    "friction": of_scene(friction=True),
    "stiffness up": lambda before, after: after.scene.as_json()["stiffness"] > 6000.0,
    "stiffness down": lambda before, after: after.scene.as_json()["stiffness"] < 6000.0,
    "damping": of_scene(damping=0.0),
    "damping up": lambda before, after: after.scene.as_json()["damping"] > 80.0,
    "damping down": lambda before, after: after.scene.as_json()["damping"] < 80.0,
    "next scene": starts("drop"),
    "drop": lambda before, after: after.time == 0.0 and after.pose.tolist() == [0.0, 0.0, 0.004, 0.0, 0.0, 0.0],
    "centre": lambda before, after: after.time == 0.0 and not after.pose.any(),
    "pause": of_session(state="paused", tick=40),
    "step": of_session(state="paused", tick=41),
    "slower": of_session(time_scale=0.2),
    "faster": of_session(time_scale=1.0),
    "record": of_session(notes=["RECORDING"]),
    "rewind": of_session(state="paused", rewound=1.0),
    "resume from here": of_session(state="running", rewound=0.0, tick=41),
    "emergency stop": of_session(state="stopped", reason="emergency stop"),
    **{f"scene {name}": starts(name) for name in BUILT_IN},
}
"""Whether an action did its task by the snapshots before and after it, by name; of a joystick after 0.2 s."""


def test_every_action_does_its_task(tmp_path: Path) -> None:
    for action, done in ACTS.items():
        session = after(made(folder=tmp_path), 1.2 if "rewind" in action else 0.2)
        session.change({"time_scale": 0.5})
        if action == "resume from here":
            session.act("pause")
        before = session.snapshot()
        session.act(action)
        if action in ("step", "resume from here"):
            session.tick(0.01)
        assert done(before, session.snapshot()), action
        session.close()


def test_the_same_hand_acts_again_after_a_rewind_and_no_action_is_unknown() -> None:
    session = after(made(), 1.2)
    assert {*session.actions} == {*ACTS, "repeat the hand's motion"}
    with pytest.raises(ParameterError, match=r"one of rate up, .* emergency stop, .*, scene press, .*\(got 'jump'\)"):
        session.act("jump")
    session.act("rewind")
    session.act("repeat the hand's motion")
    assert session.snapshot().state == "running" and session.snapshot().time == pytest.approx(0.2)


def test_walls_move_to_the_device_and_back_under_the_mouse() -> None:
    stiff = Joystick(stiffness=60e3, damping=200.0)
    for scene, words in ((stiff, "unstable on x"), (stiff.replace(wall_on="device"), "stable: 29 % of critical")):
        assert words in STABILITY.of(made(scene).snapshot(), wait=True).words
    session = made()
    session.hand.target = [0.016, 0.0, 0.0, 0.0, 0.0, 0.0]
    after(session, 0.6)
    for place in ("device", "host", "device"):
        session.act("wall on")
        depth, moved = session.snapshot().pose[0], []
        for _ in range(40):
            session.tick(0.005)
            moved.append(session.snapshot().pose[0] - depth)
        view, intervals = session.snapshot(), len(session._segment.plant._last_intervals)
        # rendered every millisecond or every period, without a bump; the force shown includes the walls
        assert view.scene.as_json()["wall_on"] == place and (intervals >= 5) is (place == "device")
        assert np.abs(moved).max() < 1e-5 and view.hand[0] > 2.0
        assert view.force == pytest.approx(-view.hand, abs=0.02)
        assert ("wall on device" in {row.name: row.value for row in readings(view)}["active"]) is (place == "device")
    session.rewind(view.time - 0.2, again=True)
    assert np.array_equal(after(session, 0.2).snapshot().pose, view.pose)


class Stepper(Joystick):
    """Joystick with a number of the name of a session's action, as a scene of a user's own may have."""

    step: bool = param("steps", default=False, live=True)


def test_an_action_of_a_scene_comes_before_one_of_the_session_of_its_name() -> None:
    session = made(Stepper())
    assert len({*session.actions}) == len(session.actions)
    session.act("step")
    assert session.snapshot().scene.as_json()["step"] and session.snapshot().state == "running"


def test_drop_lets_go_with_its_weight_and_centre_undoes_it() -> None:
    session = made("box")
    session.act("drop")
    assert session.snapshot().pose[2] == 0.004
    after(session, 1.0)
    view = session.snapshot()
    assert view.pose[2] == pytest.approx(-0.003 - INERTIA[0] * 9.81 / 6000.0, abs=1e-5)
    session.act("centre")
    assert session.snapshot().scene.as_json()["weightless"]
    assert not session.snapshot().pose.any()


@pytest.mark.parametrize(("share", "stops"), [(0.8, False), (1.5, True)])
def test_a_wall_that_is_unstable_is_stopped_and_restored_by_one_key(share: float, stops: bool) -> None:
    # Beside the boundary that the closed loop's eigenvalues give, at the press that keeps the flotor in the wall.
    limit = float(largest_stable_stiffness(87.0, period=0.005, delay=0.0015))
    session = after(made(Drop(pulse=0.0, stiffness=share * limit, damping=87.0)), 8.0 if stops else 1.0)
    note = session.snapshot().reason
    assert note.startswith("unstable: the wall generated ") == stops
    assert (session.tick(1.0) == 0) == stops
    session.act("centre")
    assert session.snapshot().state == "running"
    assert session.tick(FRAME) > 0


def test_work_is_metered_whatever_else_pushes() -> None:
    # Work of the actuators, of the hand and of weight against kinetic energy, on all six axes.
    plant = MuJoCoPlant(
        Timing(period=0.004, delay=0.0013),
        metered=True,
        twist=[0.05, -0.03, 0.02, 0.3, -0.2, 0.4],
        hand_force=lambda *_: [0.5, 0.2, 4.0, 1e-3, -2e-3, 1e-3],
    )
    model_inertia = plant.device.inertia
    laws: list[Law] = [
        Wall(axes=("x", "z"), lower=-0.001, upper=0.001, stiffness=3000.0, damping=20.0, pulse=60.0, pulse_width=0.002),
        Hold(axes=("y", "rx", "ry", "rz"), stiffness=[300.0, 0.4, 0.4, 0.4], damping=[5.0, 0.01, 0.01, 0.01]),
    ]
    controller = Controller(laws, period=0.004)
    pose, start = plant.state()
    account = EnergyAccount(pose, [0.0] * 6)
    inertia = np.array([plant.device.mass] * 3 + model_inertia.tolist())
    for _ in range(100):
        ControlLoop(plant, controller).cycle()
        pose, twist = plant.state()
        account.add(pose, plant.hand_wrench, plant.work)
    kinetic = 0.5 * float(inertia @ (twist**2 - start**2))
    weight = -plant.device.mass * 9.81 * pose[2]
    assert account.taken == pytest.approx(account.hand + weight - kinetic, abs=2e-6)
    assert abs(account.taken) > 1e-3


FAR = {"target": [0.06] * 3 + [0.6] * 3, "device_target": [3.0 * reach for reach in RANGE]}
"""A drag over the whole screen, and a full deflection of an input device [m, rad]."""


@pytest.mark.parametrize("slot", FAR)
@pytest.mark.parametrize(("name", "count"), [*product(BUILT_IN, (1,)), *product(("joystick", "box"), (2, 3))])
def test_no_drag_towards_walls_reaches_a_stop(name: str, count: int, slot: str) -> None:
    # Straight into each wall and along the diagonals of translations or rotations; at once, and back to the opposite.
    faces = find_scene(name)().controller().faces
    for walls in combinations(faces, count):
        axes = [axis for axis, _, _ in walls]
        if walls[0][1] < 0 or len({*axes}) < count or len({axis // 3 for axis in axes}) > 1:
            continue
        session, goal = made(name), np.zeros(6)
        near = np.linalg.norm([edge for axis, _, edge in walls if axis > 2]) < session.hand.largest_angle
        goal[axes] = [-normal * FAR[slot][axis] for axis, normal, _ in walls]
        setattr(session.hand, slot, goal.tolist())
        session.tick(0.3)
        assert not near or all(normal * (session.snapshot().pose[axis] - edge) < 0.0 for axis, normal, edge in walls)
        if len(faces) == 2 * len(AXES):
            setattr(session.hand, slot, (-goal).tolist())
            session.tick(0.25)
            assert not near or all(normal * (session.snapshot().pose[axis] - edge) > 0 for axis, normal, edge in walls)
        assert not session._segment.plant.met_stops  # at no time


@pytest.mark.parametrize("line", ["view", "view --web", "view --hand-stiffness 1000", "view --tour"])
def test_every_front_has_the_hand_of_the_mouse(line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    hands = [Session().hand]
    monkeypatch.setattr("maglev_mj.views.window.window.require_display", lambda: None)
    monkeypatch.setattr("maglev_mj.cli.peripherals.PageOptions.open", lambda self: id if self.web else None)
    monkeypatch.setattr("maglev_mj.cli.scenes._show", lambda source, session, *_: hands.append(session.hand))
    assert cli.main([*line.split(), "--out", str(tmp_path)]) == 0
    monkeypatch.setattr("maglev_mj.views.viewer_process.SideProcess", lambda *_: None)
    hands.append(RemoteViewer(Snapshot(scene=Joystick()), id).hand)
    stiffness = 1000.0 if "1000" in line else SpringHand.stiffness
    for hand, expected in zip(hands, (SpringHand.stiffness, stiffness, SpringHand.stiffness), strict=True):
        assert vars(hand) == vars(SpringHand.of_mouse(expected))


def test_what_was_recorded_before_a_run_is_stopped_is_kept(tmp_path: Path) -> None:
    session = made(Drop(stiffness=40000.0, damping=87.0), folder=tmp_path)
    session.act("record")
    after(session, 1.0)
    assert session.snapshot().state == "stopped"
    session.act("record")
    session.close()
    recording = Recording.load(session.recordings[0])
    assert recording.ticks > 5
    assert verify(recording, rebuild).same


def test_the_end_of_a_recording_never_holds_the_loop_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Three recordings within a second, each slow to close: no tick waits, none overwrites another, nothing is lost.
    gate = Event()

    class Slow(JournalFile):
        def close(self) -> Path | None:
            assert gate.wait(4.0)
            return super().close()

    monkeypatch.setattr("maglev_mj.session.session.open_recording", lambda path: Slow(path))
    session = made(folder=tmp_path)
    for ticks in (4, 8, 12):
        session.act("record")
        after(session, ticks * FRAME)
        session.act("record")
        after(session, FRAME)
    assert session.recordings == [] and session.snapshot().notes == ["writing the recording"]
    gate.set()
    session.close()
    recorded = [Recording.load(path).ticks for path in session.recordings]
    assert len({*session.recordings}) == 3 and sorted(recorded) == [
        pytest.approx(n * FRAME * 200, abs=1) for n in (4, 8, 12)
    ]


def test_a_recording_whose_folder_is_gone_goes_elsewhere(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    session = made(folder=folder)
    folder.rmdir()
    session.act("record")
    after(session, 0.1)
    session.close()
    (path,) = session.recordings
    assert Recording.load(path).ticks > 5
    path.unlink()


def test_walls_and_friction_on_an_axis_share_the_gains() -> None:
    # Both together are as stiff as either alone: their sum is what the delay bounds.
    for name in ("joystick", "box", "corner"):
        for friction in (False, True):
            scene = find_scene(name)().replace(friction=friction)
            laws = [law for law in scene.laws() if isinstance(law, Wall | StickSlip)]
            assert len(laws) == 1 + friction
            assert sum(float(np.max(law.stiffness)) for law in laws) == 6000.0
            assert sum(float(np.max(law.damping)) for law in laws) == 80.0
    assert wall(Joystick(), "x", lower=0.0).stiffness == 6000.0


def test_the_limits_of_the_device_are_added_but_not_to_those_of_the_scene() -> None:
    class Weak(Scene):
        """Nothing at 1 A."""

        def laws(self) -> list[Law]:
            return []

        def plant_options(self) -> dict[str, Any]:
            return {"current_limit": 1.0}

    assert live_plant(Weak()).current_limit == 1.0
    assert live_plant(Drop()).current_limit == Spec.peak_current.value


def test_the_arm_of_a_press_is_there_only_with_its_own_hand() -> None:
    """The mouse's hand has neither mass nor spring."""
    arm = Press().scripted_hand()
    for hand, mass in ((SpringHand(), 0.0), (arm, float(np.asarray(arm.hand.mass)))):
        with live_plant(Press(), hand) as plant:
            assert plant.device.model.dof_armature.max() == mass


def test_keys_stop_at_the_bounds_and_leave_what_is_not_theirs() -> None:
    class Counted(Scene):
        """Count something."""

        some: int = param("how many", default=2, at_least=0, at_most=5, live=True)
        none: float | None = param("a limit", "N", default=None, above=0.0, optional=True, live=True)

        def laws(self) -> list[Law]:
            return []

    changes = actions(Counted)
    scene: Scene = Counted()
    seen = []
    for action in ["some up"] * 5 + ["some down", "some", "some", "none up"]:
        scene = changes[action](scene)
        seen.append(scene.as_json()["some"])
    assert seen == [3, 4, 5, 5, 5, 4, 0, 2, 2] and scene.as_json()["none"] is None
    assert actions(Drop)["stiffness up"](Drop(stiffness=1e8)) == Drop(stiffness=1e8)
    for action, name, ends in (
        ("stiffness", "stiffness", (1e5, 100.0)),
        ("damping", "damping", (1e3, 1.0)),
        ("rate", "period", (1.0 / 2000.0, 1.0 / 50.0)),
        ("delay", "delay", (0.02, 0.0)),
    ):
        pressed: Scene = Joystick()
        for sense, end in zip(("up", "down", "up"), (*ends, ends[0]), strict=True):
            for _ in range(60):
                pressed = actions(Joystick)[f"{action} {sense}"](pressed)
            assert pressed.as_json()[name] == end
    assert "walls" not in actions(Joystick) and not any("weightless" in name for name in actions(Joystick))
    assert set(settable_parameters(Joystick())) >= {"walls", "weightless", "breakaway"}


def test_what_a_program_asks_of_the_scene_before_is_not_done() -> None:
    late = Program()
    session = made("box", publishers=[late])
    late.wanted = Joystick(stiffness=3000.0, period=0.001)
    after(session, 0.1)
    assert session.snapshot().scene == find_scene("box")()
    late.wanted = find_scene("box")().replace(stiffness=3000.0, period=0.001)
    after(session, 0.1)
    assert session.snapshot().scene == find_scene("box")().replace(stiffness=3000.0)
    assert late.answers == ["settings must be of scene box (got joystick)", session.snapshot().since]

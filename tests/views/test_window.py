"""Layout of the window at any size: no overlap of texts, plots, labels and handle."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import combinations, product
from types import SimpleNamespace
from typing import Any

import glfw
import mujoco
import numpy as np
import pytest

from maglev_mj import Controller, LowPass, record_run
from maglev_mj.colours import HAND, STOP
from maglev_mj.device import Knob
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import CENTRING, Joystick
from maglev_mj.session import Pacer, Session, Snapshot, TourLine, device_actions
from maglev_mj.session.margin import STABILITY, margin
from maglev_mj.session.replay import Replay
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.views.readings import SteadyRange, banner, fitted_range, stop_contacts
from maglev_mj.views.window.keys import KEYS, help_rows
from maglev_mj.views.window.painter import Scenery, default_view, label_area, project, zoom
from maglev_mj.views.window.screen import Area, Layout, Screen, letters, message_rows, number_rows, status_rows
from maglev_mj.views.window.window import _font_scale, _Window, _work_area, fitted_size
from tests.sweeps import sweep

SIZES = (480, 360), (640, 400), (800, 600), (1250, 500), (1920, 1080)
KNOB = np.array(
    [[side * 0.0165, other * 0.0165, 0.079 + up * 0.0125] for side, other, up in product((-1, 1), repeat=3)]
)


def snapshot_after(scene: Scene, target: list[float] | None = None, seconds: float = 3.0, **changed: float) -> Snapshot:
    """Return the snapshot of a scene after some time in a hand."""
    session = Session(scene, pacer=Pacer(budget=60.0, patience=3600.0))
    session.change(changed)
    session.hand.target = target
    if "hand_stiffness" in changed:
        session.hand.largest_angle = math.pi  # past the stop
    session.tick(seconds)
    session.close()
    return session.snapshot()


@pytest.fixture(scope="module")
def shot() -> Snapshot:
    return snapshot_after(Joystick(), seconds=0.1)


def overlap(one: Area, other: Area) -> bool:
    """Return True if two areas overlap."""
    across = one.left < other.left + other.width and other.left < one.left + one.width
    return across and one.bottom < other.top and other.bottom < one.top


@pytest.mark.parametrize("scale", [100, 150])
def test_no_element_covers_another(scale: int) -> None:
    for width, height in SIZES:
        view = Area(0, 0, width * scale // 100, height * scale // 100)
        layout = Layout(view, scale)
        for one, other in combinations((layout.text, layout.device, *layout.plots), 2):
            assert not overlap(one, other), (view, one, other)
        assert sum(area.width for area in (layout.text, layout.device, *layout.plots[:1])) == view.width
        assert not overlap(layout.bar, layout.label)
        for inner in (layout.bar, layout.label):
            assert layout.device.left <= inner.left and inner.width <= layout.device.width
        assert layout.device.width >= 0.4 * view.width and len(layout.plots) >= 2 * (width >= 800)


def test_a_label_lies_beside_the_tip_of_its_arrow_and_inside_the_view() -> None:
    view, random = Area(300, 40, 700, 500), np.random.default_rng(7)
    for angle, scale in product(random.uniform(0.0, 2.0 * np.pi, 40), (100, 150)):
        tip, way = np.array([600.0, 300.0]), np.array([np.cos(angle), np.sin(angle)])
        label = label_area("12.3 N", tip, tip + 8.0 * way, view, scale)
        assert not overlap(label, Area(int(tip[0]) - 3, int(tip[1]) - 3, 6, 6)), angle
        far = label_area("12.3 N", tip + 900.0 * way, tip + 908.0 * way, view, scale)
        assert view.left < far.left and far.left + far.width < view.left + view.width
        assert view.bottom < far.bottom and far.top < view.top


STOPPED = {"state": "stopped", "reason": "unstable: the wall generated 100 mJ"}
TOURED = {"tour": TourLine(1, 8, "a text that is as long as the texts of the tour are", "a task", False)}
STATES: list[dict[str, Any]] = [
    {},
    STOPPED,
    TOURED,
    {"state": "paused"},
    {"state": "flying"},
    {"overloaded": True},
    {"time_scale": 0.01},
    {"hand": np.full(6, 12.3), "work": 9.8765, "taken": 9.8765, "cost": 0.012345, "missed": 98765},
]


def drawings(shot: Snapshot, view: Area, scale: int) -> Iterator[Any]:
    """Yield a frame of each state, with and without keys and a note."""
    for state, keys, notes in product(STATES, (False, True), (["wrote /a/folder/of/some/depth/a-001.png"], [])):
        shown, screen = replace(shot, **state), Screen()
        if keys:
            screen.press(KEYS, shown.scene)
        STABILITY.of(shown, wait=True)
        yield shown, keys, notes, screen.draw(shown, view, scale, notes)


@pytest.mark.parametrize(("size", "scale"), sweep([(800, 600), (1280, 720), (1920, 1080)], [100, 150], every=2))
def test_texts_fit_their_area_and_are_whole(shot: Snapshot, size: tuple[int, int], scale: int) -> None:
    view = Area(0, 0, *(scale * side // 100 for side in size))
    for shown, keys, notes, drawn in drawings(shot, view, scale):
        blocks, area = (drawn.upper, drawn.lower), drawn.layout.text
        assert (sum(map(len, blocks)) + 1) * drawn.layout.row <= view.height
        for rows in blocks:
            names, values = (max(map(len, column), default=0) for column in zip(*rows, strict=True))
            assert names + values <= letters(area.width, scale)
        upper, lower = ("".join(map("".join, block)).replace(" ", "") for block in blocks)
        wanted = help_rows(shown.actions, mouse=shown.state != "flying") if keys else status_rows(shown)
        assert "".join(map("".join, wanted)).replace(" ", "").startswith(upper)
        assert size[0] == 800 or "".join(map("".join, wanted)).replace(" ", "") == upper
        assert keys or all((name + value).replace(" ", "") in lower for name, value in message_rows(shown, notes))
        if shown.state == "stopped":
            words = " ".join(box.text for box in drawn.boxes)
            assert "STOPPED: press /" in words and shown.reason in words


def test_nothing_moves_when_states_change(shot: Snapshot) -> None:
    for size in SIZES:
        frames = [(keys, drawn) for _, keys, _, drawn in drawings(shot, Area(0, 0, *size), 100)]
        assert len({(drawn.layout.text, drawn.layout.device, *drawn.layout.plots) for _, drawn in frames}) == 1
        first = [[name for name, _ in drawn.upper[:4]] for keys, drawn in frames if not keys]
        assert all(names == first[0] for names in first)


def test_f11_shows_the_keys_and_the_window_fits_its_screen(shot: Snapshot) -> None:
    screen, view = Screen(), Area(0, 0, 1280, 800)
    first = screen.draw(shot, view, 100)
    assert ("F11", "keys, all numbers") in first.lower and "Esc" not in dict(first.upper)
    for shown in (help_rows(shot.actions)[0][0], "hand", first.upper[0][0]):
        screen.press(KEYS, shot.scene)
        assert screen.draw(shot, view, 100).upper[0][0] == shown
        assert ("energy" in dict(screen.draw(shot, view, 100).upper)) == (shown == "hand" and screen._page == 2)
    for large, fitted in (((800, 600), (736, 528)), ((1280, 800), (1177, 704)), ((3840, 2160), (2560, 1440))):
        assert fitted_size(*large) == fitted


@pytest.mark.parametrize("size", [(1, 1), (30, 800), (800, 30), (120, 90)])
def test_a_window_of_any_size_is_arranged(shot: Snapshot, size: tuple[int, int]) -> None:
    stopped = replace(shot, state="stopped", duration=2.0)
    for scale in (100, 300):
        drawn = Screen().draw(stopped, Area(0, 0, *size), scale)
        assert drawn.layout.device.width > 0 and np.isfinite(zoom(drawn.layout.device))


@pytest.mark.parametrize("name", ["joystick", "six-axes"])
def test_the_knob_is_in_its_area(name: str) -> None:
    # At each size, wherever the flotor is; a displacement of some pixels is seen as such.
    model = Scenery(find_scene(name)()).model
    for width, height in SIZES:
        area, camera = Layout(Area(0, 0, width, height), 100).device, mujoco.MjvCamera()
        default_view(model, camera)
        camera.distance *= zoom(area)
        for place in (np.zeros(3), np.full(3, 4.5e-3), np.full(3, -4.5e-3)):
            for point in KNOB + place:
                x, y = project(model, camera, area, point)[0]
                assert area.left <= x <= area.left + area.width and area.bottom <= y <= area.top
        middle, right, up = project(model, camera, area, Knob().centre)
        moved = project(model, camera, area, Knob().centre + 7.0 * right - 5.0 * up)[0]
        assert moved - middle == pytest.approx([7.0, -5.0], abs=1e-6)
        assert abs(middle[0] - area.left - 0.5 * area.width) < 0.1 * area.width


STOPS = {
    "metal stop: +x 4.5 mm": (8e-3, 0.0, 0.0, 0.0, 0.0, 0.0),
    "metal stop: rotation 6.0 deg": (0.0, 0.0, 0.0, 0.5, 0.0, 0.4),
}
"""Targets of the hand past a stop, by the start of its message."""


@cache
def at_stop(words: str) -> Snapshot:
    return snapshot_after(Joystick(wall=False), list(STOPS[words]), hand_stiffness=2000.0)


@pytest.mark.parametrize("words", STOPS)
def test_forces_balance_at_a_metal_stop_and_it_is_named(words: str) -> None:
    shown, target = at_stop(words), STOPS[words]
    for part in (slice(0, 3), slice(3, 6)):
        forces = [shown.hand[part], shown.force[part], shown.stops[part]]
        largest = max(np.linalg.norm(force) for force in forces)
        assert np.linalg.norm(sum(forces)) <= 0.02 * largest + 1e-9
    faces, said = stop_contacts(shown)
    assert stop_contacts(replace(shown, stops=np.zeros(6))) == ([], "")
    assert said.startswith(words) and words in dict(message_rows(shown))[""]
    assert [axis > 2 for axis, _, _ in faces] == ["rotation" in words]
    for axis, normal, edge in [face for face in faces if face[0] < 3]:
        assert abs(edge) == pytest.approx(4.5e-3, rel=0.1) and normal == -np.sign(edge) == -np.sign(target[axis])


def test_arrows_of_balanced_forces_have_equal_lengths() -> None:
    # Hand to one side; device and stop, one behind the other, to the other: sums of lengths agree.
    shown, scenery = at_stop(next(iter(STOPS))), Scenery(Joystick())
    scene = mujoco.MjvScene(scenery.model, 500)
    scenery.set_pose(shown)
    scenery.decorate(scene, shown)
    arrow = int(mujoco.mjtGeom.mjGEOM_ARROW)
    hand, device, stop = [geom for geom in scene.geoms[: scene.ngeom] if geom.type == arrow]
    assert hand.rgba[:3] == pytest.approx(HAND) and stop.rgba[:3] == pytest.approx(STOP)
    assert hand.size[2] == pytest.approx(device.size[2] + stop.size[2], rel=0.02)
    # the stop's goes on where the device's ends, drawn at half of the length between its points
    assert stop.pos[0] == pytest.approx(device.pos[0] - 0.5 * device.size[2], abs=2e-4)


def test_ranges_fit_the_data_and_do_not_jitter() -> None:
    random = np.random.default_rng(19)
    for _ in range(300):
        low, span = random.uniform(-50.0, 50.0), 10.0 ** random.uniform(-2.0, 2.0)
        data = low + span * random.random(20)
        bottom, top = fitted_range(data, 1e-3)
        assert bottom <= data.min() + 1e-5 * span and top >= data.max() - 1e-5 * span
        assert np.ptp(data) >= 0.33 * (top - bottom)  # never two thirds for nothing
        # the engine rounds a range to multiples of the power of ten below it: this one stays as it is
        step = 10.0 ** np.floor(np.log10(np.float32(top - bottom) * (1 + 1e-6)))
        assert bottom / step == pytest.approx(round(bottom / step), abs=1e-3)
    assert fitted_range(np.array([0.1, 4.4]), 1.0) == (0.0, 5.0)
    assert fitted_range(np.zeros(3), 2.0) == (-1.0, 1.0) and fitted_range(np.array([np.nan]), 2.0) == (-1.0, 1.0)
    assert SteadyRange(1.0)([-4.0, 5.0]) == (-5.0, 5.0) and SteadyRange(1.0)([-0.2, 7.0]) == (-7.0, 7.0)
    steady = SteadyRange(1.0)
    ranges = {steady(np.array([0.0, 3.0 + 0.05 * np.sin(turn)])) for turn in np.linspace(0.1, 6.0, 50)}
    assert ranges == {(0.0, 4.0)}
    assert steady([0.0, 2.6]) == (0.0, 4.0) and steady([0.0, 1.5]) == (0.0, 2.0) and steady([-9.0]) == (-10.0, -8.0)


class Filtered(Drop):
    """Drop with a low-pass filter of the velocity, which moves the boundary."""

    def controller(self) -> Controller:
        """See `Scene`."""
        return Controller(super().controller().laws, period=self.period, velocity=LowPass(cutoff=20.0))


@pytest.mark.parametrize("scene", [Joystick(), Drop(), Filtered(stiffness=2000.0)])
def test_the_drawn_boundary_is_where_the_verdict_has_its_limit(scene: Scene) -> None:
    found = margin(scene)
    assert found.loop is not None
    limit = np.interp(found.loop.damping, *found.boundary)
    percent = int(re.findall(r"stable: (\d+) %", found.words)[0])
    ratio = 1.0 + (limit - found.loop.stiffness) / scene.stiffness  # type: ignore[attr-defined]
    assert 100.0 / ratio == pytest.approx(percent, rel=0.02)  # the scene's stiffness alone grows


def test_the_margin_is_that_of_the_total_gains() -> None:
    # Those of wall and centring, and of the loop that is refused; the wall's stiffness alone grows to the critical one.
    found, body = margin(Joystick()), Joystick().body.inertia
    assert found.stable and found.loop is not None and found.loop.axis == "x"
    assert found.loop.stiffness == pytest.approx(6000.0 + CENTRING) and found.loop.damping == pytest.approx(92.0)
    most = float(largest_stable_stiffness(92.0, period=0.005, delay=0.0015, mass=float(body[0])))
    assert (
        found.words == f"stable: {100.0 / (1.0 + (most - found.loop.stiffness) / 6000.0):.0f} % of critical stiffness"
    )
    free = margin(Joystick(wall=False))
    assert (
        free.stable and free.loop is not None and max(free.loop.stiffness, 12.0) <= CENTRING + 1e-9
    )  # nothing of the wall that is off
    wrong = margin(Drop(stiffness=20000.0))
    assert wrong.stable is False and wrong.words.startswith("unstable on z: ")
    assert wrong.loop is not None and wrong.loop.axis == "z" and wrong.loop.stiffness >= 20000.0
    six = margin(find_scene("six-axes")())
    assert six.stable and six.loop is not None and six.loop.stiffness < 6000.0
    assert margin(find_scene("twist")()).words == "stable: no stiffness"
    for name in BUILT_IN:
        assert "not computed" not in margin(find_scene(name)()).words


def test_the_banner_names_the_state_and_the_key_to_continue(shot: Snapshot) -> None:
    screen, view = Screen(), Area(0, 0, 1280, 800)

    def heading(shown: Snapshot, size: Area = view) -> str:
        found = [box.text for box in screen.draw(shown, size, 100).boxes]
        return next((title for title in found if title.startswith(("STOPPED", "PAUSED", "Running"))), "")

    assert heading(shot) == ""
    stopped = replace(shot, state="stopped", reason="emergency stop")
    assert heading(stopped) == "STOPPED: press / to restart"
    assert heading(replace(shot, state="paused")) == "PAUSED: press Space to resume"
    device = replace(stopped, actions=device_actions(Joystick), remedy="maglev-mj bridge ADDRESS --reset goes on")
    assert heading(device) == "STOPPED"  # no key does
    found = banner(device)
    assert found is not None and found.resume_action == "" and "--reset" in found.remedy
    assert heading(stopped, Area(0, 0, 1040, 700)).startswith("STOPPED: press /")
    late = "Running slower than real time: press - for slow motion"
    assert heading(replace(shot, overloaded=True)) == heading(shot) == late  # held for a while


@pytest.fixture
def window(shot: Snapshot, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a window without OpenGL: a knob of 33 pixels in the middle of the screen, 1 mm per pixel."""
    window: Any = _Window.__new__(_Window)
    window.pixel, window.acts, window.moves, window.pose = np.array([400.0, 300.0]), [], [], np.full(6, 1e-3)
    painter = SimpleNamespace(
        knob=lambda *_: (np.array([400.0, 300.0]), 1e-3 * np.eye(3)[0], 1e-3 * np.eye(3)[2]),
        orbit=lambda *move: window.moves.append(("orbit", *move)),
        pan=lambda *move: window.moves.append(("pan", *move[:2])),
    )
    source = SimpleNamespace(
        snapshot=lambda: replace(shot, pose=window.pose), hand=SpringHand(), act=window.acts.append
    )
    window.__dict__ |= {"_painter": painter, "_source": source, "_screen": Screen(), "_drag": "", "_held": None}
    window.__dict__ |= {"_pixel": lambda: window.pixel.copy(), "_view": lambda: Area(0, 0, 800, 600)}
    return window


@pytest.mark.parametrize("modifiers", [0, glfw.MOD_SHIFT, glfw.MOD_CONTROL])
def test_a_drag_of_the_knob_moves_the_hand(window: Any, modifiers: int) -> None:
    hand = window._source.hand
    window._button(None, glfw.MOUSE_BUTTON_LEFT, glfw.PRESS, modifiers)
    start, window.pose = window.pose, 2.0 * window.pose  # it has moved by the time of the first motion
    window.pixel += (3.0, 6.0)
    window._move(None, 0.0, 0.0)
    moved = np.array(hand.target) - start
    if modifiers == 0:
        assert moved == pytest.approx([3e-3, 0.0, 6e-3, 0.0, 0.0, 0.0])
    elif modifiers == glfw.MOD_SHIFT:
        assert moved[4] == pytest.approx(3e-3 / Knob().centre[2]) and not moved[:3].any() and not moved[5]
    else:
        assert moved == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, 3e-3 / Knob().radius])
    window._button(None, glfw.MOUSE_BUTTON_LEFT, glfw.RELEASE, 0)
    assert hand.target is None and not window.moves
    window._move(None, 0.0, 0.0)
    assert hand.target is None and not window.moves


@pytest.mark.parametrize(("number", "beside"), [(glfw.MOUSE_BUTTON_LEFT, 30.0), (glfw.MOUSE_BUTTON_RIGHT, 0.0)])
def test_other_drags_move_the_camera(window: Any, number: int, beside: float) -> None:
    window.pixel[0] += beside
    window._button(None, number, glfw.PRESS, 0)
    for _ in range(2):
        window.pixel += (6.0, -3.0)
        window._move(None, 0.0, 0.0)
    kind = "orbit" if number == glfw.MOUSE_BUTTON_LEFT else "pan"
    assert window.moves == [(kind, 0.01, -0.005)] * 2 and window._source.hand.target is None


DIRECTIONS = ((1, 0, 0), (0, 1, 0), (0.7, 0.7, 0), (0, 0, 1), (0.6, 0.6, -0.5), (-1, 0, 0), (0, 0, -1), (0, -1, 0))


@pytest.mark.parametrize(("scene", "direction"), sweep([Joystick, find_scene("box")], DIRECTIONS, every=16))
def test_the_default_hand_reaches_the_wall_but_not_the_stop(scene: type[Scene], direction: tuple[float, ...]) -> None:
    # However far it is pulled, along each axis and across.
    shown = snapshot_after(scene(), [*(0.1 * np.array(direction)), 0.0, 0.0, 0.0])
    assert stop_contacts(shown) == ([], ""), direction
    assert any(normal * (shown.pose[axis] - edge) <= 0.0 for axis, normal, edge in shown.faces)
    assert dict(number_rows(shown))["energy"].count(" absorbed") == 1


def test_the_energy_reading(shot: Snapshot) -> None:
    stored = "{:.1f} mJ in motion, height and stops"
    for taken, words in ((2e-3, "2.0 mJ absorbed"), (-2e-3, "2.0 mJ generated")):
        shown = replace(shot, work=3e-3, taken=taken)
        energy = dict(number_rows(shown))["energy"].replace("\n", " ")
        rest = stored.format(3.0 - 1e3 * taken) + " (delayed forces)" * (taken < 0.0)
        assert energy == f"3.0 mJ from the hand, {words}, {rest}"
    assert "energy" not in dict(number_rows(replace(shot, work=np.nan, taken=np.nan)))


def test_keys_seek_in_a_recording() -> None:
    replay = Replay(record_run(Drop(duration=3.995), plant="exact"))
    window: Any = _Window.__new__(_Window)
    window.__dict__ |= {"_source": replay, "_screen": Screen()}

    def press(*keys: str) -> Snapshot:
        for key in keys:
            window._key(None, getattr(glfw, f"KEY_{key}"), 0, glfw.PRESS, 0)
            window._key(None, getattr(glfw, f"KEY_{key}"), 0, glfw.RELEASE, 0)
        replay.tick(0.0)
        return replay.snapshot()

    assert press("SPACE").state == "paused"
    for keys, time in (
        (["HOME"], 0.0),
        (["UP", "UP"], 0.4),
        (["RIGHT", "RIGHT", "RIGHT"], 0.415),
        (["LEFT"], 0.41),
        (["DOWN"], 0.21),
        (["END"], 3.995),
    ):
        assert press(*keys).time == pytest.approx(time)
    shown = press("EQUAL", "9")
    assert shown.time_scale == 2.0 and shown.notes == ["REPLAY"]
    shown = press("6", "SLASH", "ENTER", "ESCAPE")  # of a scene: they do nothing here
    assert shown.time == pytest.approx(3.995)
    assert press("HOME", "SPACE").state == "running"
    replay.tick(10.0)
    assert press().state == "paused" and press().time == pytest.approx(3.995)


def test_a_screen_without_a_monitor_has_a_window_of_a_common_size(monkeypatch: pytest.MonkeyPatch) -> None:
    # A board without a screen, a remote desktop, a switch to another machine; GLFW aborts if asked for its area.
    asked = list[object]()
    monkeypatch.setattr(glfw, "get_primary_monitor", lambda: None)
    for name in ("get_monitor_workarea", "get_monitor_content_scale", "get_video_mode", "get_monitor_pos"):
        monkeypatch.setattr(glfw, name, asked.append)
    left, top, *size = _work_area()
    assert (left, top) == (0, 0) and fitted_size(*size) == (1177, 704) and _font_scale() == 100 and not asked

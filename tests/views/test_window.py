"""Layout of the window at any size: no overlap of texts, plots, labels and handle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import combinations, product
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import glfw
import mujoco
import numpy as np
import pytest

from maglev_mj import record_run
from maglev_mj.colours import HAND, STOP
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.shapes import GRIP
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import CENTRING, Joystick
from maglev_mj.session import Note, Pacer, Session, Snapshot, TourLine, device_actions
from maglev_mj.session.replay import Replay
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.views.readings import STABILITY, SteadyRange, banner, fitted_range, margin, stop_contacts
from maglev_mj.views.window.keys import KEYS, MAGNIFY, help_rows
from maglev_mj.views.window.layout import Area, Font, Layout, arranged
from maglev_mj.views.window.scenery import Framing, Scenery, directions
from maglev_mj.views.window.screen import Drawn, Screen, message_rows, status_rows
from maglev_mj.views.window.window import Grab, _Window, fitted_size
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
    session.tick(seconds)
    session.close()
    return session.snapshot()


@pytest.fixture(scope="module")
def shot() -> Snapshot:
    return snapshot_after(Joystick(), seconds=0.1)


def areas(layout: Layout) -> dict[str, Area]:
    """Return the areas of all elements by name."""
    plots = {f"plot {index}": area for index, area in enumerate(layout.plots)}
    return plots | {name: getattr(layout, name) for name in ("text", "banner", "bar", "label", "handle")}


def overlap(one: Area, other: Area) -> bool:
    """Return True if two areas overlap."""
    across = one.left < other.right and other.left < one.right
    return across and one.bottom < other.top and other.bottom < one.top


def lines(drawn: Drawn, grid: str) -> list[tuple[str, str]]:
    """Return the rows of the text block at a grid position."""
    place = int(getattr(mujoco.mjtGridPos, f"mjGRID_{grid}"))
    return [row for _, its, *columns in drawn.texts if its == place for row in zip(*(c.split("\n") for c in columns))]


@pytest.mark.parametrize("scale", [100, 150])
def test_no_element_covers_another_or_the_handle(scale: int) -> None:
    # From 480 pixels on, beside the engine's side panel or not, with a table of keys or help, and without.
    for (width, height), panel, help_width in product(SIZES, (0, 270), (0, 340, 420)):
        view = Area(panel, 0, width * scale // 100 - panel, height * scale // 100)
        layout = arranged(view, scale, help_width=help_width * scale // 100, bar=True)
        found = areas(layout)
        if help_width:  # which covers the handle until it is hidden, rather than moving it
            assert found.pop("handle") == arranged(view, scale, bar=True).handle
        for (name, one), (other_name, other) in combinations(found.items(), 2):
            assert not overlap(one, other), (view, help_width, name, other_name)
        for name, one in found.items():
            assert view.left <= one.left and one.right <= view.right, (view, help_width, name)
            assert view.bottom <= one.bottom and one.top <= view.top, (view, help_width, name)
        assert layout.handle.width >= 0.29 * view.width and layout.handle.height >= 0.3 * view.height
        if not panel and not help_width and width >= 640:
            assert len(layout.plots) >= 3 and arranged(view, scale).handle.height >= 0.5 * view.height


STOPPED = {"state": "stopped", "reason": "unstable: the wall generated 100 mJ"}
TOURED = {"tour": TourLine(1, 8, "a text that is as long as the texts of the tour are", "a task", False)}
BUSY = {"hand": np.full(6, 12.3), "work": 9.8765, "taken": 9.8765, "cost": 0.012345, "missed": 98765}
OFF = {"scene": Joystick(wall=False, pulse=False)}


def drawings(shot: Snapshot, view: Area, scale: int, states: Iterable[dict[str, Any]], note: str) -> Iterator[Any]:
    """Yield a frame of each state, with and without keys, with a note after a drag and without."""
    for state, keys, notes in product(states, (False, True), ([note], [])):
        shown, screen = replace(shot, **state), Screen()
        screen.dragged = bool(notes)
        if keys:
            screen.press(KEYS, shown.scene)
        STABILITY.wait(shown)
        yield shown, keys, notes, screen.draw(shown, view, scale, notes)


@pytest.mark.parametrize(("size", "scale"), sweep([(800, 600), (1280, 720), (1920, 1080)], [100, 150], every=2))
def test_no_text_is_truncated_or_wider_than_its_area(shot: Snapshot, size: tuple[int, int], scale: int) -> None:
    view, font = Area(0, 0, *(scale * side // 100 for side in size)), Font(scale)
    states: list[dict[str, Any]] = [{}, STOPPED, TOURED, {"time_scale": 0.01}]
    for shown, keys, notes, drawn in drawings(shot, view, scale, states, "wrote /a/folder/of/some/depth/a-001.png"):
        blocks = lines(drawn, "TOPLEFT"), lines(drawn, "BOTTOMLEFT")
        assert (sum(map(len, blocks)) + 1) * font.row <= view.height
        assert all(sum(font.columns(rows)) <= drawn.layout.text.width for rows in blocks)
        upper, lower = ("".join(map("".join, block)).replace(" ", "") for block in blocks)
        rows = help_rows(shown.actions) if keys else status_rows(shown)
        wanted = [(name, value.replace("\n", " ")) for name, value in rows]
        count = len({name for name, _ in blocks[0] if name})
        assert "".join(map("".join, wanted[:count])).replace(" ", "") == upper  # none is there in part
        assert count == len(wanted) or (size[0] == 800 and count >= len(wanted) - 4)
        assert all((name + value).replace(" ", "") in lower for name, value in message_rows(shown, notes))
        for rectangle, figure in drawn.figures:
            assert max(font.width(str(figure.title).rstrip("\0")), font.width(str(figure.xlabel))) <= rectangle.width
        if shown.state == "stopped":
            words = " ".join(title.rstrip("\0") for title, _ in titles(drawn.figures))
            assert "STOPPED: press /" in words and shown.reason in words


@pytest.mark.parametrize(("size", "room"), [((480, 360), 4), ((800, 600), 16), ((1280, 720), 14), ((1920, 1080), 13)])
def test_nothing_moves_when_states_change(shot: Snapshot, size: tuple[int, int], room: int) -> None:
    # Neither the parts of the picture nor the rows of text that stay, all but the last, of a wall; the device not even
    # when the keys or the hint to drag come and go.
    states: list[dict[str, Any]] = [
        {},
        STOPPED,
        {"state": "paused"},
        {"state": "flying"},
        {"overloaded": True},
        BUSY,
        OFF,
    ]
    frames = list(drawings(shot, Area(0, 0, *size), 100, states, "Shadows off: slow drawing. S turns them on."))
    texts = [([name for name, _ in lines(drawn, "TOPLEFT")][:room], drawn) for _, keys, _, drawn in frames if not keys]
    assert len({(*areas(drawn.layout).values(), *names) for names, drawn in texts}) == 1
    assert len({drawn.layout.handle for *_, drawn in frames}) == 1


def test_f11_shows_the_keys_and_the_window_fits_its_screen(shot: Snapshot) -> None:
    screen, view = Screen(), Area(0, 0, 1280, 800)
    first = screen.draw(shot, view, 100)
    assert ("F11", "keys") in lines(first, "BOTTOMLEFT") and "Esc" not in dict(lines(first, "TOPLEFT"))
    for shown in (help_rows(shot.actions)[0], ("hand", lines(first, "TOPLEFT")[0][1])):
        screen.press(KEYS, shot.scene)
        assert lines(screen.draw(shot, view, 100), "TOPLEFT")[0] == shown
    for large, fitted in (((800, 600), (736, 528)), ((1280, 800), (1177, 704)), ((3840, 2160), (2560, 1440))):
        assert fitted_size(*large) == fitted


@pytest.mark.parametrize("size", [(1, 1), (30, 800), (800, 30), (120, 90)])
def test_a_window_of_any_size_is_drawn(shot: Snapshot, size: tuple[int, int]) -> None:
    stopped = replace(shot, state="stopped", duration=2.0)
    framing, camera = Framing(Scenery(Joystick).model), mujoco.MjvCamera()
    framing.reset(camera)
    for scale in (100, 300):
        drawn = Screen().draw(stopped, Area(0, 0, *size), scale)
        assert all(min(rectangle.width, rectangle.height) > 0 for rectangle, _ in drawn.figures)
        framing.follow(camera, Area(0, 0, *size), drawn.layout.handle)
        assert np.isfinite([camera.distance, *camera.lookat]).all()


def projected(model: Any, camera: Any, view: Area, points: Array) -> Array:
    """Return the pixels of points in a picture, (N, 2)."""
    across, up = directions(camera)
    forward = np.cross(up, across)
    away = points - (camera.lookat - camera.distance * forward)
    focal = 0.5 * view.height / np.tan(np.radians(0.5 * model.vis.global_.fovy))
    depth = away @ forward
    return np.stack(
        [view.centre[0] + focal * (away @ across) / depth, view.centre[1] + focal * (away @ up) / depth], axis=1
    )


@pytest.mark.parametrize("name", ["joystick", "six-axes"])
def test_the_knob_is_in_the_free_area(name: str) -> None:
    # At each size, wherever the flotor is.
    model = Scenery(find_scene(name)).model
    framing, camera = Framing(model), mujoco.MjvCamera()
    framing.reset(camera)
    for (width, height), panel in product(SIZES, (0, 250)):
        view = Area(panel, 0, width - panel, height)
        free = arranged(view, 100).handle
        framing.follow(camera, view, free)
        for place in (np.zeros(3), np.full(3, 4.5e-3), np.full(3, -4.5e-3)):
            points = projected(model, camera, view, KNOB + place)
            assert (points >= (free.left, free.bottom)).all() and (points <= (free.right, free.top)).all(), view
        middle = projected(model, camera, view, GRIP[None, :])[0]
        place, right, up = framing.project(camera, view, GRIP)
        assert place == pytest.approx(middle)
        moved = projected(model, camera, view, (GRIP + 7.0 * right - 5.0 * up)[None, :])[0]
        assert moved - middle == pytest.approx([7.0, -5.0], abs=1e-6)
        assert abs(middle[0] - free.centre[0]) < 0.1 * free.width


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
    stops = stop_contacts(shown)
    assert stop_contacts(replace(shown, stops=np.zeros(6))) == ((), False, "")
    assert stops.words.startswith(words) and words in dict(message_rows(shown))[""]
    assert stops.rotation is ("rotation" in words) and bool(stops.faces) is not stops.rotation
    for axis, normal, edge in stops.faces:
        assert abs(edge) == pytest.approx(4.5e-3, rel=0.1) and normal == -np.sign(edge) == -np.sign(target[axis])


def test_arrows_of_balanced_forces_have_equal_lengths() -> None:
    # Hand to one side; device and stop, one behind the other, to the other: sums of lengths agree.
    shown, scenery = at_stop(next(iter(STOPS))), Scenery(Joystick)
    scene = mujoco.MjvScene(scenery.model, 500)
    scenery.set_pose(shown)
    scenery.decorate(scene, shown)
    arrow = int(mujoco.mjtGeom.mjGEOM_ARROW)
    hand, device, stop = [geom for geom in scene.geoms[: scene.ngeom] if geom.type == arrow]
    assert hand.rgba[:3] == pytest.approx(HAND) and stop.rgba[:3] == pytest.approx(STOP)
    assert hand.size[2] == pytest.approx(device.size[2] + stop.size[2], rel=0.02)
    # the stop's goes on where the device's ends, drawn at half of the length between its points
    assert stop.pos[0] == pytest.approx(device.pos[0] - 0.5 * device.size[2], abs=2e-4)
    assert scenery.model.vis.rgba.constraint[:3] == pytest.approx(HAND)


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


def test_the_margin_is_that_of_the_total_gains() -> None:
    # Those of wall and centring, of the walls alone where there is a wall, and of the loop that is refused.
    found, body = margin(Joystick()), Joystick().body.inertia
    assert found.stable and found.axis == "x"
    assert found.stiffness == pytest.approx(6000.0 + CENTRING) and found.damping == pytest.approx(92.0)
    most = float(largest_stable_stiffness(92.0, period=0.005, delay=0.0015, mass=float(body[0])))
    assert found.words == f"stable: {100.0 * found.stiffness / most:.0f} % of critical stiffness"
    free = margin(Joystick(wall=False))
    assert free.stable and max(free.stiffness, 12.0) <= CENTRING + 1e-9  # nothing of the wall that is off
    wrong = margin(Drop(stiffness=20000.0))
    assert wrong.stable is False and wrong.axis == "z" and wrong.words.startswith("unstable on z: ")
    assert wrong.stiffness >= 20000.0
    six = margin(find_scene("six-axes")())
    assert six.stable and six.stiffness < 6000.0
    assert margin(find_scene("twist")()).words == "stable: no stiffness"
    for name in BUILT_IN:
        assert "not computed" not in margin(find_scene(name)()).words


def titles(figures: list[Any]) -> list[tuple[str, Any]]:
    return [(str(figure.title), figure) for _, figure in figures]


def test_the_banner_names_the_state_and_the_key_to_continue(shot: Snapshot) -> None:
    screen, view = Screen(), Area(0, 0, 1280, 800)

    def heading(shown: Snapshot, size: Area = view) -> str:
        found = [title.rstrip("\0") for title, _ in titles(screen.draw(shown, size, 100).figures)]
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


def test_a_key_magnifies_the_motion_of_handle_and_walls(shot: Snapshot) -> None:
    screen, pose = Screen(), np.array([1e-3, -5e-4, 2e-3, 0.01, 0.0, 0.02])
    shown, scenery, other = replace(shot, pose=pose), Scenery(Joystick), Scenery(Joystick)
    scene = mujoco.MjvScene(scenery.model, 500)
    stem, _, *knob = np.flatnonzero(scenery.model.geom_bodyid == scenery.model.body("handle").id)  # _: collar
    scenery.set_pose(shown)
    true = scenery.data.geom_xpos.copy()

    def ends(of: Scenery) -> Array:
        along = of.model.geom_size[stem, 1] * of.data.geom_xmat[stem, 2::3]
        return np.array(of.data.geom_xpos[stem] + [-along, along])

    foot = ends(scenery)[0]
    for factor in (1, 3, 5):
        assert screen.factor == factor
        rows = lines(screen.draw(shown, Area(0, 0, 1280, 800), 100), "BOTTOMLEFT")
        assert any(f"motion x{factor}" in words for _, words in rows) is (factor > 1)
        scenery.set_pose(shown, factor)
        other.set_pose(replace(shown, pose=factor * pose))
        assert set(np.flatnonzero((scenery.data.geom_xpos != true).any(axis=1))) <= {stem, *knob}
        assert np.allclose(scenery.data.geom_xpos[knob], other.data.geom_xpos[knob], atol=1e-12)
        assert np.allclose(scenery.data.geom_xmat[knob], other.data.geom_xmat[knob], atol=1e-12)
        assert np.allclose(ends(scenery), [foot, ends(other)[1]], atol=1e-12)  # no gap at either end
        scene.ngeom = 0
        scenery.decorate(scene, shown, factor)
        walls = [geom.pos for geom in scene.geoms[: scene.ngeom] if geom.type == int(mujoco.mjtGeom.mjGEOM_BOX)]
        assert max(wall[0] for wall in walls) == pytest.approx(factor * 3.5e-3 + 0.0165, abs=3e-4)
        screen.press(MAGNIFY, shot.scene)
    assert screen.factor == 1


def test_only_plain_left_drags_of_the_knob_are_taken_from_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    pixel, engine, ours = [100.0, 100.0], list[Any](), list[Any]()

    def taken(window: Any, call: Any) -> Any:
        ours.append(call)
        return lambda *event: engine.append(event)

    raw = SimpleNamespace(glfwSetMouseButtonCallback=taken, glfwSetCursorPosCallback=taken)
    size = lambda window: (800, 600)  # noqa: E731
    parts: dict[str, Any] = {"_glfw": raw, "get_framebuffer_size": size, "get_window_size": size}
    parts |= dict.fromkeys(("_GLFWmousebuttonfun", "_GLFWcursorposfun"), lambda call: call)
    parts |= dict.fromkeys(("get_primary_monitor", "set_window_size", "set_window_pos"), lambda *_: None)
    parts |= {"get_monitor_workarea": lambda monitor: (0, 0, 800, 600), "get_cursor_pos": lambda window: pixel}
    for name, part in parts.items():
        monkeypatch.setattr(glfw, name, part)
    grab, knob = Grab(), (np.array([100.0, 500.0]), 1e-3 * np.eye(3)[0], 1e-3 * np.eye(3)[2])
    grab.attach(None)
    button, cursor = ours
    # another button, with a key, beside the knob, a knob that no hand moves
    for number, keys, beside, seen in ((1, 0, 0.0, knob), (0, 2, 0.0, knob), (0, 0, 30.0, knob), (0, 0, 0.0, None)):
        pixel[0], grab.knob = 100.0 + beside, seen
        button(None, number, glfw.PRESS, keys)
        assert grab.moved is None and engine.pop() == (None, number, glfw.PRESS, keys)
    pixel[0], grab.knob = 100.0, knob
    button(None, 0, glfw.PRESS, 0)
    pixel[:] = 104.0, 98.0
    cursor(None, *pixel)
    assert grab.moved == pytest.approx([4e-3, 0.0, 2e-3]) and not engine
    button(None, 0, glfw.RELEASE, 0)
    assert grab.moved is None and not engine
    cursor(None, *pixel)
    button(None, 0, glfw.RELEASE, 0)
    assert len(engine) == 2


@pytest.mark.parametrize("factor", [3])
def test_a_drag_sets_the_target_divided_by_the_magnification(shot: Snapshot, factor: int) -> None:
    window: Any = _Window.__new__(_Window)
    hand, start = SpringHand(), np.array([1e-3, 0.0, 0.0, 0.0, 0.01, 0.0])
    shown = [replace(shot, pose=start)]
    session = SimpleNamespace(snapshot=lambda: shown[0], hand=hand)
    none = SimpleNamespace(pushes=False, twists=False)
    window.__dict__ |= {"_session": session, "_screen": Screen(), "_grab": Grab(), "_mouse": none, "_grab_pose": None}
    window._screen.factor = factor
    window._guide_hand()
    assert hand.target is None and not window._screen.dragged
    window._grab.moved = np.array([3e-3, 0.0, 6e-3])
    for _ in range(2):  # the second time it has moved, and is drawn from its start on
        window._guide_hand()
        assert hand.target == pytest.approx([1e-3 + 3e-3 / factor, 0.0, 6e-3 / factor, *shown[0].pose[3:]])
        shown[0] = replace(shot, pose=2.0 * start)
    assert window._screen.dragged
    window._grab.moved, window._mouse = None, none
    window._guide_hand()
    assert hand.target is None and window._grab_pose is None
    grip = 2.0 * start[:3] + rotation_matrix(2.0 * start[3:]) @ GRIP
    window._mouse = SimpleNamespace(
        pushes=True, twists=False, position=grip + 3e-3 * np.eye(3)[0]
    )  # the engine's own drag
    window._guide_hand()
    assert hand.target == pytest.approx([2e-3 + 3e-3 / factor, 0.0, 0.0, *shown[0].pose[3:]])


DIRECTIONS = ((1, 0, 0), (0, 1, 0), (0.7, 0.7, 0), (0, 0, 1), (0.6, 0.6, -0.5), (-1, 0, 0), (0, 0, -1), (0, -1, 0))


@pytest.mark.parametrize(("scene", "direction"), sweep([Joystick, find_scene("box")], DIRECTIONS, every=16))
def test_the_default_hand_reaches_the_wall_but_not_the_stop(scene: type[Scene], direction: tuple[float, ...]) -> None:
    # However far it is pulled, along each axis and across.
    shown = snapshot_after(scene(), [*(0.1 * np.array(direction)), 0.0, 0.0, 0.0])
    assert not stop_contacts(shown).words, direction
    assert any(normal * (shown.pose[axis] - edge) <= 0.0 for axis, normal, edge in shown.faces)
    assert dict(status_rows(shown))["energy"].count(" absorbed") == 1


def test_the_energy_reading(shot: Snapshot) -> None:
    stored = "{:.1f} mJ in motion, height and stops"
    for taken, words in ((2e-3, "2.0 mJ absorbed"), (-2e-3, "2.0 mJ generated")):
        shown = replace(shot, work=3e-3, taken=taken)
        energy = dict(status_rows(shown))["energy"].replace("\n", " ")
        rest = stored.format(3.0 - 1e3 * taken) + " (delayed forces)" * (taken < 0.0)
        assert energy == f"3.0 mJ from the hand, {words}, {rest}"
    assert "energy" not in dict(status_rows(replace(shot, work=np.nan, taken=np.nan)))


def test_a_rejected_key_becomes_a_note(shot: Snapshot) -> None:
    def refuse(action: str) -> None:
        raise ParameterError(f"{action} is not taken here") if action == "rate up" else OSError("no space left")

    window: Any = _Window.__new__(_Window)
    session = SimpleNamespace(snapshot=lambda: shot, act=refuse)
    window.__dict__ |= {"_session": session, "_screen": Screen(), "_note": Note(), "_pressed": SimpleQueue()}
    for code, words in ((glfw.KEY_F9, "rate up is not taken here"), (glfw.KEY_F10, "no space left")):
        window._pressed.put(code)
        window._press_keys()
        assert window._note.lines == [words]
    window._pressed.put(glfw.KEY_F1)  # the engine's own help is on now
    window._press_keys()
    assert not window._screen.draw(shot, Area(0, 0, 1280, 800), 100).texts


def test_keys_seek_in_a_recording() -> None:
    replay = Replay(record_run(Drop(duration=3.995), plant="exact"))
    window: Any = _Window.__new__(_Window)
    window.__dict__ |= {"_session": replay, "_screen": Screen(), "_note": Note(), "_pressed": SimpleQueue()}

    def press(*keys: str) -> Snapshot:
        for key in keys:
            window._pressed.put(getattr(glfw, f"KEY_{key}"))
        window._press_keys()
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
    assert shown.time == pytest.approx(3.995) and not window._note.lines
    assert press("HOME", "SPACE").state == "running"
    replay.tick(10.0)
    assert press().state == "paused" and press().time == pytest.approx(3.995)

"""Web page in a real browser: slider, knob, touch, buttons."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj.device import Knob
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import REWIND_ACTIONS, DeviceStatus, Session, Snapshot, real_time
from maglev_mj.session.access import listen
from maglev_mj.views.page.page import Endpoint, page
from maglev_mj.views.page.stage import FIELD, placed
from maglev_mj.views.viewer_process import RemoteViewer
from tests.views.browser import chromium, on_screen

pytestmark = pytest.mark.needs("browser")

SIZE = {"width": 860, "height": 420}
PATIENCE = 60.0
"""Longest wait for a slow machine [s]."""

UNDRAWN = """
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (...kind) {
    const made = context.apply(this, kind);
    for (const draw of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"])
        if (made && made[draw]) made[draw] = () => {};
    return made;
};
"""  # no test looks at the scene's pixels, which software draws in more time than all else takes
UNSEEN = "--disable-gpu-compositing"  # nor at those of the panels, whose layers software puts together most cheaply so


class Run:
    """A source that runs in a thread, and its page.

    Args:
        source: The source.
        token: That of its address; None for none.
        options: Of the page, and its port.

    Attributes:
        url: Address of the page.
        shown: The newest snapshot.
        recordings: Files written.
    """

    def __init__(self, source: Any, token: str | None = None, **options: Any) -> None:
        listener = listen(options.pop("port", 0))
        door = Endpoint("127.0.0.1", listener.getsockname()[1], token)
        self.url, self._over = door.url, threading.Event()
        self._session = source
        self.shown: Snapshot = self._session.snapshot()
        self._viewer = RemoteViewer(self.shown, page(door, listener, **options))
        listener.close()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def recordings(self) -> Any:
        return self._session.recordings

    def _run(self) -> None:
        with engine_warnings_silenced():
            for elapsed, _ in real_time(None, 0.002):
                self._session.tick(elapsed)
                self._viewer.serve(self._session)
                self.shown = self._session.snapshot()
                if self._over.is_set():
                    break
        self._session.close()
        self._viewer.close()

    def until(self, done: Callable[[Snapshot], Any]) -> Snapshot:
        """Wait until the scene is so."""
        end = time.monotonic() + PATIENCE
        while not done(shown := self.shown):
            assert time.monotonic() < end, f"{shown.pose}, {shown.hand}, {shown.state}, {shown.scene}"
            time.sleep(0.01)
        return shown

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    one = Run(Session(folder=tmp_path_factory.mktemp("recordings")), token="a-token-of-some-length")
    yield one
    one.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium(UNSEEN) as found:
        yield found


def blank(context: Any, script: str) -> Any:
    """Return an empty tab, with a script for its pages."""
    tab = context.new_page()
    tab.set_default_timeout(1000.0 * PATIENCE)
    tab.add_init_script(script)
    return tab


def opened(browser: Any, run: Run, **options: Any) -> Any:
    """Return a tab that shows the scene."""
    tab = blank(browser.new_context(**{"viewport": SIZE, "device_scale_factor": 0.25, **options}), UNDRAWN)
    tab.goto(run.url, wait_until="domcontentloaded")
    tab.wait_for_selector(".gauge")
    return tab


@pytest.fixture(scope="module")
def tab(browser: Any, run: Run) -> Any:
    return opened(browser, run)


@pytest.fixture(autouse=True)
def let_go(run: Run, tab: Any) -> None:
    """Begin each test with a released hand, even after one that failed in mid drag."""
    tab.mouse.up()
    run.until(lambda shown: shown.target is None)


def knob(tab: Any, run: Run) -> tuple[float, float]:
    """Return the drawn position of the knob [px]."""
    box = tab.locator("canvas[data-engine]").bounding_box()
    return on_screen(tab, run.shown.pose[:3] + Knob().centre, placed("home", box["width"], box["height"]), FIELD)


def await_hold(run: Run) -> None:
    """Wait until the hand has hold of the knob, for a second at most: the press may have come before the drawing."""
    end = time.monotonic() + 1.0
    while run.shown.target is None and time.monotonic() < end:
        time.sleep(0.01)


def press(tab: Any, run: Run) -> tuple[float, float]:
    """Pull the knob a little, seen from home; return where it was pressed [px].

    It is pressed once the page shows by its cursor that the mouse came over it, for a drag that misses it would turn
    the view. A click alone does not take hold.
    """
    run.until(lambda shown: np.abs(shown.pose).max() < 5e-4)
    x, y = knob(tab, run)
    end = time.monotonic() + PATIENCE
    for above, cursor in (60.0, "auto"), (0.0, "pointer"):  # that of an earlier size of the page may still be there
        while tab.locator("canvas[data-engine]").evaluate("canvas => canvas.style.cursor || 'auto'") != cursor:
            assert time.monotonic() < end, f"the cursor is not {cursor}"
            tab.mouse.move(x + 2, y - above)
            tab.mouse.move(x, y - above)
    tab.mouse.down()
    pull(tab, run, x + 6, y, lambda shown: shown.target is not None and np.linalg.norm(shown.target[:2]) > 2e-3)
    return x, y


def pull(tab: Any, run: Run, x: float, y: float, done: Callable[[Snapshot], Any]) -> Snapshot:
    """Pull the knob to a position until a condition holds.

    On a busy machine the hand lets go of it now and then, until the mouse moves.
    """
    end = time.monotonic() + PATIENCE
    while not done(shown := run.shown):
        assert time.monotonic() < end, f"{shown.pose}, {shown.hand}"
        tab.mouse.move(x - 2, y)
        tab.mouse.move(x, y)
        time.sleep(0.1)
    return shown


def unfold(tab: Any) -> None:
    """Open all folders."""
    for fold in tab.locator(".mantine-Paper-root[role=button]").all():
        fold.press("Enter")
    tab.wait_for_function("document.querySelectorAll('.mantine-Paper-root[aria-expanded=true]').length == 4")


def stiffness(shown: Snapshot) -> float:
    return float(shown.scene.as_json()["stiffness"])


def test_the_rewind_slider_and_the_resume_and_repeat_buttons(run: Run, tab: Any) -> None:
    slider = tab.locator("[role=slider]").first
    slider.focus()
    tab.keyboard.press("ArrowRight")
    shown = run.until(lambda shown: shown.state == "paused" and shown.rewound)
    tab.wait_for_selector("[role=alert]:has-text('s back')")
    assert 0.0 < (shown.rewound or 0.0) < 0.6
    tab.get_by_role("button", name=REWIND_ACTIONS[2], exact=True).click()
    run.until(lambda shown: shown.state == "running" and shown.time > 0.0)
    slider.focus()
    tab.keyboard.press("ArrowRight")
    run.until(lambda shown: shown.state == "paused" and shown.rewound)
    tab.get_by_role("button", name=REWIND_ACTIONS[1], exact=True).click()
    run.until(lambda shown: shown.state == "running" and not shown.rewound)


def test_a_wall_stops_the_pulled_knob(run: Run, tab: Any) -> None:
    x, y = press(tab, run)
    edge = next(edge for axis, normal, edge in run.shown.faces if (axis, normal) == (0, -1.0))
    pushed = pull(tab, run, x + 90, y, lambda shown: shown.pose[0] > edge and shown.hand[0] > 3.0)
    assert pushed.target is not None and pushed.target[0] > 2.0 * edge  # the hand is far in the wall, the flotor is not
    assert pushed.pose[0] < 1.3 * edge
    run.until(lambda shown: shown.force[0] < -3.0)
    tab.mouse.up()
    let_go = run.until(lambda shown: shown.target is None and not shown.hand.any())
    assert let_go.state == "running"


def test_buttons_pause_step_and_stop_and_the_banner_names_the_action(run: Run, tab: Any) -> None:
    def button(name: str) -> Any:
        return tab.get_by_role("button", name=name, exact=True)

    button("pause").click()
    paused = run.until(lambda shown: shown.state == "paused")
    tab.wait_for_selector("[role=alert]:has-text('PAUSED')")
    button("step").click()
    run.until(lambda shown: shown.tick == paused.tick + 1)
    button("pause").click()
    run.until(lambda shown: shown.state == "running")
    button("slower").click()
    run.until(lambda shown: shown.time_scale == 0.5)
    button("faster").click()
    run.until(lambda shown: shown.time_scale == 1.0)  # the stop drops what still waits
    button("emergency stop").click()
    run.until(lambda shown: shown.state == "stopped")
    tab.wait_for_selector("[role=alert]:has-text('press centre')")
    button("centre").click()
    run.until(lambda shown: shown.state == "running" and shown.time_scale == 1.0)
    tab.wait_for_selector("[role=alert]:has-text('STOPPED')", state="detached")


def test_a_rejected_value_is_reported_and_the_slider_returns(run: Run, tab: Any) -> None:
    choose(tab, "press")
    run.until(lambda shown: shown.scene.name == "press")
    slider = tab.locator("[role=slider]").nth(1)
    # the slider of the scene before had the same value
    tab.wait_for_function("document.querySelectorAll('[role=slider]')[1].getAttribute('aria-valuemin') == '0'")
    slider.focus()
    tab.keyboard.press("Home")
    tab.wait_for_selector("text=stiffness must be above 0")
    assert stiffness(run.shown) > 0.0
    tab.wait_for_function("document.querySelectorAll('[role=slider]')[1].getAttribute('aria-valuenow') != '0'")
    choose(tab, "joystick")
    run.until(lambda shown: shown.scene.name == "joystick")


def test_a_number_typed_key_by_key_takes_effect_as_typed_or_is_refused(
    browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, change = list[Any](), Session.change

    def ask(session: Session, changes: Any) -> None:
        asked.append(changes)
        change(session, changes)

    monkeypatch.setattr(Session, "change", ask)
    run = Run(Session())
    try:
        tab = opened(browser, run)
        tab.wait_for_selector("[aria-label='rewind [s]']")
        tab.wait_for_selector("#state:has-text('of critical stiffness')", state="attached")
        unfold(tab)
        for box in tab.locator(".mantine-NumberInput-input").all():
            name, last = str(box.get_attribute("aria-label")), box.input_value()
            for text in ("12,5", "", "abc", "1e9", "-1", "1.25"):
                sent = len(asked)
                box.fill("")
                box.type(text)
                assert len(asked) == sent
                box.press("Tab")
                if text in ("12,5", "", "abc"):
                    tab.wait_for_selector(f"#typed:has-text('(got \"{text}\")')")
                    assert (box.input_value(), len(asked)) == (last, sent)
                    continue
                run.until(lambda _, sent=sent: len(asked) > sent)  # type: ignore[misc]
                assert [*asked[-1].values()] == pytest.approx([float(text) * (1e-3 if "[ms]" in name else 1.0)])
                last = text
        assert len(asked) == 6 * 3
    finally:
        run.close()


class Flown(Session):
    """Session that says it is a device."""

    def snapshot(self) -> Snapshot:
        return replace(super().snapshot(), device=DeviceStatus("udp://192.0.2.1:5678", "in flight"))


def test_a_page_without_its_program_says_so_and_reconnects(browser: Any) -> None:
    run, simulated = Run(Flown()), Run(Session())
    bare = opened(browser, simulated)
    simulated._viewer.serve = lambda source: None  # type: ignore[method-assign]
    bare.wait_for_selector("#gone:has-text('Connection lost')")
    assert "power" not in bare.inner_text("#gone")
    bare.context.close()
    simulated.close()
    tab, port = opened(browser, run), int(run.url.rsplit(":", 1)[1].strip("/"))
    serve, child = run._viewer.serve, run._viewer._front._process.pid or 0

    def suspend(is_suspended: bool) -> None:  # the program, not its page
        run._viewer.serve = (lambda source: None) if is_suspended else serve  # type: ignore[method-assign]

    def check(is_lost: bool) -> None:
        # a page that is drawn anew has no device for a moment, and so no such words
        tab.wait_for_selector(
            "#gone:has-text('cut the power')" if is_lost else "#gone", state="visible" if is_lost else "hidden"
        )
        assert tab.evaluate("document.getElementById('root').inert") == is_lost

    try:
        for halt in (suspend, lambda on: os.kill(child, signal.SIGSTOP if on else signal.SIGCONT)):
            for on in (True, False):
                halt(on)
                check(on)
    finally:
        run.close()
    check(True)
    run = Run(Session(), port=port)
    try:
        check(False)
        tab.wait_for_selector("[aria-label='rewind [s]']")
        inputs = "input:visible, button:visible, [role=slider], [role=tab], [role=button]:visible"
        nameless = "all => all.filter(one => !(one.ariaLabel || one.labels?.length || one.innerText)).length"
        run.until(lambda _: not tab.locator(inputs).evaluate_all(nameless))  # named within 250 ms of being drawn
        assert tab.locator(inputs).count() > 25
        assert tab.get_by_role("group", name="camera").get_by_role("button").count() > 3
        assert tab.locator("[tabindex='1']").all_text_contents() == ["emergency stop"]
        tab.keyboard.press("Escape")
        run.until(lambda shown: shown.state == "stopped")
        canvas = "loss = [...document.querySelectorAll('canvas')].pop().getContext('webgl2')"
        tab.evaluate(f"{canvas}.getExtension('WEBGL_lose_context'); loss.loseContext()")
        tab.wait_for_selector("#flat:has-text('3D view lost')")
        assert tab.get_by_role("button", name="reload", exact=True).is_visible()
        tab.evaluate("loss.restoreContext()")
        tab.wait_for_selector("#flat", state="hidden")
    finally:
        run.close()


def test_escape_stops_from_every_kind_of_input_and_during_a_drag(run: Run, tab: Any, browser: Any) -> None:
    kinds = "[role=slider]", ".mantine-NumberInput-input", ".mantine-Select-input", "[type=checkbox]", "button[id]"
    wide = opened(browser, run, viewport={"width": 1000, "height": 420})
    wide.locator("[data-dock-region-collapse=right]").click()
    wide.locator("button[id]").wait_for(state="hidden")
    for kind in ("drag", "collapsed panel", *kinds):
        if kind == "drag":
            press(tab, run)
        elif kind in kinds:
            tab.locator(f"{kind}:visible").last.focus()
        (wide if kind == "collapsed panel" else tab).keyboard.press("Escape")
        run.until(lambda shown: shown.state == "stopped")
        tab.mouse.up()
        tab.get_by_role("button", name="centre", exact=True).click()
        run.until(lambda shown: shown.state == "running" and shown.target is None)
    wide.close()


def test_arrow_keys_push_the_handle_until_released(run: Run, tab: Any) -> None:
    """Except those of a number's box: one still held there has no part in the push that follows.

    The hand of a browser that answers late has no target for a while, so that none is awaited with a force.
    """
    keys = {"ArrowRight": (0, 1), "ArrowUp": (1, 1), "PageUp": (2, 1)}
    keys |= {"ArrowLeft": (0, -1), "ArrowDown": (1, -1), "PageDown": (2, -1)}
    for (key, (axis, sign)), boxed in zip(keys.items(), [*list(keys)[1:], "ArrowRight"], strict=True):
        tab.locator(".mantine-NumberInput-input:visible").last.focus()
        tab.keyboard.down(boxed)
        tab.evaluate("document.activeElement.blur()")
        tab.keyboard.down(key)
        run.until(lambda shown, at=axis, sign=sign: sign * shown.hand[at] > 1.0)  # type: ignore[misc]
        target = run.until(lambda shown: shown.target is not None and shown.state == "running").target
        assert target is not None and abs(target[keys[boxed][0]]) < 5e-3
        tab.keyboard.up(boxed)
        if sign > 0:
            tab.keyboard.up(key)
        else:
            tab.evaluate("dispatchEvent(new Event('blur'))")
        run.until(lambda shown: shown.target is None and not shown.hand.any())
        tab.keyboard.up(key)


EXTENT = "(document.querySelector('#strip svg svg path:last-child')?.getBBox().height ?? 0)"
"""Of the newest half second of the position, in pixels of the strip."""


def test_the_strip_shows_a_buzz_once_the_wall_is_too_stiff(run: Run, tab: Any) -> None:
    stiff = tab.locator("[aria-label='stiffness [N/m]'].mantine-NumberInput-input")
    tab.keyboard.down("ArrowRight")
    run.until(lambda shown: shown.hand[0] > 1.0)
    tab.wait_for_selector("#strip :text('from the wall')")
    tab.wait_for_selector("#strip .state:text-is('still')")
    tab.wait_for_function(f"{EXTENT} < 8")
    tab.keyboard.up("ArrowRight")
    stiff.fill("13000")
    stiff.press("Enter")
    run.until(lambda shown: stiffness(shown) == 13000.0)
    tab.evaluate("document.activeElement.blur()")
    tab.keyboard.down("ArrowRight")
    tab.wait_for_selector("#strip .state.bad:has-text('swings')")
    tab.wait_for_function(f"{EXTENT} > 20")
    assert "swings" in tab.locator("#strip > svg").get_attribute("aria-label")
    tab.keyboard.up("ArrowRight")
    choose(tab, "press")
    choose(tab, "joystick")
    run.until(lambda shown: shown.scene == Joystick() and shown.state == "running")


PIECES = """
window.pieces = 0;
const start = AudioBufferSourceNode.prototype.start;
AudioBufferSourceNode.prototype.start = function (...at) { pieces++; return start.apply(this, at); };
"""


def test_sound_starts_and_ends_on_request_and_nothing_leaves_the_machine(run: Run, browser: Any) -> None:
    tab, asked = blank(browser.new_context(viewport=SIZE, device_scale_factor=0.25), UNDRAWN + PIECES), list[str]()
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(run.url, wait_until="domcontentloaded")
    button = tab.get_by_role("button", name="sound", exact=True)
    tab.wait_for_selector("#strip .title")
    for pressed in ("false", "true"):
        assert button.get_attribute("aria-pressed") == pressed
        tab.wait_for_function("pieces > 3" if pressed == "true" else "true")
        assert pressed == "true" or not tab.evaluate("pieces")
        button.press("Enter")
        tab.evaluate("pieces = 0")
    assert {url.split("/")[2] for url in asked if url.startswith(("http", "ws"))} == {run.url.split("/")[2]}
    tab.context.close()


def test_the_spring_follows_the_pointer_without_an_answer_of_the_program(run: Run, tab: Any) -> None:
    x, y = press(tab, run)
    tab.evaluate("heard = live.hear; live.hear = () => {}; 0")
    for to in (x - 20, y - 15), (x + 90, y + 10):
        tab.mouse.move(*to)
        at = "{ x, y } = document.querySelector('#pull circle').getBoundingClientRect()"
        tab.wait_for_function(f"() => {{ const {at}; return Math.hypot(x + 5 - {to[0]}, y + 5 - {to[1]}) < 1; }}")
    assert tab.locator("#pull path").get_attribute("d").count("L") > 4  # turns
    tab.evaluate("live.hear = heard; 0")
    tab.mouse.up()
    tab.wait_for_selector("#pull", state="hidden")


OVERLAPS = """() => {
    const box = (element) => element.getBoundingClientRect();
    const meet = (a, b, room = 1) =>
        a.left + room < b.right && b.left + room < a.right && a.top + room < b.bottom && b.top + room < a.bottom;
    const strip = document.querySelector("#strip"), edge = box(strip);
    const texts = [...strip.querySelectorAll("svg > text, button")].filter((text) => text.textContent.trim());
    const boxes = texts.map((text) => [text.textContent, box(text)]);
    const pairs = boxes.flatMap(([one, a], i) =>
        boxes.slice(i + 1).filter(([, b]) => meet(a, b, 2)).map(([other]) => `${one} / ${other}`));
    const wrong = boxes.filter(([, { left, right, top, bottom }]) =>
        left < edge.left || right > edge.right || top < edge.top || bottom > edge.bottom + 1);
    const others = document.querySelectorAll(".gauge, .verdict, svg.chart, button[style*=c35500], canvas");
    const covered = [...others].filter((other) => box(other).width && meet(box(other), edge));
    return [boxes.length, [...wrong.map(([text]) => text), ...pairs, ...covered.map((other) => other.outerHTML)]];
}"""


def test_no_texts_of_the_strip_overlap_and_no_panel_covers_it(run: Run, browser: Any) -> None:
    plots = {}
    for width, height in ((360, 740), (768, 900), (1280, 800), (1920, 1000), (640, 400)):
        tab = opened(browser, run, viewport={"width": width, "height": height})
        tab.wait_for_selector("#strip .title")
        tab.keyboard.down("ArrowLeft")
        run.until(lambda shown: shown.hand[0] < -1.0)
        for state in ("swings", "still"):
            tab.wait_for_selector(f"#strip .state:has-text('{state}')")
            count, overlaps = tab.evaluate(OVERLAPS)
            assert count > 8 and overlaps == [], width
        tab.keyboard.up("ArrowLeft")
        run.until(lambda shown: shown.target is None)
        if width >= 1280:
            wide = "document.querySelector('svg.chart')?.getBoundingClientRect().width"
            plots[width] = tab.wait_for_function(wide).json_value()
        tab.context.close()
    assert plots[1920] > 1.3 * plots[1280]


def test_the_stop_button_is_filled_with_a_device_alone(tab: Any) -> None:
    ground = "getComputedStyle(document.querySelector('button[style*=c35500]')).backgroundColor"
    assert tab.evaluate(ground) == tab.evaluate("getComputedStyle(document.body).backgroundColor")
    for name, is_filled in ("TWIN", False), ("DEVICE", True):
        tab.evaluate(f"document.body.insertAdjacentHTML('beforeend', '<i class=device data-name={name}></i>')")
        assert (tab.evaluate(ground) == "rgb(195, 85, 0)") == is_filled
        tab.evaluate("document.querySelector('i.device').remove()")


CONTRASTS = """() => {
    const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    const blend = (...colours) => {
        for (const colour of colours) (context.fillStyle = colour), context.fillRect(0, 0, 1, 1);
        const parts = [...context.getImageData(0, 0, 1, 1).data].slice(0, 3).map((part) => part / 255);
        const light = parts.map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
        return 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2] + 0.05;
    };
    const style = (element) => getComputedStyle(element);
    const found = {};
    for (const element of document.querySelectorAll("#root *")) {
        const text = [...element.childNodes].map((node) => (node.nodeType === 3 ? node.data.trim() : "")).join("");
        if (!/\\w/.test(text) || !element.checkVisibility({ visibilityProperty: true })) continue;
        const grounds = [];
        for (let at = element; at; at = at.parentElement) grounds.unshift(style(at).backgroundColor);
        const ground = ["#fff", ...grounds], ink = style(element)[element instanceof SVGElement ? "fill" : "color"];
        const [low, high] = [blend(...ground), blend(...ground, ink)].sort((one, other) => one - other);
        found[text] = Math.min(found[text] ?? 21, high / low);
    }
    return found;
}"""


def test_texts_have_contrast_in_the_light_and_the_dark_scheme_of_the_system(run: Run, tab: Any) -> None:
    unfold(tab)
    for scheme in ("dark", "light"):
        tab.emulate_media(color_scheme=scheme)
        tab.wait_for_selector(f"html[data-mantine-color-scheme={scheme}]")
        found = tab.evaluate(CONTRASTS)
        assert len(found) > 40 and {text: ratio for text, ratio in found.items() if ratio < 4.5} == {}


def choose(tab: Any, scene: str) -> None:
    """Choose a scene in the list, which closes while the page is laid out."""
    from playwright.sync_api import TimeoutError

    box, end = tab.get_by_label("scene"), time.monotonic() + PATIENCE
    while box.input_value() != scene and time.monotonic() < end:
        with suppress(TimeoutError):
            box.click(timeout=5000.0)
            tab.get_by_role("option", name=scene, exact=True).click(timeout=5000.0)
    assert box.input_value() == scene


def test_the_phone_layout_is_touch_sized_and_closing_the_tab_releases_the_hand(
    run: Run, browser: Any, tab: Any
) -> None:
    phone = opened(browser, run, viewport={"width": 390, "height": 800}, has_touch=True, is_mobile=True)
    assert phone.evaluate("document.documentElement.scrollWidth") <= 390
    stop = phone.get_by_role("button", name="emergency stop", exact=True)
    assert stop.bounding_box()["height"] >= 44.0
    stop.click()
    run.until(lambda shown: shown.state == "stopped")
    phone.wait_for_selector("[role=alert]:has-text('press centre')")  # drawn with it, the panel moves its buttons
    phone.get_by_role("button", name="centre", exact=True).click()
    run.until(lambda shown: shown.state == "running")
    touch(phone, run)
    phone.context.close()
    run.until(lambda shown: shown.target is None and not shown.hand.any())
    press(tab, run)  # another can take hold
    tab.mouse.up()


def touch(phone: Any, run: Run) -> None:
    """Pull the knob with a finger until the hand's force is felt."""
    finger = phone.context.new_cdp_session(phone)

    def event(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": x, "y": y} for x, y in points]
        finger.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": places})

    x, y = knob(phone, run)
    touched, end = False, time.monotonic() + PATIENCE
    while not run.shown.hand.any():
        assert time.monotonic() < end
        if run.shown.target is None:
            if touched:
                event("End")
            touched = True
            event("Start", (x, y))
        for step in range(1, 5):
            event("Move", (x + 5.0 * step, y))
        await_hold(run)


NO_WEBGL = """
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.includes("webgl") ? null : context.call(this, kind, ...more);
};
"""


def test_without_webgl_and_with_the_cookie_alone_the_controls_work(run: Run, tab: Any) -> None:
    address = run.url.split("?")[0]
    assert tab.url == address != run.url  # the browser that has shown the token keeps it as a cookie
    other = blank(tab.context, NO_WEBGL)
    other.goto(address, wait_until="domcontentloaded")
    other.wait_for_selector("text=no WebGL")
    other.wait_for_selector(".gauge")
    assert other.url == address and other.title() == "maglev-mj"
    before = stiffness(run.shown)
    other.locator("[role=slider]").nth(1).focus()
    other.keyboard.press("ArrowRight")
    run.until(lambda shown: stiffness(shown) > before)
    other.get_by_role("button", name="emergency stop", exact=True).click()
    run.until(lambda shown: shown.state == "stopped")
    other.wait_for_selector("[role=alert]:has-text('STOPPED')")
    other.get_by_role("button", name="centre", exact=True).click()
    run.until(lambda shown: shown.state == "running")
    other.close()

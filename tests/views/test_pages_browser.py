"""Pages that a browser opens by themselves, in Chromium: dragged by mouse, finger and keys, without a network."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.views.pages import FOLDER, NAMES, one_file
from tests.views.browser import MISSING, chromium

pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.skipif("playwright" in MISSING, reason="needs playwright"),
    pytest.mark.xdist_group("pages"),
]

# notes each text of a canvas that meets another one or leaves the canvas
TEXTS = """(() => {
  const P = CanvasRenderingContext2D.prototype, { fillText, clearRect } = P;
  window.meeting = new Set();
  P.clearRect = function (...area) { this.texts = []; return clearRect.apply(this, area); };
  P.fillText = function (words, x, y) {
    const m = this.measureText(words), { clientWidth, clientHeight, id } = this.canvas;
    const box = { words, left: x - m.actualBoundingBoxLeft, right: x + m.actualBoundingBoxRight,
      top: y - m.actualBoundingBoxAscent, bottom: y + m.actualBoundingBoxDescent };
    if (words.trim()) {
      if (box.left < 1 || box.right > clientWidth - 1 || box.top < 0 || box.bottom > clientHeight)
        meeting.add(`${id}: ${words} leaves`);
      for (const other of this.texts ?? []) {
        const beside = box.left >= other.right + 2 || other.left >= box.right + 2;
        if (!beside && box.top < other.bottom && other.top < box.bottom)
          meeting.add(`${id}: ${other.words} meets ${words}`);
      }
      (this.texts ??= []).push(box);
    }
    return fillText.call(this, words, x, y);
  };
})()"""

STATES = {
    "wall": [
        "13000,80,200,1.5",
        "6000,80,200,1.5",
        "13000,80,400,0.75",
        "200,0,50,200",
        "200000,500,2000,0.1",
        "300,20,200,30",
        "20000,180,200,0",
    ],
    "friction": ["3,6000,60,200", "8,6000,60,200", "0.5,50000,400,2000", "3,13000,60,100"],
    "pulse": ["4.5,200,0,220,3", "0.5,100,99,400,5", "4.5,2000,0,0,0.5", "4.5,100,50,400,5"],
}
SPOTS = {
    "wall": [(0.33, 128), (0.5, 128), (0.99, 128), (0.02, 128)],
    "friction": [(0.5, 112), (0.6, 112), (0.95, 112), (0.05, 112)],
    "pulse": [(0.25, 120), (0.25, 60), (0.25, 160)],
}
"""Where a drag leads: share of the width, and height [px]."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Start a Chromium for all tests."""
    with chromium(draws_3d=False) as started:
        yield started


@contextmanager
def opened(
    browser: Any, name: str, state: str = "", width: int = 1280, file: Path | None = None, **options: Any
) -> Iterator[Any]:
    """Yield a page opened from its file; afterwards, it had no error and asked for nothing but its own files."""
    context = browser.new_context(viewport={"width": width, "height": 800}, **options)
    page, errors, asked = context.new_page(), list[str](), list[str]()
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    page.on("request", lambda request: asked.append(request.url))
    page.add_init_script(TEXTS)
    file = file or FOLDER / f"{name}.html"
    page.goto(file.as_uri() + (state and f"#{state}"))
    yield page
    assert errors == []
    assert asked and all(url.startswith((FOLDER.as_uri(), file.as_uri(), "data:")) for url in asked), asked
    context.close()


def frames(page: Any, count: int = 2) -> None:
    """Wait for a number of pictures."""
    for _ in range(count):
        page.evaluate("() => new Promise(requestAnimationFrame)")


def verdict(page: Any) -> str:
    frames(page)
    return str(page.locator("#verdict").inner_text())


def drag(page: Any, selector: str, *points: tuple[float, float], let_go: bool = True) -> None:
    """Drag the mouse over points of an element [px]."""
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    for index, (x, y) in enumerate(points):
        page.mouse.move(box["x"] + x, box["y"] + y, steps=4)
        if index == 0:
            page.mouse.down()
        frames(page)
    if let_go:
        page.mouse.up()
        frames(page)


def touch(page: Any, selector: str, *points: tuple[float, float]) -> None:
    """Drag a finger over points of an element [px]."""
    page.locator(selector).scroll_into_view_if_needed()
    box, session = page.locator(selector).bounding_box(), page.context.new_cdp_session(page)
    for kind, (x, y) in zip(["touchStart", *["touchMove"] * len(points)], points):
        session.send(
            "Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": box["x"] + x, "y": box["y"] + y}]}
        )
        frames(page)
    frames(page, 4)
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    frames(page)


def until(page: Any, condition: str) -> None:
    """Wait for a state, at most a minute."""
    page.wait_for_function(condition, timeout=60e3)


VIEWS = [(360, "light"), (360, "dark"), (1280, "light"), (1280, "dark")]


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_a_wall_is_pulled_dragged_on_its_map_and_judged(browser: Any, width: int, scheme: str) -> None:
    with opened(browser, "wall", width=width, color_scheme=scheme) as page:
        until(page, "() => trail.some(point => point[1] > EDGE + 1e-4)")  # the ghost pulls
        assert verdict(page).startswith("Buzzes: 129 %") and page.evaluate("pull.ghost")
        wide = page.locator("#scene").bounding_box()["width"]
        drag(page, "#scene", (0.33 * wide, 128), (0.7 * wide, 128), let_go=False)
        until(page, "() => loop.x > EDGE")
        assert page.evaluate("!pull.ghost && pull.target > EDGE")
        page.mouse.up()
        until(page, "() => pull.target === null && loop.x < EDGE")
        page.get_by_role("button", name="Softer: still").click()
        assert verdict(page).startswith("Holds still: 59 %")
        page.evaluate("state.stiffness = 10000; changed()")  # between the boundaries with the hand's spring and without
        assert verdict(page).startswith("Holds still alone, buzzes in the hand: 98 %") and "9\u202f922" in verdict(page)
        page.get_by_role("button", name="Twice as fast: still").click()
        assert verdict(page).startswith("Holds still") and "Dashed" in page.locator("#dashed").inner_text()
        # the dot of the map is the wall
        page.get_by_role("button", name="Softer: still").click()
        frames(page)
        x, y = page.evaluate("dot")
        drag(page, "#map", (x, y), (x + 10, y - 40), (x + 20, 40))
        assert verdict(page).startswith("Buzzes") and page.evaluate("state.stiffness > 10200 && state.damping > 80")
        # a number, by mouse and by keys
        stiffness = page.get_by_role("slider", name="stiffness")
        before = page.evaluate("state.stiffness")
        box = stiffness.bounding_box()
        drag(page, "[data-key=stiffness]", (box["width"] / 2, 12), (box["width"] / 2 - 120, 12))
        assert page.evaluate("state.stiffness") < before / 2 and verdict(page).startswith("Holds still")
        stiffness.press("PageUp")
        assert stiffness.get_attribute("aria-valuenow") == str(page.evaluate("state.stiffness"))
        page.locator("#map").press("ArrowUp")
        until(page, "() => location.hash === '#' + Object.values(state).join(',')")
        # the arrow keys pull
        page.locator("#scene").focus()
        page.keyboard.down("ArrowRight")
        assert page.evaluate("pull.target > loop.x")
        page.keyboard.up("ArrowRight")
        assert page.evaluate("pull.target") is None


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_friction_sticks_slips_and_is_judged(browser: Any, width: int, scheme: str) -> None:
    with opened(browser, "friction", width=width, color_scheme=scheme) as page:
        until(page, "() => !law.stuck")  # the ghost pulls it out
        until(page, "() => law.stuck")
        assert "3.0 N" in verdict(page)
        wide = page.locator("#scene").bounding_box()["width"]
        drag(page, "#scene", (0.5 * wide, 112), (0.9 * wide, 112), let_go=False)
        until(page, "() => loop.x > 3e-3")
        page.mouse.up()
        page.get_by_role("button", name="Pin too stiff").click()
        assert verdict(page).startswith("Buzzes while it sticks: a pin may have at most 8\u202f538 N/m")
        page.get_by_role("slider", name="damping").press("ArrowUp")
        assert page.evaluate("state.damping") == 61


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_a_pulse_is_dropped_and_judged(browser: Any, width: int, scheme: str) -> None:
    with opened(browser, "pulse", width=width, color_scheme=scheme) as page:
        assert "2.5\u00a0mm, not 3.6\u00a0mm, but needs 96\u00a0N" in verdict(page)
        assert page.evaluate("without.deepest.toFixed(5) === '0.00358' && braked.peak.toFixed(1) === '95.6'")
        page.get_by_role("button", name="Pulse of 90").click()
        assert "with 54\u00a0N at most" in verdict(page)
        wide = page.locator("#scene").bounding_box()["width"]
        page.evaluate("drop(false); held = true")
        frames(page)
        drag(page, "#scene", (0.25 * wide, 80), (0.25 * wide, 110), let_go=False)
        assert page.evaluate("held && clock === 0 && state.height < 4.4")
        page.mouse.up()
        until(page, "() => !held && clock === END")
        page.locator("#scene").press("ArrowUp")
        assert page.evaluate("state.height") >= 2.5


def test_a_finger_pulls_the_handle_and_the_dot_and_scrolls_elsewhere(browser: Any) -> None:
    with opened(browser, "wall", "6000,80,200,1.5", width=360, has_touch=True, is_mobile=True) as page:
        touch(page, "#scene", (110, 128), (150, 128), (230, 128), (250, 128))
        until(page, "() => loop.x > EDGE || !pull.ghost")
        assert page.evaluate("!pull.ghost && pull.target === null")
        page.locator("#map").scroll_into_view_if_needed()
        frames(page)
        place, (x, y) = page.evaluate("scrollY"), page.evaluate("dot")
        touch(page, "#map", (x, y), (x, y - 40), (x, y - 90))
        assert page.evaluate("scrollY") == place and page.evaluate("state.stiffness") > 7000
        wall, (x, y) = page.evaluate("state"), page.evaluate("dot")
        touch(page, "#map", (x + 120, 250), (x + 120, 200), (x + 120, 120), (x + 120, 40))  # beside the dot, upwards
        assert page.evaluate("state") == wall and page.evaluate("scrollY") > place
    with opened(browser, "pulse", width=360, has_touch=True, is_mobile=True) as page:
        page.evaluate("drop(false)")
        page.locator("#scene").scroll_into_view_if_needed()
        place = page.evaluate("scrollY")
        touch(page, "#scene", (165, 300), (165, 240), (165, 120), (165, 60))  # between the handles
        assert page.evaluate("scrollY") > place and page.evaluate("state.height") == 4.5


@pytest.mark.parametrize("width", [360, 390, 768, 1280, 1920])
@pytest.mark.parametrize("name", NAMES)
def test_no_texts_meet_and_none_leaves_its_canvas(browser: Any, name: str, width: int) -> None:
    with opened(browser, name, width=width) as page:
        wide = page.locator("#scene").bounding_box()["width"]
        for state in STATES[name]:
            page.evaluate(f"location.hash = '{state}'")
            frames(page, 3)
            if name == "pulse":
                page.evaluate("clock = END")  # with all that it says after a drop
            frames(page, 3)
            drag(page, "#scene", *((share * wide, height) for share, height in SPOTS[name]))
            frames(page, 2)
            assert page.evaluate("[...meeting]") == [], state
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), state


def test_the_notes_of_meeting_texts_note_one(browser: Any) -> None:
    with opened(browser, "wall") as page:
        page.evaluate(
            """() => {
              const [g] = pen($("#map"), 330);
              for (const [words, x, y] of [["one", 50, 50], ["two", 55, 52], ["three", -5, 90]]) text(g, words, x, y);
            }"""
        )
        assert page.evaluate("[...meeting]") == ["map: one meets two", "map: three leaves"]


@pytest.mark.parametrize("name", NAMES)
def test_sound_starts_and_stops(browser: Any, name: str) -> None:
    with opened(browser, name) as page:
        button = page.get_by_role("button", name="Sound")
        assert not page.evaluate("sound.on") and button.get_attribute("aria-pressed") == "false"
        page.evaluate("""() => {
          window.played = 0;
          const start = AudioBufferSourceNode.prototype.start;
          AudioBufferSourceNode.prototype.start = function (...when) {
            played += this.buffer.length;
            return start.apply(this, when);
          };
        }""")
        button.click()
        until(page, "() => played > 4000")
        assert page.evaluate("sound.on") and button.get_attribute("aria-pressed") == "true"
        button.click()
        frames(page)
        before = page.evaluate("played")
        frames(page, 10)
        assert not page.evaluate("sound.on") and page.evaluate("played") == before


BAD = ["x,80,-5", "1,2", "NaN,80,200,1.5", "1e99,-7,1e9,-1", "9,-7,1e9,-1,1e9", "%00", ",,,", "Infinity,1,1,1"]
"""Addresses that no page remembers."""


@pytest.mark.parametrize("name", NAMES)
def test_a_bad_address_gives_a_page_within_its_limits(browser: Any, name: str) -> None:
    with opened(browser, name, BAD[0]) as page:
        for state in BAD:
            page.evaluate("state => { location.hash = state; }", state)
            assert verdict(page) and "NaN" not in page.locator("main").inner_text()
            for key, value in page.evaluate("state").items():
                least, most = page.evaluate("key => [limits[key].least, greatest(limits[key])]", key)
                assert least <= value <= most, (state, key)


def test_with_reduced_motion_a_wall_is_a_still_picture_until_one_acts(browser: Any) -> None:
    with opened(browser, "wall", reduced_motion="reduce") as page:
        before = page.evaluate("loop.time")
        frames(page, 5)
        assert page.evaluate("loop.time") == before > 1.0
        page.locator("#map").press("ArrowUp")
        until(page, f"() => loop.time > {before}")


@pytest.mark.parametrize("name", NAMES)
def test_one_file_runs_by_itself_and_in_a_frame_that_says_the_scheme(browser: Any, name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.html"
    file.write_text(one_file(name), "utf-8")
    with opened(browser, name, file=file) as page:
        assert verdict(page) and page.locator("nav").count() == 0
    (tmp_path / "outer.html").write_text(f'<iframe src="{name}.html"></iframe>', "utf-8")
    context = browser.new_context(color_scheme="light")
    page = context.new_page()
    page.goto((tmp_path / "outer.html").as_uri())
    inner = page.frames[1]
    inner.wait_for_function("() => document.documentElement.classList.contains('framed')", timeout=60e3)
    light = inner.evaluate("palette.ink")
    height = page.evaluate(
        """() => new Promise(answer => {
          addEventListener("message", ({ data }) => answer(data.height));
          document.querySelector("iframe").style.width = "500px";
          frames[0].postMessage({ scheme: "dark" }, "*");
        })"""
    )
    assert height > 500
    inner.wait_for_function("light => palette.ink !== light", arg=light, timeout=60e3)
    context.close()


def test_the_pages_lead_to_one_another(browser: Any) -> None:
    with opened(browser, "wall") as page:
        for link, title in {
            "Static friction": "Static friction without a surface",
            "Braking pulse": "The braking pulse",
        }.items():
            page.get_by_role("link", name=link).click()
            assert page.locator("h1").inner_text() == title

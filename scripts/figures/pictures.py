"""Make the pictures of the documentation, from the product as it is.

    python scripts/figures/pictures.py [NAME ...]     # all but those of benchmarks and long studies, or those named
    python scripts/figures/pictures.py --check        # list renders and pages that are older than what they show

Pages need Debian's chromium and the package playwright. `--all` includes the studies, which take hours; the pictures
of benchmarks, speed_*.png, are those of `make bench`.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.cli.declare import Parser
from maglev_mj.pictures import line_style, name_curves, new_figure, save
from maglev_mj.recording import Recording
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.scenes.run import run
from maglev_mj.session import Pacer, Session
from maglev_mj.session.access import listen
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD
from maglev_mj.theory import DeviceLaw, stiffest_wall

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs/images"
MADE = IMAGES / "made.json"
"""Digest of the inputs of each render and page at the time it was made."""

_LIVE = [f"maglev_mj/views/{files}" for files in ("*.py", "page/*.py", "page/*.html", "window/*.py")]
INPUTS = {
    "views": ["model/**/*.xml", *_LIVE, "maglev_mj/plants/shapes.py"],
    "pages": [f"maglev_mj/views/pages/*.{suffix}" for suffix in ("html", "css", "js")],
}
"""What pictures show: model and live views, or pages of a browser alone; also the colours."""

_PATIENCE = 60.0


def digest(shows: str) -> str:
    """Return the digest of what pictures show; a key of `INPUTS`."""
    files = sorted({path for pattern in INPUTS[shows] for path in ROOT.glob(pattern)})
    files.append(ROOT / "maglev_mj/colours.py")
    parts = (path.read_bytes().replace(b"\r\n", b"\n") for path in files)
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def outdated() -> list[str]:
    """Return the names of renders and pages that were made of other model, views or pages."""
    made = json.loads(MADE.read_text("utf-8")) if MADE.exists() else {}
    now = {shows: digest(shows) for shows in INPUTS}
    return [name for name, picture in PICTURES.items() if picture.shows and made.get(name) != now[picture.shows]]


@dataclass(frozen=True)
class Picture:
    """How a picture is made.

    Attributes:
        make: Called with the path of the file to write.
        shows: What it shows, a key of `INPUTS`; empty for a chart.
        long: True if it takes more than a minute.
    """

    make: Callable[[Path], object]
    shows: str = "views"
    long: bool = False


def render(scene: str, path: Path, *options: str) -> None:
    """Render a scene."""
    _maglev("render", scene, "--bare", "--out", str(path), *(options or ("--size", "1120x700")))


_PAGES = {"mine.py": "compare.md", "device.py": "wall_on_the_device.md"}


def chart(path: Path, *command: str) -> None:
    """Run a command or script that writes charts into a folder, and keep one of them."""
    with tempfile.TemporaryDirectory() as folder:
        program = [str(ROOT / command[0])] if command[0].endswith(".py") else ["-m", "maglev_mj", command[0]]
        for name in _PAGES.keys() & set(command):  # the law of the page
            page = (ROOT / "docs/howto" / _PAGES[name]).read_text("utf-8")
            (Path(folder) / name).write_text(page.partition("```python\n")[2].partition("```")[0], "utf-8")
        words = [sys.executable, *program, *command[1:], "--out", folder]
        subprocess.run(words, check=False, stdout=subprocess.DEVNULL, cwd=folder)  # status 1: some runs do not settle
        shutil.copyfile(Path(folder) / path.name, path)


def assume_mass(file: Path, mass: float) -> None:
    """State another mass in the metadata of a recording, which its simulation takes."""
    recording = Recording.load(file)
    setup = recording.segments[0].setup
    setup["parameters"]["mass"] = setup["plant"]["mass"] = mass
    recording.save(file)


def analysed(path: Path, scene: str, *options: str, assumed_mass: float | None = None) -> None:
    """Record a run, state another mass in its metadata if asked, and keep a chart of its analysis."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.maglev"
        _maglev("run", scene, *options, "--record", str(file))
        if assumed_mass is not None:
            assume_mass(file, assumed_mass)
        _maglev("analyse", str(file), "--out", folder)
        shutil.copyfile(Path(folder) / path.name, path)


def _maglev(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "maglev_mj", *words], check=True, stdout=subprocess.DEVNULL)


@contextmanager
def shown(
    session: Session, width: int, height: int, camera: str = "home"
) -> Iterator[tuple[Any, Callable[[float], bytes]]]:
    """Yield a browser's page of a session, and a function that runs it for a time [s] and returns a screenshot."""
    from playwright.sync_api import sync_playwright

    from maglev_mj.views.page.page import Endpoint, Page, PageServer
    from maglev_mj.views.page.stage import look

    listener = listen(0)
    endpoint = Endpoint("127.0.0.1", listener.getsockname()[1])
    with redirect_stdout(StringIO()):  # viser's greeting
        server = PageServer(endpoint, listener)
    page = Page(server, session)
    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_browser(), args=flags)
        view = browser.new_page(viewport={"width": width, "height": height})
        view.goto(endpoint.url)
        view.wait_for_selector("canvas", timeout=1e3 * _PATIENCE)

        def run(seconds: float) -> bytes:
            session.tick(seconds)
            for _ in range(4):  # until the browser has drawn it
                page._apply()
                page._pose = np.empty(0)  # a sign of life, also of a scene at rest
                page._show()
                page._plots.show(session.snapshot())
                view.wait_for_timeout(60)
            return bytes(view.screenshot())

        # a slow screenshot must not look like a lost connection
        view.add_style_tag(content="#root { filter: none !important } #gone { display: none }")
        view.evaluate(
            "Object.defineProperty(document.querySelector('#root'), 'inert', { get: () => false, set: () => {} })"
        )
        end = time.monotonic() + 10.0
        while time.monotonic() < end:  # the first look takes long
            run(0.0)
        for client in server.get_clients().values():
            look(client, camera)
        yield view, run
        browser.close()
    server.stop()


def _browser() -> str | None:
    return shutil.which("chromium") or shutil.which("google-chrome")


def _live(**parameters: Any) -> Session:
    return Session(Joystick(**parameters), pacer=Pacer(budget=_PATIENCE, patience=3600.0))


def page_home(path: Path) -> None:
    """Write the page while the handle is pulled against a wall."""
    session = _live()
    with shown(session, 1280, 720) as (_, run):
        session.hand.target = [0.016, 0.0, 0.004, 0.0, 0.0, 0.0]
        run(0.5)
        path.write_bytes(run(0.5))


_TYPED = re.compile(r"(\d+) into (?:the box of the slider|that of) `(\w+)`(?: in the folder `(\w+)`)?")
"""A step of a page: number, label of the slider, and of its folder."""


def page_buzz(path: Path) -> None:
    """Type what the first steps say on the page, by their labels, pull, and write the page when it has been stopped."""
    text = " ".join((ROOT / "docs/tutorials/first_steps.md").read_text("utf-8").split())
    session = _live()
    with shown(session, 1280, 720) as (view, run):
        for number, label, folder in _TYPED.findall(text):
            if folder:
                view.get_by_role("button", name=folder, exact=True).click()
            box = view.locator(f"input[aria-label^='{label} [']")
            box.fill(number)
            box.press("Enter")
            run(0.05)
        session.hand.target = [0.016, 0.0, 0.0, 0.0, 0.0, 0.0]
        for _ in range(400):
            session.tick(0.05)
            if session.snapshot().state == "stopped":
                break
        else:
            raise RuntimeError("the steps of the page must make the wall unstable")
        for _ in range(4):  # the page has had no sign of life meanwhile
            picture = run(0.0)
        path.write_bytes(picture)


def wall(path: Path) -> None:
    """Write the page of a wall that buzzes, while a hand presses the handle into it."""
    from playwright.sync_api import sync_playwright

    from maglev_mj.views.pages import one_file

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = Path(folder, "wall.html")
        page.write_text(one_file("wall"), "utf-8")
        browser = playwright.chromium.launch(executable_path=_browser(), args=["--no-sandbox"])
        # with reduced motion it shows a still
        view = browser.new_page(viewport={"width": 830, "height": 900}, device_scale_factor=2, reduced_motion="reduce")
        view.goto(page.as_uri())
        view.wait_for_timeout(500)
        end = view.evaluate("document.querySelector('.grid').getBoundingClientRect().bottom")
        view.screenshot(path=path, clip={"x": 0, "y": 0, "width": 830, "height": end + 12})
        browser.close()


_WALLS: Mapping[str, dict[str, Any]] = {
    "force from the host": {"stiffness": 6000.0, "damping": 80.0},
    "damper on the device": {"stiffness": 30_000.0, "damping": 17.0, "device_damping": 200.0},
    "wall on the device": {"stiffness": 60_000.0, "damping": 200.0, "wall_on": "device"},
}
"""Scenes of the chart of walls on the device, each at most at half its critical stiffness but the first."""


def critical_stiffness() -> list[float]:
    """Return the critical stiffness of each kind of wall in the chart, at its best damping [N/m]."""
    host = {"period": 0.005, "delay": 0.0015, "mass": 0.7}
    loops = host, host | {"device": DeviceLaw(damping=200.0)}, host | {"period": DEVICE_PERIOD, "delay": DEVICE_DELAY}
    return [float(stiffest_wall(**loop).stiffness) for loop in loops]


def device_walls(path: Path) -> None:
    """Write drops on three walls over all sampling phases, and the critical stiffness of each kind."""
    critical = critical_stiffness()
    head = [f"A wall on the device may have {critical[2] / critical[0]:.0f} times the stiffness of one on the host"]
    head += ["0.7 kg, host 200 Hz, delay 1.5 ms, device 1 kHz, 0.2 ms, damper 200 N s/m, bands: all sampling phases"]
    figure, (left, right) = new_figure(head, 1, 2, 3.0)
    for index, (name, values) in enumerate(_WALLS.items()):
        drop = run(Drop(**values, pulse=0.0, duration=0.1), plant="exact", phase=np.arange(48) / 48)
        time, style = np.linspace(0.025, 0.099, 400), line_style(index)
        heights = 1e3 * drop.motion(time)[0]
        left.fill_between(1e3 * time, heights.min(1), heights.max(1), color=style["color"], alpha=0.25, linewidth=0)
        gains = f"{values['stiffness']:,.0f} N/m, {values['damping']:g} N s/m".replace(",", " ", 1)
        left.plot(1e3 * time, np.median(heights, axis=1), label=f"{name}, {gains}", **style)
        right.barh(name, critical[index] / 1e3, color=style["color"])
        right.annotate(f" {critical[index] / 1e3:.0f}", (critical[index] / 1e3, name), va="center", fontsize=9.0)
    left.set(xlabel="time (ms)", ylabel="height above the wall (mm)")
    right.set_xlabel("critical stiffness at the best damping (kN/m)")
    right.invert_yaxis()
    name_curves(left)
    save(figure, path)


_PAPER = {2: "stability", 3: "drop", 4: "phase_plane", 6: "press", 8: "stick_slip", 9: "six_axes"}
_LAWS = "--law pd --law pulse --law half-sample --law mine.py".split()
_STUDIES = {
    "stability_steps": "stability_steps",
    "nonlinear_walls": "stability_nonlinear",
    "measured_walls": "measured_walls",
    "two_walls": "two_walls",
    "friction_laws": "friction_laws",
    "where_methods_fail": " ".join(f"where_methods_fail_{name}" for name in ("timing", "pulse", "limits", "hands")),
}
_DESIGN = "design --mass 0.56:0.84 --delay 0.0012:0.0018 --hand arm,stylus,fingertip".split()


def _chart(*command: str, long: bool = False) -> Picture:
    return Picture(lambda path: chart(path, *command), shows="", long=long)


def _analysis(*command: str, **options: Any) -> Picture:
    return Picture(lambda path: analysed(path, *command, **options), shows="")


PICTURES: Mapping[str, Picture] = {
    **{f"scene_{name}.png": Picture(partial(render, name)) for name in ("joystick", "drop", "table", "box", "corner")},
    "scene_press.png": Picture(lambda path: render("press", path, "--size", "1120x700", "--seconds", "2.5")),
    "device.png": Picture(
        lambda path: subprocess.run([sys.executable, ROOT / "scripts/figures/render_device.py", path], check=True)
    ),
    "wall.png": Picture(wall, shows="pages"),
    "page_home.png": Picture(page_home),
    "page_buzz.png": Picture(page_buzz),
    **{
        f"fig{number}_{name}.png": _chart("scripts/figures/paper.py", "--figure", str(number), long=number in (2, 9))
        for number, name in _PAPER.items()
    },
    "analysis_contact.png": _analysis("drop", "--mass", "0.75", "--quantize", "5e-6", assumed_mass=0.7),
    "analysis_run.png": _analysis("press"),
    "analysis_sticks.png": _analysis("box", "--friction"),
    "stability.png": _chart(
        *"map --rate 1000 --delay 0.0005 --mass 0.15 --own-damping 20 --friction 0.6 --quantum 1e-5".split()
    ),
    "diagnosis.png": _chart(*"diagnose --stiffness 500 --damping 1 --rate 200 --delay 0.005 --mass 0.15".split()),
    "jitter.png": _chart(
        *"diagnose --stiffness 6000 --damping 80 --rate 200 --mass 0.7 --jitter 0.0005,0.0025".split()
    ),
    "compare_drop.png": _chart("compare", "drop", *_LAWS),
    "compare_drop_phases.png": _chart(*"compare drop --pulse 0 --law pd --law device.py".split()),
    "device_walls.png": Picture(device_walls, shows=""),
    "design.png": _chart(*_DESIGN),
    "gallery.png": _chart("scripts/examples/gallery.py"),
    **{
        f"{name}.png": _chart(f"scripts/studies/{study}.py", long=True)
        for study, names in _STUDIES.items()
        for name in names.split()
    },
}
"""All pictures by file name, but those of benchmarks."""


def main() -> int:
    """Make pictures, or list those that are out of date."""
    parser = Parser(description=__doc__, add_help=True)
    parser.add_argument("names", nargs="*", metavar="NAME", help="file names; default: all that take up to a minute")
    parser.add_argument("--all", action="store_true", help="also those of long studies")
    parser.add_argument(
        "--check", action="store_true", help="list renders and pages that are out of date; status 1 if any"
    )
    options = parser.parse_args()
    if options.check:
        print("\n".join(old := outdated()))
        return int(bool(old))
    names = options.names or [name for name, picture in PICTURES.items() if options.all or not picture.long]
    if unknown := [name for name in names if name not in PICTURES]:
        parser.error(f"NAME must be one of {', '.join(PICTURES)} (got {unknown[0]})")
    made = json.loads(MADE.read_text("utf-8")) if MADE.exists() else {}
    for name in names:
        print(name, flush=True)
        PICTURES[name].make(IMAGES / name)
        if shows := PICTURES[name].shows:
            made[name] = digest(shows)
            MADE.write_text(json.dumps(made, indent=1, sort_keys=True) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Pages of the docs: Python, commands and links checked."""

from __future__ import annotations

import ast
import json
import re
import shlex
import subprocess
import sys
import tempfile
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import (
    AbstractContextManager,
    chdir,
    contextmanager,
    nullcontext,
)
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pytest
from matplotlib.image import imread

import maglev_mj
from maglev_mj.bridge import State, Twin, TwinParameters
from maglev_mj.bridge.connection import estop
from maglev_mj.bridge.links import UdpServer
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import TwinServer
from maglev_mj.cli import parse
from maglev_mj.cli.declare import joined
from maglev_mj.cli.renamed import renewed
from maglev_mj.scenes import names

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    str(path.relative_to(ROOT))
    for pattern in ("*.md", "docs/**/*.md", "model/*.md", "scripts/**/*.md")
    for path in sorted(ROOT.glob(pattern))
]


LESSONS = [str(path.relative_to(ROOT)) for path in sorted(ROOT.glob("docs/lessons/*.ipynb"))]


@cache
def text_of(page: str) -> str:
    """Return the text of a page; of a lesson, that of its cells in words."""
    text = (ROOT / page).read_text(encoding="utf-8")
    if not page.endswith(".ipynb"):
        return text
    return "\n\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown")


def blocks(page: str, language: str) -> list[tuple[int, str]]:
    """Return a page's blocks of a language, with line numbers."""
    text = text_of(page)
    found = re.finditer(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return [(text.count("\n", 0, match.start(1)), match[1]) for match in found]


def own_files(page: str) -> dict[str, str]:
    """Return the reader's files on a page.

    Blocks with a name in the first line.
    """
    heads = {"python": r"# (\w+\.py)\n", "c": r"/\* (\w+\.[ch]) \*/\n"}
    found = ((re.match(head, block), block) for language, head in heads.items() for _, block in blocks(page, language))
    return {match[1]: block for match, block in found if match}


def code_of(page: str) -> list[tuple[int, str]]:
    """Return the blocks of a page that are typed in."""
    files = own_files(page).values()
    return [(before, block) for before, block in blocks(page, "python") if block not in files]


def write_files(page: str, folder: Path) -> None:
    """Write the files of a page, the examples that it names, and one for `my_scene.py` and `mine.toml`."""
    named = {*re.findall(r"scripts/examples/\w+\.py", text_of(page))}
    for name in filter(lambda name: (ROOT / name).is_file(), named):  # the changelog names earlier ones
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text_of(name), encoding="utf-8")
    own = {"my_scene.py": text_of("scripts/examples/detents.py"), "mine.toml": text_of("model/devices/stage.toml")}
    for name, text in {**own, **own_files(page)}.items():
        (folder / name).write_text(text, encoding="utf-8")


# what runs beside a page: a context, handed the lines that the page prints, of what to put in place of addresses


@contextmanager
def device(_: list[str]) -> Iterator[dict[str, str]]:
    """Run a twin, in lockstep.

    No flight then waits for real time.
    """
    twin = Twin(TwinParameters(lockstep=True))
    server = TwinServer(twin, UdpServer("127.0.0.1", 0))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        link = 'open_link("udp://{}:{}"), patience=60.0'.format(*server.address)  # a busy machine may need it
        yield {'open_link("udp://127.0.0.1:5678")': link}
        assert twin.firmware.state is State.INACTIVE and not twin.firmware.faults  # it has landed
    finally:
        server.stop()
        thread.join()
        server.close()


BESIDE: dict[str, Callable[[list[str]], AbstractContextManager[dict[str, str]]]] = {
    "docs/howto/fly.md": device,
}


THINNED = {
    "docs/howto/scene.md": {"print(measure_fidelity(scene, over=Range(phases=1, around=0.0)).level.level)": ""},
}
"""Replacements in the Python of expensive pages; as written they run as studies."""

FULL = ["docs/howto/compare.md"]
"""Expensive pages that run as studies only; `tests/studies/test_compare.py` has small cases of their calls."""


class PageRun(NamedTuple):
    """Output lines of a page's Python, names of the files that it writes, and results that a comment states.

    Each of those is the comment behind a statement, with what the statement prints or its value.
    """

    lines: list[str]
    files: set[str]
    comments: list[tuple[str, str]]


@cache
def run_page(page: str, thinned: bool = True) -> PageRun:
    """Run the Python of a page, block after block in one namespace and an empty folder; once per process."""
    lines, comments = list[str](), list[tuple[str, str]]()
    namespace: dict[str, Any] = {"__name__": page, "print": lambda *words: lines.append(" ".join(map(str, words)))}
    beside = BESIDE[page](lines) if page in BESIDE else nullcontext({})
    quick = patch("maglev_mj.studies.levels._LONG", 1e-9)  # computing times are taken once
    with tempfile.TemporaryDirectory() as folder, chdir(folder), quick, beside as replaced:
        write_files(page, Path())
        for before, block in code_of(page):
            code = "\n" * before + block  # a traceback tells the line of the page
            for written, meant in {**replaced, **(THINNED.get(page, {}) if thinned else {})}.items():
                code = code.replace(written, meant)
            for node in ast.parse(code).body:
                start, value = len(lines), None
                if isinstance(node, ast.Expr):
                    value = eval(compile(ast.Expression(node.value), page, "eval", dont_inherit=True), namespace)
                else:
                    exec(compile(ast.Module([node], []), page, "exec", dont_inherit=True), namespace)
                if comment := re.search(r"  # (.*\d.*)$", code.splitlines()[(node.end_lineno or 1) - 1]):
                    comments.append((comment[1], "\n".join([*lines[start:], repr(value)])))
        return PageRun(lines, {path.name for path in Path().iterdir()}, comments)


def shared(page: str) -> list[pytest.MarkDecorator]:
    """Return the marks of the tests of a page: one worker runs them all, and a page with a file in C is compiled."""
    compiled = any(name.endswith(".c") for name in own_files(page)) if page in PAGES else False
    return [pytest.mark.xdist_group(page), *[pytest.mark.needs("own compiler")] * compiled]


RUNNING = [page for page in PAGES if code_of(page)]


@pytest.mark.parametrize(
    ("page", "thinned"),
    [
        *(pytest.param(page, True, marks=shared(page)) for page in RUNNING if page not in FULL),
        *(pytest.param(page, False, marks=pytest.mark.study) for page in [*THINNED, *FULL]),
    ],
)
def test_the_python_of_a_page_runs(page: str, thinned: bool) -> None:
    lines, files, _ = run_page(page, thinned)
    if page == "docs/explanation/drop.md":
        assert len(code_of(page)[0][1].strip().splitlines()) <= 12  # a drop in ten lines
        assert lines[0].startswith("height in mm:") and "force in N:" in lines[0]
    elif page == "docs/reference/recording.md":
        assert -2.6e-3 < float(lines[-1]) < -2.2e-3
        assert "mine.maglev" in files
    elif page == "docs/howto/device.md":
        assert lines[0] == "1.0 kg"
        for one, other in (lines[1:3], lines[3:5]):  # both plants
            assert one.split(" ", 1)[1] == other.split(" ", 1)[1]


@pytest.mark.needs("drawing")
def test_the_scene_of_ones_own_is_made_as_the_page_says(tmp_path: Path) -> None:
    write_files("docs/reference/viewer.md", tmp_path)
    command = [sys.executable, "-m", "maglev_mj", "render", "shaft.py", "--out", "shaft.png", "--width", "0.003"]
    command += ["--size", "320x200"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "  wrote shaft.png\n", "")
    picture = imread(tmp_path / "shaft.png")
    assert picture.shape[:2] == (200, 320) and len(np.unique(picture.reshape(200 * 320, -1), axis=0)) > 400  # colours


def written_commands(page: str) -> Iterator[str]:
    """Yield the arguments of each `maglev-mj` command of a page."""
    for line in text_of(page).splitlines():
        if line.startswith("    "):
            yield from re.findall(r"maglev-mj (.*?)(?: *[#&].*| \|.*)?$", line)
        else:
            yield from (re.split(r" [|&]", text)[0] for text in re.findall(r"`maglev-mj ([^`]*)`", line))


def typed(command: str) -> list[str]:
    """Return a command's arguments with placeholders filled in."""
    command = re.sub(r"[\[\]]", " ", command)  # options, all at once
    command = re.sub(r"(\w+)(\|\w+)+", r"\1", command)  # the first of several
    words = [re.sub(r"^(X|N|\.\.\.)$", "1", word) for word in shlex.split(command.replace("SCENE", "drop"))]
    return joined(words if words[1:] else [*words, "--help"])  # one alone is spoken of, not typed


COMMANDS = {page: sorted({*written_commands(page)}) for page in [*PAGES, *LESSONS]}


@pytest.mark.parametrize("page", [page for page, commands in COMMANDS.items() if commands])
def test_the_commands_of_a_page_are_understood(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(names, "installed_scenes", cache(names.installed_scenes))
    write_files(page, tmp_path)
    for command in COMMANDS[page]:
        assert page == "CHANGELOG.md" or renewed(typed(command)) is None, f"{page}: maglev-mj {command}"
        try:
            parse(typed(command))
        except SystemExit as ended:
            assert ended.code == 0, f"{page}: maglev-mj {command}"  # --help


def test_the_files_that_pages_name_are_there() -> None:
    for page in (page for page in PAGES if page != "CHANGELOG.md"):
        linked = [(ROOT / page).parent / name for name in re.findall(r"\]\((?!http)([^)#]+)", text_of(page))]
        named = [ROOT / name for name in re.findall(r"\b(?:scripts|tests|docs|model)/[\w/]+\.\w+", text_of(page))]
        missing = {str(path.relative_to(ROOT)) for path in linked + named if not path.exists()}
        assert missing <= {"model/scenes/shaft.xml"}, page  # the reader's own


def test_the_readme_of_the_package_has_no_relative_link() -> None:
    build = tomllib.loads(text_of("pyproject.toml"))["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    text = text_of("README.md")
    linked = re.findall(r"\]\(([^)#]+)|<img src=\"([^\"]+)", text)
    for one in build["substitutions"]:
        text = re.sub(one["pattern"], one["replacement"], text)
    assert len(linked) > 20
    assert re.findall(r"(?:\]\(|<img src=\")(?!https://).*", text) == []
    images = re.findall(r"https://raw[^)\"]*/main/([^)\"]+)", text)
    assert images and all((ROOT / image).is_file() for image in images)


def test_the_citation_has_the_version_of_the_package() -> None:
    assert re.findall(r"^version: (.*)$", text_of("CITATION.cff"), re.MULTILINE) == [maglev_mj.__version__]


def test_pages_and_examples_take_a_name_from_the_top_of_the_package() -> None:
    pages = [page for page in PAGES if page.startswith(("README", "docs/tutorials", "docs/howto"))]
    code = {page: "".join(block for _, block in blocks(page, "python")) for page in pages}
    code |= {path.name: path.read_text(encoding="utf-8") for path in ROOT.glob("scripts/examples/*.py")}
    taken = {
        f"{name}: {alias.name}"
        for name, text in code.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("maglev_mj.")
        for alias in node.names
        if alias.name in dir(maglev_mj)
    }
    assert taken == set() and len(code) > 15


def test_every_name_of_the_package_has_an_example() -> None:
    found = {name: getattr(maglev_mj, name) for name in dir(maglev_mj)}
    assert not [name for name, one in found.items() if callable(one) and ">>> " not in (one.__doc__ or "")]


def test_the_emergency_stop_says_what_the_drill_waits_for() -> None:
    quoted = re.findall(r"says `([^`]+)`; `([^`]+)` means", text_of("docs/howto/commission.md"))
    report = estop(VirtualLink(Twin(TwinParameters())))
    assert [(re.sub(r"[\d.]+", "0", stopped), failed) for stopped, failed in quoted] == [
        (re.sub(r"[\d.]+", "0", str(report)), str(report._replace(confirmed=False)).partition(" (")[0])
    ]

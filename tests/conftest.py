"""Settings of the tests' workers, and what some tests need beside Python packages."""

from __future__ import annotations

import gc
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from ctypes.util import find_library
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads only wait, on cores that others need
os.environ["LANGUAGE"] = "C"  # else each option of a command line is looked for in catalogues of translations

# a shell lets what it runs in the background ignore Ctrl-C, and so would the programs that tests start
signal.signal(signal.SIGINT, signal.default_int_handler)

gc.disable()  # until all tests are collected: a third of the time that takes

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


BROWSERS = "chromium", "chromium-browser", "google-chrome"


class Need(NamedTuple):
    """Need of tests: its name, how to ask for it, and its Debian packages."""

    name: str
    there: Callable[[], bool]
    packages: str = ""


def _has_sanitizers() -> bool:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "empty.c")
        source.write_text("int main(void) { return 0; }\n")
        command = [str(COMPILER), "-fsanitize=address,undefined", str(source), "-o", str(source.with_suffix(""))]
        return COMPILER is not None and subprocess.run(command, capture_output=True, check=False).returncode == 0


def _draws() -> bool:
    from maglev_mj.views.window.backend import DisplayError, drawing_library

    try:
        return bool(drawing_library())
    except DisplayError:
        return False


def _has_header(name: str) -> bool:
    return any(Path(folder, name).is_file() for folder in ("/usr/include", "/usr/local/include"))


NEEDS = {
    "drawing": Need("drawing off screen", _draws, "libosmesa6"),
    "screen": Need("a virtual screen", lambda: bool(shutil.which("Xvfb") and find_library("GL")), "xvfb libgl1"),
    "xdotool": Need("xdotool", lambda: shutil.which("xdotool") is not None, "xdotool"),
    "browser": Need("Chromium", lambda: any(map(shutil.which, BROWSERS)), "chromium"),
    "compiler": Need("a C compiler", lambda: COMPILER is not None, "gcc libc6-dev"),
    "sanitizers": Need("a C compiler's sanitizers", _has_sanitizers, "gcc libc6-dev"),
    "cross": Need("a compiler for boards", lambda: bool(shutil.which("arm-none-eabi-gcc")), "gcc-arm-none-eabi"),
    "emulator": Need("an emulator of boards", lambda: bool(shutil.which("qemu-system-arm")), "qemu-system-arm"),
    "spnav": Need("libspnav", lambda: _has_header("spnav.h") and _has_header("X11/Xlib.h"), "libspnav-dev libx11-dev"),
    "linux": Need("Linux", lambda: sys.platform == "linux"),
    "pty": Need("pseudo-terminals", lambda: hasattr(os, "openpty")),
    "workers": Need("several workers, -n", lambda: "PYTEST_XDIST_WORKER" in os.environ),
}
PEERS = {"bdsim", "control", "drake", "mujoco", "pinocchio", "pybullet", "rerun", "scipy", "xarray"}
"""Others' programs, which `make test` does not install."""


@cache
def _lacks(need: str) -> str:
    """Return the reason to skip a test with a need, empty for none."""
    if need in PEERS:
        module = {"drake": "pydrake"}.get(need, need)
        return "" if importlib.util.find_spec(module) else f"peer {need} is not installed"
    return "" if NEEDS[need].there() else f"needs {NEEDS[need].name}"


_LINES = pytest.StashKey[Path | None]()
"""File through which the first worker tells what is missing; None in others."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the gate's option."""
    parser.addoption("--nothing-missing", action="store_true", help="fail if any test but those of peers is skipped")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker, and a file through which workers tell."""
    config.addinivalue_line("markers", f"needs(name): skipped without it, of {', '.join([*NEEDS, *sorted(PEERS)])}")
    known = getattr(config, "workerinput", {"lines": ""}).get("lines")
    config.stash[_LINES] = None if known is None else Path(known or tempfile.mkstemp()[1])


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Hand the first worker the file."""
    if node.gateway.id == "gw0":
        node.workerinput["lines"] = str(node.config.stash[_LINES])


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip tests that lack a need."""
    for item in items:
        if lacking := sorted(filter(None, map(_lacks, _needs(item)))):
            item.add_marker(pytest.mark.skip(reason="; ".join(lacking)))


def _needs(item: pytest.Item) -> set[str]:
    return {name for mark in item.iter_markers("needs") for name in mark.args}


@pytest.hookimpl(tryfirst=True)  # before a worker says that it has collected
def pytest_collection_finish(session: pytest.Session) -> None:
    """Say what is missing, and exclude tests and modules from garbage collection."""
    lacked = {name for item in session.items for name in _needs(item) - PEERS if _lacks(name)}
    file = session.config.stash[_LINES]
    if lacked and file is not None:
        count = sum(bool(_needs(item) & lacked) for item in session.items)
        packages = " ".join(dict.fromkeys(" ".join(NEEDS[name].packages for name in NEEDS if name in lacked).split()))
        names = ", ".join(NEEDS[name].name for name in NEEDS if name in lacked)
        brought = f"to run them too: apt install {packages}\n" if packages else ""
        file.write_text(f"missing here: {names}; {count} tests are left out\n{brought}")
    if not hasattr(session.config, "workerinput"):
        _say(session.config)
    gc.enable()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node: Any) -> None:
    """Say what is missing before the first test."""
    if node.gateway.id == "gw0":
        _say(node.config)


def _say(config: pytest.Config) -> None:
    file, reporter = config.stash[_LINES], config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and file is not None and file.exists():
        for line in file.read_text().splitlines():
            reporter.write_line(line)
        file.unlink()


def _skipped(config: pytest.Config) -> Counter[str]:
    """Return how many tests were skipped, by reason."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    reports = [] if reporter is None else reporter.stats.get("skipped", [])
    return Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in reports)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Name the skipped tests by reason, the most frequent first."""
    for reason, count in sorted(_skipped(config).items(), key=lambda one: (-one[1], one[0])):
        terminalreporter.write_line(f"{count:4} skipped: {reason}")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail if more than peers was skipped, where that is asked."""
    missed = [reason for reason in _skipped(session.config) if not reason.startswith("peer ")]
    if missed and session.config.getoption("--nothing-missing") and not hasattr(session.config, "workerinput"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return one worker more than there are cores.

    Tests in real time mostly wait.
    """
    return (os.cpu_count() or 1) + 1


@pytest.fixture(scope="session", autouse=True)
def _locked_as_touched() -> Iterator[None]:
    """Lock memory as it is touched in real-time loops of this process.

    All that a worker of the tests has asked for are gigabytes, and 0.2 s of each loop.
    """
    realtime = sys.modules.get("maglev_mj.bridge.realtime")  # no test that needs it not has to load it
    if realtime is None:
        yield
        return
    with patch.object(realtime, "_CURRENT_AND_FUTURE", 1 | 2 | 4):  # MCL_ONFAULT
        yield


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Exclude a file's remains from garbage collection.

    Takeoffs and real-time loops collect garbage first: 0.1 s each in a process with all that the tests import.
    """
    if nextitem is None or item.path != nextitem.path:
        gc.collect()
        gc.freeze()

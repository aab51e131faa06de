"""Settings of the tests: what needs the machine, what each test may cost, and what some need beside Python packages."""

from __future__ import annotations

import gc
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
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


NEEDS = {
    "drawing": Need("drawing off screen", _draws, "libosmesa6"),
    "screen": Need("a virtual screen", lambda: bool(shutil.which("Xvfb") and find_library("GL")), "xvfb libgl1"),
    "xdotool": Need("xdotool", lambda: shutil.which("xdotool") is not None, "xdotool"),
    "browser": Need("Chromium", lambda: any(map(shutil.which, BROWSERS)), "chromium"),
    "node": Need("Node.js", lambda: shutil.which("node") is not None, "nodejs"),
    "compiler": Need("a C compiler", lambda: COMPILER is not None, "gcc libc6-dev"),
    "own compiler": Need("a C compiler", lambda: COMPILER is not None),  # used where it is, no reason to install one
    "sanitizers": Need("a C compiler's sanitizers", _has_sanitizers, "gcc libc6-dev"),
    "cross": Need("a compiler for boards", lambda: bool(shutil.which("arm-none-eabi-gcc")), "gcc-arm-none-eabi"),
    "emulator": Need("an emulator of boards", lambda: bool(shutil.which("qemu-system-arm")), "qemu-system-arm"),
    "linux": Need("Linux", lambda: sys.platform == "linux"),
    "pty": Need("pseudo-terminals", lambda: hasattr(os, "openpty")),
}
"""Needs of tests. One that takes a Debian package makes them tests of the machine."""

PEERS = {"bdsim", "control", "drake", "mujoco", "pinocchio", "pybullet", "rerun", "scipy", "xarray"}
"""Other projects' packages, which `make test` does not install."""

LIMIT, SHARED = 2.0, 5.0
"""Processor time allowed for one test and for the fixtures set up before it [s], on the reference machine."""

REFERENCE = 0.10
"""Processor time of the loop in `_slowness` on the reference machine [s]."""


@cache
def _lacks(need: str) -> str:
    """Return the reason to skip a test with a need, empty for none."""
    if need in PEERS:
        module = {"drake": "pydrake"}.get(need, need)
        return "" if importlib.util.find_spec(module) else f"peer {need} is not installed"
    return "" if NEEDS[need].there() else f"needs {NEEDS[need].name}"


def _needs(item: pytest.Item) -> set[str]:
    return {name for mark in item.iter_markers("needs") for name in mark.args}


def _marked(item: pytest.Item, *names: str) -> bool:
    return any(item.get_closest_marker(name) for name in names)


def _packages(needs: Sequence[Need]) -> str:
    return " ".join(dict.fromkeys(" ".join(need.packages for need in needs).split()))


_LEFT = pytest.StashKey[int]()
"""Number of deselected tests that need the machine."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the gate's option."""
    parser.addoption("--nothing-missing", action="store_true", help="fail if any test but those of peers is skipped")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker of needs."""
    config.addinivalue_line("markers", f"needs(name): skipped without it, of {', '.join([*NEEDS, *sorted(PEERS)])}")


@pytest.hookimpl(tryfirst=True)  # before tests are deselected by their markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that need a Debian package as tests of the machine."""
    for item in items:
        if any(NEEDS[name].packages for name in _needs(item) & NEEDS.keys()):
            item.add_marker("machine")


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    """Count the tests that only `make test-machine` runs."""
    left = sum(_marked(item, "machine") and not _marked(item, "study") for item in items)
    config = items[0].config
    config.stash[_LEFT] = left
    if hasattr(config, "workeroutput"):
        config.workeroutput["left"] = left


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take over the count of a worker."""
    node.config.stash[_LEFT] = getattr(node, "workeroutput", {}).get("left", 0)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Skip tests that lack a need, and exclude tests and modules from garbage collection."""
    for item in session.items:  # those that are not deselected: asking for a compiler takes a while
        if lacking := sorted(filter(None, map(_lacks, _needs(item)))):
            item.add_marker(pytest.mark.skip(reason="; ".join(lacking)))
    gc.enable()
    gc.freeze()


def _used() -> float:
    """Return the processor time of this process and of its ended children [s]."""
    return sum(os.times()[:4])


def _slowness() -> float:
    """Return how much slower this machine is at the moment than the reference, 1 to 3."""
    begun = time.process_time()
    sum(index * index % 7 for index in range(1_000_000))
    return min(max((time.process_time() - begun) / REFERENCE, 1.0), 3.0)


def _is_overloaded() -> bool:
    """Return True if processor time says little: the cores are shared, or BLAS has another processor's kernel."""
    busy = hasattr(os, "getloadavg") and os.getloadavg()[0] > 1.5 * (os.cpu_count() or 1)
    return busy or "OPENBLAS_CORETYPE" in os.environ


def _check_cost(item: pytest.Item, begun: float, limit: float) -> None:
    """Fail a test of `make test` that has used more processor time than allowed since `begun`."""
    used = _used() - begun
    if used <= limit or _marked(item, "study", "machine") or _is_overloaded():
        return
    if used > (limit := limit * _slowness()):
        reason = f"{used:.1f} s of processor time, limit {limit:.1f} s: thin it, share its fixture or mark it study"
        pytest.fail(reason, pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, None, None]:
    """Fail a test whose fixtures use too much processor time."""
    begun = _used()
    yield
    _check_cost(item, begun, SHARED)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Fail a test that uses too much processor time."""
    begun = _used()
    yield
    _check_cost(item, begun, LIMIT)


def _skipped(config: pytest.Config) -> Counter[str]:
    """Return how many tests were skipped, by reason."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    reports = [] if reporter is None else reporter.stats.get("skipped", [])
    return Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in reports)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Name the skipped tests by reason, the most frequent first, and the packages that they miss."""
    skipped = _skipped(config)
    for reason, count in sorted(skipped.items(), key=lambda row: (-row[1], row[0])):
        terminalreporter.write_line(f"{count:4} skipped: {reason}")
    reasons = "; ".join(skipped).split("; ")
    if missing := [need for need in NEEDS.values() if need.packages and f"needs {need.name}" in reasons]:
        terminalreporter.write_line(f"to run them too: apt install {_packages(missing)}")


@pytest.fixture(autouse=True)
def _path_of_imports() -> Iterator[None]:
    """Restore the path of imports: pages and files of scenes extend it, and later tests would import from there."""
    before = [*sys.path]
    yield
    sys.path[:] = before


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail if more than peers was skipped, where that is asked."""
    missed = [reason for reason in _skipped(session.config) if not reason.startswith("peer ")]
    if missed and session.config.getoption("--nothing-missing") and not hasattr(session.config, "workerinput"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_unconfigure(config: pytest.Config) -> None:
    """Name the tests that were left out, on the last line."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if (left := config.stash.get(_LEFT, 0)) and reporter is not None and not hasattr(config, "workerinput"):
        reporter.write_line(
            f"{left} more tests need the machine (processes, sockets, a window, a browser, an emulated board): "
            f"make test-machine. On Debian they need: apt install {_packages([*NEEDS.values()])}"
        )


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

"""The settings of the tests themselves: what is skipped, left out and too expensive."""

import subprocess
import sys
from pathlib import Path

from tests import conftest

TESTS = """
import pytest

@pytest.mark.needs("xdotool")
@pytest.mark.parametrize("number", range(3))
def test_keys(number):
    pass

@pytest.mark.needs("browser", "xdotool")
def test_page():
    pass

@pytest.mark.needs("rerun")
def test_peer():
    pass

@pytest.mark.machine
def test_flight():
    pass

@pytest.mark.machine
@pytest.mark.study
def test_many_flights():
    pass

def test_rest():
    pass
"""
ALL_PACKAGES = "libosmesa6 xvfb libgl1 xdotool chromium gcc libc6-dev gcc-arm-none-eabi qemu-system-arm"
SUITE, MACHINE = ("-m", "not study and not machine"), ("-m", "machine and not study")


def run(folder: Path, *options: str) -> tuple[int, str]:
    """Run tests under the settings of this suite where no program is installed; return status and output."""
    (folder / "conftest.py").write_text(Path(conftest.__file__).read_text())
    (folder / "test_some.py").write_text(TESTS)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-W", "ignore", *options, str(folder)],
        env={"PATH": str(folder)},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def test_the_last_line_names_the_tests_that_are_left_out(tmp_path: Path) -> None:
    """Studies do not count, and the gate does not fail where a peer alone is skipped."""
    status, out = run(tmp_path, *SUITE, "--nothing-missing", "-p", "no:xdist")
    *_, summary, last = out.splitlines()
    assert status == 0 and "1 passed, 1 skipped, 6 deselected" in summary, out
    assert last.startswith("5 more tests need the machine (") and last.endswith(f": apt install {ALL_PACKAGES}")
    assert ": make test-machine. " in last


def test_skipped_tests_are_named_by_reason_with_their_packages_and_fail_the_gate(tmp_path: Path) -> None:
    status, out = run(tmp_path, *MACHINE, "-p", "no:xdist", "--nothing-missing")
    assert status == 1 and [line.strip() for line in out.splitlines()[-4:-1]] == [
        "3 skipped: needs xdotool",
        "1 skipped: needs Chromium; needs xdotool",
        "to run them too: apt install xdotool chromium",
    ], out
    assert "1 passed, 4 skipped" in out.splitlines()[-1]

"""The settings of the tests themselves: what is skipped, left out and too expensive."""

import subprocess
import sys
from pathlib import Path

import pytest

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
BURNERS = """
import subprocess, sys, time
import pytest

BURN = "import time\\nwhile time.process_time() < 0.3: pass"

def burn(start=0.0):
    end = time.process_time() + 0.3
    while time.process_time() < end: pass

@pytest.fixture(scope="module")
def dear():
    burn()

def test_burns(): burn()
def test_child_burns(): subprocess.run([sys.executable, "-c", BURN])
def test_fixture_burns(dear): pass
def test_fixture_is_shared(dear): pass
def test_sleeps(): time.sleep(0.5)
@pytest.mark.study
def test_study_burns(): burn()
@pytest.mark.machine
def test_machine_burns(): burn()
"""
EXTENDS = """
import sys

def test_extends(): sys.path.insert(0, "elsewhere")
def test_is_restored(): assert "elsewhere" not in sys.path
"""
ALL_PACKAGES = "libosmesa6 xvfb libgl1 xdotool chromium nodejs gcc libc6-dev gcc-arm-none-eabi qemu-system-arm"
SUITE, MACHINE = ("-m", "not study and not machine"), ("-m", "machine and not study")


def run(
    folder: Path, *options: str, tests: str = TESTS, limit: str = "LIMIT, SHARED = 2.0, 5.0", load: str = "0.0"
) -> tuple[int, str]:
    """Run tests under the settings of this suite where no program is installed; return status and output."""
    settings = Path(conftest.__file__).read_text().replace("os.getloadavg()[0]", load)
    assert "LIMIT, SHARED = 2.0, 5.0" in settings and f"{load} > 1.5" in settings
    (folder / "conftest.py").write_text(settings.replace("LIMIT, SHARED = 2.0, 5.0", limit))
    (folder / "test_some.py").write_text(tests)
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


def test_no_test_imports_from_where_one_before_it_did(tmp_path: Path) -> None:
    status, out = run(tmp_path, "-p", "no:xdist", tests=EXTENDS)
    assert status == 0 and "2 passed" in out, out


@pytest.mark.machine
def test_a_test_that_uses_too_much_processor_time_fails(tmp_path: Path) -> None:
    """Its child processes count, waiting does not; studies and tests of the machine have no limit."""
    status, out = run(tmp_path, "-p", "no:xdist", "-rfE", tests=BURNERS, limit="LIMIT, SHARED = 0.05, 0.05")
    lines = [line.split(" - ")[0] for line in out.splitlines() if line.startswith(("FAILED", "ERROR"))]
    assert status == 1 and sorted(line.replace("test_some.py::", "") for line in lines) == [
        "ERROR test_fixture_burns",
        "FAILED test_burns",
        "FAILED test_child_burns",
    ], out
    assert "s of processor time, limit 0." in out and "mark it study" in out
    # where other programs share the cores nothing is judged
    assert run(tmp_path, "-p", "no:xdist", tests=BURNERS, limit="LIMIT, SHARED = 0.05, 0.05", load="1e9")[0] == 0

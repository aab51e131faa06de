"""The settings of the tests themselves: what is said of tests that lack something."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests import conftest

TESTS = """
import pytest

@pytest.mark.needs("xdotool")
@pytest.mark.parametrize("number", range(1000))
def test_keys(number):
    pass

@pytest.mark.needs("browser", "xdotool")
def test_page():
    pass

@pytest.mark.needs("rerun")
def test_peer():
    pass

def test_rest():
    pass
"""


def run(folder: Path, *options: str) -> tuple[int, list[str]]:
    """Run the tests where no program is found."""
    (folder / "conftest.py").write_text(Path(conftest.__file__).read_text())
    (folder / "test_some.py").write_text(TESTS)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options, str(folder)],
        env={"PATH": str(folder)},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout.splitlines()


@pytest.mark.parametrize("workers", ["0", "2"])
def test_what_is_missing_is_said_first_and_skips_are_named_last(workers: str, tmp_path: Path) -> None:
    status, lines = run(tmp_path, "-n", workers)
    first = lines.index("missing here: xdotool, Chromium; 1001 tests are left out")
    assert lines[first + 1] == "to run them too: apt install xdotool chromium"
    assert status == 0 and first < next(row for row, line in enumerate(lines) if "s" in line and "%]" in line)
    assert [line.strip() for line in lines[-5:-1] if "skipped:" in line] == [
        "1000 skipped: needs xdotool",
        "1 skipped: needs Chromium; needs xdotool",
        "1 skipped: peer rerun is not installed",
    ]


def test_the_gate_fails_where_more_than_a_peer_is_skipped(tmp_path: Path) -> None:
    assert run(tmp_path, "-n", "0", "--nothing-missing")[0] == 1
    assert run(tmp_path, "-n", "0", "--nothing-missing", "-k", "peer or rest")[0] == 0

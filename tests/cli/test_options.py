"""Options of the command line that declared parameters give."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Any

import pytest

from maglev_mj import cli
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin.twin import TwinParameters
from maglev_mj.cli import output, peripherals, program
from maglev_mj.cli import twin as cli_twin
from maglev_mj.cli.declare import Parser
from maglev_mj.cli.options import add_parameters, chosen
from maglev_mj.cli.program import COMMANDS
from maglev_mj.interop.hand_devices import AUTO
from maglev_mj.parameters import Parameters, param
from maglev_mj.pictures import FORMATS


class Lever(Parameters):
    """One parameter of each kind."""

    length: float = param("length of the arm; 0 for none", "m", default=0.5, at_least=0.0)
    twice: float = param("twice that", "m", default=None, derive=lambda lever: 2.0 * lever.length)
    load: float | None = param("load, 100 % of it", "kg", default=None, optional=True)
    count_of: int = param("how many", default=3, at_least=1)
    kind: str = param("kind", default="first", choices=("first", "second"))
    locked: bool = param("locked", default=True)
    ends: tuple[float, float] = param("ends", default=(0.0, 1.0), parse=tuple)


def parser(parameters: Lever | type[Lever], **keywords: Any) -> Parser:
    made = Parser(prog="lever")
    add_parameters(made, parameters, **keywords)
    return made


def given(*words: str, parameters: Lever | type[Lever] = Lever) -> Lever:
    return chosen(parser(parameters).parse_args(words), parameters)


def test_nothing_given_leaves_every_default() -> None:
    assert vars(parser(Lever).parse_args([])) == {}
    assert given() == Lever()
    other = Lever(length=2.0, load=3.0, locked=False, ends=(1.0, 2.0))
    assert given(parameters=other) == other


def test_each_kind_of_parameter_has_its_option() -> None:
    words = "--length 1 --load 4 --count-of 2 --kind second --no-locked".split()
    assert given(*words) == Lever(length=1.0, load=4.0, count_of=2, kind="second", locked=False)
    assert given("--load", "none", parameters=Lever(load=3.0)).load is None


def test_a_derived_value_follows_an_option_unless_it_was_given() -> None:
    assert given("--length", "3").twice == 6.0
    assert given("--length", "3", parameters=Lever(twice=1.0)).twice == 1.0


def test_the_help_has_unit_and_default() -> None:
    text = " ".join(parser(Lever(length=0.25)).format_help().split())
    assert "length of the arm [m]; 0 for none (default 0.25)" in text
    assert "twice that [m] (default 0.5)" in text
    assert "load, 100 % of it [kg] (default none)" in text
    assert "how many (default 3)" in text
    assert "kind: first, second (default first)" in text
    assert "locked (default on)" in text
    assert "--ends" not in text
    assert "--length" not in parser(Lever, without=["length"]).format_help()


CALLS = 541
"""Calls of this package until the first law of `drop` acts. A commit that raises it says what was bought.

The default force limit, which is that of the device, took 9 of them.
"""
_COUNT = """
import collections, sys
from maglev_mj import cli
from maglev_mj.control import Hold, Wall

laws, calls = {Wall.__call__.__code__, Hold.__call__.__code__}, []
inlined = {"<listcomp>", "<dictcomp>", "<setcomp>"}  # by later versions of Python

def name(frame):
    return str(frame.f_globals.get("__name__"))

def count(frame, event, _):
    code = frame.f_code
    if code in laws:
        sys.setprofile(None)
    elif event == "call" and code.co_name not in inlined and name(frame).startswith("maglev_mj."):
        calls.append(code.co_qualname)

for _ in range(2):  # the second time with all modules loaded
    calls.clear()
    sys.setprofile(count)
    status = cli.main("drop --stiffness 4000 --duration 0.01".split())
    sys.setprofile(None)
print("\\n", status, len(calls), collections.Counter(calls).most_common(9))
"""


def test_a_command_line_is_a_short_way_to_the_first_law() -> None:
    # In a process of its own, whose imports no other test decides: parameters, two sets of laws (whether the pulse
    # decides), plant and controller of the first run.
    done = subprocess.run([sys.executable, "-c", _COUNT], capture_output=True, text=True, check=True)
    status, count, most = done.stdout.splitlines()[-1].split(maxsplit=2)
    assert (int(status), int(count)) == (0, CALLS), most


NEEDED = {
    "render": "--out a.png",
    "run": "drop",
    "stability": "drop",
    "sweep": "drop",
    "compare": "drop",
    "fidelity": "drop",
    "bridge": "udp://127.0.0.1:9",
    "estop": "udp://127.0.0.1:9",
    "lessons": "lessons",
    "commission": "udp://127.0.0.1:9 spots",
    "conform": "udp://127.0.0.1:9",
    "replay": "a.maglev",
    "analyse": "a.maglev",
    "convert": "a.csv a.maglev --columns time=t z=z --mass 1",
}
TIMED = set("sweep view render run diagnose stability map design card compare fidelity twin".split())
TIMED |= {"convert"}


def test_a_rate_is_understood_where_a_period_is() -> None:
    for command in COMMANDS:
        words = [command, *NEEDED.get(command, "").split()]
        found = []
        for more in ("--period=0.002", "--rate=500"):
            with suppress(SystemExit):
                options = vars(program.parse([*words, more]))
                found.append({name: value for name, value in options.items() if name == "rate" or "period" in name})
        known = {"rate": 500.0} if command in ("twin", "sweep", "convert") else {"parameter period": 0.002}
        assert found == (1 if command == "sweep" else 2) * [known] * (command in TIMED), command


def test_a_scene_may_have_a_rate_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(
        "from maglev_mj import Scene, param\n"
        "class Own(Scene):\n"
        "    rate: float = param('of something', default=3.0)\n"
        "    def laws(self):\n"
        "        return []\n"
    )
    options = program.parse(["run", str(path), "--rate", "7"])
    assert vars(options)["parameter rate"] == 7.0 and "parameter period" not in vars(options)


def test_without_a_display_the_page_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for command in ("view", "view --tour", "twin --view"):
        assert cli.main(command.split()) == 1
        assert "--web (browser)" in capsys.readouterr().err


QUICK = "twin estop commission conform replay analyse convert".split()


def test_a_help_without_a_scene_loads_no_library() -> None:
    ask = "import sys; from maglev_mj.cli import main\n"
    for command in QUICK:
        ask += f"try: main(['{command}', '--help'])\nexcept SystemExit: print('{command}:', *sys.modules)\n"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    for command in QUICK:
        (loaded,) = [line.split() for line in done.stdout.splitlines() if line.startswith(f"{command}: ")]
        assert set(loaded).isdisjoint({"numpy", "mujoco", "maglev_mj.parameters"}), command


def defaults(function: Callable[..., int]) -> dict[str, Any]:
    """Return the defaults of a command."""
    return {name: one.default for name, one in signature(function).parameters.items()}


def test_what_a_help_says_without_its_library_is_what_the_library_has() -> None:
    twin = defaults(cli_twin.twin)
    assert (twin["watchdog"], twin["noise"]) == (Limits.watchdog, TwinParameters.noise)
    assert output.FORMATS == FORMATS and peripherals._AUTO == AUTO

"""Wrong command lines: status 2, and one line that names the value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest

from maglev_mj import cli
from maglev_mj.cli.program import COMMANDS
from tests.cli.test_options import NEEDED

SCENES = {
    "raises": "    def laws(self):\n        return [1 / 0]\n",
    "no_laws": "    pass\n",
    "none": "    def laws(self):\n        return None\n",
    "wrong_law": "    def laws(self):\n        return [Hold(60.0)]\n",
    "start": "    def laws(self):\n        return []\n\n    def start(self):\n        return (0.0, 0.0, 0.0)\n",
    "hand": "    def laws(self):\n        return []\n\n    def scripted_hand(self, phase=0.0):\n        return 5\n",
    "option": "    def laws(self):\n        return []\n\n    def plant_options(self):\n        return {'hue': 3}\n",
    "figure": "    figures = ('beauty',)\n\n    def laws(self):\n        return []\n",
    "model": "    model = 'absent.xml'\n\n    def laws(self):\n        return []\n",
}
FILES = {
    "garbage.npz": "PK garbage",
    "empty.json": "{}",
    "broken.json": "[1,",
    "notes.jsonl": "hello\n",
    "syntax.py": "class (",
}
Refused: TypeAlias = Callable[[str], str]
DEVICE = "udp://127.0.0.1:9"

TABLE = """
drp                                                 | drp
--nosuch                                            | --nosuch
drop view                                           | view
view box --stiffness stiff                          | stiff
view box --stiffness nan                            | nan
view box --stiffness -5                             | -5
view nosuch.py                                      | nosuch.py
view raises.py --web --no-open --port 0             | raises.py, line 6: ZeroDivisionError
view --hand-stiffness -1                            | -1
view --seconds nan                                  | nan
view --web --host 8.8.8.8                           | 8.8.8.8
view --web --token short                            | token
tour --seconds -1                                   | -1
tour box                                            | box
render                                              | --out
render --out a.foo                                  | a.foo
render --out a.png --size 10x10                     | 10x10
render --out a.png --fps 0                          | 0
render --out a.png --seconds -1                     | -1
drop --stiffness                                    | --stiffness
drop --stiffness inf                                | inf
drop --plant glass                                  | glass
drop --phase 1                                      | 1
drop --phases 0                                     | 0
drop --duration 1e9                                 | 1000000000.0
drop --format png                                   | png
drop --record a.foo                                 | a.foo
drop 0.004                                          | 0.004
press --hand leg                                    | leg
press --hand 1,2                                    | 1,2
press --hits 1.5                                    | 1.5
stick-slip --law glue                               | glue
stick-slip --axis w                                 | w
run                                                 | SCENE
run nosuch                                          | nosuch
run drop:Drop                                       | drop:Drop
run empty.json                                      | empty.json
run --plant exact                                   | --plant
run raises.py                                       | raises.py, line 6: ZeroDivisionError
run raises.py:Other                                 | Other
run no_laws.py                                      | Own of no_laws.py must define laws()
run none.py                                         | None
run wrong_law.py                                    | wrong_law.py, line 6
run start.py                                        | start() of Own of start.py
run option.py                                       | hue
run figure.py                                       | figure.py
run syntax.py                                       | syntax.py
stability --grid 0                                  | 0
stability --hand leg                                | leg
stability --damping low high                        | low high
stability --damping 5:1                             | 5 to 1
stability --delay -1                                | -1
stability --workers -1                              | -1
stability --record notes.jsonl                      | notes.jsonl
stability no_laws.py                                | no_laws.py
stability run.maglev                                   | run.maglev
stability drop --grid 3                             | --grid
compare drop --law glue                             | glue
compare drop --law pd --law pd                      | pd
compare drop --law pd --law nofile.py               | nofile.py
compare box --law pd                                | box
compare drop --law pd --law colgate                 | colgate
compare drop --law pd --phases 0                    | 0
card glue                                           | glue
card drop --rate 0                                  | 0
card --delay -1                                     | -1
card nofile.json                                    | nofile.json
design --mass heavy                                 | heavy
design --mass 2:1                                   | 2 to 1
design --hand leg                                   | leg
design --law glue                                   | glue
design --modulus 2                                  | 2
design --held                                       | hand
sweep                                               | SCENE
sweep drop --vary height                            | height
sweep drop --vary glue=1,2                          | glue
sweep drop --vary height=1:2                        | 1:2
sweep drop --vary height=nan                        | nan
sweep drop --set height=high                        | high
sweep drop --vary height=0.001 --set height=0.002   | height
sweep drop --vary height=0.01:0.02:200000000        | 200000000
sweep drop --height 3                               | --height 3; parameters are given by --set and --vary
sweep drop --rate 1000                              | 1000; parameters are given by --set and --vary
sweep drop --set rate=1000                          | period
sweep --vary height=0.001,0.002                     | SCENE
fidelity drop --tolerance nan                       | nan
fidelity drop --phases 0                            | 0
fidelity drop --share 0                             | 0
fidelity raises.py                                  | raises.py, line 6: ZeroDivisionError
lessons                                             | DIR
lessons out --students=no                           | no
lessons notes.jsonl                                 | notes.jsonl
info extra                                          | extra
twin --rate nan                                     | nan
twin --rate fast                                    | fast
twin --delay -1                                     | -1
twin --noise -1                                     | -1
twin --seed -1                                      | -1
twin --fault glue:1@2                               | fault must be one of
twin --fault dead-coil:9@1                          | dead-coil must be of 0 to 5, not 9
twin --push w:1@0-1                                 | w:1@0-1
twin --push z:1@2-1                                 | z:1@2-1
twin --block nan                                    | nan
twin --listen nosuch                                | listen must be
twin --listen udp://8.8.8.8:5678                    | 8.8.8.8
twin --listen udp://0.0.0.0:0                       | loopback
twin --rate 0                                       | rate must be
twin --realtime maybe                               | --realtime must be one of enforce, ignore, not 'maybe'
twin --calibration nosuch.json                      | nosuch.json
twin --calibration broken.json                      | broken.json
twin --truth empty.json                             | empty.json
twin --key nosuch.key                               | key must be a file of 32 to 64 hexadecimal digits
twin --scene nosuch                                 | nosuch
twin --view --web                                   | view and web
bridge                                              | ADDRESS
bridge nosuch                                       | nosuch
bridge udp://127.0.0.1:0                            | udp://127.0.0.1:0
bridge udp://8.8.8.8:5678                           | loopback
bridge joystick DEVICE                              | DEVICE
bridge DEVICE --scene nosuch                        | scene must be one of
bridge DEVICE --seconds nan                         | nan
bridge DEVICE --mass 1                              | mass is for --identify
bridge DEVICE --identify a.json --view              | view
bridge DEVICE --profile nosuch.json                 | profile 'nosuch.json' cannot be read
bridge DEVICE --current-limit 2                     | --current-limit
bridge DEVICE --calibration run.maglev                 | run.maglev
bridge DEVICE --key run.maglev                         | run.maglev
bridge 127.0.0.1:5678                               | address must be udp://HOST:PORT
bridge DEVICE --reset --seconds 1                   | seconds is for scenes, not for --reset
bridge DEVICE --reset --identify a                  | identify flies, and --reset does not
bridge DEVICE --max-current 0                       | max_current must be
bridge DEVICE --max-current much                    | --max-current: must be a number, not 'much'
bridge DEVICE --force-limit 7                       | force_limit must be above
bridge DEVICE --envelope nan                        | envelope must be
bridge DEVICE --speed-limit -1                      | speed_limit must be
estop nosuch                                        | nosuch
estop udp://192.0.2.1:5678                          | loopback
estop DEVICE --key nosuch                           | key must be a file of 32 to 64 hexadecimal digits
commission spots DEVICE                             | DEVICE
commission DEVICE glue                              | glue
commission DEVICE coils --coil 9                    | 9
commission DEVICE coils --coil -1                   | -1
commission DEVICE coils --current nan               | nan
commission DEVICE coils --current -1                | -1
commission DEVICE spots --write a.json              | write
conform nosuch                                      | nosuch
conform DEVICE --calibration nosuch.json            | nosuch.json
fault nosuch.json                                   | recording 'nosuch.json' cannot be read
fault empty.json                                    | empty.json
fault broken.json                                   | it is not a journal
fault run.maglev                                       | run.maglev
fault empty.json --format png                       | png
replay nosuch.maglev                                  | nosuch.maglev
replay garbage.npz                                  | garbage.npz
replay empty.json                                   | empty.json
replay run.maglev --scene nosuch.py --check            | nosuch.py
replay run.maglev --port 80                            | port
analyse nosuch.maglev                                 | nosuch.maglev
analyse drop                                        | drop
analyse run.maglev --stretch 9                         | 9
analyse run.maglev --from nan                          | nan
analyse run.maglev --from -1                           | -1
analyse run.maglev --to 0                              | 0
analyse run.maglev --axis w                            | w
analyse run.maglev --scene nosuch.py                   | nosuch.py
export run.maglev                                      | --to
export run.maglev --to xls                             | xls
export garbage.npz --to csv                         | garbage.npz
export csv run.maglev                                  | --to
export run.maglev --to npz --out run.maglev             | run.maglev
"""
LINES = [[part.strip() for part in line.replace("DEVICE", DEVICE).split(" | ")] for line in TABLE.strip().splitlines()]
LINES += [[f"{command} {NEEDED.get(command, '')} --nosuch", "--nosuch"] for command in COMMANDS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording and files that are wrong."""
    made = tmp_path_factory.mktemp("wrong")
    for name, body in SCENES.items():
        (made / f"{name}.py").write_text(f"from maglev_mj import Hold, Scene\n\n\nclass Own(Scene):\n{body}")
    for name, text in FILES.items():
        (made / name).write_text(text)
    record = str(made / "run.maglev")
    assert cli.main(["drop", "--plant", "exact", "--record", record, "--json", str(made / "json")]) == 0
    return made


@pytest.fixture
def refused(folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Refused:
    """Return a function that runs a wrong line and returns its message."""
    monkeypatch.chdir(folder)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    files = sorted(folder.iterdir())

    def run(line: str) -> str:
        capfd.readouterr()
        try:
            status = cli.main(line.split())
        except SystemExit as stopped:
            status = int(str(stopped.code))
        captured = capfd.readouterr()
        assert (status, captured.out) == (2, ""), captured
        assert captured.err.startswith("maglev-mj") and captured.err.count("\n") == 1, captured.err
        assert sorted(folder.iterdir()) == files  # and nothing was begun
        return captured.err

    return run


@pytest.mark.parametrize(("line", "named"), LINES)
def test_a_wrong_line_is_status_2_and_one_line_that_names_the_value(line: str, named: str, refused: Refused) -> None:
    assert named in refused(line)


def test_every_command_is_tried_with_several_lines() -> None:
    words = [line.split()[0] for line, _ in LINES]
    assert {command for command in COMMANDS if words.count(command) < 2} == set() and len(LINES) > 160


def test_a_key_that_others_can_read_is_refused(refused: Refused, tmp_path: Path) -> None:
    key = tmp_path / "open.key"
    key.write_text("a7" * 16)
    key.chmod(0o644)
    for command in ("bridge udp://127.0.0.1:9", "twin", "estop udp://127.0.0.1:9"):
        said = refused(f"{command} --key {key}")
        assert f"key must be a file that others cannot read: chmod 600 {key}" in said

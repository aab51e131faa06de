"""Wrong command lines: status 2, one line that names the value, and nothing done."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeAlias

import pytest

from maglev_mj import cli
from maglev_mj.cli.declare import _inverse, count, number_option
from maglev_mj.cli.program import COMMANDS, add_options, command_parser
from maglev_mj.interop import hand_devices
from maglev_mj.views.window import window
from tests.cli.test_options import NEEDED

SCENES = {
    "raises": "    def laws(self):\n        return [1 / 0]\n",
    "no_laws": "    pass\n",
    "none": "    def laws(self):\n        return None\n",
    "wrong_law": "    def laws(self):\n        return [Hold(60.0)]\n",
    "start": "    def laws(self):\n        return []\n\n    def start(self):\n        return (0.0, 0.0, 0.0)\n",
    "option": "    def laws(self):\n        return []\n\n    def plant_options(self):\n        return {'hue': 3}\n",
    "still": "    def laws(self):\n        return [type('Still', (AxisLaw,), {})(axes='z')]\n",
    "law": "    def laws(self):\n        return [type('Odd', (AxisLaw,), {'force': lambda *_: 1 / 0})(axes='z')]\n",
    "figure": "    figures = ('beauty',)\n\n    def laws(self):\n        return []\n",
}
FILES = {
    "garbage.npz": "PK garbage",
    "empty.json": "{}",
    "broken.json": "[1,",
    "broken.toml": "[1,",
    "notes.jsonl": "hello\n",
    "syntax.py": "class (",
}
Refused: TypeAlias = Callable[[str], str]

DEVICE = "udp://127.0.0.1:9"

TABLE = """
# scenes, studies and recordings
render pub --out a.png                              | scene must be one of joystick
render box --out a.bmp                              | out must end in .png, .gif or .mp4 (got 'a.bmp'
render box --out nowhere/a.png                      | out must be a file in an existing folder (got 'nowhere/a.png')
render box --out a.png --size 1x1                   | size must be WxH, e.g. 1200x750, 160 to 4000 pixels each
fidelity moon                                       | scene must be one of joystick, drop, press,
fidelity all --out pictures                         | out is not supported for all scenes
fidelity all --tolerance 1e-3                       | unrecognized arguments: --tolerance 1e-3
design --mass a:b                                   | mass must be LOW:HIGH or one value (got 'a:b')
design --mass 0.5:0.6:3                             | mass must be LOW:HIGH or one value (got '0.5:0.6:3')
design --hand fist                                  | hand must be one of none, arm, stylus, fingertip
design --held                                       | hand must be at least one, without duplicates (got none)
design --spectral-radius 0.4                                | spectral_radius must be above 0.4: no pd wall
design --out x                                      | mass or delay must be a range for a chart
map --grid 3 --plant mujoco                         | unrecognized arguments: --plant mujoco
map --of moon                                       | --of must be one of theory, exact, mujoco, drops
map --grid 3 --height 0                             | height requires --of drops (got --of theory)
map --grid 3 --of exact --pulse 1                   | pulse requires --of drops (got --of exact)
map --grid 3 --record a                             | record requires --of exact, mujoco or drops
map --of drops --grid 3 --pulse 220 --damping 50 --out . | damping must be a range for a chart (got 50)
diagnose drop --jitter soon                         | jitter must be LOW,HIGH, LOW:HIGH or one value (got 'soon')
diagnose drop --jitter 0.003,0.001                  | jitter must be in ascending order, low to high
diagnose drop --jitter 0,0.002 --delay 0.003        | delay must be within the jitter, 0 to 0.002 s (got 0.003)
diagnose drop --loss 1                              | loss must be at least 0 and below 1 (got 1.0)
diagnose drop --lost-in-a-row 100                   | lost_in_a_row must be between 0 and 64 (got 100)
# numbers, their bounds and their kinds
drop --delay soon                                   | argument --delay: must be a number (got 'soon')
drop --delay 0.8 | delay must be at most 0.05 s, 10 periods in a simulation (got 0.8); did you mean 0.0008 s?
drop --period 1e-6 --delay 0 --duration 10          | duration must be at most 1000000 periods (got 10 s)
drop --phase 1                                      | phase must be at least 0 and below 1 (got 1.0)
drop --pulse-width 0                                | pulse_width must be
fidelity drop --share 0                             | share must be
drop --phases many                                  | argument --phases: must be an integer (got 'many')
drop --carry --force-limit 0                         | carry needs a force_limit above 0
press --hand none | hand must have a stiffness above 0, in order to press (got 'none')
press --hand fist | hand must be one of none, arm, stylus, fingertip, or mass,damping,stiffness
press --press 60 --force-limit 60                   | press must be below the force_limit of 60 N
press --duration 1 | duration must be above 1.905 and at most 100000 (got 1.0)
stick-slip --law glue                               | law must be one of stick-slip, spring-reset, kikuuwe, dahl,
# values at a bound that excludes them
view box --seconds 0                                | seconds must be above 0 s (got 0
render box --out a.png --fps 0                      | fps must be
fidelity drop --tolerance 0                         | tolerance must be above 0 (got 0
fidelity drop --boundary-tolerance 0                | boundary must be above 0 (got 0
map --grid 1                                  | grid must be
map --of drops --grid 3 --force-limit -1 | force_limit must be between 0 and 1e6 N (got -1
map --of drops --grid 3 --quantize 2 | quantize must be between 0 and 1 m (got 2
drop --phases 0                                     | phases must be at least 1 and at most 10000 (got 0
drop --rate 0                                       | argument --rate: must be a finite number above 0 (got '0')
press --hits 0                                      | hits must be
stick-slip --breakaway 0                            | breakaway must be
twin --rate 0                                       | rate must be between 10 and 20000 Hz (got 0
twin --block -3                                     | block must be above 0 and at most 20000 N/m (got -3
bridge DEVICE --max-current 0                       | max_current must be
map --damping 80 --stiffness 6000                   | must be a range (got one wall): for one, maglev-mj diagnose
map --damping 80 --stiffness 6000 --of exact        | must be a range (got one wall): for one, maglev-mj diagnose
map --damping 80 --stiffness 6000 --of drops        | must be a range (got one wall): for one, maglev-mj diagnose
stability --damping 80 --stiffness 6000 --grid 20   | unrecognized arguments: --grid
map --damping 1 2                                   | damping must be LOW:HIGH:COUNT, LOW:HIGH or one value (got '1 2')
map --damping 1:2:0 | damping must be LOW:HIGH:COUNT, LOW:HIGH or one value (got '1:2:0')
map --damping 1:2:1.5 | damping must be LOW:HIGH:COUNT, LOW:HIGH or one value (got '1:2:1.5')
map --damping 1:2:2000                              | count of damping must be between 1 and 1000
# rates beside periods
drop --rate fast                                    | argument --rate: must be a
drop --rate 100 --period 0.01                       | argument --period: not allowed with argument --rate
--rate 5 drop --phase 0                             | options must follow the command: maglev-mj drop --phase 0 --rate 5
--json=- sweep drop                                 | options must follow the command: maglev-mj sweep drop --json=-
# slips, with the nearest name
drpo                                                | (got 'drpo'); did you mean drop?
--verison                                           | unrecognized arguments: --verison; did you mean --version?
drop --stifness 3                                   | unrecognized arguments: --stifness 3; did you mean --stiffness?
sweep drop --vary stifness=1,2                      | (got 'stifness'); did you mean stiffness?
map --hand armm                               | (got 'armm'); did you mean arm?
drop --plant exct                                   | (got 'exct'); did you mean exact?
# maps of stability
map --damping -5:3 | damping must be between 0 and 1e6 (got -5
map --stiffness 9:3                           | stiffness must be in ascending order, low to high (got 9 to 3)
map --delay 2 | delay must be between 0 and 1 s (got 2.0); did you mean 0.002 s?
map --hand 1e-300,0,0,0,1e10                  | hand grip_stiffness must be between 0 and 1e7
map --hand 0,0,1e300                          | hand stiffness must be between 0 and 1e7
map --hand 0.2,0,0,1,0                        | grip_stiffness above 0 in a soft grip
# sweeps
drop --out out.png | out must be a folder; try --out . --format png (got 'out.png')
sweep drop                                          | a sweep needs --vary NAME=VALUES; for one run: maglev-mj run drop
sweep joystick --vary stiffness=1000,2000 --out .   | out is not supported: joystick has no figures to draw
card nothing.toml | device file 'nothing.toml' cannot be read: No such file or directory
card --table1 --header                              | table1 and header are mutually exclusive
card ubc --header --out .                           | out is not supported with table1 and header: they have no chart
card drop --delay 0.06 | delay must be at most 0.05 s, 10 periods in a simulation (got 0.06)
sweep moon.py                                       | scene file 'moon.py' does not exist
sweep drop --vary height=0:inf:3                    | values of height must be LOW:HIGH:COUNT
sweep drop --vary height=0:1                        | values of height must be LOW:HIGH:COUNT
sweep drop --vary height                            | a parameter must be given as NAME=VALUE (got 'height')
sweep drop --set mass=1 --vary mass=1,2             | mass must be either set or varied
sweep drop --vary height=0:1:20000 --vary phase=0:1:20000 | at most 100000000 cells
sweep wall --vary period=0.005 --json both --record both | json and record must be different paths (got 'both'
sweep drop --set mass=1 --set mass=2                | mass must be given once (got 1 and 2)
sweep drop --set mass=true                          | mass must be a finite number (got 'true')
sweep drop --set carry=2                            | carry must be true or false (got '2')
sweep wall --vary period=0.005 --set hand=5         | hand must be one of none, arm
sweep stick-slip --vary period=0.005 --set axis=1   | axis must be one of x, y, z, rx, ry, rz (got '1')
sweep wall --vary period=0.005 --scheduler moon     | scheduler must be the address of a Dask scheduler (got 'moon'
sweep wall --vary period=0.005 --workers 2 --scheduler tcp://x:1 | workers and scheduler are mutually exclusive
# files
stick-slip --format pdf | format requires out, the output folder (got format 'pdf' alone)
bridge DEVICE --record a.foo                        | record must be a file that ends in .maglev (got 'a.foo'
# servers and pages
twin --plant euler                                  | plant must be one of exact, mujoco (got 'euler')
view --allow-origin http://a/b | argument --allow-origin: origin must be a URL without a path, such as
view --web --host 0.0.0.0                           | host '0.0.0.0' is not this machine: add --token
view --web --token short                            | token must be at least 16 characters
view --port 8000                                    | port requires --web
view --tour --port 5680                             | maglev-mj view: port requires --web
view box --tour                                     | tour needs the scene joystick with its defaults (got box:
view --tour --stiffness 3000                        | tour needs the scene joystick with its defaults (got joystick:
twin --port 5680 | maglev-mj twin: port requires --web; set a device's address by --listen
view --no-open                                      | no-open requires --web
twin --view --web                                   | mutually exclusive
# input devices
view --hand-device | hand-device 'auto' not found; `--hand-device list` shows
view --hand-device /no/such.sock | hand-device '/no/such.sock' not found
view --hand-gain 2                                  | hand-gain and other hand options require --hand-device
# commands, files and devices
render                                              | --out
run raises.py                                       | raises.py, line 6: ZeroDivisionError
run raises.py:Other                                 | Other
run no_laws.py                                      | Own of no_laws.py must define laws()
run none.py                                         | None
run wrong_law.py                                    | wrong_law.py, line 6
run start.py                                        | start() of Own of start.py
run option.py                                       | hue
run still.py                                        | must define force(self
run law.py                                          | law Odd raises ZeroDiv
run figure.py                                       | figure.py
run syntax.py                                       | syntax.py
map --record notes.jsonl                      | notes.jsonl
compare drop --law glue                             | glue
compare drop --law pd --law pd                      | pd
compare drop --law pd --law nofile.py               | nofile.py
compare box --law pd                                | box
compare drop --law pd --law colgate                 | colgate
compare drop --law pd --vary stiffness=1000 --map   | vary and map are mutually exclusive (got vary stiffness=1000)
compare drop --law pd --figure noise                | figure needs --vary NAME=VALUES (got noise)
compare drop --law pd --vary rate=200 --figure glow | figure must be one of penetration
compare drop --law pd --vary plant=exact            | parameter must be one of device
compare drop --law colgate --map                    | law colgate sets its own gains
card glue                                           | glue
lessons notes.jsonl                                 | notes.jsonl
twin --fault glue:1@2                               | fault must be one of
twin --fault dead-coil:9@1                          | K of dead-coil must be 0 to 5 (got 9)
twin --push w:1@0-1                                 | w:1@0-1
twin --listen nosuch                                | listen must be
twin --listen udp://8.8.8.8:5678                    | 8.8.8.8
twin --device broken.toml                           | broken.toml
twin --truth empty.json                             | empty.json
twin --key nosuch.key                               | key must be a file of 32 to 64 hexadecimal digits
twin --scene nosuch                                 | nosuch
bridge nosuch                                       | nosuch
bridge udp://8.8.8.8:5678                           | loopback
bridge haply://127.0.0.1                             | address must be haply://HOST:PORT
bridge haply://127.0.0.1:9?rate=0                    | address must be haply://HOST:PORT
bridge haply://127.0.0.1:9?arm=A                     | address must be haply://HOST:PORT, optionally with ?rate=HZ
bridge haply://127.0.0.1:9 --reset                   | --reset does not apply to haply://
bridge haply://127.0.0.1:9 --max-current 5           | limits of the host for haply:// are --force-limit
twin --haply nosuch                                  | haply must be PORT or HOST:PORT (got 'nosuch')
twin --haply 8.8.8.8:10001                           | host must be a loopback address
twin --haply --listen pty                            | --listen does not apply to --haply
twin --haply --noise 1e-6                            | --noise does not apply to --haply
twin --haply --device stage                          | device must take a force, [force] in its file (got 'stage'
bridge haply://127.0.0.1:9 --device stage            | device must take a force, [force] in its file (got 'stage'
twin --haply --web                                   | --web does not apply to --haply
bridge DEVICE --mass 1                              | --mass requires --identify
bridge DEVICE --identify a.json --view              | view
bridge DEVICE --profile nosuch.json                 | profile 'nosuch.json' cannot be read
bridge DEVICE --device run.maglev                   | run.maglev
bridge DEVICE --reset --identify a                  | --reset and --identify cannot be combined
bridge DEVICE --force-limit 7                       | force_limit must be above
commission DEVICE coils --coil 9                    | 9
commission DEVICE spots --write a.json              | write
conform nosuch                                      | nosuch
analyse nosuch.json --cycles                        | recording 'nosuch.json' cannot be read
analyse empty.json                                  | empty.json
analyse run.maglev --cycles                         | run.maglev' is not a valid recording: no device cycles
analyse run.maglev --all                            | no device cycles (only recordings of flights contain them)
replay nosuch.maglev                                | nosuch.maglev
replay garbage.npz                                  | garbage.npz
replay run.maglev --scene nosuch.py --check         | nosuch.py
replay run.maglev --port 80                         | port
analyse run.maglev --segment 9                      | 9
analyse run.maglev --axis w                         | w
analyse run.maglev --json run.maglev                | must not overwrite the recording
convert run.maglev run.maglev --to npz              | out must not overwrite the recording
convert run.maglev . --to npz                       | out must be a file in an existing folder
convert none.maglev none.csv                        | 'none.maglev' cannot be read: No such file
convert none.csv none.maglev --mass 1               | log 'none.csv' cannot be read: No such file or directory
convert none.csv none.maglev                        | log 'none.csv' cannot be read: No such file or directory
convert run.maglev run                              | format of out must be one of maglev, npz, mcap, csv
convert run.maglev run.csv --to ods                 | format of out must be one of maglev, npz, mcap, csv
convert run.maglev run.csv --units time=s           | units applies to a text table, not to a recording (got
convert notes.jsonl run.csv                         | mass or device must be given
"""
LINES = [
    [part.strip() for part in line.replace("DEVICE", DEVICE).split(" | ", 1)]
    for line in TABLE.strip().splitlines()
    if not line.startswith("#")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording and files that are wrong."""
    made = tmp_path_factory.mktemp("wrong")
    for name, body in SCENES.items():
        (made / f"{name}.py").write_text(f"from maglev_mj import AxisLaw, Hold, Scene\n\n\nclass Own(Scene):\n{body}")
    for name, text in FILES.items():
        (made / name).write_text(text)
    record = str(made / "run.maglev")
    assert cli.main(["drop", "--plant", "exact", "--record", record, "--json", str(made / "json")]) == 0
    return made


@pytest.fixture
def refused(folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Refused:
    """Return a function that runs a wrong line and returns its message."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(window, "require_display", lambda: None)
    monkeypatch.setattr(hand_devices, "_SETTINGS", folder / "spnavrc")
    monkeypatch.setattr(hand_devices, "_DAEMONS", folder / "daemon.sock")
    monkeypatch.setenv("SPNAV_SOCKET", str(folder / "spnav.sock"))
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


ALSO = {
    "compare": "--law pd --duration 0.02",
    "map": "--of drops",
    "run press": "--plant exact --hits 1 --interval 0.1",
    "sweep": "--vary height=0.001",
}
SAID = {"--boundary-tolerance": "boundary"}
NUMBER = re.compile(
    r"must be .*\b(number|least|above|below|between|integer|one of)\b.* (?:not |\(got )'?([^\s')]+)'?\)?\n"
)


@cache
def numeric_options(command: str) -> tuple[list[str], list[str], list[str]]:
    """Return a command's words, those of its options that read numbers, and those that say so in the help."""
    name, *more = command.split()
    needed = " ".join(more) or NEEDED.get(name, "")
    words = f"{needed} {ALSO.get(command, '')}".replace("a.maglev", "run.maglev").split()
    asked = command_parser(name, words)
    add_options(asked, name)
    options = [(one, one.option_strings[0]) for one in asked._actions if one.option_strings]
    # what reads a parameter that may be none has its reader as argument
    readers = [(option, getattr(one.type, "args", [one.type])[0]) for one, option in options]
    told = [option for one, option in options if one.metavar in ("X", "N") and one.nargs is None]
    return [name, *words], [option for option, read in readers if read in (number_option, count, _inverse)], told


@pytest.mark.parametrize("command", [*COMMANDS, "run press", "run stick-slip"])
def test_every_number_of_every_command_is_finite_and_has_a_lower_bound(command: str, refused: Refused) -> None:
    words, options, _ = numeric_options(command)
    for option in options:
        web = ["--web"] * (option == "--port")
        for value in ("-1000000", "nan"):
            said = refused(" ".join([*words, f"{option}={value}", *web]))
            name, found = SAID.get(option, option.strip("-").replace("-", "[-_ ]")), NUMBER.search(said)
            assert re.search(rf"\b{name}:? must be ", said) and found, said
            assert float(found[2]) == pytest.approx(float(value), rel=1e-12, nan_ok=True), said


def test_every_number_is_visited() -> None:
    found = {command: numeric_options(command) for command in [*COMMANDS, "run press", "run stick-slip"]}
    assert sum(len(options) for _, options, _ in found.values()) >= 170
    assert {
        command: {*told} - {*options} for command, (_, options, told) in found.items() if {*told} - {*options}
    } == {}


def test_a_key_that_others_can_read_is_refused(refused: Refused, tmp_path: Path) -> None:
    key = tmp_path / "open.key"
    key.write_text("a7" * 16)
    key.chmod(0o644)
    for command in ("bridge udp://127.0.0.1:9", "twin", "estop udp://127.0.0.1:9"):
        said = refused(f"{command} --key {key}")
        assert f"key must be a file that only you can read; run: chmod 600 {key}" in said

"""Command lines that are refused: one line on standard error, status 2, and nothing done."""

from __future__ import annotations

from pathlib import Path

import pytest

from maglev_mj.interop import hand_devices
from maglev_mj.views.window import window
from tests.processes import run_here

HANDS = "hand must be one of none, arm, stylus, fingertip, or mass,damping,stiffness"
COUNTED = "must vary as LOW:HIGH:COUNT"
ABSENT = "hand-device must be one of those that `--hand-device list` prints, not "
NEAR = "bridge udp://127.0.0.1:9"
WALL = "sweep wall --vary period=0.005"

REFUSED = {
    # scenes, studies and recordings
    "render pub --out a.png": "scene must be one of joystick",
    "render box --out a.bmp": "out must end in .png, .gif or .mp4, not 'a.bmp'",
    "render box --out nowhere/a.png": "out must be a file in a folder that is there",
    "render box --out a.png --size 1x1": "size must be WxH, such as 1200x750, of 160 to 4000 pixels",
    "render box --out a.png --stiffness -1": "stiffness must be",
    "view pub": "scene must be one of joystick",
    "view box --seconds 0": "seconds must be a finite number above 0",
    "view box --hand-stiffness -5": "hand stiffness must be",
    "drop --record nowhere/a.maglev": "record must be a file in a folder that is there",
    "fidelity moon": "scene must be one of joystick, drop, press, ",
    "fidelity drop --tolerance 0": "tolerance must be a finite number above 0, not 0",
    "fidelity drop --boundary-tolerance 0": "boundary must be a finite number above 0, not 0",
    "fidelity all --out pictures": "out must be left out for all scenes",
    "fidelity all --tolerance 1e-3": "unrecognized arguments: --tolerance 1e-3",
    "fidelity stick-slip --height 1e-3": "unrecognized arguments: --height 1e-3",
    "fidelity drop --json no/such/folder.json": "json",
    "design --mass a:b": "mass must be LOW HIGH, LOW:HIGH, or one value, not 'a:b'",
    "design --hand fist": "hand must be one of none, arm, stylus, fingertip",
    "design --held": "hands must be one or more different ones, not none at all",
    "design --modulus 0.4": "modulus must be above 0.4 here",
    "design --law observer --pulse": "pulse must be left out for the observer",
    "design --out x": "mass or delay must be a range for a picture",
    "stability --grid 3 --pulse -1": "pulse must be a finite number at least 0 and at most 1e+06, not -1",
    "stability --grid 3 --force-limit 0": "force_limit must be a finite number above 0 and at most 1e+06, not 0",
    "stability --grid 3 --quantize 2": "quantize must be a finite number at least 0 and at most 1, not 2",
    "stability --grid 3 --height -0.001": "height must be a finite number at least 0 and at most 1, not -0.001",
    "stability --grid 3 --height 0 --plant mujoco": "plant must be one of exact, not 'mujoco'",
    "stability --grid 3 --pulse 220 --damping 50 --out .": "damping must be a range for a picture, not 50 alone",
    # numbers, their bounds and their kinds
    "drop --period -1e-3": "period must be a finite number at least 1e-06 and at most 1, not -0.001",
    "drop --height -inf": "height must be a finite number above 0 and below 0.045, not -inf",
    "drop --delay soon": "argument --delay: must be a number, not 'soon'",
    "drop --delay 0.5 --period 1e-6 --duration 0.1": "delay must be at most 10000 periods",
    "drop --period 1e-6 --duration 10": "duration must be at most 1000000 periods, not 10 s",
    "drop --phase 1": "phase must be a finite number at least 0 and below 1, not 1.0",
    "drop --phases 0": "phases must be at least 1 and at most 10000, not 0",
    "drop --phases many": "argument --phases: must be a whole number, not 'many'",
    "drop --mass nan": "mass must be a finite number at least 0.001 and at most 1000, not nan",
    "drop --carry": "carry needs a force_limit",
    "press --hand none": "hand must have an arm of some stiffness, by which it presses, not 'none'",
    "press --hand fist": HANDS,
    "press --hits 2.5": "argument --hits: must be a whole number, not '2.5'",
    "render drop --out a.png --magnify 2": "magnify must be one of 1, 3, 5, not '2'",
    "press --press 60 --force-limit 60": "press must be below the force_limit of 60 N",
    "press --duration 1": "duration must be a finite number above 1.905 and at most 100000, not 1.0",
    "stick-slip --law glue": "law must be one of stick-slip, spring-reset, dahl, ",
    "stick-slip --velocity guess": "velocity must be one of difference, low-pass, adaptive, not 'guess'",
    "stick-slip --axis w": "axis must be one of x, y, z, rx, ry, rz, not 'w'",
    # rates beside periods
    "drop --rate 0": "argument --rate: must be a ",
    "drop --rate nan": "argument --rate: must be a ",
    "drop --rate fast": "argument --rate: must be a ",
    "drop --rate 100 --period 0.01": "argument --period: not allowed with argument --rate",
    "view --period 0.01 --rate 100": "argument --rate: not allowed with argument --period",
    "twin --period 1 --rate 1": "argument --rate: not allowed with argument --period",
    # slips, with the nearest name
    "drpo": "not 'drpo'; did you mean drop?\n",
    "qqq": "not 'qqq'\n",
    "--verison": "unrecognized arguments: --verison; did you mean --version?\n",
    "drop --stifness 3": "unrecognized arguments: --stifness 3; did you mean --stiffness?\n",
    "drop --stifness=3": "unrecognized arguments: --stifness=3; did you mean --stiffness?\n",
    "drop there": "unrecognized arguments: there\n",
    "press --carry": "unrecognized arguments: --carry",
    "view joistick": "not 'joistick'; did you mean joystick?\n",
    "design --law observr": "not 'observr'; did you mean observer?\n",
    "sweep drop --vary stifness=1,2": "not 'stifness'; did you mean stiffness?\n",
    "stability --hand armm": "not 'armm'; did you mean arm?\n",
    "drop --plant exct": "not 'exct'; did you mean exact?\n",
    # maps of stability
    "stability --damping a b": "damping must be LOW HIGH, LOW:HIGH, or one value, not 'a b'",
    "stability --damping -5:3": "damping must be a finite number at least 0 and at most 1e+06, not -5",
    "stability --stiffness 9 3": "stiffness must be from a lower to a higher value, not 9 to 3",
    "stability --grid 1": "grid must be a finite number at least 2",
    "stability --plant moon": "plant must be one of none, exact, mujoco, not 'moon'",
    "stability --delay 1": "delay must be at most 10 periods of 0.005 s, not 1",
    "stability --damping 20 --out .": "damping must be a range for a picture, not 20 alone",
    "stability --workers -1 --plant exact": "workers must be at least 0, not -1",
    "stability --hand 1e-300,0,0,0,1e10": "hand grip_stiffness must be at most 1e+07",
    "stability --hand 0,0,1e300": "hand stiffness must be at most 1e+07",
    "stability --hand 0.2,0,0,1,0": "grip_stiffness above 0 in a soft grip",
    # sweeps
    "sweep drop": "a sweep needs --vary NAME=VALUES; for one run: maglev-mj run drop",
    "sweep joystick --vary stiffness=1000,2000 --out .": "out must be left out: joystick has no figures to draw",
    "card nothing.json": "calibration 'nothing.json' cannot be read: No such file or directory",
    "card drop --delay 0.06": "delay must be at most 10 periods, not 12 periods",
    "sweep moon": "scene must be one of joystick, drop, press, ",
    "sweep moon.py": "scene must be a file that is there, not 'moon.py'",
    "sweep drop --vary colour=1": "parameter of drop must be one of plant, phase, period, delay, stiffness",
    "sweep drop --vary height=1:2": f"height {COUNTED}, A,B,C or A;B;C, not '1:2'",
    "sweep drop --vary height=0:1:100000000000": f"height {COUNTED}",
    "sweep drop --vary height=0:inf:3": f"height {COUNTED}",
    "sweep drop --vary height": "a parameter must be given as NAME=VALUE, not 'height'",
    "sweep drop --vary phase=0 --set mass=0": "mass must be a finite number at least 0.001",
    "sweep drop --set mass=1 --vary mass=1,2": "mass must be either set or varied, not both",
    "sweep drop --vary height=0:1:20000 --vary phase=0:1:20000": "at most 100000000 cells",
    f"{WALL} --json both --record both": "json and record must be a file and a folder, not 'both' for both",
    "sweep drop --set mass=1 --set mass=2": "mass must be given once, not as 1 and 2",
    "sweep drop --set mass=true": "mass must be a finite number, not 'true'",
    "sweep drop --set carry=2": "carry must be true or false, not '2'",
    f"{WALL} --set hand=5": "hand must be one of none, arm",
    "sweep stick-slip --vary period=0.005 --set axis=1": "axis must be one of x, y, z, rx, ry, rz, not '1'",
    f"{WALL} --scheduler moon": "scheduler must be the address of a Dask scheduler, not 'moon'",
    f"{WALL} --workers 2 --scheduler tcp://x:1": "workers must be left to the scheduler",
    # files
    "press --json no/such.json": "json must be a file in a folder that is there, not 'no/such.json'",
    "stick-slip --out pictures --format bmp": "--format must be one of png, pdf, svg, not 'bmp'",
    "stick-slip --format pdf": "format must be given with out, the folder of pictures, not 'pdf' alone",
    f"{NEAR} --record a.foo": "record must be a file that ends in .maglev, not 'a.foo'",
    # servers and pages
    "twin --plant euler": "plant must be one of exact, mujoco, not 'euler'",
    "view --allow-origin http://a/b": "argument --allow-origin: origin must be as http://192.168.0.5:8080, without a",
    "view --web --host 0.0.0.0": "token must be given for a host that is not this machine",
    "view --web --token short": "token must be 16 or more letters",
    "view --web --port 65536": "port must be a whole number of 0 to 65535",
    "view --port 8000": "port is for --web",
    "tour --port 5680": "maglev-mj tour: port is for --web\n",
    "twin --port 5680": "maglev-mj twin: port is for --web; a device's address is given by --listen\n",
    "view --no-open": "no-open is for --web",
    "twin --view --web": "give one",
    # input devices
    "view --hand-device joypad": f"{ABSENT}'joypad'",
    "view --hand-device": f"{ABSENT}'auto'",
    "view --hand-device /no/such.sock": f"{ABSENT}'/no/such.sock'",
    "view --hand-gain 2": "hand-gain and the like are for --hand-device",
    "view --hand-device joypad --hand-gain 101": "hand-gain must be a finite number at least 0 and at most 100",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_done_is_one_line_and_status_2(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(window, "require_display", lambda: None)
    monkeypatch.setattr(hand_devices, "_SETTINGS", tmp_path / "spnavrc")
    monkeypatch.setattr(hand_devices, "_DAEMONS", tmp_path / "daemon.sock")
    monkeypatch.setenv("SPNAV_SOCKET", str(tmp_path / "spnav.sock"))
    status, output, errors = run_here(*words.split())
    assert (status, output, errors.count("\n")) == (2, "", 1)
    assert REFUSED[words] in errors
    assert not list(tmp_path.iterdir())

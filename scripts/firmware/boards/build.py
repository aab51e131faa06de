"""Build a board's program, with the nominal device's plant and profile.

    python scripts/firmware/boards/build.py [--board NAME] [--key FILE] [--hand X,Y,Z,RX,RY,RZ@FROM:UNTIL] PROGRAM
    python scripts/firmware/boards/build.py --board stm32f405 --own FILE.c [--crystal MHZ] [--key FILE] PROGRAM

Writes device.h next to the program. With --own it is that of a device, with its own functions; else the emulated one
with the simulated flotor. The hand applies a constant wrench [N, N m] to the flotor between two times of the
device's clock [s].
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.links import BAUD
from maglev_mj.bridge.twin.twin import REST, TwinParameters
from maglev_mj.plants.sensor import beams

BOARDS = Path(__file__).resolve().parent
FIRMWARE = BOARDS.parent
NAMES = "mps2_an386", "stm32f405"
COMPILER = "arm-none-eabi-gcc"
STRICT = "-std=c99 -Os -Wall -Wextra -Wpedantic -Werror -Wl,--fatal-warnings"
BARE = "-ffreestanding -DMAGLEV_NO_LIBRARY -nostdlib"
CORTEX_M4 = "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard"


def plant(hand: str) -> dict[str, object]:
    """Return the members of the plant; `hand` as on the command line."""
    calibration = Calibration.nominal()
    wrench, start, end = re.split("[@:]", hand)
    return {
        "wrench": calibration.coils.wrench_per_current,
        "inertia": [*[calibration.mass] * 3, *calibration.inertia],
        "gravity": [*calibration.gravity, 0.0, 0.0, 0.0],
        "slopes": beams()._spots(np.zeros(6))[1],
        "rest": REST,
        "hand": np.array([float(x) for x in wrench.split(",")]).reshape(6),
        "hand_from": round(float(start) * 1e9),
        "hand_until": round(float(end) * 1e9),
    }


def profile(key: bytes) -> dict[str, object]:
    """Return the members of the profile."""
    profile = TwinParameters(lockstep=True).profile
    limits, maps = profile.limits, profile.wall_maps
    assert maps is not None
    return {
        "period": profile.period,
        "delay": profile.delay,
        "watchdog": round(limits.watchdog * 1e9),
        "enable": round(limits.enable * 1e9),
        "stale": round((limits.stale or 0.0) * 1e9),
        "current_limit": limits.current_limit,
        "continuous_current": limits.continuous_current,
        "hover_limit": limits.hover_limit,
        "thermal_time": limits.thermal_time,
        "spot_limit": limits.spot_limit,
        "spot_speed": limits.spot_speed,
        **{name: getattr(limits, name) for name in ("stiffness_limit", "damping_limit", "edge_speed")},
        **{name: getattr(profile, name) for name in ("wall_period", "wall_delay")},
        **{"spots": maps.spots, "pose": maps.pose_per_spot, "current": maps.current_per_wrench},
        "device": profile.number,
        "key_length": len(key),
        "key": np.frombuffer(key.ljust(32, b"\0"), np.uint8),
        "calibration": np.frombuffer(profile.calibration, np.uint8),
        "lockstep": 1,
    }


def initialiser(members: Mapping[str, object]) -> str:
    """Return the members of a C structure by name."""
    lines = []
    for name, value in members.items():
        numbers = ", ".join(repr(x) for x in np.ravel(np.asarray(value)).tolist())
        lines.append(f".{name} = {{{numbers}}}" if np.ndim(np.asarray(value)) else f".{name} = {numbers}")
    return " \\\n    " + ", \\\n    ".join(lines)


def build(
    program: Path,
    key: bytes = b"",
    hand: str = "0,0,0,0,0,0@0:0",
    board: str = NAMES[0],
    own: Path | None = None,
    crystal: int = 8,
) -> None:
    """Compile and link the program of a board.

    Args:
        program: File to write.
        key: Key of the device; empty for none.
        hand: As on the command line.
        board: One of NAMES.
        own: C file with a device's own functions; None for the emulated program.
        crystal: Frequency of the board's crystal [MHz].

    Raises:
        CalledProcessError: If compilation fails.
    """
    members = profile(key)
    if own is not None:
        members["lockstep"] = 0
    else:
        del members["spots"]  # 0 at the simulated centre
    macros = {"BAUD": str(BAUD), "PROFILE": initialiser(members), "CRYSTAL_MHZ": str(crystal)}
    sources = [FIRMWARE / "maglev_firmware.c", BOARDS / "board.c", BOARDS / board / "chip.c"]
    if own is None:
        macros |= {"PLANT": initialiser(plant(hand)), "QEMU": "1"}
        sources += [FIRMWARE / "simulated_flotor.c", BOARDS / "simulation.c"]
    else:
        sources += [BOARDS / board / "device.c", own]
    header = "\n".join(f"#define {name} {text}" for name, text in macros.items())
    (program.parent / "device.h").write_text(header + "\n", encoding="ascii")
    folders = FIRMWARE, BOARDS, BOARDS / board, program.parent
    command = [COMPILER, *STRICT.split(), *BARE.split(), *CORTEX_M4.split(), *(f"-I{folder}" for folder in folders)]
    command += [*map(str, sources), "-T", str(BOARDS / board / "board.ld"), "-lgcc", "-o", str(program)]
    subprocess.run(command, check=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--key", type=Path, metavar="FILE", help="key file, hexadecimal digits (default: none)")
    parser.add_argument("--board", default=NAMES[0], choices=NAMES, help="board (default: %(default)s)")
    parser.add_argument("--own", type=Path, metavar="FILE.c", help="functions of a device, see stm32f405/own.h")
    parser.add_argument("--crystal", type=int, default=8, metavar="MHZ", help="crystal of the board (default: 8)")
    parser.add_argument("--hand", default="0,0,0,0,0,0@0:0", help="wrench [N, N m] and times [s] (default: none)")
    parser.add_argument("program", type=Path)
    options = parser.parse_args()
    if options.own and options.board != "stm32f405":
        parser.error("own: needs --board stm32f405")
    if not 4 <= options.crystal <= 26:
        parser.error(f"crystal must be 4 to 26 MHz (got {options.crystal})")
    secret = bytes.fromhex(options.key.read_text()) if options.key else b""
    try:
        build(options.program.resolve(), secret, options.hand, options.board, options.own, options.crystal)
    except (subprocess.CalledProcessError, ValueError) as error:
        sys.exit(f"build.py: {error}")

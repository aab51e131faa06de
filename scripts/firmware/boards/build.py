"""Build a board's program, with the profile of a device and, emulated, the published one's plant.

    python scripts/firmware/boards/build.py [--board NAME] [--key FILE] [--hand X,Y,Z,RX,RY,RZ@FROM:UNTIL] PROGRAM
    python scripts/firmware/boards/build.py --board stm32f405 --own FILE.c [--device FILE] [--crystal MHZ] PROGRAM

Writes device.h next to the program. With --own it is that of a device, with its own functions; else the emulated one
with the simulated flotor. The hand applies a constant wrench [N, N m] to the flotor between two times of the
device's clock [s].
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.links import BAUD
from maglev_mj.bridge.safety import macro
from maglev_mj.bridge.twin.twin import TwinParameters
from maglev_mj.device import PUBLISHED
from maglev_mj.errors import MaglevError
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
        "rest": calibration.base.rest,
        "hand": np.array([float(x) for x in wrench.split(",")]).reshape(6),
        "hand_from": round(float(start) * 1e9),
        "hand_until": round(float(end) * 1e9),
    }


def build(
    program: Path,
    key: bytes = b"",
    hand: str = "0,0,0,0,0,0@0:0",
    board: str = NAMES[0],
    own: Path | None = None,
    crystal: int = 8,
    device: str = PUBLISHED,
    let_go: int = 2,
) -> None:
    """Compile and link the program of a board.

    Args:
        program: File to write.
        key: Key of the device; empty for none.
        hand: As on the command line.
        board: One of NAMES.
        own: C file with a device's own functions; None for the emulated program.
        crystal: Frequency of the board's crystal [MHz].
        device: Device file or name, see `Device.load`.
        let_go: Time after which a silent host is dropped in lockstep [s].

    Raises:
        CalledProcessError: If compilation fails.
    """
    secret = {"key_length": len(key), "key": [*key.ljust(32, b"\0")]}
    # the simulated spots are 0 at the centre, and have no noise
    simulated = {} if own else {"spots": [0.0] * 6, "frozen": 0}
    profile = TwinParameters(lockstep=own is None, calibration=Calibration.load(device)).profile
    header = [profile.header(**secret, **simulated), f"#define BAUD {BAUD}", f"#define CRYSTAL_MHZ {crystal}"]
    sources = [FIRMWARE / "maglev_firmware.c", BOARDS / "board.c", BOARDS / board / "chip.c"]
    if own is None:
        header += [macro("PLANT", plant(hand)), "#define QEMU 1", f"#define LET_GO {let_go}000000000u"]
        sources += [FIRMWARE / "simulated_flotor.c", BOARDS / "simulation.c"]
    else:
        sources += [BOARDS / board / "device.c", own]
    (program.parent / "device.h").write_text("\n".join(header) + "\n", encoding="ascii")
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
    parser.add_argument("--let-go", type=int, default=2, help="time until a silent host is dropped [s] (default: 2)")
    parser.add_argument("program", type=Path)
    parser.add_argument("--device", default=PUBLISHED, metavar="FILE", help="device file of --own (default: ubc)")
    options = parser.parse_args()
    if not options.own and options.device != PUBLISHED:
        parser.error("device: needs --own, the emulated flotor is the published one")
    if options.own and options.board != "stm32f405":
        parser.error("own: needs --board stm32f405")
    if not 4 <= options.crystal <= 26:
        parser.error(f"crystal must be 4 to 26 MHz (got {options.crystal})")
    secret = bytes.fromhex(options.key.read_text()) if options.key else b""
    try:
        board = {name: getattr(options, name) for name in ("hand", "board", "own", "crystal", "device", "let_go")}
        build(options.program.resolve(), secret, **board)
    except (subprocess.CalledProcessError, MaglevError, ValueError) as error:
        sys.exit(f"build.py: {error}")

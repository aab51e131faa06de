"""Options that several commands have, each declared once."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from maglev_mj.cli.declare import Option, Shared, option
from maglev_mj.cli.pictures import add_pictures, chosen_pictures
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.bridge.bench.calibration import Calibration
    from maglev_mj.pictures import PictureFolder


def json_of(what: str = "the figures") -> Option:
    """Declare a result's JSON."""
    return option(f"write {what} as JSON; - for standard output", "output", "FILE")


def pictures_to(help: str = "write pictures to this folder") -> Shared:
    """Declare the folder of pictures and their format."""
    return Shared(partial(add_pictures, told=help), chosen_pictures)


def _calibration(options: argparse.Namespace) -> Calibration:
    from maglev_mj.bridge.bench.calibration import Calibration

    return Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)


def _key(options: argparse.Namespace) -> bytes | None:
    """Return the key in a file; None without one."""
    from maglev_mj.bridge.wire import LEAST_KEY, MOST_KEY

    path: Path | None = options.key
    if path is None:
        return None
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        key = b""
    if not LEAST_KEY <= len(key) <= MOST_KEY:
        digits = f"{2 * LEAST_KEY} to {2 * MOST_KEY} hexadecimal digits"
        raise ParameterError(f"key must be a file of {digits}, not {str(path)!r}")
    return key


Json: TypeAlias = Annotated[str | None, json_of()]
Pictures: TypeAlias = Annotated["PictureFolder | None", pictures_to()]
Picture: TypeAlias = Annotated["PictureFolder | None", pictures_to("write a picture to this folder")]
Record: TypeAlias = Annotated[
    Path | None, option("write a recording, .mcap or .npz, for `maglev-mj replay`", "output", "FILE")
]
Folder: TypeAlias = Annotated[Path, option("folder for recordings and screenshots", "output", "DIR")]
Recorded: TypeAlias = Annotated[Path, option("a recording of run, view or bridge", "", "FILE")]
Seconds: TypeAlias = Annotated[float | None, option("end after so long [s]", above=0.0)]
Shown: TypeAlias = Annotated[float | None, option("close the window after so long [s]", above=0.0)]
Address: TypeAlias = Annotated[str, option("udp://HOST:PORT, or serial:///PATH?baud=RATE", "", "ADDRESS")]
CalibrationFile: TypeAlias = Annotated[
    "Calibration",
    option("what is known of the device (default: the model)", "device", "FILE", kind=Path, take=_calibration),
]
Key: TypeAlias = Annotated[
    bytes | None,
    option(
        "secret of 16 to 32 bytes as hexadecimal digits, for more than this machine",
        "device",
        "FILE",
        kind=Path,
        take=_key,
    ),
]
Realtime: TypeAlias = Annotated[
    Literal["enforce", "ignore"], option("what to do where the system refuses real-time scheduling")
]

"""Command that imports measurements of other programs."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from maglev_mj.cli.declare import Parser, Shared, option
from maglev_mj.cli.output import check_files, print_written
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.terminal import wrapped

if TYPE_CHECKING:
    from maglev_mj.recording.sample import Face

_TABLE, _DEVICE = "table", "device"
_VALUES = "time, pose x to rz, wrench fx to frz, wrench of a hand hx to hrz, currents i0 to i5"
_PAIRS = {
    "columns": f"COLUMN of {_VALUES}, quaternion=xyzw:A+B+C+D, euler=ZYX:A+B+C; without names: 1, 2, ...",
    "units": "unit of time, length, angle, force, torque, current, such as length=mm",
    "scale": "factor of a column: SI units per count, or -1 for a mirrored axis",
}


def _add_pairs(parser: Parser) -> None:
    for name, text in _PAIRS.items():
        group, required = parser.group(_TABLE), name == "columns"
        group.add_argument(
            f"--{name}", nargs="+", action="extend", default=[], metavar="NAME=X", help=text, required=required
        )


def _pairs(name: str, options: argparse.Namespace) -> dict[str, str]:
    """Return the words NAME=X of an option."""
    pairs: dict[str, str] = {}
    for word in getattr(options, name):
        key, _, value = word.partition("=")
        if not (key and value) or key in pairs:
            raise ParameterError(f"{name} must be NAME=X, each name once (got {word!r})")
        pairs[key] = value
    return pairs


_Pairs: TypeAlias = dict[str, str]


def _face(text: str) -> Face:
    """Parse a wall plane, AXIS:EDGE:SIDE."""
    from maglev_mj.parameters import axis_indices, parsed_number

    axis, _, rest = text.partition(":")
    edge, _, side = rest.partition(":")
    check_one_of("side of a face", ("above", "below"), side, ", as in z:0:above")
    return axis_indices(axis)[0], 1.0 if side == "above" else -1.0, parsed_number("edge of a face", edge)


def import_log(
    file: Annotated[Path, option("text table: CSV, tabs, semicolons or blanks", "", "FILE")],
    columns: Annotated[_Pairs, Shared(_add_pairs, partial(_pairs, "columns"))],
    units: Annotated[_Pairs, Shared(None, partial(_pairs, "units"))],
    scale: Annotated[_Pairs, Shared(None, partial(_pairs, "scale"))],
    face: Annotated[
        list[str], option("wall plane with its free side, such as z:0:above; repeat it", _DEVICE, "AXIS:EDGE:SIDE")
    ],
    mass: Annotated[float | None, option("moving mass [kg] (default: of --calibration)", _DEVICE, above=0.0)] = None,
    inertia: Annotated[str | None, option("moments of inertia [kg m²], required for torques", _DEVICE, "X,Y,Z")] = None,
    gravity: Annotated[
        float | None, option("gravity along -z [m/s²]; 0 for a device without weight", _DEVICE, at_least=0.0)
    ] = None,
    delay: Annotated[
        float | None,
        option("delay from a sample to the effect of its command [s] (default: one period)", _DEVICE, at_least=0.0),
    ] = None,
    calibration: Annotated[Path | None, option("mass, inertia, gravity and coils of a device", _DEVICE)] = None,
    rate: Annotated[
        float | None, option("sample rate [Hz] (default: from time)", _TABLE, inverse="period", above=0.0)
    ] = None,
    join: Annotated[
        Literal["none", "hold"],
        option("hold: hold the wrench until its next row, if pose and wrench are on rows of their own", _TABLE, "NAME"),
    ] = "none",
    resample: Annotated[
        bool, option("accept time off a uniform grid: pose by a cubic, wrench held; delay is not identifiable", _TABLE)
    ] = False,
    out: Annotated[
        Path | None, option("file .maglev, .mcap, .npz, .csv, .parquet or .wav (default: beside the table)", "output")
    ] = None,
) -> int:
    """Import a text table of another program as a recording, for analyse, diagnose, export and replay."""
    from maglev_mj.bridge.commissioning.calibration import Calibration
    from maglev_mj.parameters import parsed_number
    from maglev_mj.recording.export import EXPORTS, export
    from maglev_mj.recording.table import import_table

    path = out or file.with_suffix(".maglev")
    check_files({"out": path}, file)
    check_one_of("suffix of out", (".maglev", *(f".{kind}" for kind in EXPORTS)), path.suffix)
    device = None if calibration is None else Calibration.load(calibration)
    body = {name: getattr(device, name) for name in ("mass", "inertia", "gravity", "coils") if device is not None}
    moments = None if inertia is None else [parsed_number("inertia", part) for part in inertia.split(",")]
    weight = None if gravity is None else (0.0, 0.0, -gravity)
    stated = {"mass": mass, "inertia": moments, "gravity": weight}
    body |= {name: value for name, value in stated.items() if value is not None}
    if "mass" not in body:
        raise ParameterError("mass or calibration must be given; analyse compares the mass with the motion")
    options: dict[str, Any] = {"rate": rate, "hold": join == "hold", "resample": resample, "delay": delay, **body}
    factors = {name: parsed_number(f"scale of {name}", text) for name, text in scale.items()}
    recording = import_table(file, columns, units, scale=factors, faces=[*map(_face, face)], **options)
    if path.suffix == ".maglev":
        recording.save(path)
    else:
        export(recording, path.suffix[1:], path)
    print("\n".join(wrapped(recording.events[0])))
    print_written(path)
    return 0

"""Command that converts recordings and measurements of other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from maglev_mj.cli.declare import option
from maglev_mj.cli.options import assignments
from maglev_mj.cli.output import LAYOUT, Progress
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.recording.formats import FORMATS
from maglev_mj.terminal import wrapped

if TYPE_CHECKING:
    from maglev_mj.recording import Recording
    from maglev_mj.recording.sample import Face

_TABLE, _DEVICE = "text table", "device of a text table"
_DECIDED = "(default: decided by the file)"
_VALUES = (
    "column of each value (default: time and pose by name): time, pose x to rz, wrench fx to frz, of a hand hx to hrz, "
    "currents i0, i1, ..., quaternion=xyzw:A+B+C+D, euler=ZYX:A+B+C; without names, the columns are 1, 2, ..."
)


def _face(text: str) -> Face:
    """Parse a wall plane, AXIS:EDGE:SIDE."""
    from maglev_mj.parameters import axis_indices, parsed_number

    axis, edge, side = [*text.split(":"), "", ""][:3]
    check_one_of("side of a face", ("above", "below"), side, ", as in z:0:above")
    return axis_indices(axis)[0], 1.0 if side == "above" else -1.0, parsed_number("edge of a face", edge)


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """Options of a text table: its columns, and the device that it was measured on."""

    columns: Annotated[list[str], option(_VALUES, _TABLE, "NAME=COLUMN", several=True)]
    units: Annotated[
        list[str],
        option(
            "unit of time, length, angle, force, torque, current (default: as the file states it)",
            _TABLE,
            "NAME=UNIT",
            several=True,
        ),
    ]
    scale: Annotated[
        list[str], option("SI units per count of a column, or -1 to mirror it", _TABLE, "COLUMN=FACTOR", several=True)
    ]
    face: Annotated[list[str], option("wall plane and free side, such as z:0:above", _DEVICE, "PLANE", several=True)]
    mass: Annotated[float | None, option("moving mass [kg] (default: of --device)", _DEVICE, above=0.0)] = None
    inertia: Annotated[str | None, option("moments of inertia [kg m²], required for torques", _DEVICE, "X,Y,Z")] = None
    gravity: Annotated[float | None, option("gravity along -z [m/s²], 0 if compensated", _DEVICE, at_least=0.0)] = None
    delay: Annotated[
        float | None, option("delay from sample to force [s] (default: one period)", _DEVICE, at_least=0.0)
    ] = None
    device: Annotated[
        str | None, option("device file (.toml) or name, for mass, inertia, gravity, delay, coils", _DEVICE, "FILE")
    ] = None
    rate: Annotated[float | None, option("sample rate [Hz]", _TABLE, inverse="period", above=0.0)] = None
    join: Annotated[
        Literal["none", "hold"], option("hold: hold a wrench until its next row, for rows of pose or wrench", _TABLE)
    ] = "none"
    resample: Annotated[bool, option("accept time off a grid: pose by a cubic, wrench held", _TABLE)] = False
    encoding: Annotated[Literal["utf-8", "utf-16", "latin-1"] | None, option(f"encoding {_DECIDED}", _TABLE)] = None
    skip: Annotated[int | None, option(f"lines before names or numbers {_DECIDED}", _TABLE, at_least=0)] = None
    separator: Annotated[
        Literal["tab", "semicolon", "comma", "bar", "blank"] | None, option(f"separator {_DECIDED}", _TABLE)
    ] = None
    decimal: Annotated[
        Literal["point", "comma"] | None, option(f"decimal mark {_DECIDED}; the other one groups thousands", _TABLE)
    ] = None
    names: Annotated[str | None, option(f"names of all columns {_DECIDED}", _TABLE, "A,B,...")] = None


def _read_recording(file: Path, options: TableOptions) -> tuple[Recording, str]:
    """Return a recording, and its damage in words.

    Raises:
        ParameterError: If an option of a text table is set.
    """
    from maglev_mj.recording import Recording

    for name, default in vars(TableOptions(columns=[], units=[], scale=[], face=[])).items():
        if (value := getattr(options, name)) != default:
            raise ParameterError(f"{name} applies to a text table, not to a recording (got {value})")
    recording = Recording.load(file)
    return recording, f"{file}: {recording.damage}" if recording.damage else ""


def _read_table(file: Path, options: TableOptions) -> tuple[Recording, str]:
    """Return a text table as a recording, and what the file was taken for, which the recording keeps."""
    import numpy as np

    from maglev_mj.device import Device
    from maglev_mj.parameters import parsed_number, read_file
    from maglev_mj.plants.coils import CoilMap
    from maglev_mj.recording.table import import_table

    body: dict[str, Any] = {}
    delay = options.delay
    if options.device is not None:
        known = Device.load(options.device)
        body = {"mass": known.mass, "inertia": known.inertia[3:], "gravity": np.array(known.body.gravity)}
        body |= {} if known.coils is None else {"coils": CoilMap.of(known)}
        delay = known.delay if delay is None else delay
    body |= {} if options.mass is None else {"mass": options.mass}
    body |= {} if options.gravity is None else {"gravity": (0.0, 0.0, -options.gravity)}
    if options.inertia is not None:
        body["inertia"] = [parsed_number("inertia", part) for part in options.inertia.split(",")]
    if "mass" not in body:
        read_file("log", file, len, read=Path.read_bytes)  # a missing file is the first thing to say
        raise ParameterError("mass or device must be given; analyse compares the mass with the motion")
    table: dict[str, Any] = {name: getattr(options, name) for name in ("rate", "resample", "encoding", "skip")}
    table |= {"separator": options.separator, "decimal": options.decimal, "hold": options.join == "hold"}
    table["scale"] = {name: parsed_number("scale", text) for name, text in assignments("scale", options.scale).items()}
    table |= {"faces": [*map(_face, options.face)], "delay": delay}
    table["names"] = None if options.names is None else options.names.split(",")
    columns = assignments("columns", options.columns) if options.columns else None
    recording = import_table(file, columns, assignments("units", options.units), **table, **body)
    return recording, recording.events[0]


_FORMATS = {"maglev": "recording", **{name: form.text for name, form in FORMATS.items()}}
"""Meaning of each format of an output, by the suffix of the file."""


def convert(
    file: Annotated[
        Path, option("recording, or text table: CSV, tabs, semicolons or blanks; may be compressed by gzip", "", "IN")
    ],
    out: Annotated[Path, option("output file, whose suffix is its format", "", "OUT")],
    *,
    to: Annotated[
        str | None, option("format of OUT (default: its suffix)", "output", "FORMAT", meanings=_FORMATS)
    ] = None,
    table: TableOptions,
) -> int:
    """Convert a recording, or a text table of another program, to a recording, table, arrays, MCAP or sound.

    The content of IN decides how it is read. A table becomes a recording for analyse, diagnose and replay: one line
    says what the file was taken for, which the recording keeps; options override each part of it.
    """
    from maglev_mj.recording.export import export
    from maglev_mj.recording.journal import SUFFIX, is_journal

    kind = out.suffix[1:] if to is None else to
    check_one_of("format of out", _FORMATS, kind)
    read = _read_recording if file.suffix == SUFFIX or is_journal(file) else _read_table
    with Progress("convert"):
        recording, remark = read(file, table)
        if kind in FORMATS:
            export(recording, kind, out)
        else:
            recording.save(out)
    if remark:
        print("\n".join(wrapped(remark)))
    print(f"  wrote {out}: {recording.ticks} samples")
    if kind == "mcap":
        print(f"  Foxglove layout: {LAYOUT}")
    return 0

"""Command that imports measurements of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from maglev_mj.cli.declare import option
from maglev_mj.cli.options import assignments
from maglev_mj.cli.output import check_files, print_written
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.recording.formats import FORMATS
from maglev_mj.terminal import wrapped

if TYPE_CHECKING:
    from maglev_mj.recording.sample import Face

_SUFFIXES = ".maglev", *(f".{kind}" for kind in FORMATS)
_TABLE, _DEVICE = "table", "device"
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


def import_log(
    file: Annotated[Path, option("text table: CSV, tabs, semicolons or blanks; may be compressed by gzip", "", "FILE")],
    columns: Annotated[list[str], option(_VALUES, _TABLE, "NAME=COLUMN", several=True)],
    units: Annotated[
        list[str],
        option(
            "unit of time, length, angle, force, torque, current (default: as the file states it)",
            _TABLE,
            "NAME=UNIT",
            several=True,
        ),
    ],
    scale: Annotated[
        list[str], option("SI units per count of a column, or -1 to mirror it", _TABLE, "COLUMN=FACTOR", several=True)
    ],
    face: Annotated[list[str], option("wall plane and free side, such as z:0:above", _DEVICE, "PLANE", several=True)],
    mass: Annotated[float | None, option("moving mass [kg] (default: of --device)", _DEVICE, above=0.0)] = None,
    inertia: Annotated[str | None, option("moments of inertia [kg m²], required for torques", _DEVICE, "X,Y,Z")] = None,
    gravity: Annotated[float | None, option("gravity along -z [m/s²], 0 if compensated", _DEVICE, at_least=0.0)] = None,
    delay: Annotated[
        float | None, option("delay from sample to force [s] (default: one period)", _DEVICE, at_least=0.0)
    ] = None,
    device: Annotated[
        str | None, option("device file (.toml) or name, for mass, inertia, gravity, delay, coils", _DEVICE, "FILE")
    ] = None,
    rate: Annotated[float | None, option("sample rate [Hz]", _TABLE, inverse="period", above=0.0)] = None,
    join: Annotated[
        Literal["none", "hold"], option("hold: hold a wrench until its next row, for rows of pose or wrench", _TABLE)
    ] = "none",
    resample: Annotated[bool, option("accept time off a grid: pose by a cubic, wrench held", _TABLE)] = False,
    encoding: Annotated[Literal["utf-8", "utf-16", "latin-1"] | None, option(f"encoding {_DECIDED}", _TABLE)] = None,
    skip: Annotated[int | None, option(f"lines before names or numbers {_DECIDED}", _TABLE, at_least=0)] = None,
    separator: Annotated[
        Literal["tab", "semicolon", "comma", "bar", "blank"] | None, option(f"separator {_DECIDED}", _TABLE)
    ] = None,
    decimal: Annotated[
        Literal["point", "comma"] | None, option(f"decimal mark {_DECIDED}; the other one groups thousands", _TABLE)
    ] = None,
    names: Annotated[str | None, option(f"names of all columns {_DECIDED}", _TABLE, "A,B,...")] = None,
    out: Annotated[Path | None, option(f"file {' '.join(_SUFFIXES)} (default: beside the table)", "output")] = None,
) -> int:
    """Import a text table of another program as a recording, for analyse, diagnose, export and replay.

    Prints in one line what the file was taken for, which the recording keeps; options override each part of it.
    """
    import numpy as np

    from maglev_mj.device import Device
    from maglev_mj.parameters import parsed_number
    from maglev_mj.plants.coils import CoilMap
    from maglev_mj.recording.export import export
    from maglev_mj.recording.table import import_table

    path = out or file.with_suffix(".maglev")
    check_files({"out": path}, file)
    check_one_of("suffix of out", _SUFFIXES, path.suffix)
    body: dict[str, Any] = {}
    if device is not None:
        known = Device.load(device)
        body = {"mass": known.mass, "inertia": known.inertia[3:], "gravity": np.array(known.body.gravity)}
        body |= {} if known.coils is None else {"coils": CoilMap.of(known)}
        delay = known.delay if delay is None else delay
    body |= {} if mass is None else {"mass": mass}
    body |= {} if gravity is None else {"gravity": (0.0, 0.0, -gravity)}
    if inertia is not None:
        body["inertia"] = [parsed_number("inertia", part) for part in inertia.split(",")]
    if "mass" not in body:
        raise ParameterError("mass or device must be given; analyse compares the mass with the motion")
    table: dict[str, Any] = {"rate": rate, "hold": join == "hold", "resample": resample, "delay": delay}
    table["scale"] = {name: parsed_number("scale", text) for name, text in assignments("scale", scale).items()}
    table["faces"] = [*map(_face, face)]
    table |= {"encoding": encoding, "skip": skip, "separator": separator, "decimal": decimal}
    table["names"] = None if names is None else names.split(",")
    table["columns"] = assignments("columns", columns) if columns else None
    recording = import_table(file, units=assignments("units", units), **table, **body)
    if path.suffix == ".maglev":
        recording.save(path)
    else:
        export(recording, path.suffix[1:], path)
    print("\n".join(wrapped(recording.events[0])))
    print_written(path)
    return 0

"""Write a recording as .rrd for Rerun: device, walls, position, force and a blueprint.

pip install rerun-sdk && python scripts/examples/rerun_recording.py run.mcap [position.z] && rerun run.rrd
"""

import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import DeriveLens, McapReader, Selector

from maglev_mj import Recording
from maglev_mj.plants.shapes import Shape, shapes, wall_box
from maglev_mj.recording.messages import device_of

PLOTTED = "position.z", "applied.z"


def columns(stream: Any, entity: str, name: str) -> list[Any]:
    """Return the values of an entity's component over time."""
    tables = [pa.Table.from_batches([chunk.to_record_batch()]) for chunk in stream if chunk.entity_path == entity]
    table = pa.concat_tables([one.select(["message_log_time", name]) for one in tables if name in one.schema.names])
    return [one[0] for one in table.sort_by("message_log_time")[name].to_pylist()]


def scalars(reader: McapReader, field: str) -> Any:
    """Return the stream of a field of the samples."""
    named = rr.Scalars.descriptor_scalars(), Selector(f".{field}")
    lens = DeriveLens("maglev_mj.Sample:message", output_entity=f"/{field}").to_component(*named)
    return reader.stream().lenses([lens], content="/maglev/sample")


path, asked = Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "position.z"
reader, recording = McapReader(path), rr.RecordingStream("maglev_mj")
plots = [rrb.TimeSeriesView(origin=f"/{field}") for field in PLOTTED]
space = rrb.Spatial3DView(name="device", spatial_information=rrb.SpatialInformation(target_frame="stator"))
recording.save(path.with_suffix(".rrd"), default_blueprint=rrb.Horizontal(space, rrb.Vertical(*plots)))
recording.send_chunks(reader.stream())
for field in PLOTTED:
    recording.send_chunks(scalars(reader, field))
segment = Recording.load(path).segments[0]
device = device_of(segment.setup)
plates = wall_box(segment.metadata.faces, device.knob)[0].values()
walls = [Shape(False, "box", half, place, (1.0, 0.0, 0.0, 0.0), (0.25, 0.47, 0.85, 0.16)) for place, half in plates]
for number, one in enumerate([*shapes("maglev", device), *walls]):
    w, *axis = one.turn
    about = {"centers": [one.position], "quaternions": [[*axis, w]], "colors": [one.colour], "fill_mode": "solid"}
    long = {"lengths": [2.0 * one.half[2]], "radii": [one.half[0]]}
    sizes = long if one.kind == "cylinder" else {"half_sizes": [one.half]}
    shape = {"box": rr.Boxes3D, "cylinder": rr.Cylinders3D, "ellipsoid": rr.Ellipsoids3D}[one.kind](**sizes, **about)
    recording.log(f"/device/{number}", rr.CoordinateFrame("flotor" if one.moves else "stator"), shape, static=True)
recording.flush()
flotor = zip(*(columns(reader.stream(), "/tf", f"Transform3D:{name}") for name in ("child_frame", "translation")))
places = [place for name, place in flotor if name == "flotor"]
print(f"Transform3D of the flotor: {len(places)} rows, lowest {min(place[2] for place in places) * 1e3:.6f} mm")
values = columns(scalars(reader, asked), f"/{asked}", "Scalars:scalars")
print(f"Scalars of {asked}: {len(values)} rows, least {min(values)!r}")

"""Read a recording with Rerun.

It finds the flotor's transform, and a field of its samples as scalars.

    pip install rerun-sdk && python scripts/examples/rerun_recording.py run.mcap [position.z]

It needs nothing of this package. `rerun mcap convert run.mcap -o run.rrd` writes what is read here.
"""

from __future__ import annotations

import sys
from typing import Any

import pyarrow as pa
import rerun as rr
from rerun.chunk import DeriveLens, McapReader, Selector

MESSAGE = "maglev_mj.Sample:message"


def columns(stream: Any, entity: str, name: str) -> list[Any]:
    """Return the values of an entity's component over time."""
    found: list[Any] = []
    for chunk in stream:
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and name in batch.schema.names:
            times = batch.column(batch.schema.get_field_index("message_log_time")).cast(pa.int64()).to_pylist()
            found += zip(times, batch.column(batch.schema.get_field_index(name)).to_pylist(), strict=True)
    return [value[0] for _, value in sorted(found, key=lambda one: one[0])]


def main() -> None:
    """Print the flotor's position; it stands in the transform, and in a field of the samples."""
    path, field = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "position.z"
    reader = McapReader(path)
    names = columns(reader.stream(), "/tf", "Transform3D:child_frame")
    places = columns(reader.stream(), "/tf", "Transform3D:translation")
    flotor = [place for name, place in zip(names, places, strict=True) if name == "flotor"]
    print(f"Transform3D of the flotor: {len(flotor)} rows, lowest {min(place[2] for place in flotor) * 1e3:.6f} mm")
    lens = DeriveLens(MESSAGE, output_entity=f"/{field}").to_component(
        rr.Scalars.descriptor_scalars(), Selector(f".{field}")
    )
    scalars = columns(reader.stream().lenses([lens], content="/maglev/sample"), f"/{field}", "Scalars:scalars")
    print(f"Scalars of {field}: {len(scalars)} rows, least {min(scalars)!r}")


if __name__ == "__main__":
    main()

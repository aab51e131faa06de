"""Formats that recordings are exported to; imports nothing, so that a help can list them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Format(NamedTuple):
    """File format of an export.

    Attributes:
        writer: "module:function" of a recording, a temporary path to write to, and the final path.
        text: Meaning in the help of commands.
    """

    writer: str
    text: str


FORMATS: Mapping[str, Format] = {
    "npz": Format("maglev_mj.recording.export:as_npz", "arrays for NumPy"),
    "mcap": Format("maglev_mj.recording.export:as_mcap", "messages for Foxglove and Rerun"),
    "csv": Format("maglev_mj.recording.export:as_csv", "text table, everything else in FILE.csv.json"),
    "parquet": Format("maglev_mj.recording.export:as_parquet", "table for pandas and other data frames"),
    "wav": Format("maglev_mj.recording.export:as_wav", "force as sound"),
}
"""Formats of an export by name, which is the suffix of the file."""

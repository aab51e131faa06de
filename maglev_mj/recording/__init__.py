"""Recordings of runs: what went by at each sample, to be looked at, checked and run again bit for bit."""

from maglev_mj.recording.files import (
    EXPORTS,
    ArrayFile,
    ParquetMissingError,
    Recorder,
    RecordingFile,
    best_suffix,
    check_name,
    export,
    open_recording,
)
from maglev_mj.recording.legacy import metadata_of
from maglev_mj.recording.metadata import (
    Mechanics,
    OwnSetup,
    RunMetadata,
    Setup,
    setup_of,
)
from maglev_mj.recording.recording import InvalidRecordingError, Recording, RecordingError, Stretch
from maglev_mj.recording.row import FIELDS, ROW, TOTALS, Field, RecordedPlant
from maglev_mj.recording.verify import Expected, FieldVerdict, Rebuild, Verdict, verify

__all__ = [
    "EXPORTS",
    "FIELDS",
    "ROW",
    "TOTALS",
    "ArrayFile",
    "Expected",
    "Field",
    "FieldVerdict",
    "InvalidRecordingError",
    "Mechanics",
    "OwnSetup",
    "ParquetMissingError",
    "Rebuild",
    "RecordedPlant",
    "Recorder",
    "Recording",
    "RecordingError",
    "RecordingFile",
    "RunMetadata",
    "Setup",
    "Stretch",
    "Verdict",
    "best_suffix",
    "check_name",
    "export",
    "metadata_of",
    "open_recording",
    "setup_of",
    "verify",
]

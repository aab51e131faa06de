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
from maglev_mj.recording.metadata import Mechanics, RunMetadata, Setup
from maglev_mj.recording.recording import InvalidRecordingError, Recording, RecordingError, Stretch
from maglev_mj.recording.setup import (
    Own,
    OwnCodeError,
    attach_model,
    attach_source,
    controller_again,
    plant_again,
    scripted,
    setup_of,
)
from maglev_mj.recording.verify import Expected, Rebuild, Verdict, first_other_answer, verify

__all__ = [
    "EXPORTS",
    "ArrayFile",
    "Expected",
    "InvalidRecordingError",
    "Mechanics",
    "Own",
    "OwnCodeError",
    "ParquetMissingError",
    "Rebuild",
    "Recorder",
    "Recording",
    "RecordingError",
    "RecordingFile",
    "RunMetadata",
    "Setup",
    "Stretch",
    "Verdict",
    "attach_model",
    "attach_source",
    "best_suffix",
    "check_name",
    "controller_again",
    "export",
    "first_other_answer",
    "metadata_of",
    "open_recording",
    "plant_again",
    "scripted",
    "setup_of",
    "verify",
]

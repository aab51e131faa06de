"""Recordings of runs: what went by at each sample, to be looked at, checked and run again bit for bit."""

from maglev_mj.recording.export import EXPORTS, ParquetMissingError, export
from maglev_mj.recording.files import ArrayFile, RecordingFile, best_suffix, check_name, open_recording
from maglev_mj.recording.recorder import Felt, Mechanics, Recorder, row_of
from maglev_mj.recording.stretch import InvalidRecordingError, Recording, RecordingError, Setup, Stretch
from maglev_mj.recording.verify import Expected, FieldVerdict, Rebuild, Verdict, verify

__all__ = [
    "EXPORTS",
    "ArrayFile",
    "Expected",
    "Felt",
    "FieldVerdict",
    "InvalidRecordingError",
    "Mechanics",
    "ParquetMissingError",
    "Rebuild",
    "Recorder",
    "Recording",
    "RecordingError",
    "RecordingFile",
    "Setup",
    "Stretch",
    "Verdict",
    "best_suffix",
    "check_name",
    "export",
    "open_recording",
    "row_of",
    "verify",
]

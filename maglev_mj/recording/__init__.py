"""Recordings of runs: samples to view, check and replay bitwise."""

from maglev_mj.recording.export import EXPORTS, export
from maglev_mj.recording.files import ArrayFile, Recorder, RecordingFile, best_suffix, check_name, open_recording, tee
from maglev_mj.recording.recording import (
    InvalidRecordingError,
    Recording,
    RecordingError,
    Samples,
    Stretch,
    load_samples,
)
from maglev_mj.recording.sample import Mechanics, RunMetadata, Setup
from maglev_mj.recording.setup import OwnCodeError, setup_of
from maglev_mj.recording.verify import Expected, Rebuild, Verdict, verify

__all__ = [
    "EXPORTS",
    "ArrayFile",
    "Expected",
    "InvalidRecordingError",
    "Mechanics",
    "OwnCodeError",
    "Rebuild",
    "Recorder",
    "Recording",
    "RecordingError",
    "RecordingFile",
    "RunMetadata",
    "Samples",
    "Setup",
    "Stretch",
    "Verdict",
    "best_suffix",
    "check_name",
    "export",
    "load_samples",
    "open_recording",
    "setup_of",
    "tee",
    "verify",
]

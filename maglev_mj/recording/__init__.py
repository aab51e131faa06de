"""Recordings of runs: what went by at each sample, to be looked at, checked and run again bit for bit."""

from maglev_mj.recording.recorder import Felt, Recorder, row_of
from maglev_mj.recording.stretch import Recording, RecordingError, Setup, Stretch
from maglev_mj.recording.verify import Rebuild, Verdict, verify

__all__ = [
    "Felt",
    "Rebuild",
    "Recorder",
    "Recording",
    "RecordingError",
    "Setup",
    "Stretch",
    "Verdict",
    "row_of",
    "verify",
]

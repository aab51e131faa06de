"""The pose stream: what graphical hosts are told while a scene runs, and how they set it; see docs/stream.md."""

from maglev_mj.stream.client import Answer, StreamClient, StreamError
from maglev_mj.stream.stream import PoseStream

__all__ = ["Answer", "PoseStream", "StreamClient", "StreamError"]

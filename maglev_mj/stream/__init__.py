"""The pose stream: what graphical hosts are told while a scene runs, and how they set it; see docs/stream.md."""

from maglev_mj.stream.client import Answer, StreamClient, StreamError
from maglev_mj.stream.stream import URL, PoseStream

__all__ = ["URL", "Answer", "PoseStream", "StreamClient", "StreamError"]

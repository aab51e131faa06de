"""The live server: programs that read the Foxglove protocol watch a scene and set it; see docs/reference/live.md."""

from maglev_mj.live.server import PORT, LiveServer, LiveServerError

__all__ = ["PORT", "LiveServer", "LiveServerError"]

"""Live server of the Foxglove protocol; see docs/reference/live.md.

Other programs watch a scene and set its parameters.
"""

from maglev_mj.live.server import PORT, LiveServer, LiveServerError

__all__ = ["PORT", "LiveServer", "LiveServerError"]

"""Live server of the Foxglove protocol; see docs/reference/live.md.

Other programs watch a scene and set its parameters.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

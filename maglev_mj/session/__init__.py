"""Scene in real time, without a window.

Pacing, changes by keys, recording, and snapshots.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

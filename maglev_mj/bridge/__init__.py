"""Bridge to a device: wire protocol, simulated twin, safety limits."""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

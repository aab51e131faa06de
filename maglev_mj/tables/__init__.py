"""Results as text for a terminal, one module per subject."""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Stability theory of rendered walls, and wall design.

The exact closed loop, its stability boundary over the gains, and walls designed by it.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Recordings of runs: samples to view, check and replay bitwise."""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

"""Simulated plants, hands, sensors and the device model."""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

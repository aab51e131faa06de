"""Sampled controller: control laws, command timeline and control loop.

Laws are pure functions with frozen parameters: they take a state and return the next one. The same code serves one
device and a batch of N. Each law receives position and velocity on all six axes and adds its force to the common
wrench.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

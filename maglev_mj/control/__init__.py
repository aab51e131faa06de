"""Sampled controller: laws, the time line of commands, and the loop that drives a plant.

Laws are pure functions with frozen parameters.

A law takes a state and returns the next one; the same code serves one device and N devices. It acts on some of the six
axes: the controller hands it the position and velocity components of all six, and each law adds its force to the same
wrench.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

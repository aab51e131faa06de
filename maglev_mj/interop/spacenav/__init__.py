"""The joystick as a 3D mouse over spacenav's protocol.

Six axes for any program, on a Unix socket.
"""

from maglev_mj.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)

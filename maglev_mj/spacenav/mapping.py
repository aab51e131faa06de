"""Settings of a six-axis input device.

Gains, dead zone, order and signs of the axes, buttons.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import Parameters, param

_NOTHING, _NONE = "0", "none"
_FINITE = 1e6


class AxisMapping(Parameters):
    """Mapping from an input device's deflections to six numbers.

    The dead zone is taken off each deflection first. Then come order and signs, the gains, and the choice of the
    largest. The defaults change no number.

    Raises:
        ParameterError: If a value is outside its bounds, or a word is no axis.

    Example:
        >>> mapping = AxisMapping(order="x,y,z,0,0,0", invert="y", dominant=True)
        >>> mapping([0.2, 0.1, 0.5, 0.9, 0.0, 0.0]).tolist()
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    """

    gain: float = param("factor on translations", default=1.0, at_least=0.0, at_most=100.0)
    turning_gain: float = param("factor on rotations", default=1.0, at_least=0.0, at_most=100.0)
    dead_zone: float = param("share of a full deflection that counts as none", default=0.0, at_least=0.0, at_most=0.9)
    order: str = param("axis behind each of the six numbers, 0 for none", default=",".join(AXES))
    invert: str = param("numbers with the opposite sign, such as x,rz", default=_NONE)
    dominant: bool = param("keep the largest of the six numbers alone", default=False)

    def check(self) -> None:
        """See `Parameters`."""
        words, inverted = self.order.split(","), self._inverted()
        if len(words) != len(AXES) or not set(words) <= {*AXES, _NOTHING}:
            raise ParameterError(f"order must be six of {', '.join(AXES)} and {_NOTHING}, not {self.order!r}")
        if not set(inverted) <= set(AXES) or len(set(inverted)) < len(inverted):
            raise ParameterError(f"invert must be {_NONE}, or some of {', '.join(AXES)}, not {self.invert!r}")

    def outside(self, deflection: Array, full: Array) -> Array:
        """Return a deflection without its dead zone, (6,).

        A full deflection stays full.

        Args:
            deflection: From the centre [m, rad], (6,).
            full: The full one [m, rad], (6,).
        """
        if self.dead_zone == 0.0:
            return deflection
        rest = np.maximum(np.abs(deflection) - self.dead_zone * full, 0.0) / (1.0 - self.dead_zone)
        beyond: Array = np.copysign(rest, deflection)
        return beyond

    def __call__(self, shares: Array) -> Array:
        """Return the six numbers, (6,); NaN counts as 0.

        Args:
            shares: Of the full deflection or rate, (6,).
        """
        told: Array = self._matrix @ np.nan_to_num(shares, posinf=_FINITE, neginf=-_FINITE)
        if self.dominant:
            told[np.arange(len(AXES)) != np.argmax(np.abs(told))] = 0.0
        return told

    def _inverted(self) -> list[str]:
        return [] if self.invert == _NONE else self.invert.split(",")

    @cached_property
    def _matrix(self) -> Array:
        matrix = np.zeros((len(AXES), len(AXES)))
        for row, (name, source) in enumerate(zip(AXES, self.order.split(","))):
            if source != _NOTHING:
                gain = self.gain if row < 3 else self.turning_gain
                matrix[row, AXES.index(source)] = -gain if name in self._inverted() else gain
        return matrix


class SpacenavMapping(AxisMapping):
    """Settings of the joystick as a 3D mouse.

    Raises:
        ParameterError: See `AxisMapping`.
    """

    press: float | None = param(
        "force of a tap on the lower or the upper wall, which is button 0 or 1",
        "N",
        default=None,
        optional=True,
        at_least=0.5,
        at_most=50.0,
    )

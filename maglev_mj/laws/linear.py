"""A law or an estimate of one coordinate as a linear system, for theory to put into a closed loop."""

from __future__ import annotations

from typing import NamedTuple

from maglev_mj.frames import Array

__all__ = ["LinearController"]


class LinearController(NamedTuple):
    """q[k+1] = advance q[k] + take x[k]; output[k] = give q[k] + direct x[k].

    The position x is measured from the edge of the wall.

    Attributes:
        advance: (..., n, n).
        take: (..., n).
        give: (..., n).
        direct: (...,).
    """

    advance: Array
    take: Array
    give: Array
    direct: Array

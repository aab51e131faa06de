"""Drags of the handle's knob on the page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plants.shapes import GRIP
from maglev_mj.views.glide import SILENCE

Aim = Callable[[list[float] | None], object]
"""Takes a target pose [m, rad], (6,); None on release."""


class Grab:
    """Follow drags of the knob: plain moves, Shift tilts.

    The first browser to grab has the hand.

    Its methods run in the event loop of viser, in order.

    Args:
        server: viser's.
        knob: What is dragged.
        aim: Told of each target.

    Attributes:
        pose: Where the flotor is [m, rad], (6,).
    """

    def __init__(self, server: Any, knob: Any, aim: Aim) -> None:
        self._server, self._aim = server, aim
        self._holder: int | None = None
        self._listening: asyncio.Task[None] | None = None
        self._tilts = self._silent = False
        self.pose = self._from = np.zeros(6)
        self._start, self._target = np.zeros(3), [0.0] * 6
        for modifier in (None, "shift"):
            knob.on_drag("left", modifier=modifier)(self._dragged)

    async def _dragged(self, event: Any) -> None:
        if event.phase == "start" and (self._holder is None or self._silent):
            self._let_go()
            self._holder, self._tilts = event.client_id, event.modifier == "shift"
            self._from, self._start = self.pose, np.array(event.start_position)
            self._listening = asyncio.create_task(self._listen(event.client_id))
        if event.client_id != self._holder:
            return
        if event.phase == "end":
            self._let_go()
        else:
            self._target = self._pose(np.array(event.end_position) - self._start).tolist()
            self._aim(self._target)

    def _pose(self, moved: Array) -> Array:
        """Return the target pose for a knob displacement [m], (3,)."""
        place, turn = self._from[:3], self._from[3:]
        if self._tilts:
            return np.concatenate([place, turn + np.cross(GRIP, moved) / (GRIP @ GRIP)])
        return np.concatenate([place + moved, turn])

    def _let_go(self) -> None:
        self._holder, self._silent = None, False
        if self._listening is not None:
            self._listening.cancel()
        self._aim(None)

    async def _listen(self, client: int) -> None:
        """Release the knob while a browser does not answer.

        One that is held still sends nothing by itself.
        """
        while self._holder == client:
            answer = asyncio.ensure_future(self._ask(client))
            self._silent = not (await asyncio.wait([answer], timeout=SILENCE))[0]
            if self._silent:
                self._aim(None)
                await asyncio.wait([answer])
            if self._holder != client:
                return
            if answer.exception() is not None:  # it is gone, and nobody may say the end of its drag
                self._let_go()
                return
            if self._silent:
                self._silent = False
                self._aim(self._target)
            await asyncio.sleep(SILENCE / 5.0)

    async def _ask(self, client: int) -> None:
        """Wait for a browser's answer.

        Raises:
            Exception: If it is gone.
        """
        await (await self._server._websock_server._live_connections[client].ping())

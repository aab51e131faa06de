"""What has been asked for and checked, on its way from the thread that listens to the loop that takes it."""

from __future__ import annotations

import threading
from typing import NamedTuple

from maglev_mj.net.udp import Address
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.stream.datagrams import Message
from maglev_mj.stream.messages import refused, same_rules

__all__ = ["Asked", "Pending"]

_BY_HOST = "replaced by a newer set, before it was in force for a sample that was told of"
_BY_PERSON = "replaced by a change at the machine"


class Asked(NamedTuple):
    """Settings that were asked for, checked and accepted.

    Attributes:
        address: Of the host.
        asked: The host's number for it; None for none.
        given: What it wrote.
        scene: The scene with it.
        tick: The newest sample told of when they were accepted.
        session: Of the stream.
    """

    address: Address
    asked: int | None
    given: object
    scene: Scene
    tick: int
    session: int


def accepted(asked: Asked) -> Message:
    """Return what the host is told that may have what it asks for."""
    return {"type": "accepted", "id": asked.asked, "session": asked.session, "tick": asked.tick}


class Pending:
    """At most one waits for the loop; the newest has it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: Asked | None = None
        self._taken: list[Asked] = []
        self._untold: Asked | None = None
        self._done: tuple[Asked, Message] | None = None

    def put(self, asked: Asked) -> list[tuple[Message, Address]]:
        """Let settings wait; return what is to be said, and to whom. Call `told` when it has been."""
        with self._lock:
            older, self._waiting = self._waiting, asked
            self._untold = asked
        said = [(accepted(asked), asked.address)]
        if older is not None:
            said.append((refused(older.asked, _BY_HOST, older.session), older.address))
        return said

    def told(self) -> None:
        """Take note that the host has been told of what was accepted last: it may hear now that it is in force."""
        self._untold = None

    def again(self, address: Address, asked: int | None, given: object) -> Message | None:
        """Return what a host was told last of a request that it sends again; None where it is a new one."""
        if asked is None:
            return None
        with self._lock:
            for one in (self._waiting, *self._taken):
                if one is not None and one[:3] == (address, asked, given):
                    return accepted(one)
            if self._done is not None and self._done[0][:3] == (address, asked, given):
                return self._done[1]
        return None

    def take(self) -> Scene | None:
        """Return what waits, once; for the loop."""
        if self._waiting is None:  # as nearly always: it is asked at every tick
            return None
        with self._lock:
            taken, self._waiting = self._waiting, None
            if taken is None:
                return None
            self._taken.append(taken)
        return taken.scene

    def settle(self, snapshot: Snapshot) -> list[tuple[Message, Address]]:
        """Return what is to be said of what the loop has taken, now that a snapshot under it is there, and to whom."""
        if not self._taken or self._untold is self._taken[-1]:
            return []
        with self._lock:
            taken, self._taken = self._taken, []
            said = [(refused(one.asked, _BY_HOST, one.session), one.address) for one in taken[:-1]]
            last = taken[-1]
            message = refused(last.asked, _BY_PERSON, last.session)
            if same_rules(last.scene, snapshot.scene):
                message = {"type": "in force", "id": last.asked, "session": last.session, "tick": snapshot.since}
            self._done = (last, message)
        return [*said, (message, last.address)]

"""What the pose stream knows of its hosts: who hears poses, and which settings are asked for."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.net.udp import Address
from maglev_mj.scenes import Scene
from maglev_mj.session import Refusal, Snapshot, refusal
from maglev_mj.stream.datagrams import MOST_ASKED, Datagrams, Guard, Message
from maglev_mj.stream.messages import (
    accepted,
    asked_scene,
    description,
    identifier,
    mistaken,
    pose_message,
    refused,
)

__all__ = ["MOST_SUBSCRIBERS", "SUBSCRIBED", "Hosts", "Said", "Verdict", "checked"]

SUBSCRIBED = 5.0
"""How long poses go to a host that does not renew its subscription [s]."""

MOST_SUBSCRIBERS = 16

_OWN = ("pose", "description", "subscribed", "unsubscribed", "accepted", "refused", "error", "end")
"""What the stream says itself: answering those, two streams could go on for ever."""

_NEWER = "replaced by a newer set before it was in force"

Said: TypeAlias = list[tuple[Message, Address]]
"""What is to be said, and to whom."""

Verdict: TypeAlias = Scene | Refusal | str
"""The scene that a host may have, or why it may not."""


class _Set(NamedTuple):
    """A set that a host asks for: its address, its number for it (None for none), what it wrote."""

    address: Address
    asked: int | None
    given: object


def checked(snapshot: Snapshot, given: object) -> Verdict:
    """Return the present scene with the settings that a host asks for, or why it may not have them."""
    try:
        wanted = asked_scene(snapshot.scene, given)
        return refusal(wanted.replace(delay=snapshot.delay), inertia=snapshot.inertia) or wanted
    except MaglevError as error:
        return str(error)
    except Exception as error:  # a scene or a law of the user's own
        return f"the settings cannot be checked: {type(error).__name__}: {error}"


class Hosts:
    """Answers hosts. It has no socket, and waits for nothing.

    One set at a time is on its way: it waits, is checked, and is handed to the control loop. So each is checked with
    the settings that the one before has left. At most one more waits; the newest has it.

    Args:
        key: See `PoseStream`.
        clock: Returns real time [s].

    Attributes:
        dropped: How many datagrams were dropped, by reason: size, tag, json, session, replay, own, network;
            and, as unsent, how many could not leave.
        nothing: Why there is nothing to describe or to set.
    """

    def __init__(self, key: bytes | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._datagrams, self._guard, self._clock = Datagrams(key, MOST_ASKED), Guard(), clock
        self.encode, self.dropped = self._datagrams.encode, self._datagrams.dropped
        self.nothing = "nothing runs here yet"
        self._subscribers: dict[Address, float] = {}
        self._snapshot: Snapshot | None = None
        self._waiting: _Set | None = None
        self._checking: _Set | None = None
        self._handed: _Set | None = None
        self._done: deque[tuple[_Set, Message]] = deque(maxlen=MOST_SUBSCRIBERS)

    def answers(self, data: bytes, address: Address) -> Said:
        """Take a datagram; return what is to be said at once, and to whom. It never raises.

        Args:
            data: Whatever has come.
            address: Where from.
        """
        message = self._datagrams.decode(data)
        if message is None:
            return []
        kind, session = message.get("type"), self._guard.session
        if kind in _OWN:
            self.dropped["own"] += 1
            return []
        # who asks for the description does so to learn the session
        if self._datagrams.keyed and kind != "get" and (objection := self._guard.objection(message)):
            self.dropped[objection] += 1
            return []
        asked: int | None = None
        try:
            asked = identifier(message)
            if kind == "set":
                return self._set(_Set(address, asked, message.get("settings")))
            return [(self._answer(kind, asked, session, address), address)]
        except MaglevError as error:
            return [(mistaken(asked, str(error), session), address)]

    def to_check(self) -> tuple[Snapshot, object] | None:
        """Return what `checked` is to look at next, once; `settle` its verdict."""
        if self._waiting is None or self._checking is not None or self._handed is not None or self._snapshot is None:
            return None
        self._checking, self._waiting = self._waiting, None
        return self._snapshot, self._checking.given

    def settle(self, verdict: Verdict) -> Said:
        """Note what came of a check; a scene is for the control loop now, whose answer comes by `show`."""
        request, self._checking = self._checking, None
        if request is None:
            return []
        if isinstance(verdict, Scene):
            self._handed = request
            return []
        figures = verdict if isinstance(verdict, Refusal) else None
        return self._finish(request, refused(request.asked, str(verdict), self._guard.session, figures))

    def show(self, snapshot: Snapshot, answer: int | str | None = None) -> Said:
        """Publish a snapshot, and what the control loop answered to the scene that it was handed."""
        self._snapshot, session = snapshot, self._guard.session
        said: Said = []
        if answer is not None and self._handed is not None:
            asked = self._handed.asked
            no = isinstance(answer, str)
            said = self._finish(
                self._handed, refused(asked, str(answer), session) if no else accepted(asked, int(answer), session)
            )
            self._handed = None
        message = pose_message(snapshot, session)
        return said + [(message, address) for address in self._subscribed()]

    def end(self) -> Said:
        """Return what is said to all when the scene is closed."""
        message = {"type": "end", "session": self._guard.session}
        return [(message, address) for address in self._subscribed()]

    def _answer(self, kind: object, asked: int | None, session: int, address: Address) -> Message:
        """Return the answer to anything but a set."""
        if kind == "get":
            if self._snapshot is None:
                return refused(asked, self.nothing, session)
            return description(self._snapshot, session, asked, self.dropped)
        if kind == "subscribe":
            if not self._subscribe(address):
                return refused(asked, f"there are {MOST_SUBSCRIBERS} subscribers already", session)
            return {"type": "subscribed", "id": asked, "session": session, "seconds": SUBSCRIBED}
        if kind == "unsubscribe":
            self._subscribers.pop(address, None)
            return {"type": "unsubscribed", "id": asked, "session": session}
        raise ParameterError(f"type must be one of get, subscribe, unsubscribe, set, not {kind!r}")

    def _set(self, request: _Set) -> Said:
        """Let a set wait for its check, unless it is on its way already, or done."""
        address, asked, _ = request
        if self._snapshot is None:
            return [(refused(asked, self.nothing, self._guard.session), address)]
        if asked is not None:
            if request in (self._waiting, self._checking, self._handed):
                return []
            for done, message in self._done:
                if done == request:
                    return [(message, address)]
        older, self._waiting = self._waiting, request
        return [] if older is None else self._finish(older, refused(older.asked, _NEWER, self._guard.session))

    def _finish(self, request: _Set, message: Message) -> Said:
        """Answer a set, and keep the answer for a host that asks again."""
        self._done.append((request, message))
        return [(message, request.address)]

    def _subscribe(self, address: Address) -> bool:
        """Let poses go to an address; return whether there is room for it."""
        now = self._clock()
        self._subscribers = {one: until for one, until in self._subscribers.items() if until > now}
        if address not in self._subscribers and len(self._subscribers) >= MOST_SUBSCRIBERS:
            return False
        self._subscribers[address] = now + SUBSCRIBED
        return True

    def _subscribed(self) -> list[Address]:
        now = self._clock()
        return [address for address, until in self._subscribers.items() if until > now]

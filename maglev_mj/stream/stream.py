"""The pose stream: tells graphical hosts of every frame, and takes settings from them that would be stable."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeAlias

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.net.addresses import check_host, parse_url
from maglev_mj.net.udp import Address, UdpServer
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot, refusal
from maglev_mj.stream.datagrams import MOST_ASKED, Datagrams, Guard, Message
from maglev_mj.stream.messages import asked_scene, description, identifier, mistaken, pose_message, refused
from maglev_mj.stream.pending import Asked, Pending

__all__ = ["MOST_SUBSCRIBERS", "SUBSCRIBED", "URL", "PoseStream"]

URL = "udp://127.0.0.1:5680"

SUBSCRIBED = 5.0
"""How long poses go to a host that does not renew its subscription [s]."""

MOST_SUBSCRIBERS = 16

_LOOK = 0.1
_OWN = ("pose", "description", "subscribed", "unsubscribed", "accepted", "in force", "refused", "error", "end")
"""What the stream says itself: answering those, two streams could go on for ever."""

_NOTHING = "nothing runs here yet"
_Said: TypeAlias = list[tuple[Message, Address]]


class PoseStream:
    """Tells graphical hosts of every frame, and takes settings from them that would be stable: a `Publisher`.

    A thread of its own listens, checks and answers. The loop that shows it a snapshot makes one datagram of it and
    sends that without waiting.

    Args:
        url: Where to listen, udp://HOST:PORT; port 0 for any that is free.
        key: 16 to 32 bytes that every host must have too; needed for any machine but this.
        clock: Returns real time [s].

    Attributes:
        address: Where it listens: host and port.
        dropped: How many datagrams were dropped, by reason: size, tag, json, session, replay, own, network.
        unsent: Datagrams that could not leave at once and were left out.

    Raises:
        ParameterError: If the address is none, or is another machine's and there is no key, or the key is none.
        LinkError: If it cannot listen there.
    """

    def __init__(
        self, url: str = URL, *, key: bytes | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        scheme, host, port = parse_url(url, server=True)
        if scheme != "udp":
            raise ParameterError(f"a pose stream must be at udp://HOST:PORT, not {url!r}")
        self._datagrams, self._guard, self._clock = Datagrams(key, MOST_ASKED), Guard(), clock
        self.dropped, self.unsent = self._datagrams.dropped, 0
        self._pending = Pending()
        self._subscribers: dict[Address, float] = {}
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._snapshot: Snapshot | None = None
        self._server = UdpServer(check_host(host, key), port, backlog=None)
        self.address: Address = self._server.address
        self._thread = threading.Thread(target=self._listen, name="pose stream", daemon=True)
        self._thread.start()

    def take(self) -> Scene | None:
        """Return the scene that a host asks for and may have, once."""
        return self._pending.take()

    def show(self, snapshot: Snapshot) -> None:
        """Publish a snapshot."""
        self._snapshot = snapshot
        for message, address in self._pending.settle(snapshot):
            self._send(self._datagrams.encode(message), address)
        if addresses := self._subscribed():
            data = self._datagrams.encode(pose_message(snapshot, self._guard.session))
            for address in addresses:
                self._send(data, address)

    def close(self) -> None:
        """Let everybody go; a second time does nothing."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._send(b"", self.address)  # wakes the thread; where it does not, that looks by itself
        self._thread.join()
        data = self._datagrams.encode({"type": "end", "session": self._guard.session})
        for address in self._subscribed():
            self._send(data, address)
        self._server.close()

    def answers(self, data: bytes, address: Address) -> _Said:
        """Take a datagram; return what is to be said, and to whom. It never raises.

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
                return self._set(asked, message.get("settings"), address)
            return [(self._answer(kind, asked, session, address), address)]
        except MaglevError as error:
            return [(mistaken(asked, str(error), session), address)]

    def _answer(self, kind: object, asked: int | None, session: int, address: Address) -> Message:
        """Return the answer to anything but a set."""
        if kind == "get":
            snapshot = self._snapshot
            return refused(asked, _NOTHING, session) if snapshot is None else description(snapshot, session, asked)
        if kind == "subscribe":
            if not self._subscribe(address):
                return refused(asked, f"there are {MOST_SUBSCRIBERS} subscribers already", session)
            return {"type": "subscribed", "id": asked, "session": session, "seconds": SUBSCRIBED}
        if kind == "unsubscribe":
            with self._lock:
                self._subscribers.pop(address, None)
            return {"type": "unsubscribed", "id": asked, "session": session}
        raise ParameterError(f"type must be one of get, subscribe, unsubscribe, set, not {kind!r}")

    def _set(self, asked: int | None, given: object, address: Address) -> _Said:
        """Check what a host asks for, and let it wait for the loop."""
        snapshot, session = self._snapshot, self._guard.session
        if snapshot is None:
            return [(refused(asked, _NOTHING, session), address)]
        if (known := self._pending.again(address, asked, given)) is not None:
            return [(known, address)]
        try:
            wanted = asked_scene(snapshot.scene, given)
            wrong = refusal(wanted.replace(delay=snapshot.delay))
        except MaglevError as error:
            return [(refused(asked, str(error), session), address)]
        if wrong is not None:
            return [(refused(asked, str(wrong), session, wrong), address)]
        return self._pending.put(Asked(address, asked, given, wanted, snapshot.tick, session))

    def _subscribe(self, address: Address) -> bool:
        """Let poses go to an address; return whether there is room for it."""
        now = self._clock()
        with self._lock:
            self._subscribers = {one: until for one, until in self._subscribers.items() if until > now}
            if address not in self._subscribers and len(self._subscribers) >= MOST_SUBSCRIBERS:
                return False
            self._subscribers[address] = now + SUBSCRIBED
        return True

    def _subscribed(self) -> list[Address]:
        now = self._clock()
        with self._lock:
            return [address for address, until in self._subscribers.items() if until > now]

    def _listen(self) -> None:
        """Answer until closed."""
        while not self._closing.is_set():
            try:
                arrived = self._server.receive(_LOOK)
            except OSError:  # on some systems this is where a datagram sent earlier comes back
                self.dropped["network"] += 1
                continue
            if arrived is None:
                continue
            if self._closing.is_set():
                return
            data, address = arrived
            began = time.perf_counter()
            for message, peer in self.answers(data, address):
                self._send(self._datagrams.encode(message), peer)
            self._pending.told()
            # hosts that ask without end get half of the time that the loop may need
            self._closing.wait(time.perf_counter() - began)

    def _send(self, data: bytes, address: Address) -> None:
        """Send one datagram; one that cannot leave now is lost."""
        try:
            left = self._server.send(data, address)
        except OSError:
            left = False
        self.unsent += not left  # no room, or nobody there: a newer pose comes in a moment

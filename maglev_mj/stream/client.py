"""A graphical host's end of the pose stream."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Iterator, Mapping
from types import NoneType
from typing import Any, NamedTuple, Self

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES
from maglev_mj.net.addresses import check_host, parse_url
from maglev_mj.net.udp import UdpLink
from maglev_mj.parameters import number
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.session import DEVICES_OWN, Snapshot
from maglev_mj.stream.datagrams import MOST_ANSWERED, MOST_INTEGER, Datagrams, Message
from maglev_mj.stream.messages import posed_snapshot
from maglev_mj.stream.stream import URL

__all__ = ["Answer", "StreamClient", "StreamError"]

_NEEDED: Mapping[str, Mapping[str, Any]] = {
    "pose": {
        **{name: dict for name in ("pose", "force", "hand")},
        **{name: int for name in ("session", "tick", "missed", "settings_since")},
        **{"time": (int, float), "state": str, "reason": str, "stuck": (dict, NoneType)},
    },
    "description": {"session": int, "scene": str, "settings": dict},
    "refused": {"reason": str, "figures": (dict, NoneType)},
    "accepted": {"tick": int},
}
"""What is in messages that are taken apart here."""

_SIX = ("pose", "force", "hand", "stuck")
_AGAIN = 0.25
_SOON = 0.05
_RENEW = 1.5
_KEPT = 256


class StreamError(MaglevError):
    """No pose stream answers, it will not have this host, or it has ended."""


class Answer(NamedTuple):
    """What came of a set.

    Attributes:
        reason: Why it was refused; empty where it is in force.
        figures: Of the loop that would be unstable, see `Refusal`; None where that is not the reason.
        since: The first sample answered under it; None where it is not in force.
    """

    reason: str = ""
    figures: Mapping[str, Any] | None = None
    since: int | None = None


class StreamClient:
    """Hears of poses and sets the scene.

    Args:
        url: Of the stream, udp://HOST:PORT.
        key: 16 to 32 bytes that the stream has too; needed for any machine but this.
        patience: How long to wait for an answer or a pose [s].

    Attributes:
        dropped: How many datagrams were dropped, by reason: size, tag, json, session, old.

    Raises:
        ParameterError: If the address is none, or is another machine's and there is no key, or the key is none.
        LinkError: If there is no way there.
    """

    def __init__(self, url: str = URL, *, key: bytes | None = None, patience: float = 2.0) -> None:
        scheme, host, port = parse_url(url)
        if scheme != "udp":
            raise ParameterError(f"a pose stream must be at udp://HOST:PORT, not {url!r}")
        self._url, self._patience = url, number("patience", patience, above=0.0)
        self._datagrams = Datagrams(key, MOST_ANSWERED)
        self.dropped = self._datagrams.dropped
        self._link = UdpLink(check_host(host, key), port)
        self._host, self._sequence, self._session = secrets.randbelow(MOST_INTEGER), 0, 0
        self._poses: deque[Message] = deque(maxlen=_KEPT)
        self._newest, self._ended = -1, False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def describe(self) -> Message:
        """Return the description of the scene: settings, walls, units and so on.

        Raises:
            StreamError: If nobody answers, or nothing runs there.
        """
        end = time.monotonic() + self._patience
        while (said := self._ask("get", ("description", "refused")))["type"] == "refused":
            if time.monotonic() > end:
                raise StreamError(f"{self._url}: {said['reason']}")
            time.sleep(_SOON)  # a device that takes off says nothing until it flies
        self._session = said["session"]
        return said

    def set(self, **settings: Any) -> Answer:
        """Ask for settings, and wait until they are in force or refused.

        Args:
            settings: Those to change; the others stay.

        Raises:
            StreamError: If nobody answers.
        """
        self._know_session()
        said = self._ask("set", ("accepted", "refused"), settings=settings)
        if said["type"] == "refused":
            return Answer(said["reason"], said["figures"])
        return Answer(since=said["tick"])

    def poses(self) -> Iterator[Message]:
        """Subscribe, and yield each pose as it comes, for as long as there are any; older ones are left out.

        Raises:
            StreamError: If nobody answers, there is no room for another subscriber, or no pose comes any more.
        """
        self._know_session()
        said = self._ask("subscribe", ("subscribed", "refused"))
        if said["type"] == "refused":
            raise StreamError(f"{self._url}: {said['reason']}")
        renewed = heard = time.monotonic()
        while not self._ended:
            while self._poses:
                yield self._poses.popleft()
                heard = time.monotonic()
            now = time.monotonic()
            if now - renewed > _RENEW:
                self._send({"type": "subscribe"})
                renewed = now
            if now - heard > self._patience:
                raise StreamError(f"no pose from {self._url} for {self._patience:g} s")
            self._hear(_AGAIN)

    def snapshots(self) -> Iterator[Snapshot]:
        """Yield the poses of `poses` as snapshots, under the settings that were in force at the beginning.

        Raises:
            StreamError: As for `poses`; if the scene or its settings are not known here.
        """
        told = self.describe()
        try:
            scene = _scene_told(told["scene"], told["settings"])
        except ParameterError as error:
            raise StreamError(f"{self._url} shows what is not known here: {error}") from None
        blank = Snapshot(scene=scene, delay=scene.delay)
        for pose in self.poses():
            yield posed_snapshot(pose, blank)

    def close(self) -> None:
        """Unsubscribe and close the socket; a second time does nothing."""
        if not self._ended:
            self._ended = True
            self._send({"type": "unsubscribe"})
        self._link.close()

    def _know_session(self) -> None:
        """Wait until something runs there, and learn the number that requests with a key must name."""
        if not self._session:
            self.describe()

    def _send(self, message: Message) -> None:
        if self._datagrams.keyed:
            self._sequence += 1
            message = {**message, "session": self._session, "host": self._host, "sequence": self._sequence}
        self._link.send(self._datagrams.encode(message))

    def _ask(self, kind: str, answers: tuple[str, ...], **fields: Any) -> Message:
        """Send a request until an answer to it comes; a set that is sent again is not done again."""
        asked = secrets.randbelow(MOST_INTEGER)
        end, again = time.monotonic() + self._patience, 0.0
        while (now := time.monotonic()) < end:
            if now >= again:
                self._send({"type": kind, "id": asked, **fields})
                again = now + _AGAIN
            said = self._hear(min(again, end) - now)
            if said is not None and said.get("id") == asked and said["type"] in answers:
                return said
        raise StreamError(f"nobody answers at {self._url}; is a scene running there, with the same key?")

    def _hear(self, timeout: float) -> Message | None:
        """Return an answer if one comes in time [s]; poses are kept."""
        data = self._link.receive(timeout)
        said = None if data is None else self._datagrams.decode(data)
        if said is None:
            return None
        if not _plausible(said):
            self.dropped["json"] += 1
            return None
        foreign = said.get("session") != self._session
        if self._datagrams.keyed and foreign and said["type"] != "description":
            self.dropped["session"] += 1
            return None
        if said["type"] == "pose":
            if foreign:
                self._session, self._newest = said["session"], -1
            if said["tick"] < self._newest:
                self.dropped["old"] += 1
            else:
                self._newest = said["tick"]
                self._poses.append(said)
            return None
        self._ended = self._ended or said["type"] == "end"
        return said


def _scene_told(name: str, settings: Message) -> Scene:
    """Return a scene of this package; for any other, which may be a file, one that has its timing alone."""
    if name in BUILT_IN:
        return find_scene(name).from_json(settings)
    return Scene.from_json({name: settings.get(name) for name in DEVICES_OWN})


def _plausible(said: Message) -> bool:
    """Whether a message is one that a stream says: anybody may answer at an address."""
    kind = said.get("type")
    if not isinstance(kind, str):
        return False
    if not all(isinstance(said.get(name), wanted) for name, wanted in _NEEDED.get(kind, {}).items()):
        return False
    six = [said[name] for name in _SIX if kind == "pose" and said[name] is not None]
    return all(axis in part and isinstance(part[axis], (int, float, NoneType)) for part in six for axis in AXES)

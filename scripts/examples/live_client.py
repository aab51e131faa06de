"""Watch and set a scene over the Foxglove protocol.

    maglev-mj view --foxglove                                  # or bridge, or twin: in another terminal
    python scripts/examples/live_client.py [ws://127.0.0.1:8765] [--seconds X] [--set NAME=VALUE]

Needs websockets and protobuf. It prints the parameters, what came of each --set, and the flotor's pose.
"""

from __future__ import annotations

import argparse
import base64
import json
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, NamedTuple, Self

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

URL = "ws://127.0.0.1:8765"
MESSAGE, CALL, RESULT = 1, 2, 3
PATIENCE = 30.0


class Message(NamedTuple):
    """Logged message: topic, time [ns], and fields."""

    topic: str
    time: int
    fields: Any


class LiveClient:
    """Hears from a live server.

    Args:
        url: Where it is.
        topics: Those to hear of; None for all.
    """

    def __init__(self, url: str = URL, topics: set[str] | None = None) -> None:
        self._url, self._topics, self._stack = url, topics, ExitStack()
        self._readers: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
        self._messages: deque[Message] = deque()
        self._services: dict[str, int] = {}

    def __enter__(self) -> Self:
        self._line = self._stack.enter_context(
            connect(self._url, subprotocols=[Subprotocol("foxglove.sdk.v1")], compression=None, max_size=None)
        )
        self.heard(lambda said: said["op"] == "advertise")
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def messages(self, seconds: float) -> Iterator[Message]:
        """Yield messages as they come, for so long [s]."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            while self._messages:
                yield self._messages.popleft()
            self._hear(end - time.monotonic())

    def parameters(self) -> dict[str, Any]:
        """Return the parameters in force by name."""
        self.send({"op": "getParameters", "parameterNames": [], "id": "get"})
        said = self.heard(lambda said: said["op"] == "parameterValues" and said.get("id") == "get")
        return {one["name"]: one["value"] for one in said["parameters"]}

    def set(self, **values: Any) -> dict[str, Any]:
        """Set parameters and return the answer.

        It waits until they are in force or refused; see docs/reference/live.md.
        """
        if "/maglev/set" not in self._services:
            self.heard(lambda said: said["op"] == "advertiseServices")
        head = struct.pack("<BIII", CALL, self._services["/maglev/set"], 0, 4)
        self._line.send(head + b"json" + json.dumps(values).encode())
        return self.heard(lambda said: said["op"] in ("result", "serviceCallFailure"))

    def send(self, message: dict[str, Any]) -> None:
        """Say something of the protocol's."""
        self._line.send(json.dumps(message))

    def drop(self) -> None:
        """Close the line without a closing handshake."""
        self._line.close_socket()

    def heard(self, so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait for an answer of some kind and return it.

        Logged messages that arrive meanwhile are kept.
        """
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            said = self._hear(end - time.monotonic())
            if said is not None and so(said):
                return said
        raise TimeoutError(f"no answer from {self._url}")

    def _hear(self, seconds: float) -> dict[str, Any] | None:
        """Receive one frame; return it unless it is logged data."""
        try:
            data = self._line.recv(timeout=max(seconds, 0.0))
        except TimeoutError:
            return None
        if isinstance(data, str):
            said: dict[str, Any] = json.loads(data)
            if said["op"] == "advertise":
                self._subscribe(said["channels"])
            elif said["op"] == "advertiseServices":
                self._services |= {one["name"]: one["id"] for one in said["services"]}
            return said
        if data[0] == RESULT:
            length = struct.unpack_from("<I", data, 9)[0]
            return {"op": "result", **json.loads(data[13 + length :])}
        if data[0] == MESSAGE:
            _, subscription, when = struct.unpack_from("<BIQ", data)
            topic, read = self._readers[subscription]
            self._messages.append(Message(topic, when, read(data[13:])))
        return None

    def _subscribe(self, channels: list[dict[str, Any]]) -> None:
        wanted = [one for one in channels if self._topics is None or one["topic"] in self._topics]
        for one in wanted:
            schema = base64.b64decode(one["schema"]) if one["encoding"] == "protobuf" else b""
            self._readers[one["id"]] = one["topic"], reader(one["encoding"], one["schemaName"], schema)
        self.send({"op": "subscribe", "subscriptions": [{"id": one["id"], "channelId": one["id"]} for one in wanted]})


def reader(encoding: str, name: str, schema: bytes) -> Callable[[bytes], Any]:
    """Return a decoder of a channel's messages."""
    if encoding == "json":
        return json.loads
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name)).FromString  # type: ignore[no-any-return]


def main() -> int:
    """Watch; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("url", nargs="?", default=URL, help=f"of the live server (default {URL})")
    parser.add_argument("--seconds", type=float, default=5.0, metavar="X", help="how long to watch [s] (default 5)")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter, as JSON")
    options = parser.parse_args()
    try:
        with LiveClient(options.url, {"/maglev/sample"}) as client:
            print(json.dumps(client.parameters()))
            for wish in options.set:
                name, _, value = wish.partition("=")
                print(f"set {wish}:", json.dumps(client.set(**{name: json.loads(value)})))
            shown = 0
            for _, when, sample in client.messages(options.seconds):
                if when > shown + 10**8:
                    shown, at = when, sample.position
                    millimetres = " ".join(f"{axis} {getattr(at, axis) * 1e3:+.3f}" for axis in "xyz")
                    print(f"tick {sample.tick}: {millimetres} mm")
    except (OSError, WebSocketException, TimeoutError, ValueError) as error:
        print(f"live_client.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

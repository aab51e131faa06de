"""The pose stream: tells graphical hosts of every frame, and takes settings from them; in processes of its own."""

from __future__ import annotations

import math
import os
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.net.addresses import check_host, parse_url
from maglev_mj.net.udp import Address, UdpServer
from maglev_mj.process import SideProcess
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot, Wish
from maglev_mj.stream.datagrams import Datagrams
from maglev_mj.stream.hosts import Hosts, Said, Verdict, checked

__all__ = ["URL", "PoseStream"]

URL = "udp://127.0.0.1:5680"

LONGEST_CHECK = 10.0
"""How long a check may take [s]."""

_LOOK = 0.1
_AT_ONCE = 64
"""Datagrams taken in one turn, so that poses go out under a flood of them."""
_PATIENCE = 60.0
_NICE = 5
_NO_ROWS = np.empty((0, 5))


class PoseStream:
    """Tells graphical hosts of every frame, and takes settings from them that would be stable: a `Publisher`.

    It listens, checks and answers in processes of its own: the control loop writes a snapshot for it 60 times a second
    and looks for a scene that it may go on with, and waits for neither.

    Args:
        url: Where to listen, udp://HOST:PORT; port 0 for any that is free.
        key: 16 to 32 bytes that every host must have too; needed for any machine but this.

    Attributes:
        address: Where it listens: host and port.

    Raises:
        ParameterError: If the address is none, or is another machine's and there is no key, or the key is none.
        LinkError: If it cannot listen there.
        MaglevError: If its process does not start, as from a script without `if __name__ == "__main__":`.
    """

    def __init__(self, url: str = URL, *, key: bytes | None = None) -> None:
        scheme, host, port = parse_url(url, server=True)
        if scheme != "udp":
            raise ParameterError(f"a pose stream must be at udp://HOST:PORT, not {url!r}")
        Datagrams(key, 0)  # says what is wrong with a key here
        server = UdpServer(check_host(host, key), port, backlog=None)
        self.address: Address = server.address
        self._answer: int | str | None = None
        self._process = SideProcess(serve, server, key)
        server.close()  # the other process has it
        if not (self._process.line.poll(_PATIENCE) and any(self._process.received())):
            self._process.close(0.0)
            needs = 'a script that opens one needs `if __name__ == "__main__":`'
            raise MaglevError(f"the process of the pose stream does not start; {needs}")

    def take(self) -> Wish | None:
        """Return the scene that a host asks for and may have, once."""
        for scene in self._process.received():
            return Wish(scene, self._note)
        return None

    def show(self, snapshot: Snapshot) -> None:
        """Publish a snapshot; where the other process does not keep up, it is left out."""
        if self._process.ready:
            self._process.send((replace(snapshot, history=_NO_ROWS), self._answer))
            self._answer = None

    def close(self) -> None:
        """Let everybody go; a second time does nothing."""
        self._process.close()

    def _note(self, answer: int | str) -> None:
        self._answer = answer  # one scene at a time is handed over: none is written over


def serve(line: Connection, server: UdpServer, key: bytes | None) -> None:
    """Answer hosts until the line ends; in a process of its own."""
    service = _Service(line, server, key)
    _give_way()
    line.send(service.is_warm())
    service.run()


def check_requests(line: Connection) -> None:
    """Check settings until the line ends; in a process of its own."""
    _give_way()
    with suppress(EOFError, OSError):
        line.send(None)  # it has loaded what it needs
        while True:
            line.send(checked(*line.recv()))


def _give_way() -> None:
    """Let what has deadlines go first."""
    with suppress(AttributeError, OSError):
        os.nice(_NICE)


class _Service:
    """The stream in its own process, between the control loop, the hosts, and the process that checks."""

    def __init__(self, line: Connection, server: UdpServer, key: bytes | None) -> None:
        self._line, self._server, self._hosts = line, server, Hosts(key)
        self._checker, self._until = SideProcess(check_requests), math.inf

    def is_warm(self) -> bool:
        """Wait until the process that checks can; return whether it can."""
        return self._checker.line.poll(_PATIENCE)

    def run(self) -> None:
        """Answer until the control loop's end of the line is closed."""
        try:
            while self._turn():
                pass
            self._say(self._hosts.end())
        finally:
            self._checker.close(0.0)
            self._server.close()

    def _turn(self) -> bool:
        """Wait for whatever comes next, and answer it; return False at the end."""
        ready: list[Any] = wait([self._line, self._server, self._checker.line], _LOOK)  # type: ignore[list-item]
        if self._line in ready:
            try:
                shown = self._line.recv()
            except (EOFError, OSError):
                return False
            except Exception as error:  # a class of the user's own that this process does not find
                self._hosts.nothing = f"the scene is not known here: {type(error).__name__}: {error}"
            else:
                self._say(self._hosts.show(*shown))
        if self._server in ready:
            for _ in range(_AT_ONCE):
                try:
                    arrived = self._server.receive(0.0)
                except OSError:  # on some systems this is where a datagram sent earlier comes back
                    self._hosts.dropped["network"] += 1
                    break
                if arrived is None:
                    break
                self._say(self._hosts.answers(*arrived))
        self._check()
        return True

    def _check(self) -> None:
        """Take what has been checked, and let the next be checked."""
        for verdict in self._checker.received():
            if verdict is not None:
                self._settle(verdict)
        if self._checker.ended or time.monotonic() > self._until:
            ended = self._checker.ended
            self._checker.close(0.0)
            self._checker = SideProcess(check_requests)
            why = "the process that checks them has ended" if ended else f"their check takes over {LONGEST_CHECK:g} s"
            self._settle(f"it is not known whether the settings would be stable: {why}")
        if (task := self._hosts.to_check()) is not None:
            self._checker.send(task)
            self._until = time.monotonic() + LONGEST_CHECK

    def _settle(self, verdict: Verdict) -> None:
        """Hand a scene over to the control loop, or say why not."""
        self._until = math.inf
        if isinstance(verdict, Scene):
            with suppress(OSError):  # it has ended, which the next turn notices
                self._line.send(verdict)
        self._say(self._hosts.settle(verdict))

    def _say(self, said: Said) -> None:
        """Send datagrams; one that cannot leave now is lost."""
        last, data = None, b""
        for message, address in said:
            if message is not last:
                last, data = message, self._hosts.encode(message)
            try:
                left = self._server.send(data, address)
            except OSError:
                left = False
            if not left:  # no room, or nobody there: a newer pose comes in a moment
                self._hosts.dropped["unsent"] += 1

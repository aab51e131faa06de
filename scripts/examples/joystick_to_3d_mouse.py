"""Serve the simulated joystick as a 3D mouse, in protocol 0 of spacenav: an event is eight native integers."""

import math
import os
import socket
import struct
import sys
from contextlib import closing, suppress
from pathlib import Path

import numpy as np

from maglev_mj import Session, SpringHand, real_time
from maglev_mj.spec import RANGE

FULL, PERIOD = 500, 1.0 / 60.0  # a full deflection; time between two events [s]
ORDER = [0, 2, 1, 3, 5, 4]  # y of a 3D mouse is up, z is away from the user


class SpacenavServer:
    """Publisher of a session that sends the pose of the handle to each connected program."""

    def __init__(self, path):
        self.listener, self.clients = socket.socket(socket.AF_UNIX), []
        self.listener.bind(os.fspath(path))
        path.chmod(0o600)  # programs of the same user only
        self.listener.listen()
        self.listener.setblocking(False)

    def show(self, snapshot):
        """Send an event."""
        with suppress(BlockingIOError):  # no new client
            self.clients.append(self.listener.accept()[0])
        axes = np.rint(FULL * np.asarray(snapshot.pose) / RANGE)[ORDER].astype(int)
        for client in [*self.clients]:
            try:
                client.send(struct.pack("=8i", 0, *axes, round(1e3 * PERIOD)), socket.MSG_DONTWAIT)
            except BlockingIOError:
                pass  # drop the event for a program that does not read
            except OSError:
                self.clients.remove(client)

    def take(self):
        """Return None: a 3D mouse has no requests."""

    def close(self):
        """Close all connections."""
        for line in (self.listener, *self.clients):
            line.close()


if __name__ == "__main__":
    path = Path(os.environ.get("SPNAV_SOCKET") or "/tmp/maglev-spnav.sock")
    path.unlink(missing_ok=True)
    print(f"export SPNAV_SOCKET={path}", flush=True)
    with closing(Session("joystick", hand_force=SpringHand(), publishers=[SpacenavServer(path)])) as session:
        for elapsed, now in real_time(float(sys.argv[1]) if sys.argv[1:] else None, PERIOD):
            axis = np.eye(6)[int(now / 2.0) % 6]  # a hand moves the axes in turn
            session.hand.target = 3.0 * math.sin(math.pi * now) * axis * RANGE
            session.tick(elapsed)

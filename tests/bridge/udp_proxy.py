"""Impaired UDP line between two processes."""

from __future__ import annotations

import threading
import time
from select import select

from maglev_mj.bridge.links import Address, UdpLink, UdpServer
from maglev_mj.bridge.twin.simulated_links import TO_DEVICE, TO_HOST
from tests.bridge.impaired import ImpairedLine, Impairment

_LOOK = 0.05  # [s] between looks at a line on which nothing happens


class UdpProxy:
    """Impaired UDP line between hosts and a device.

    It runs in a thread. Hosts use its address in place of the device's.

    The device's frames go to the host of the last frame.

    Args:
        upstream: Address of the device.
        impairment: Impairment of the line, each way.
        host: Address of this machine to listen at.
        port: Port to listen at; 0 for any free one.

    Attributes:
        address: Address of the proxy.
        to_device: Impairer towards the device; see its `counts`.
        to_host: Impairer towards the host.

    Raises:
        ParameterError: If a host or port is invalid.
        LinkError: If it cannot listen there.
    """

    def __init__(self, upstream: Address, impairment: Impairment, host: str = "127.0.0.1", port: int = 0) -> None:
        self._device = UdpLink(*upstream)
        try:
            self._host = UdpServer(host, port)
        except BaseException:
            self._device.close()
            raise
        self.address = self._host.address
        self._line = ImpairedLine(impairment, time.monotonic_ns())
        self.to_device, self.to_host = self._line.impairers[TO_DEVICE], self._line.impairers[TO_HOST]
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bad line", daemon=True)
        self._thread.start()

    def __enter__(self) -> UdpProxy:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the proxy and drop frames in transit; idempotent."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        host, device, line, clock = self._host, self._device, self._line, time.monotonic_ns
        ends: tuple[UdpServer | UdpLink, ...] = host, device
        peer: Address | None = None
        try:
            while not self._stopped.is_set():
                select(ends, (), (), min(max((line.due - clock()) * 1e-9, 0.0), _LOOK))
                while (heard := host.receive(0.0)) is not None:
                    data, peer = heard
                    line.send(TO_DEVICE, data, clock())
                while (answer := device.receive(0.0)) is not None:
                    line.send(TO_HOST, answer, clock())
                for way, data in line.arrived(clock()):
                    if way == TO_DEVICE:
                        device.send(data)
                    elif peer is not None:
                        host.send(data, peer)
        finally:
            device.close()
            host.close()

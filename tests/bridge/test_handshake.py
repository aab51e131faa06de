"""Handshakes: accepted and refused answers of a device.

The line is closed after any failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import pytest

from maglev_mj.bridge import connection, wire
from maglev_mj.bridge.connection import Connection, profile_of
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.links import LinkError
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits, Limits
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Codec, Fault, HelloAck, HelloStatus, State, StateReport
from maglev_mj.errors import ParameterError, PlantError

NAN, INF = math.nan, math.inf
KEY = b"0123456789abcdef"


class Doctored(VirtualLink):
    """Link that changes the device's answers.

    Args:
        twin: The device.
        change: Function from a body to another, to bytes in place of its frame, or to None for no frame.
        key: Key of the device.
    """

    def __init__(self, twin: Twin, change: Callable[[Any], Any] = lambda body: body, key: bytes | None = None) -> None:
        super().__init__(twin)
        self.change, self.codec, self.closed = change, Codec(key), 0

    def receive(self, timeout: float) -> bytes | None:
        end = self.time + round(timeout * 1e9)
        while (data := super().receive((end - self.time) * 1e-9)) is not None:
            frame = self.codec.decode(data)
            assert frame is not None
            body = self.change(frame.body)
            if isinstance(body, bytes):
                return body
            if body is not None:
                return self.codec.encode(frame.session, frame.sequence, frame.time, body)
        return None

    def close(self) -> None:
        self.closed += 1


def with_(**values: Any) -> Callable[[Any], Any]:
    """Return a function that changes fields of HELLO_ACK."""
    return lambda body: body._replace(**values) if isinstance(body, HelloAck) else body


ABSURD: list[tuple[str, Any, str]] = [
    *(("period", value, "period must be between 1e-5 and 0.1") for value in (0, 9_999, 100_000_001, 2**64 - 1)),
    *(("delay", value, "delay must be between 0 and 0.1") for value in (100_000_001, 2**64 - 1)),
    *(("latency", value, "latency must be between 0 and 0.1") for value in (100_000_001, 2**64 - 1)),
    *(("watchdog", value, "watchdog must be") for value in (0, 999_999, 1_000_000_001, 2**64 - 1)),
    *(("enable", value, "enable must be") for value in (0, 9_999, 1_000_000_001)),
    *(("stale", value, "stale must be") for value in (0, 9_999, 1_000_000_001)),
    *(
        (field, value, f"{field} must be")
        for field, least, most in (
            ("current_limit", 0.0, 20.1),
            ("continuous_current", 0.0, 20.1),
            ("hover_limit", -0.1, 20.1),
            ("thermal_time", 0.009, 1.1e7),
            ("spot_limit", 0.9e-4, 10.1),
            ("spot_speed", 0.9e-3, 101.0),
            ("stiffness_limit", -0.1, 1.1e8),
            ("damping_limit", -0.1, 1.1e6),
            ("edge_speed", -0.1, 10.1),
            ("lever", 0.0, 10.1),
            ("energy", 0.0, 1.1e3),
            ("recede", -0.1, 10.1),
            ("off_current", 0.0, 20.1),
        )
        for value in (NAN, INF, -INF, -1.0, 1e9, least, most)
    ),
    ("frozen", 1_000_001, "frozen must be"),
    ("wall_count", 13, "wall_count must be"),
    ("lockstep", 2, "lockstep must be"),
    ("state", 3, "state must be"),
    # which each alone may be
    ("watchdog", 9_999_999, "two periods must be at most watchdog, 0.009999999 s [(]got 0.01 s"),
    ("latency", 10_000_001, "latency must be at most two periods, 0.01 s [(]got 0.010000001 s"),
    ("off_current", 3.5, "off_current must be at most continuous_current, 3 A [(]got 3.5 A"),
    ("delay", 10_000_001, "delay must be at most two periods, 0.01 s [(]got 0.010000001 s"),
    ("enable", 50_000_001, "enable must be at most watchdog, 0.05 s [(]got 0.050000001 s"),
    ("stale", 4_999_999, "one period must be at most stale, 0.004999999 s [(]got 0.005 s"),
    ("stale", 50_000_001, "stale must be at most watchdog, 0.05 s [(]got 0.050000001 s"),
    ("wall_period", 3_000_000, "wall_period must divide 5000000 ns"),
    ("wall_delay", 2_000_001, "wall_delay must be at most two wall periods, 0.002 s [(]got 0.002000001 s"),
    ("hover_limit", 3.5, "hover_limit must be at most continuous_current, 3 A [(]got 3.5 A"),
    ("continuous_current", 11.0, "continuous_current must be at most current_limit, 10 A [(]got 11 A"),
    ("state", State.FAULT, "state FAULT with faults none"),
    ("faults", Fault.CLOCK, "state INACTIVE with faults CLOCK"),
    ("first", Fault.CLOCK, "first CLOCK of faults none"),
    ("fault_time", 2**63, f"fault_time {2**63} ns at "),
]


def test_implausible_device_limits_are_refused_by_name() -> None:
    twin = Twin(TwinParameters())
    line = Connection(VirtualLink(twin), twin.parameters.calibration.digest, None, 1.0)
    for field, value, says in ABSURD:
        with pytest.raises(HandshakeError, match=says) as caught:
            profile_of(line.welcome._replace(**{field: value}), line._handshake_time)
        assert "\n" not in str(caught.value), field
    assert {one.name for one in Limits.parameters()} <= {says.split(" ")[0] for _, _, says in ABSURD}


def test_a_refused_handshake_closes_the_link_and_releases_the_device() -> None:
    twin = Twin(TwinParameters())
    link = Doctored(twin, with_(period=0))
    with pytest.raises(HandshakeError, match="period must be"):
        RemotePlant(link)
    assert link.closed == 1 and twin.firmware.session == 0


def test_the_smaller_of_both_ends_limits_counts() -> None:
    changed = with_(current_limit=4.0, hover_limit=2.0, continuous_current=2.5)
    plant = RemotePlant(Doctored(Twin(TwinParameters()), changed), limits=HostLimits(max_current=6.0))
    assert (plant.limits.current_limit, plant.limits.hover_limit, plant.limits.continuous_current) == (4.0, 2.0, 2.5)
    plant = RemotePlant(Doctored(Twin(TwinParameters()), changed), limits=HostLimits(max_current=1.9))
    assert (plant.limits.current_limit, plant.limits.hover_limit, plant.limits.continuous_current) == (1.9, 1.9, 2.5)


def test_limits_too_low_for_hovering_are_refused_at_once() -> None:
    twin = Twin(TwinParameters())
    fields, needs = ("current_limit", "continuous_current", "hover_limit"), "1.43 A [(]got 1[)]: hovering needs 1.14 A"
    for small, says in ((fields, needs), (fields[2:], "1.14 A .*got 1")):
        link = Doctored(twin, with_(**dict.fromkeys(small, 1.0)))
        with pytest.raises(HandshakeError, match=says):
            RemotePlant(link)
        assert link.closed == 1 and twin.firmware.session == 0
    link = Doctored(twin)
    with pytest.raises(ParameterError, match=r"max_current must be at least 1.43 A [(]got 1[)]: hovering needs 1.14 A"):
        RemotePlant(link, limits=HostLimits(max_current=1.0))
    assert link.closed == 1 and link.time == 0  # before any frame was sent


@pytest.mark.parametrize("kind", [KeyboardInterrupt, ValueError, OverflowError, ZeroDivisionError, LinkError])
@pytest.mark.parametrize("place", ["in the handshake", "after it"])
def test_any_error_in_the_handshake_closes_the_link(
    kind: type[BaseException], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail = Mock(side_effect=kind("oh"))
    link = Doctored(Twin(TwinParameters()), fail if place == "in the handshake" else lambda body: body)
    if place == "after it":
        monkeypatch.setattr(connection, "profile_of", fail)
    with pytest.raises(HandshakeError if issubclass(kind, (ValueError, ArithmeticError)) else kind, match="oh"):
        RemotePlant(link)
    assert link.closed == 1


def test_invalid_arguments_close_the_link() -> None:
    wrongs: list[dict[str, Any]] = [{"patience": 0.0}, {"patience": NAN}, {"key": b"short"}]
    for wrong in wrongs:
        link = Doctored(Twin(TwinParameters()))
        with pytest.raises(ParameterError):
            RemotePlant(link, **wrong)
        assert link.closed == 1, wrong


def foreign() -> bytes:
    """Return an untagged frame of another version."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("maglev_mj.bridge.wire.VERSION", 7)
        return Codec().encode(0, 0, 0, wire.blank(HelloAck)._replace(status=HelloStatus.VERSION, version=7))


class Disturbed(Doctored):
    """Link with a foreign frame before each frame of the device."""

    def __init__(self, twin: Twin, key: bytes | None, mute: bool = False) -> None:
        super().__init__(twin, key=key)
        self._due, self._mute = True, mute

    def receive(self, timeout: float) -> bytes | None:
        self._due = not self._due
        if not self._due:
            return foreign()
        if self._mute:
            self.change = lambda body: None
        return super().receive(timeout)


def test_an_untagged_frame_of_another_version_does_not_end_a_keyed_handshake() -> None:
    plant = RemotePlant(Disturbed(Twin(TwinParameters(), key=KEY), KEY), key=KEY)
    plant.read()
    assert plant.state == State.INACTIVE
    with pytest.raises(HandshakeError, match=r"no device answered within 1 s; frames dropped: \d+ for version \(7\)$"):
        RemotePlant(Disturbed(Twin(TwinParameters(), key=KEY), KEY, mute=True), key=KEY)
    with pytest.raises(HandshakeError, match=f"protocol version mismatch: device 7, host {wire.VERSION}"):
        RemotePlant(Disturbed(Twin(TwinParameters()), None))


def test_a_device_of_another_host_is_busy() -> None:
    link = Doctored(Twin(TwinParameters()), with_(status=HelloStatus.BUSY))
    with pytest.raises(HandshakeError, match="the device is in use by another host"):
        RemotePlant(link)
    assert link.closed == 1


def test_latched_faults_are_reported_in_one_line() -> None:
    twin = Twin(TwinParameters())
    link = VirtualLink(twin)
    assert RemotePlant(link).latched == ""
    twin.firmware.trip(Fault.CLOCK, link.time)
    twin.firmware.trip(Fault.ESTOP | Fault.COIL_OVERTEMP, link.time)
    while link.time < 1_300_000_000:
        link.receive(1.0)
    plant = RemotePlant(link)
    assert plant.latched == "latched: COIL_OVERTEMP ESTOP CLOCK, 1.3 s ago, first CLOCK"
    assert (plant.first, plant.state) == (Fault.CLOCK, State.FAULT)
    plant.reset()
    assert (plant.first, plant.fault_time, plant.faults) == (Fault(0), 0, Fault(0))


def test_frames_of_another_session_are_dropped_and_counted() -> None:
    twin = Twin(TwinParameters())
    line = Connection(link := Doctored(twin), twin.parameters.calibration.digest, None, 1.0)
    assert line.state() is not None
    own, theirs = twin.firmware.session, twin.firmware.session ^ 1
    spoken = link.codec.encode

    def of_another(session: int, sequence: int, time: int, body: Any) -> bytes:
        return spoken(theirs if isinstance(body, StateReport) else session, sequence, time, body)

    link.codec.encode = of_another  # type: ignore[method-assign]
    with pytest.raises(PlantError, match="no sample from the device within 1 s"):
        line.state()
    assert line.codec.dropped["session"] >= 20
    link.codec.encode = spoken  # type: ignore[method-assign]
    assert line.state() is not None and twin.firmware.session == own


def test_samples_left_out_during_a_request_count_as_skipped() -> None:
    twin, waiting = Twin(TwinParameters()), list[Any]()
    plant = RemotePlant(link := Doctored(twin))
    plant.read()

    def late(body: Any) -> Any:
        """Delay the device's answer by five samples."""
        if isinstance(body, StateReport):
            waiting.append(None)
            return body
        return body if len(waiting) > 5 else None

    link.change = late
    plant.arm()
    plant.read()
    assert plant.samples.skipped >= 4 and plant.samples.lost == 0 and plant.samples.tick == twin.tick

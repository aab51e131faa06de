"""Arm behind Haply's JSON: known answers in lockstep, faults of both ends, and scenes on it, all in virtual time."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj.bridge import Arm, HaplyPlant, HaplyTwin
from maglev_mj.bridge.haply.flight import ForcesOnly, fly_arm, on_arm, preflight_arm
from maglev_mj.bridge.haply.plant import force_message, numbers_at
from maglev_mj.bridge.links import Link, LinkError
from maglev_mj.bridge.preflight import LinkReport, Preflight
from maglev_mj.cli import main
from maglev_mj.control import Bias, Hold
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop, drive
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, Command, Sample
from maglev_mj.recording import Recording
from maglev_mj.scenes import find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.theory import largest_stable_stiffness
from tests.all_of import LAWS, SCENES

FREE: dict[str, Any] = {"force_limit": (1e9,) * 3, "speed_limit": 1e9, "range": (10.0,) * 3}
SETTINGS = {(200.0, 0.0): 867, (200.0, 1e-3): 709, (500.0, 5e-4): 4226, (1000.0, 0.0): 21670, (1000.0, 1e-3): 9365}
"""Critical stiffness [N/m] of 0.15 kg at the best damping, by rate [Hz] and delay of the device [s]."""
ZERO_WITHIN = 0.06
"""Time after a fault within which the force is zero [s]."""


class MockService:
    """A service with a free mass of its own, independent of the twin: a force acts a delay after its message."""

    def __init__(self, arm: Arm) -> None:
        self.arm, self.clock, self.position, self.speed, self.force = arm, 0, 1e-3, 0.0, 0.0
        self.replies = deque([self.state(status={"calibrated": True, "in_use": False})])

    def state(self, **more: Any) -> str:
        place = {"x": 0.1, "y": -0.2, "z": 0.1 + self.position}
        return json.dumps({"inverse3": [{"device_id": "04BA", "state": {"cursor_position": place}, **more}]})

    def send(self, text: bytes) -> None:
        (entry,) = json.loads(text)["inverse3"]
        force, period = entry["commands"]["set_cursor_force"]["vector"]["z"], 1.0 / self.arm.rate
        self.replies.append(self.state())  # before the force acts
        for acting, duration in ((self.force, self.arm.delay), (force, period - self.arm.delay)):
            acceleration = acting / self.arm.mass
            self.position += duration * (self.speed + 0.5 * duration * acceleration)
            self.speed += duration * acceleration
        self.force = force

    def receive(self, timeout: float) -> bytes | None:
        if not self.replies:
            self.clock += round(timeout * 1e9)
        return self.replies.popleft().encode() if self.replies else None

    def now(self) -> int:
        return self.clock

    def close(self) -> None:
        pass


class VirtualLink:
    """Link to a twin in the same process, in simulated time, which passes only while the host waits."""

    def __init__(self, twin: HaplyTwin, latency: float = 0.0) -> None:
        self.twin, self.time, self.latency, self.open = twin, 0, round(latency * 1e9), True
        self.replies = deque([(0, twin.update(full=True))])

    def send(self, text: bytes) -> None:
        if not self.open:
            raise LinkError("the service closed the connection")
        self.replies.append((self.time + self.latency, self.twin.receive(text, self.time)))

    def receive(self, timeout: float) -> bytes | None:
        end = self.time + round(timeout * 1e9)
        if not self.open:
            raise LinkError("the service closed the connection")
        if not self.replies or self.replies[0][0] > end:
            self.time = end
            return None
        due, reply = self.replies.popleft()
        self.time = max(self.time, due)
        return reply.encode()

    def now(self) -> int:
        return self.time

    def close(self) -> None:
        self.open = False
        self.twin.release()


def twin_link(arm: Arm) -> Link:
    return VirtualLink(HaplyTwin(arm, lockstep=True, start=(0.1, -0.2, 0.101)))


@pytest.mark.parametrize("service", [twin_link, MockService])
@pytest.mark.parametrize("rate, delay", SETTINGS)
def test_a_loop_decays_below_the_predicted_stiffness_and_grows_above(
    rate: float, delay: float, service: Callable[[Arm], Link]
) -> None:
    arm = Arm(rate=rate, delay=delay, **FREE)
    limit = largest_stable_stiffness(period=1.0 / rate, delay=1.0 / rate + delay, mass=arm.mass)
    assert float(limit.stiffness) == pytest.approx(SETTINGS[rate, delay], abs=0.5)
    for share in (0.9, 1.1):
        hold = Hold(axes="z", stiffness=share * float(limit.stiffness), damping=float(limit.damping))
        plant, heights = HaplyPlant(service(arm), arm=arm), list[float]()
        plant.centre[2] = 0.1  # released 1 mm above it
        assert plant.delay == pytest.approx(1.0 / rate + delay)
        loop = ControlLoop(plant, Controller([hold], period=plant.period), observe=partial(note_height, heights))
        loop.cycle(400)
        assert (max(heights[-40:]) < max(heights[20:60])) == (share < 1.0)


def note_height(heights: list[float], sample: Sample, _: Command) -> None:
    heights.append(abs(sample.position[2]))


class FaultyLink(VirtualLink):
    """Link to a twin with a fault of the service from a time on; notes each force that is sent."""

    fault, since = "", math.inf

    def send(self, text: bytes) -> None:
        force = numbers_at(json.loads(text)["inverse3"][0], "commands", "set_cursor_force", "values")
        self.sent.append((self.time, force))
        super().send(text)
        if self.time >= self.since and self.fault == "silent":
            self.replies.pop()

    def receive(self, timeout: float) -> bytes | None:
        if self.time >= self.since:
            self.open &= self.fault != "gone"
            self.latency = 10_000_000 * (self.fault == "10 ms late")
        reply = super().receive(timeout)
        if reply is None or self.time < self.since:
            return reply
        place = numbers_at(json.loads(reply)["inverse3"][0], "state", "cursor_position")
        assert place is not None
        changes = {
            **{f"{name} is false": (f'"{name}": true', f'"{name}": false') for name in CONDITIONS},
            "status is no object": ('"status": {', '"status": 3, "before": {'),
            "power is text": ('"power_supply": true', '"power_supply": "yes"'),
            "two of one identifier": ('"inverse3": [', '"inverse3": [{"device_id": "TWIN"}, '),
            "orientation is NaN": ('"w": 1.0', '"w": NaN'),
            "orientation is 0": ('"w": 1.0', '"w": 0.0'),
            "no orientation": ('"orientation"', '"attitude"'),
            "grip is lost": ('"GRIP"', '"GRAP"'),
            "position is text": (f'"z": {place[2]}', '"z": "0.0"'),
            "position is huge": (f'"z": {place[2]}', f'"z": 1{"0" * 400}'),
            "nested too deep": ('"inverse3": [', f'"inverse3": {"[" * 5000}{"]" * 5000}, "before": ['),
            "wrong device": ('"TWIN"', '"049D"'),
            "position is NaN": (f'"z": {place[2]}', '"z": NaN'),
            "no position": ("cursor_position", "angular_position"),
            "no JSON": ('"session_id"', "session_id"),
            "millimetres": (f'"z": {place[2]}', f'"z": {1e3 * place[2]}'),
        }
        spoiled = reply.decode().replace(*changes.get(self.fault, ("", "")))
        assert spoiled != reply.decode() or self.fault in ("silent", "10 ms late", *HOST_FAULTS)
        return spoiled.encode()

    def __init__(self, twin: HaplyTwin) -> None:
        super().__init__(twin)
        self.sent: list[tuple[int, list[float] | None]] = []


class NotingTwin(HaplyTwin):
    """Twin that notes at each sample if a force acts."""

    notes: list[tuple[int, bool]]

    def _step(self) -> None:
        super()._step()
        self.__dict__.setdefault("notes", []).append((self._time or 0, any(self.force)))


CONDITIONS = ("connected", "power_supply", "awake", "calibrated", "ready")
SERVICE_FAULTS = {
    "gone": "the service closed the connection",
    "silent": r"no reply of the service within 1[5-9] ms",
    "wrong device": r"the service reports no device 'TWIN' \(connected: '049D'\)",
    "position is NaN": r"no finite cursor_position \(got \[.*nan\]\)",
    "no position": r"no finite cursor_position \(got None\)",
    "no JSON": r"the service reports no device 'TWIN' \(connected: none\)",
    "nested too deep": r"the service reports no device 'TWIN' \(connected: none\)",
    "connected is false": r"the service reports of 'TWIN': not connected; check its cable and power, and calibrate it",
    "power_supply is false": "the service reports of 'TWIN': no power supply; check",
    "awake is false": "the service reports of 'TWIN': not awake; check",
    "calibrated is false": "the service reports of 'TWIN': not calibrated; check",
    "ready is false": "the service reports of 'TWIN': not ready; check",
    "power is text": "the service reports of 'TWIN': no power supply; check",
    "status is no object": r"the service reports no valid status of 'TWIN' \(got 3\)",
    "two of one identifier": "identifiers must differ, but the service reports 'TWIN', 'TWIN'",
    "orientation is NaN": r"no orientation of grip 'GRIP' as a unit quaternion \(got \[nan, ",
    "orientation is 0": r"no orientation of grip 'GRIP' as a unit quaternion \(got \[0.0, ",
    "no orientation": r"no orientation of grip 'GRIP' as a unit quaternion \(got None\)",
    "grip is lost": r"the service reports no grip 'GRIP' \(connected: 'GRAP'\)",
    "position is text": r"no finite cursor_position \(got None\)",
    "position is huge": r"no finite cursor_position \(got None\)",
    "10 ms late": "3 samples in a row were late, the last 10.0 ms old: lower",
    "millimetres": "the tip moves at .* m/s, above the limit of 0.5 m/s",
}
HOST_FAULTS = {
    "command is NaN": r"the command is not finite \(0, 0, nan\)",
    "host silent": "the sample was 120 ms old when its answer was sent",
}


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("fault, message", [*SERVICE_FAULTS.items(), *HOST_FAULTS.items()])
def test_every_fault_ends_the_force_within_60_ms_with_one_sentence(fault: str, message: str, rate: float) -> None:
    twin = NotingTwin(hand_force=lambda tick, time, state: [0.0, 0.0, -2.0 * (time < 0.5), 0.0, 0.0, 0.0])
    link = FaultyLink(twin)
    plant = HaplyPlant(link, period=1.0 / rate)
    spring = Controller([Hold(axes=AXES[:3], stiffness=300.0, damping=8.0)], period=plant.period)
    drive(plant, spring, round(0.4 * rate))
    onset, link.fault, link.since = link.time, fault, link.time

    def step(sample: Any) -> Command:
        if fault == "host silent":
            link.time += 120_000_000
        return Command([0.0, 0.0, math.nan, 0.0, 0.0, 0.0]) if fault == "command is NaN" else spring.step(sample)

    spoiled = SimpleNamespace(period=plant.period, step=step)
    with pytest.raises(PlantError, match=message) as caught:
        drive(plant, spoiled, round(0.2 * rate))
    assert str(caught.value).startswith("the force is off: ") and "\n" not in str(caught.value)
    late = link.time - onset - 120_000_000 * (fault == "host silent")
    assert late <= ZERO_WITHIN * 1e9
    if fault != "gone":
        forces = [abs(force[2]) for _, force in link.sent[-round(0.02 * rate) - 1 :] if force]  # the last by close()
        assert forces == sorted(forces, reverse=True) and forces[-2] == 0.0
        assert (forces[0] > 1.0) == (fault != "host silent")  # fades, unless the service has dropped the force
    twin.receive("{}", onset + 200_000_000)
    assert any(acting for time, acting in twin.notes if time <= onset)
    assert not any(acting for time, acting in twin.notes if time > onset + round(ZERO_WITHIN * 1e9))
    with pytest.raises(PlantError, match="the force is off"):
        plant.read()


FORCE = force_message("TWIN", (0.0, 0.0, 3.0)).decode()
CLIENT_FAULTS: dict[str, str | None] = {
    "silent": None,
    "no command": '{"inverse3": [{"device_id": "TWIN"}]}',
    "wrong device": FORCE.replace("TWIN", "049D"),
    "NaN": FORCE.replace("3.0", "NaN"),
    "no vector": FORCE.replace("3.0", '"three"'),
    "no JSON": FORCE[1:],
    "another JSON": "[[], 3]",
    "nested too deep": f'{{"inverse3": {"[" * 9999}{"]" * 9999}}}',
    "a number too large": FORCE.replace("3.0", f"1{'0' * 400}"),
    "no list": '{"inverse3": {"TWIN": {}}}',
}


@pytest.mark.parametrize("name, message", CLIENT_FAULTS.items())
def test_the_twin_drops_the_force_of_a_faulty_client(name: str, message: str | None) -> None:
    twin = HaplyTwin()
    for tick in range(20):
        twin.receive(FORCE if tick % 2 else FORCE.encode(), now=tick * 1_000_000)
        assert twin.force == [0.0, 0.0, 3.0]
    if message is None:
        twin._advance(19_000_000 + round(ZERO_WITHIN * 1e9))
    else:
        twin.receive(message, now=20_000_000)
    assert not any(twin.force)


def test_the_twin_answers_each_message_with_one_update_and_a_full_one_on_demand() -> None:
    twin = HaplyTwin(lockstep=True)
    inventory, update = json.loads(twin.update(full=True)), json.loads(twin.receive(FORCE, 0))
    assert inventory["inverse3"][0]["config"]["type"] == "inverse3" and "config" not in update["inverse3"][0]
    assert update["wireless_verse_grip"][0]["state"]["orientation"] == {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    assert "config" in json.loads(twin.receive('{"session": {"force_render_full_state": {}}}', 0))["inverse3"][0]
    place = json.loads(twin.update())["inverse3"][0]["state"]["cursor_position"]
    assert json.loads(twin.receive("{}", 10**9))["inverse3"][0]["state"]["cursor_position"] == place  # a probe
    for key in ("vector", "values"):  # either is understood, and scaled to the limit
        command = {"set_cursor_force": {key: {"x": 0.0, "y": 16.0, "z": 16.0}}}
        twin.receive(json.dumps({"inverse3": [{"commands": command}]}), 0)
        assert twin.force == [0.0, 8.0, 8.0]
    assert twin.clipped == 2


def test_a_push_ends_by_the_speed_limit_and_a_landing_fades() -> None:
    twin, push = HaplyTwin(), Controller([Bias([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])], period=0.005)
    with pytest.raises(PlantError, match=r"moves at 0.5.* m/s, above the limit of 0.5 m/s"):
        drive(HaplyPlant(VirtualLink(twin), period=0.005), push, 100)
    link = FaultyLink(HaplyTwin())
    plant = HaplyPlant(link, period=0.025)
    plant.read()
    assert plant.write(Command([0.0, 30.0, 0.0, 0.0, 0.0, 0.0])).force[1] == 8.0
    plant.land()
    assert [force[1] for _, force in link.sent[1:] if force] == pytest.approx([6.0, 4.0, 2.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "spoil, options, message",
    [
        (lambda text: text.replace('"inverse3"', '"minverse"'), {}, r"reports no device \(connected: none\)"),
        (str, {"device": "049D"}, r"reports no device '049D' \(connected: 'TWIN'\)"),
        (lambda text: text.replace('"x": 0.04', '"x": 40'), {}, r"within 1 m \(got 40, 0, 0\): is it in millimetres"),
        (lambda text: "hello", {}, "reports no device"),
        (lambda text: text.replace('"status"', '"mood"'), {}, "reports no status of 'TWIN': it must be of version 3"),
        (
            lambda text: text.replace('"calibrated": true', '"calibrated": false'),
            {},
            "of 'TWIN': not calibrated; check",
        ),
        (lambda text: text.replace('"w": 1.0', '"w": NaN'), {}, "no orientation of grip 'GRIP' as a unit quaternion"),
        (str, {"grip": "61576"}, r"reports no grip '61576' \(connected: 'GRIP'\)"),
    ],
)
def test_an_unusable_service_is_refused_at_the_start(
    spoil: Callable[[str], str], options: dict[str, Any], message: str
) -> None:
    link = FaultyLink(HaplyTwin(start=(0.04, 0.0, 0.0)))
    link.replies = deque([(0, spoil(link.replies[0][1]))])
    with pytest.raises(PlantError, match=message):
        HaplyPlant(link, **options)
    assert not link.open and not link.sent


@pytest.mark.parametrize("kind, first, second", [("device", "TWIN", "0B77"), ("grip", "GRIP", "61577")])
def test_of_two_arms_or_grips_the_named_one_is_flown(kind: str, first: str, second: str) -> None:
    for order in ((first, second), (second, first)):
        for named in (None, first, "nosuch"):
            own: Any = {kind: named}
            link = TwoOfAKind(HaplyTwin(start=(0.0, 0.0, 0.02)), kind, order)
            if named == first:
                plant = HaplyPlant(link, **own)
                drive(plant, Controller([Hold(axes="z", stiffness=50.0, damping=1.0)], period=plant.period), 20)
                assert getattr(plant, kind) == first
                assert {json.loads(text)["inverse3"][0]["device_id"] for text in link.messages} == {"TWIN"}
                continue
            names = ", ".join(map(repr, order))
            remedy = rf"no {kind} 'nosuch' \(connected: {names}\)" if named else f"2 {kind}s, {names}: choose one by"
            with pytest.raises(PlantError, match=remedy):
                HaplyPlant(link, **own)
            assert not link.messages and not link.open


class TwoOfAKind(VirtualLink):
    """Link to a service with two arms or two grips, in an order; the other one's state is invalid."""

    def __init__(self, twin: HaplyTwin, kind: str, order: tuple[str, str]) -> None:
        self.section, self.order = {"device": "inverse3", "grip": "wireless_verse_grip"}[kind], order
        self.messages: list[bytes] = []
        super().__init__(twin)

    def send(self, text: bytes) -> None:
        self.messages.append(text)
        super().send(text)

    def receive(self, timeout: float) -> bytes | None:
        if (reply := super().receive(timeout)) is None:
            return None
        message = json.loads(reply)
        own = {entry["device_id"]: entry for entry in message[self.section]}
        message[self.section] = [own.get(name, {"device_id": name, "state": {}}) for name in self.order]
        return json.dumps(message).encode()


@pytest.mark.parametrize(
    "command", [Command([0.0] * 5 + [0.1]), Command([0.0] * 6, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 1e-3)]
)
def test_torques_and_pulses_are_refused(command: Command) -> None:
    plant = HaplyPlant(VirtualLink(HaplyTwin()))
    plant.read()
    with pytest.raises(PlantError, match="renders forces only"):
        plant.write(command)
    plant.read()  # nothing has changed


@pytest.mark.parametrize(
    "address",
    ["haply://", "haply://127.0.0.1", "haply://127.0.0.1:0", "haply://h:1?rate=x", "haply://h:1?rate=0"]
    + [f"haply://h:1?{query}" for query in ("", "device=", "device", "arm=A", "device=A&device=B", "rate=5?device=A")],
)
def test_an_invalid_address_is_refused(address: str) -> None:
    with pytest.raises(ParameterError, match=r"address must be haply://HOST:PORT|period must be"):
        HaplyPlant(address)


COUNTS: dict[str, Any] = dict.fromkeys(("samples", "lost", "skipped", "late"), 0) | {"clock": 1.0, "lockstep": False}


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_flies_on_an_arm_without_torques(name: str) -> None:
    twin = HaplyTwin(hand_force=lambda tick, time, state: [0.0, 0.0, -0.3 * (time > 0.006), 0.0, 0.0, 0.0])
    plant = HaplyPlant(VirtualLink(twin), period=0.002)
    soft = {"stiffness": 200.0, "damping": 5.0}
    scene = find_scene(name)()
    scene = scene.replace(**soft) if soft.keys() <= {item.name for item in scene.parameters()} else scene
    own = on_arm(scene, plant)
    assert own.body.inertia[0] == 0.15 and not own.body.load.any() and own.period == plant.period
    report = LinkReport(device_delay=plant.delay, delay=np.zeros(0), answer=np.zeros(0), **COUNTS)
    for _ in range(20):  # the tip is moved before the flight
        plant.read()
    assert fly_arm(plant, scene, Preflight(own, report, math.inf, "", ""), duration=0.06) == (30, "")
    place = 0.0 if name == "wall" else scene.start().pose[2]  # which would start inside a wall
    assert not any(twin.force) and plant.centre[2] == pytest.approx(-0.5 * 0.3 / 0.15 * 0.034**2 - place, rel=0.2)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_without_torques_exerts_its_forces(name: str) -> None:
    place, speed = [1e-3, -2e-3, -1e-3, 0.0, 0.0, 0.0], [0.01, 0.02, -0.03, 0.0, 0.0, 0.0]
    for law in LAWS[name]:
        wrenches = [[0.0] * 6, [0.0] * 6]
        for one, wrench in zip((law, ForcesOnly(law)), wrenches):
            one(place, speed, one(place, speed, one.start(), [0.0] * 6)[0], wrench)
        assert wrenches[0][:3] == wrenches[1][:3] and not any(wrenches[1][3:])


def test_the_preflight_check_reduces_a_wall_until_the_arm_is_stable(monkeypatch: pytest.MonkeyPatch) -> None:
    delay = {True: 0.005, False: 0.007}  # takes 0.4 s to compute
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda scene, _: delay[scene.stiffness == 1000.0])
    monkeypatch.setattr("maglev_mj.bridge.preflight._HALVINGS", 4)
    plant = HaplyPlant(VirtualLink(HaplyTwin()), period=0.005)
    result = preflight_arm(plant, Drop(stiffness=1000.0))
    own = float(largest_stable_stiffness(period=0.005, delay=plant.delay, mass=0.15).stiffness)
    assert "wall stiffness reduced from 1000 to" in result.reduction and not result.problem
    assert 0.25 * own < result.scene.stiffness < own  # type: ignore[attr-defined]
    with pytest.raises(PlantError, match=r"take 5.50 ms, above the period of 5 ms"):
        preflight_arm(HaplyPlant(VirtualLink(HaplyTwin(), 0.0055), period=0.005), Drop())


def test_the_command_flies_a_scene_records_it_and_lands(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    links: list[FaultyLink] = []

    def opened(address: str, key: bytes | None) -> FaultyLink:
        links.append(FaultyLink(HaplyTwin(hand_force=lambda *_: [0.0, 0.0, -0.3, 0.0, 0.0, 0.0])))
        return links[-1]

    monkeypatch.setattr("maglev_mj.bridge.haply.plant.WebSocketLink", opened)
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.02)
    line = "bridge haply://127.0.0.1:10001 --scene box --stiffness 100 --damping 2 --force-limit 0.2"
    assert main([*line.split(), "--seconds", "0.2", "--record", "arm.maglev"]) == 0
    said = capsys.readouterr().out
    assert "wall stiffness 100 N/m" in said and "0.2 s, 200 samples; the force has faded to zero\n" in said
    forces = [max(map(abs, force)) for _, force in links[0].sent if force]
    assert 0.0 < max(forces) < 0.2 + 1e-12 and forces[-1] == 0.0 and not links[0].open
    (segment,) = Recording.load("arm.maglev").segments
    assert len(segment) == 200
    assert main([*line.split(), "--check"]) == 0 and "box is stable up to 20.00 ms: ready" in capsys.readouterr().out
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.001)
    assert main([*line.split(), "--as-written"]) == 1
    assert "no flight: box is stable up to a loop delay of 1.00 ms" in capsys.readouterr().err


@pytest.mark.parametrize(
    "critical, stiffness, reason", [(0.002, 50.0, "loop delay too long"), (1.0, 2000.0, "laws generate energy")]
)
def test_a_guard_ends_the_flight_with_a_landing(critical: float, stiffness: float, reason: str) -> None:
    twin = HaplyTwin(hand_force=lambda tick, time, state: [0.0, 0.0, -2.0, 0.0, 0.0, 0.0])
    link = FaultyLink(twin)
    plant, scene = HaplyPlant(link, arm=Arm(speed_limit=10.0), period=0.005), Drop(stiffness=stiffness, damping=3.0)
    report = LinkReport(device_delay=plant.delay, delay=np.zeros(0), answer=np.zeros(0), **COUNTS)
    checked = Preflight(on_arm(scene, plant), report, critical, "", "")
    count, ended = fly_arm(plant, scene, checked, duration=5.0)
    assert count < 1000 and reason in ended
    forces = [abs(force[2]) for _, force in link.sent[-5:] if force]
    assert forces == sorted(forces, reverse=True) and forces[-1] == 0.0


def test_the_numbers_of_an_arm_are_those_of_its_device_file(tmp_path: Path) -> None:
    assert Arm.of(Device.load("arm")) == Arm.of(Device.load("ubc")) == Arm()
    heavy = Device.load("arm").change("body", mass=0.3).change("loop", rate=500.0)
    assert Arm.of(heavy) == replace(Arm(), mass=0.3, rate=500.0)
    (tmp_path / "heavy.toml").write_text(heavy.toml(), encoding="utf-8")
    assert Arm.of(Device.load(tmp_path / "heavy.toml")) == Arm.of(heavy)


def test_a_forked_process_that_leaves_its_copy_ends_no_flight_of_an_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    link = Mock(wraps=VirtualLink(HaplyTwin(Arm())))
    plant = HaplyPlant(link)
    plant.read()
    sent = link.send.call_count
    monkeypatch.setattr("os.getpid", lambda: -1)
    plant.close()
    assert link.send.call_count == sent and not link.close.called

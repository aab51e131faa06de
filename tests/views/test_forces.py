"""One number for the force of the device, in every view; words of states; the magnified wall."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.analysis.report import analyse
from maglev_mj.colours import BAD, DEVICE
from maglev_mj.control import Controller, Wall
from maglev_mj.frames import AXES, Array
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.recording import Recording
from maglev_mj.recording.export import export
from maglev_mj.result import number_text
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Box, Corner, Joystick, TableTop
from maglev_mj.session import DeviceStatus, Pacer, Session, Snapshot
from maglev_mj.session.margin import STABILITY
from maglev_mj.session.replay import Replay
from maglev_mj.views.forces import averaging_time, force_text, forces, state_words, strip
from maglev_mj.views.handle import force_arrows, hand_spring
from maglev_mj.views.page import panel
from maglev_mj.views.readings import Charts, acts, device_strip, outline, readings
from maglev_mj.views.window.screen import Area, Screen, message_rows, number_rows, status_rows
from tests.all_of import SCENES
from tests.sweeps import sweep as cases


def unhurried() -> Pacer:
    """Return a pacer without a deadline."""
    return Pacer(budget=60.0, patience=3600.0)


def played(session: Session, targets: Any, period: float) -> list[Snapshot]:
    """Return the snapshot after each tick of a session whose hand goes to each target in turn."""
    shown = []
    for target in targets:
        session.hand.target = target
        session.tick(period)
        shown.append(session.snapshot())
    return shown


def most(shown: list[Snapshot]) -> float:
    """Return the largest device force of snapshots, which readings, bars of the page and of the window show alike."""
    for one in shown[:: len(shown) // 7]:
        text = force_text(forces(one)["device"])
        assert {row.name: row.value for row in readings(one)}["device"] == text == dict(status_rows(one))["device"]
        assert f'aria-valuetext="{text}"' in panel._gauge(one)
    return max(forces(one)["device"].most for one in shown)


def impacts(seed: int) -> tuple[Scene, list[list[float]]]:
    """Return a scene with pulses of random gains and rate, and the targets of a hand that hits its walls."""
    random = np.random.default_rng(seed)
    period = float(random.uniform(0.001, 0.008))
    scene = [Joystick, Box, Corner][seed % 3](
        period=period,
        delay=float(random.uniform(0.0, 0.9)) * period,
        stiffness=float(random.uniform(500.0, 4000.0)),
        damping=float(random.uniform(5.0, 60.0)),
    )
    way = random.normal(size=3)
    way *= 0.05 / np.linalg.norm(way)
    count = round(0.8 / period)
    return scene, [[*(way * np.sign(math.sin(9.0 * k * period))), 0.0, 0.0, 0.0] for k in range(count)]


@pytest.mark.parametrize("seed", cases(range(12), every=4))
def test_the_largest_device_force_is_one_number(seed: int, tmp_path: Path) -> None:
    # page, window, replay, analysis and export
    scene, targets = impacts(seed)
    path = tmp_path / "run.maglev"
    session = Session(scene, record=path, pacer=unhurried())
    live = most(played(session, targets, scene.period))
    pulses = session.snapshot().pulses
    session.close()
    recording = Recording.load(path)
    (segment,) = recording.segments
    replay = Replay(recording)
    replay.act("loop")
    replay.act("pause")
    shown = [replay.snapshot()]
    for _ in range(len(segment) - 1):
        replay.act("step")
        shown.append(replay.snapshot())
    export(recording, "csv", tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(encoding="utf-8") as file:
        exported = max(float(row["device_force"]) for row in csv.DictReader(file))
    analysed = analyse(segment).recorded.figures.device_force
    assert pulses and live == most(shown) == exported == analysed
    assert f"device force up to {number_text(analysed, 3, 2)} N" in str(analyse(segment).table())
    held = float(np.linalg.norm(segment.applied[:, :3] - segment.metadata.carried[:3], axis=1).max())
    assert live > held  # the pulse is the peak
    assert any(f"peak {live:.1f} N" in panel._gauge(one) for one in shown)


@pytest.mark.parametrize("scene", [Joystick, Box])
def test_a_pulse_is_a_spike_of_the_plot_however_few_points(scene: type[Scene]) -> None:
    session = Session(scene(), pacer=unhurried())
    shown = played(session, [[0.05, 0.0, 0.0, 0.0, 0.0, 0.0]] * 160, 0.005)[-1]
    rows = shown.history
    spike = float(np.abs(rows[:, 13] + rows[:, 25]).max())  # device and pulse along x
    assert spike > 1.2 * np.abs(rows[:, 13]).max()
    for points in (10, 50, 500):
        chart = Charts(points).of(shown, 0)[1]
        (line,) = [line for line in chart.lines if line.colour == DEVICE]
        assert np.abs(np.asarray(line.y)).max() == spike and len(np.asarray(line.x)) <= max(points, 0)
        assert np.asarray(line.x)[-1] == 0.0 and (np.diff(line.x) > 0.0).all()
        assert ("device peak", DEVICE) in chart.title


@pytest.mark.parametrize("count", [1, 5, 39, 40, 41, 977])
def test_an_outline_keeps_extremes_order_and_the_newest(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    time, kept = outline(np.arange(float(count)), values, 40)
    assert len(time) <= 40 and time[-1] == count - 1 and (np.diff(time) > 0.0).all()
    assert kept.min() == values.min() and kept.max() == values.max() and (values[time.astype(int)] == kept).all()


def test_arrows_are_the_means_that_bars_show() -> None:
    session = Session(Joystick(stiffness=11720.0), pacer=unhurried())
    shown = played(session, [[0.03, 0.0, 0.0, 0.0, 0.0, 0.0]] * 400, 0.005)[-1]
    felt, arrows = forces(shown), force_arrows(shown)
    assert felt["device"].most - felt["device"].least > 5.0  # it buzzes
    assert abs(felt["device"].size - felt["hand"].size) < 0.5  # but the means balance
    for name in ("hand", "device"):
        assert arrows[name].text == f"{felt[name].size:.1f} N"
    rows = shown.history[-20:]
    assert felt["hand"].size == pytest.approx(np.linalg.norm(rows[:, 19:22].mean(axis=0)))
    for changed, time in (({"time_scale": 0.1}, 0.01), ({"state": "paused"}, 0.005), ({"time_scale": 0.001}, 0.005)):
        now = replace(shown, **changed)
        assert averaging_time(now) == pytest.approx(time) and f"over {time:g} s" in panel._gauge(now)


def test_no_force_acts_once_a_scene_has_stopped() -> None:
    session = Session(Joystick(), pacer=unhurried())
    shown = played(session, [[0.03, 0.0, 0.0, 0.0, 0.0, 0.0]] * 400, 0.005)[-1]
    assert {"hand", "device"} <= force_arrows(shown).keys()
    stopped = replace(shown, state="stopped")
    assert [force_text(force) for force in forces(stopped).values()] == ["0.0 N, peak 0.0 N"] * 2
    assert not force_arrows(stopped) and "no force" in panel._gauge(stopped)
    # a device goes on in a fault, perhaps with amplifiers that stick: nothing says that its force is gone
    device = replace(stopped, device=DeviceStatus("udp://twin", "fault", simulated=True))
    assert forces(device)["device"].size == forces(shown)["device"].size > 1.0
    assert force_arrows(device).keys() == force_arrows(shown).keys() and "no force" not in panel._gauge(device)


def truth(timing: Timing, controller: Controller, hand: float, ticks: int) -> tuple[Array, Any]:
    """Return the rows of a history of an exact run against a wall along x, and its trace."""
    rows = []
    with ExactPlant(
        timing,
        mass=0.7,
        gravity=0.0,
        hand_force=lambda *_: [hand, 0.0, 0.0, 0.0, 0.0, 0.0],
        pose=[4e-4, *[0.0] * 5],
        record=True,
    ) as plant:
        for _ in range(ticks):
            sample = plant.read()
            applied = plant.write(controller.step(sample))
            pose, twist = plant.state()
            parts = pose, twist, applied.wrench, plant.hand_wrench, applied.pulse
            rows.append([sample.time, *np.concatenate(parts), applied.pulse_width if applied.extra else 0.0])
        plant.read()
        return np.array(rows), plant.trace()


@pytest.mark.parametrize("seed", cases(range(8), every=3))
def test_the_magnified_wall_is_the_motion_and_the_forces(seed: int) -> None:
    random = np.random.default_rng(seed)
    period = float(random.uniform(0.002, 0.006))
    timing = Timing(period=period, delay=float(random.uniform(0.05, 1.9)) * period)
    gains: dict[str, Any] = {
        "stiffness": float(random.uniform(200.0, 1500.0)),
        "damping": float(random.uniform(5.0, 40.0)),
    }
    wall = Wall(axes="x", lower=0.0, pulse=float(random.uniform(0.0, 60.0)), pulse_width=0.4 * period, **gains)
    rows, trace = truth(timing, Controller([wall], period=period), -2.0, 120)

    class Own(Scene):
        def laws(self) -> list[Any]:
            return [wall]

    scene = Own(period=period, delay=timing.delay)
    shown = Snapshot(scene=scene, delay=scene.delay, history=rows, faces=wall.faces(), inertia=[0.7] * 6)
    near = strip(shown)
    assert near is not None and (near.axis, near.normal, near.edge) == (0, 1.0, 0.0)
    assert len(near.time) < 1500 and near.time[-1] == 0.0 and near.time[0] >= -0.5
    later = near.time > near.time[0] + 3.0 * period  # the commands before the strip are not in it
    pose, twist, _ = trace.at(rows[-1, 0] + near.time[later])
    assert near.position[later] == pytest.approx(pose[:, 0], abs=1e-9)
    inside = pose[:, 0] < -1e-8
    ideal = -gains["stiffness"] * pose[:, 0] - gains["damping"] * twist[:, 0]
    assert near.ideal[later][inside] == pytest.approx(ideal[inside], abs=1e-4)
    assert not near.ideal[later][pose[:, 0] > 1e-8].any()
    middle = 0.5 * (near.time[later][1:] + near.time[later][:-1])
    acting = near.force[np.searchsorted(near.switches, middle, side="right") - 1]
    assert acting == pytest.approx(trace.at(rows[-1, 0] + middle)[2][:, 0], abs=1e-9)


def test_the_strip_is_at_the_stick_position_until_a_wall_is_touched() -> None:
    session = Session(Joystick(friction=True), pacer=unhurried())
    stuck = played(session, [[0.004, 0.0, 0.0, 0.0, 0.0, 0.0]] * 80, 0.005)[-1]
    near = strip(stuck)
    assert near is not None and near.sticks and near.edge == stuck.ghost[0] and np.isnan(near.ideal).all()  # type: ignore[index]
    pressed = played(session, [[0.05, 0.0, 0.0, 0.0, 0.0, 0.0]] * 300, 0.005)[-1]
    wall = strip(pressed)
    assert wall is not None and not wall.sticks and (wall.axis, wall.edge) == (0, 0.0035)


def test_the_state_of_hand_and_friction_in_words() -> None:
    session = Session(Joystick(friction=True), pacer=unhurried())
    still = session.snapshot()
    assert state_words(still) == ""
    words = [
        state_words(one) for one in played(session, [[0.004, *[0.0] * 5]] * 60 + [[0.06, *[0.0] * 5]] * 120, 0.005)
    ]
    stuck = re.fullmatch(r"sticking, (\d\.\d) of 2 N", words[59])
    assert stuck and 0.2 < float(stuck[1]) < 2.0
    assert "slipping along x" in words and "7.0 N, limit of the hand" in words[-1]
    now = session.snapshot()
    load = Joystick().stiffness * 0.5 * abs(now.pose[1])  # walls and friction share the stiffness
    assert load < 2.0 and not state_words(replace(now, state="stopped", hand_limit=math.inf))
    row = next(row for row in readings(replace(now, hand_limit=math.inf)) if row.name == "device")
    assert "limit" not in row.value


@pytest.mark.parametrize("coupled", [False, True])
def test_coupled_friction_is_of_the_whole_pull(coupled: bool) -> None:
    session = Session((TableTop if coupled else Joystick)(friction=True), pacer=unhurried())
    now = played(session, [[0.003, 0.003, 0.0, 0.0, 0.0, 0.0]] * 100, 0.005)[-1]
    assert now.anchors is not None
    pulls = now.scene.stiffness * (1.0 if coupled else 0.5) * np.abs(now.anchors - now.pose)[:2]  # type: ignore[attr-defined]
    load = float(np.hypot(*pulls)) if coupled else float(pulls.max())
    assert state_words(now) == f"sticking, {load:.1f} of 2 N" and load > 0.3


STATES: list[dict[str, Any]] = [
    {},
    {"state": "paused"},
    {"state": "stopped", "reason": "unstable: the wall generated 100 mJ"},
    {"state": "flying", "hand_estimated": True, "delay": 0.0019},
    {"idle": "inactive: nothing is rendered", "device": DeviceStatus("pty", "inactive", simulated=True)},
    {
        "state": "stopped",
        "reason": "ESTOP",
        "idle": "fault: nothing is rendered",
        "device": DeviceStatus("pty", "fault"),
    },
    {"state": "flying", "delay": math.nan, "device": DeviceStatus("udp://h:1", "in flight", 0.9, 9000.0)},
    {"hand": np.full(6, math.nan)},
    {"duration": 2.0},
]
"""States of a snapshot that change what may be said."""
OF_LAWS = "stable", "critical stiffness", "N/m", "soft centring", "sticking", "slipping", "spectral radius"


def texts(shown: Snapshot) -> str:
    """Return all words of page and window about a snapshot."""
    STABILITY.of(shown, wait=True)
    parts = [f"{name} {value}" for rows in (status_rows, number_rows, message_rows) for name, value in rows(shown)]
    charts = [*Charts(50).of(shown, 0), *Charts(50).strip(shown)]
    parts += [" ".join(text for text, _ in chart.title) + f" {chart.foot} {chart.side}" for chart in charts]
    parts += [f"{row.name} {row.value}" for row in readings(shown)]
    parts += [panel._verdict(shown), panel._gauge(shown), panel._banner(shown), panel._device(shown)]
    parts += [box.text for box in Screen().draw(shown, Area(0, 0, 1200, 750), 100).boxes]
    return "\n".join(parts)


@pytest.mark.parametrize("name", SCENES)
def test_words_of_laws_only_while_they_act_and_only_numbers(name: str) -> None:
    session = Session(name, pacer=unhurried())
    session.tick(0.1)
    for changed in STATES:
        shown = replace(session.snapshot(), **changed)
        if changed.get("idle"):
            shown = replace(shown, faces=())
        text = texts(shown)
        assert not re.search(r"\bnan\b|\binf\b", text, re.IGNORECASE), text
        if shown.idle:
            assert shown.idle in panel._verdict(shown) and not [word for word in OF_LAWS if word in text], text
        elif not acts(shown):
            assert not re.search(r"\bstable|critical|sticking", text) and "stopped: nothing is rendered" in text
        for chart in (*Charts(50).of(shown, 0), *Charts(50).strip(shown)):
            assert np.isfinite([chart.across, chart.up]).all()
    session.close()


def test_the_strip_of_a_device() -> None:
    shown = Snapshot(
        scene=Joystick(stiffness=4172.0), faces=Joystick().controller().faces, delay=0.0019, state="flying"
    )
    status = DeviceStatus("udp://192.0.2.1:5678", "in flight", 0.31, 6000.0)
    row = device_strip(replace(shown, device=status))
    assert row is not None and row.name == "DEVICE" and row.colour != BAD
    assert row.value == ("udp://192.0.2.1:5678: in flight, loop 1.9 ms, coils 31 % of limit, wall 4172 of 6000 N/m")
    hot = device_strip(replace(shown, device=status._replace(warmth=0.85)))
    assert hot is not None and hot.colour == BAD
    assert device_strip(shown) is None and panel._device(shown) == ""
    assert 'data-name="DEVICE"' in panel._device(replace(shown, device=status))
    assert 'data-name="SIMULATED DEVICE"' in panel._device(replace(shown, device=status._replace(simulated=True)))


@pytest.mark.parametrize(("scene", "words"), [(Joystick(), "wall 6000 + centring 300 N/m"), (Box(), "")])
def test_the_dot_of_the_map_names_its_parts(scene: Scene, words: str) -> None:
    shown = Snapshot(scene=scene, faces=scene.controller().faces)
    rows = {row.name: row.value for row in readings(shown)}
    assert rows.get("loop", "") == words
    chart = Charts(50).of(shown, 0)[2]
    dots = [(float(np.asarray(line.x)[-1]), 1e3 * float(np.asarray(line.y)[-1])) for line in chart.lines if line.dot]
    assert dots[0] == pytest.approx((80.0, 6000.0)) if words else len(dots) == 1
    assert dots[-1] == pytest.approx((92.0, 6300.0) if words else (81.0, 6000.0))


def test_the_spring_of_the_hand_ends_at_its_target() -> None:
    shown = Snapshot(scene=Joystick(), target=[0.01, 0.0, 0.005, 0.0, 0.1, 0.0])
    coil, knob = hand_spring(shown), shown.scene.hardware.knob.centre
    assert coil[0] == pytest.approx(knob) and np.linalg.norm(coil[-1] - knob) > 0.01
    assert not len(hand_spring(replace(shown, target=None))) and not len(hand_spring(replace(shown, target=[0.0] * 6)))
    assert not len(hand_spring(replace(shown, target=[math.nan] * 6)))
    assert len(AXES) == 6

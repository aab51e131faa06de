"""Analysis of recordings against known values: to rounding if every force is recorded."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, Hold
from maglev_mj.analysis import SegmentReport, analyse, face_figures, reconstruct
from maglev_mj.analysis.motion import _stick_slip
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.cli import main
from maglev_mj.frames import AXES, Command, Sample
from maglev_mj.plants import Timing
from maglev_mj.plants.hand import SpringHand, Trajectory
from maglev_mj.plants.trace import PassivityObserver
from maglev_mj.recording import MemoryFile, Recording, RecordingError, Segment, open_recording
from maglev_mj.result import number_text
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.figures import perceived_hardness, summarise_bounce
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.run import run
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import Replay, rebuild, record_run, stick_positions_of
from maglev_mj.spec import GRAVITY
from maglev_mj.views.page import panel
from maglev_mj.views.readings import Charts
from maglev_mj.views.window.screen import WindowPlots, status_rows
from tests.bridge.impaired import ImpairedLine, Impairment
from tests.published import INERTIA, MASS

ZERO = (0.0,) * 6
TOUR = Trajectory(
    [0.8, 1.1, 1.4, 1.8, 2.2],
    [ZERO, (0.016, 0.004, 0, 0, 0.1, 0), (-0.016, 0.01, 0.005, 0.1, 0, 0.1), (0, -0.012, -0.016, 0.1, 0, -0.1), ZERO],
)
"""Path of a hand against walls on three axes."""


def recorded(scene: Scene, plant: str = "exact", phase: float = 0.0) -> Segment:
    (segment,) = record_run(scene, plant=plant, phase=phase).segments
    return segment


def analysed(segment: Segment, **keywords: Any) -> SegmentReport:
    return analyse(segment, rebuild, anchors=stick_positions_of(segment), **keywords)


@cache
def flown(mass: float = MASS, *, hand: bool = False, loss: float = 0.0, **parameters: float) -> Segment:
    """Return a flight of a joystick on a twin, whose mass may differ from the calibration's."""
    truth = replace(Calibration.nominal(), mass=mass)
    spring = SpringHand(target=Trajectory(np.asarray(TOUR.times) + 0.6, TOUR.poses))

    def holder(tick: int, time: Any, state: Any) -> Any:
        return spring(tick, time, state) if hand and time > 1.3 else ZERO  # hands off in takeoff

    twin = Twin(TwinParameters(truth=truth, **parameters), hand_force=holder, draw=lambda: 7)  # type: ignore[arg-type]
    with RemotePlant(VirtualLink(twin, ImpairedLine(Impairment(loss=loss)))) as plant:
        file = MemoryFile()
        Flight(plant, Joystick(period=plant.period, delay=plant.delay), file=file).run(2.0 if hand else 1.2)
    (segment,) = file.recording.segments
    return segment


@pytest.fixture
def no_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write empty pictures."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: path.write_bytes(b""))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a joystick recording without, then with friction."""
    folder, tour = tmp_path_factory.mktemp("session"), Trajectory(np.asarray(TOUR.times) - 0.6, TOUR.poses)
    running = Session(
        Joystick(), folder=folder, hand_force=SpringHand(target=tour), pacer=Pacer(budget=100.0, patience=100.0)
    )
    running.act("record")
    running.tick(0.9)
    running.act("friction")
    running.tick(0.9)
    running.close()
    return running.recordings[0]


DROPS: list[dict[str, Any]] = [
    {"phase": 0.3, "pulse": 0.0, "delay": 0.0},  # whose force peaks after the entry
    {"phase": 0.1, "force_limit": 60.0, "carry": True},
    {"phase": 0.2, "delay": 0.004, "stiffness": 3000.0},  # so late that the next command ends its pulse
    {"phase": 0.4, "delay": 0.007, "stiffness": 1000.0, "damping": 20.0},
]


@pytest.mark.parametrize("changes", DROPS)
def test_samples_and_forces_alone_give_the_exact_figures_of_a_drop(changes: Mapping[str, Any]) -> None:
    drop, phase = Drop(**{name: value for name, value in changes.items() if name != "phase"}), changes.get("phase", 0.0)
    found = analysed(recorded(drop, phase=phase), rest=drop.rest, simulated=False).recorded
    (face,) = found.figures.faces
    end = float(found.motion.trace.time[-1])
    exact = run(drop, plant="exact", phase=phase).trace.until(end)  # the recording ends with its last sample
    summary, hardness = summarise_bounce(exact, drop.rest), perceived_hardness(exact, 0.005)
    assert face.penetration == pytest.approx(float(summary.penetration), abs=1e-15)
    assert face.rebound == pytest.approx(float(summary.rebound), abs=1e-15)
    assert face.contacts[0].peak_force == face.peak_force == float(summary.peak_force)
    assert face.settling_time == pytest.approx(float(summary.settling_time), abs=1e-12, nan_ok=True)
    assert float(face.rate_hardness) == pytest.approx(float(hardness.rate), rel=1e-12, abs=1e-6)
    assert float(face.extended_hardness) == pytest.approx(float(hardness.extended), rel=1e-12)
    times = np.linspace(0.0, end, 2001)[:-1]  # what begins with the last sample is no longer in the recording
    for ours, theirs in zip(found.motion.trace.at(times), exact.at(times), strict=True):
        assert np.abs(ours[:, 2] - theirs[:, 2]).max() < 1e-13
    # energy: what the fall gave is taken, or still there
    speed = float(exact.twist[-1, 2])
    fallen = drop.mass * (GRAVITY * (drop.height - float(exact.pose[-1, 2])) - 0.5 * speed * speed)
    assert found.figures.energy.taken[2] == pytest.approx(fallen, rel=1e-12)
    assert found.figures.unexplained[2] < 1e-12


def test_a_coarse_sensor_costs_no_more_than_its_steps() -> None:
    step = 5e-6
    drop = Drop(quantize=step)
    for phase in (0.0, 0.5):
        found = analysed(recorded(drop, phase=phase), rest=drop.rest, simulated=False).recorded
        (face,) = found.figures.faces
        exact = run(drop, plant="exact", phase=phase).trace.until(float(found.motion.trace.time[-1]))
        summary = summarise_bounce(exact, drop.rest)
        assert abs(face.penetration - summary.penetration) < step
        assert abs(face.rebound - summary.rebound) < step
        assert face.peak_force == float(summary.peak_force)
        assert abs(face.settling_time - summary.settling_time) < 1e-3
        assert float(face.extended_hardness) == pytest.approx(perceived_hardness(exact, 0.005).extended, rel=0.01)


def test_the_table_has_the_figures_of_a_wall_and_its_contacts_in_order() -> None:
    found = analysed(recorded(Press(hits=2)), simulated=False)
    (face,) = found.recorded.figures.faces
    rows = [line.split() for line in str(found.table()).splitlines() if line.startswith(f"  {face.name} ")]
    small = face.penetration * 1e3, face.rebound * 1e3, face.peak_force, face.settling_time * 1e3
    figures = (*small, float(face.rate_hardness) / 1e3, float(face.extended_hardness) / 1e3)
    assert abs(figures[4] - figures[5]) > 1.0
    assert rows[0][4:] + rows[1][4:] == [*(number_text(figure, 3, 2) for figure in figures), str(len(face.contacts))]
    for row, one in zip(rows[2:10], face.contacts):
        times = one.duration, one.approach_speed, one.penetration
        assert row[4:] == [
            f"{one.start:.4f}",
            *(number_text(1e3 * part, 3, 2) for part in times),
            number_text(one.peak_force, 3, 2),
        ]


def test_the_hardness_is_that_of_the_fastest_contact_alone() -> None:
    segment = recorded(Press(hits=2))
    (whole,) = analysed(segment, simulated=False).recorded.figures.faces
    fastest = int(np.nanargmax([contact.approach_speed for contact in whole.contacts]))
    assert fastest > 0
    before, this = whole.contacts[fastest - 1 : fastest + 1]
    between = 0.5 * (before.start + before.duration + this.start)
    (alone,) = analysed(segment, begin=between, simulated=False).recorded.figures.faces
    assert float(whole.rate_hardness) == pytest.approx(float(alone.rate_hardness), rel=1e-9)
    assert float(whole.extended_hardness) == pytest.approx(float(alone.extended_hardness), rel=1e-3)  # from a sample on


def test_where_a_drop_rests_is_found_in_its_samples() -> None:
    drop = Drop(duration=0.5)
    segment = recorded(drop, phase=0.3)
    (found,), (told,) = (analysed(segment, rest=rest).recorded.figures.faces for rest in (None, drop.rest))
    assert found.rest == pytest.approx(drop.rest, abs=1e-8)
    assert found.settling_time == pytest.approx(told.settling_time, abs=1e-6)
    (cut,) = analysed(segment, end=0.06).recorded.figures.faces
    assert np.isnan(cut.settling_time)  # on its way still
    for share, settled in ((0.85, True), (0.95, False)):  # of the time: in the last tenth it is no rest
        end = float(told.settling_time) / share
        (cut,) = analysed(segment, end=end, rest=drop.rest).recorded.figures.faces
        assert np.isfinite(cut.settling_time) == settled


def test_a_constant_force_is_found_over_samples_that_were_lost() -> None:
    push, lost = (0.3, -0.2, 0.5, 1e-3, -2e-3, 1e-3), [7, 8, 20, 33, 34, 35, 50]
    plant = ExactPlant(Timing(), pose=(0.0, 0.0, 1e-3, 0.0, 0.0, 0.0), gravity=0.0, hand_force=lambda *_: push)
    hold = Hold(stiffness=[200.0] * 3 + [0.2] * 3, damping=[10.0] * 3 + [0.01] * 3)
    controller, file = Controller([hold], period=Timing().period), MemoryFile()
    record = file.begin(plant, controller)
    for tick in range(60):
        sample = plant.read()
        if tick not in lost:
            command = controller.step(sample)
            record(sample, command, plant.write(command))
    (segment,) = file.recording.segments
    found = reconstruct(segment.replace(hand=np.zeros_like(segment.hand)))
    assert len(found.unexplained) == 59 - len(lost)
    np.testing.assert_allclose(found.unexplained, np.tile(push, (len(found.unexplained), 1)), rtol=1e-8)


def test_hits_of_a_hand_are_told_apart_and_its_pull_is_found() -> None:
    press = Press(hand="stylus", hits=3)
    found, ran = analysed(recorded(press)).recorded, run(press, plant="exact")
    times = np.linspace(0.0, float(found.motion.trace.time[-1]), 4001)
    assert np.abs(found.motion.trace.at(times)[0][:, 2] - ran.trace.at(times)[0][:, 2]).max() < 1e-6
    (face,) = found.figures.faces
    starts = [*press.strokes(0.0), np.inf]
    hits = (ran.figures[name] for name in ("penetration", "approach_speed", "contacts"))
    for place, (depth, speed, contacts) in enumerate(zip(*hits, strict=True)):
        hit = [one for one in face.contacts if starts[place] <= one.start < starts[place + 1]]
        assert len(hit) == contacts
        assert max(one.penetration for one in hit) == pytest.approx(depth, abs=1e-6)
        assert hit[0].approach_speed == pytest.approx(speed, rel=0.005)
    assert found.figures.energy.taken[2] == pytest.approx(float(ran.figures["absorbed"]), rel=0.005)


@pytest.mark.parametrize(
    ("scene", "plant"),
    [(Pull(), "exact"), (Pull(axis="ry"), "mujoco"), (Pull(delay=0.005, duration=1.0), "mujoco")],
)
def test_sticks_and_slips_are_those_of_the_experiment(scene: Pull, plant: str) -> None:
    ran, found = run(scene, plant=plant), analysed(recorded(scene, plant))
    axis, events = AXES.index(scene.axis), scene.events(ran)
    figures = found.recorded.figures
    ((rubbing, friction),) = figures.friction.items()
    assert rubbing == scene.axis
    sticks = friction.sticks
    slips = [event.time for event in events if event.kind == "slip"]
    stuck = [event for event in events if event.kind == "stick"]
    assert friction.transitions == ran.figures["transitions"] > 1
    assert friction.slips == len(slips)
    assert [stick.start + stick.duration for stick in sticks if stick.slipped] == pytest.approx(slips)
    assert [stick.start for stick in sticks[1:]] == [event.time for event in stuck]
    assert [stick.position for stick in sticks[1:]] == [event.position for event in stuck]
    assert found.axis() == axis
    table = next(table for table in found.table().below if "friction" in table.head)
    assert table.head[2] == "longest stick [ms]"
    assert table.rows[0][2] == number_text(1e3 * max(stick.duration for stick in sticks), 3, 2)


def test_a_stick_lasts_to_the_next_sample_and_ends_where_its_spring_did() -> None:
    none = math.nan
    anchors = np.array([0.1, 0.2, none, none, 0.5, none, 0.7, 0.8])
    times = np.arange(len(anchors)) / 100.0
    expected = [(0.0, 0.02, 0.2, True), (0.04, 0.01, 0.5, True), (0.06, 0.01, 0.8, False)]
    found = _stick_slip(times, np.isfinite(anchors), anchors).sticks
    for stick, told in zip(found, expected, strict=True):
        assert stick == pytest.approx(told)


@pytest.mark.parametrize("delay", [0.0, 0.0015, 0.004, 0.007])
def test_the_energy_taken_is_what_the_observer_of_the_loop_finds(delay: float) -> None:
    scene = Pull(delay=delay, duration=0.06)
    segment = recorded(scene)
    observer = PassivityObserver(Timing(period=scene.period, delay=delay), INERTIA)
    for row, (place, applied) in enumerate(zip(segment.position.tolist(), segment.applied.tolist(), strict=True)):
        observer(Sample(row, 0.0, place), Command(applied))
    energy = analysed(segment, simulated=False).recorded.figures.energy
    assert abs(observer.energy[0]) > 1e-7
    assert energy.taken[0] == pytest.approx(observer.energy[0], rel=1e-9)
    assert energy.least[0] <= observer.least[0] + 1e-15  # which looks at samples alone


def test_a_simulated_recording_is_its_simulation_bit_for_bit(session: Path) -> None:
    _, with_friction = Recording.load(session).segments
    for segment in (recorded(Drop(quantize=5e-6), "mujoco"), with_friction):
        comparison = analysed(segment).comparison
        assert comparison is not None and comparison.same


def test_how_far_a_changed_recording_is_apart_is_found_to_the_digit() -> None:
    segment = recorded(Drop())
    place = segment.position.copy()
    place[:, 0] += 2e-6
    place[30, 0] += 3e-6
    comparison = analysed(segment.replace(position=place)).comparison
    assert comparison is not None and not comparison.same
    count = len(place)
    assert comparison.rms[0] == pytest.approx(np.sqrt((4.0 * (count - 1) + 25.0) / count) * 1e-6)
    assert comparison.most[0] == pytest.approx(5e-6)
    assert comparison.when[0] == segment.time[30]
    assert comparison.rms[2] == 0.0
    assert "max. 5 µm at 0.15 s" in comparison.sentence
    # a sample that is 3 µm off is 3 µm ahead of its neighbours, twice that behind, and 3 µm ahead again
    assert comparison.one_step_rms[0] == pytest.approx(np.sqrt((9.0 + 36.0 + 9.0) / (count - 2)) * 1e-6, rel=0.01)


def test_a_device_that_is_as_known_is_followed_to_a_micrometre() -> None:
    found = analysed(flown())
    assert found.comparison is not None and found.comparison.device
    assert found.comparison.rms[:3].max() < 5e-6
    assert found.comparison.one_step_rms[:3].max() < 2e-6  # the noise of the sensor, and not more
    assert found.recorded.figures.missed == 0
    quiet = analysed(flown(quantum=0.0, noise=0.0)).comparison
    assert quiet is not None and quiet.one_step_rms[:3].max() < 1e-9


def test_a_device_that_weighs_more_is_found_out_one_sample_ahead() -> None:
    heavy = 0.05
    found = analysed(flown(MASS + heavy, quantum=0.0, noise=0.0))
    comparison = found.comparison
    assert comparison is not None
    # what carries 0.75 kg would lift 0.7 kg by a T² in a period
    ahead = heavy * GRAVITY / MASS * 0.005**2
    assert comparison.one_step_rms[2] == pytest.approx(ahead, rel=2e-3)
    assert np.median(found.recorded.motion.unexplained[:, 2]) == pytest.approx(-heavy * GRAVITY, rel=1e-3)
    # and over time it sags by its weight over the spring of the joystick
    assert comparison.most[2] > heavy * GRAVITY / 300.0
    assert comparison.rms[2] == pytest.approx(heavy * GRAVITY / 300.0, rel=0.02)
    assert "RMS" in comparison.sentence and "on z:" in comparison.sentence


def test_samples_that_a_device_lost_are_counted_and_bridged() -> None:
    found = analysed(flown(hand=True, loss=0.05, quantum=0.0, noise=0.0))
    figures = found.recorded.figures
    assert 5 < figures.missed <= 400 - figures.samples <= figures.missed + 1  # the first in flight may be lost too
    # what nobody recorded is the hand, which did what the walls took
    assert np.isnan(figures.energy.hand).all()
    assert figures.energy.others[0] == pytest.approx(figures.energy.taken[0], rel=0.05)
    assert {(face.axis, face.normal) for face in figures.faces} >= {("x", 1.0), ("x", -1.0), ("z", 1.0)}
    assert found.simulated is not None and not found.simulated.figures.faces


def test_a_part_of_a_segment_has_the_figures_of_that_part() -> None:
    segment = recorded(Press())
    whole = analysed(segment).recorded.figures.faces[0]
    part = analysed(segment, begin=0.6, end=1.3).recorded
    (face,) = part.figures.faces
    assert [one.start for one in face.contacts] == pytest.approx([one.start for one in whole.contacts[1:3]])
    assert face.penetration == max(one.penetration for one in face.contacts)
    assert part.figures.start == 0.6 and part.figures.end == 1.3
    assert (part.motion.time == segment.time[120:261]).all()
    (face,) = analysed(fallen := recorded(Drop(), phase=0.3), begin=0.1).recorded.figures.faces
    (contact,) = face.contacts  # which begins inside the wall
    assert np.isnan([contact.approach_speed, face.rate_hardness]).all()
    assert contact.duration == pytest.approx(fallen.time[-1] - contact.start)


def test_upper_walls_are_seen_as_lower_ones_in_a_mirror() -> None:
    segment = recorded(Press())
    turned = segment.replace(
        **{name: -segment.arrays[name] for name in ("position", "hand", "applied", "applied_pulse")}
    )
    down = face_figures(reconstruct(segment).trace, (2, 1.0, 0.0))
    up = face_figures(reconstruct(turned).trace, (2, -1.0, 0.0))
    assert down is not None and up is not None
    assert up.contacts == down.contacts
    assert up.penetration == down.penetration > 1e-3
    assert up.extended_hardness == down.extended_hardness
    assert up.name == "z above 0 mm" and down.name == "z below 0 mm"


def test_what_cannot_be_analysed_is_refused(session: Path, tmp_path: Path, capsys: Any) -> None:
    segment = recorded(Drop())
    with pytest.raises(RecordingError, match=r"at least 2 samples for analysis [(]got 1"):
        analysed(segment[:1])
    with pytest.raises(RecordingError, match="in time order"):
        analysed(segment.replace(time=segment.time[::-1]))
    for name, recording, lacks in (
        ("none", Recording([]), "samples"),
        ("one", Recording([segment[:1]]), "segment"),
    ):
        recording.save(tmp_path / f"{name}.maglev")
        assert main(["analyse", str(tmp_path / f"{name}.maglev")]) == 2
        said = capsys.readouterr().err
        assert len(said.splitlines()) == 1 and f"contains no {lacks}" in said
    assert main(["analyse", str(session), "--from", "1"]) == 2
    assert "choose one of 2 by --segment" in capsys.readouterr().err


@pytest.mark.usefixtures("no_pixels")
def test_a_session_is_analysed_segment_by_segment(session: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(["analyse", str(session), "--json", "-"]) == 0
    both = json.loads(capsys.readouterr().out)["segments"]
    assert [one["segment"] for one in both] == [1, 2]
    assert [one["name"] for one in both] == ["scene joystick"] * 2
    assert not both[0]["recorded"]["friction"] and set(both[1]["recorded"]["friction"]) == set(AXES)
    arguments = ["analyse", str(session), "--segment", "2", "--from", "0.4", "--axis", "y", "--no-compare"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "segment 2 of 2\nScene joystick: " in said and " 100 samples, " in said and "simulation" not in said
    assert {path.name for path in tmp_path.glob("*.png")} == {
        f"segment_2_{name}.png" for name in ("contact", "run", "sticks")
    }


@pytest.mark.usefixtures("no_pixels")
def test_a_flight_is_analysed_beside_a_simulated_device(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "flight.maglev"
    Recording([flown(hand=True, loss=0.05, quantum=0.0, noise=0.0)]).save(path)
    assert main(["analyse", str(path), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "joystick on a device" in said and "the hand on the device is not measured" in said
    assert "unrecorded force" in said and "simulated" in said
    assert max(map(len, said.splitlines())) <= 110
    assert {picture.name for picture in tmp_path.glob("*.png")} == {"analysis_contact.png", "analysis_run.png"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--from", "3"], "from must be at least 0 and below 0.3965 (got 3.0"),
        (["--from", "0.2", "--to", "0.1"], "to must be above 0.2 (got 0.1"),
        (["--from", "0.2", "--to", "0.201"], "from and to must have at least 2 samples between them"),
        (["--axis", "y"], "axis must be one of those with motion (z) (got 'y')"),
    ],
)
def test_a_wrong_option_is_one_line_and_status_2(
    options: list[str], words: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    record_run(Drop(), plant="exact", phase=0.3).save("run.maglev")
    assert main(["analyse", "run.maglev", *options]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and words in said
    assert [path.name for path in tmp_path.iterdir()] == ["run.maglev"]


def test_the_hand_on_a_device_is_an_estimate_and_taken_for_none(tmp_path: Path) -> None:
    path, file = tmp_path / "flight.maglev", open_recording(tmp_path / "flight.maglev", wait=True)
    weighed = replace(Calibration.nominal(), mass=0.75, inertia=np.array([1e-3, 2e-3, 3e-3]))
    twin = Twin(TwinParameters(calibration=weighed), draw=lambda: 7)
    with RemotePlant(VirtualLink(twin), calibration=weighed) as plant:
        Flight(plant, Joystick(period=plant.period, delay=plant.delay), file=file).run(0.3)
    file.close()
    recording = Recording.load(path)
    (segment,) = recording.segments
    assert segment.metadata.inertia.tolist() == [0.75, 0.75, 0.75, 1e-3, 2e-3, 3e-3]
    assert segment.metadata.load[2] == pytest.approx(-0.75 * GRAVITY)
    assert np.isfinite(segment.hand).all() and segment.hand.any() and not segment.metadata.hand_recorded
    assert not segment.recorded_hand_wrench.any() and len(segment) == 60
    found, before = (analysed(one, simulated=False) for one in (segment, segment.replace(hand=0.0)))
    assert found.recorded.motion.trace.pose.tobytes() == before.recorded.motion.trace.pose.tobytes()
    replay = Replay(recording)
    replay.tick(0.25)
    shown = replay.snapshot()
    assert shown.hand_estimated and "hand |F|, estimated" in panel._gauge(shown)
    assert "hand, estimated" in panel.drawn(Charts(100).of(shown, 0)[1])


def test_a_hand_that_is_not_known_is_not_drawn() -> None:
    replay = Replay(Recording([flown().replace(hand=math.nan)]))
    replay.tick(0.4)
    shown = replay.snapshot()
    assert np.isnan(shown.hand).all() and math.isnan(shown.work)
    assert "hand" not in dict(status_rows(shown)).get("energy", "") and "hand" not in panel._gauge(shown)
    force = WindowPlots().update(shown)[1]
    assert force.linepnt[0] == 0 and force.linepnt[1] > 50 and np.isfinite(force.linedata).all()
    drawn = panel.drawn(Charts(100).of(shown, 0)[1])
    assert drawn.count("<polyline") == 2 and '<polyline points=""' in drawn and "nan" not in drawn

"""Pose of one device from six spots, as exact as `Beams.pose` or an error."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from maglev_mj.errors import ParameterError, SensingError
from maglev_mj.frames import Array, rotation_matrix
from maglev_mj.plants import SpotReader, SpotSensor
from maglev_mj.plants.sensor import MAX_ANGLE, MAX_DISTANCE, Beams, FastBeams, PoseTracker, beams

QUANTUM = 8e-7


def poses(count: int, distance: float = 4.5e-3, degrees: float = 6.0, seed: int = 1) -> Array:
    """Return seeded poses in a cube and angle, unordered."""
    random = np.random.default_rng(seed)
    axis = random.normal(size=(count, 3))
    axis *= np.radians(random.uniform(0.0, degrees, (count, 1))) / np.linalg.norm(axis, axis=1, keepdims=True)
    return np.concatenate([random.uniform(-distance, distance, (count, 3)), axis], axis=1)


def path(count: int, step: float) -> Array:
    """Return a smooth path through the range, poses about a given distance apart [m]."""
    random = np.random.default_rng(2)
    rates, phases = random.uniform(0.5, 1.5, 6), random.uniform(0.0, 2.0 * math.pi, 6)
    reach = np.array([4e-3] * 3 + [0.055] * 3)
    return np.asarray(reach * np.sin(phases + np.outer(np.arange(count), rates) * step / reach[0]))


def stepped(spots: Array) -> Array:
    """Return spots in steps of a diode's resolution."""
    return np.asarray(np.rint(spots / QUANTUM) * QUANTUM)


def tracked(tracker: PoseTracker, spots: Iterable[Array]) -> Array:
    """Return a tracker's poses for successive spots."""
    return np.array([tracker(one.tolist()) for one in spots])


@pytest.mark.parametrize(
    "wanted",
    [poses(600), poses(600, 9e-3, 12.0), path(400, 1e-6), path(400, 2e-4)],
    ids=["anywhere", "beyond", "hovering", "moving"],
)
def test_it_agrees_with_newton_on_all_six(wanted: Array) -> None:
    spots = beams().spots(wanted)
    found = tracked(PoseTracker(beams()), spots)
    np.testing.assert_allclose(found, beams().pose(spots), atol=1e-13)
    np.testing.assert_allclose(found, wanted, atol=1e-13)


@pytest.mark.parametrize("share", [1, 3, 6, 10])
def test_beyond_the_range_it_is_the_right_pose_or_an_error(share: int) -> None:
    # Up to 45 mm along each axis and 60 degrees, by jumps from anywhere to anywhere.
    wanted = poses(400, 4.5e-3 * share, 6.0 * share, seed=share)
    tracker = PoseTracker(beams())
    for pose, spots in zip(wanted, beams().spots(wanted)):
        near = np.linalg.norm(pose[:3]) < MAX_DISTANCE and np.linalg.norm(pose[3:]) < MAX_ANGLE
        if near:
            np.testing.assert_allclose(tracker(spots.tolist()), pose, atol=1e-12)
        else:
            with pytest.raises(SensingError, match="no pose found for the spots"):
                tracker(spots.tolist())


@pytest.mark.study
@pytest.mark.parametrize("count", [30])
def test_of_all_poses_with_the_same_spots_one_is_near(count: int) -> None:
    # Newton on the full equations, from anywhere, finds no second pose within the limits.
    random, sensor, others = np.random.default_rng(3), beams(), 0
    for pose in poses(count, 15e-3, 40.0):
        spots = sensor.spots(pose)
        for guess in np.concatenate([random.uniform(-0.03, 0.03, (30, 3)), random.normal(size=(30, 3)) * 2.0], axis=1):
            try:
                found = sensor.pose(spots, guess)
            except SensingError:
                continue
            turn = rotation_matrix(found[3:])
            angle = math.acos(max(-1.0, min(1.0, (np.trace(turn) - 1.0) / 2.0)))
            if np.abs(turn - rotation_matrix(pose[3:])).max() > 1e-6:
                others += 1
                assert angle > 2.0 > MAX_ANGLE
    assert others > 3 * count


def test_half_a_turn_gives_the_same_spots_and_is_not_taken() -> None:
    # The beams start from one point in one plane: half a turn about its normal puts every one back on its line.
    sensor, pose = beams(), np.array([1e-3, 2e-3, -1e-3, 0.02, -0.03, 0.05])
    turn = rotation_matrix(pose[3:])
    meeting = np.array([0.0, 0.0, sensor.leds[0, 2]])
    half = turn @ np.diag([-1.0, -1.0, 1.0])
    values, vectors = np.linalg.eig(half)  # near half a turn the axis is the eigenvector of 1
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
    sine = np.array([half[2, 1] - half[1, 2], half[0, 2] - half[2, 0], half[1, 0] - half[0, 1]]) @ axis
    vector = axis * math.atan2(sine, float(np.trace(half)) - 1.0)
    np.testing.assert_allclose(rotation_matrix(vector), half, atol=1e-12)
    other = np.concatenate([pose[:3] + turn @ meeting - half @ meeting, vector])
    np.testing.assert_allclose(sensor.spots(other), sensor.spots(pose), atol=1e-13)
    tracker = PoseTracker(sensor)
    np.testing.assert_allclose(tracker(sensor.spots(other).tolist()), pose, atol=1e-12)


def test_no_pose_is_an_error_and_the_next_one_is_found_as_by_a_new_tracker() -> None:
    sensor, wanted = beams(), poses(5)
    spots = sensor.spots(wanted).tolist()
    tracker, bad = PoseTracker(sensor), [[1.0, -1.0] * 3]
    bad += [
        [value if axis == bent else 0.0 for axis in range(6)] for bent in range(6) for value in (math.nan, math.inf)
    ]
    bad += [[math.nan] * 6, [-math.inf] * 6, [1e300] * 6, sensor.spots(np.array([31e-3, 0, 0, 0, 0, 0])).tolist()]
    bad += [sensor.spots(np.array([0, 0, 0, 0, 0, 0.81])).tolist()]
    for missing in bad:
        tracker(spots[0])
        with pytest.raises(SensingError, match="no pose found for the spots"):
            tracker(missing)
        assert tracker(spots[1]) == PoseTracker(sensor)(spots[1])
    tracker.reset()
    assert tracker(spots[2]) == PoseTracker(sensor)(spots[2])


def test_it_needs_no_beams_from_one_point_in_one_plane() -> None:
    random, good = np.random.default_rng(4), beams()
    directions = good.directions + random.normal(size=(3, 3)) * 0.3
    bent = Beams(
        good.leds + random.normal(size=(3, 3)) * 5e-3,
        directions / np.linalg.norm(directions, axis=1, keepdims=True),
        good.diodes + random.normal(size=(3, 3)) * 5e-3,
        np.einsum("kab,kcb->kca", rotation_matrix(random.normal(size=(3, 3)) * 0.3), good.across),
    )
    wanted = poses(500, 9e-3, 12.0)
    np.testing.assert_allclose(tracked(PoseTracker(bent), bent.spots(wanted)), wanted, atol=1e-12)
    np.testing.assert_allclose(
        [FastBeams(bent).spots(pose.tolist()) for pose in wanted], bent.spots(wanted), atol=1e-15
    )


def test_fast_spots_are_the_spots() -> None:
    fast = FastBeams(beams())
    wanted = np.concatenate([np.zeros((1, 6)), path(200, 1e-6) * 1e-3, poses(1000, 9e-3, 45.0)])
    np.testing.assert_allclose(
        [fast.spots(pose.tolist()) for pose in wanted], beams().spots(wanted), rtol=0, atol=2e-16
    )
    turned = np.array([1e-3, 0.0, 0.0, 0.0, 0.3, math.pi - 1e-9])
    np.testing.assert_allclose(fast.spots(turned.tolist()), beams().spots(turned), rtol=0, atol=2e-16)


@pytest.mark.parametrize("measure", [FastBeams(beams()).spots, SpotReader(beams(), QUANTUM), SpotSensor().start()])
def test_a_pose_that_is_none_has_no_spots(measure: Any) -> None:
    for value, axis in itertools.product((math.nan, math.inf, -math.inf, 1e300), range(6)):
        with pytest.raises(SensingError, match="no spots for the pose"):
            measure([value if axis == bent else 0.0 for bent in range(6)])


@pytest.mark.parametrize("noise", [0.0, 3e-7])
def test_a_sensor_is_a_reader_and_a_tracker_bit_for_bit(noise: float) -> None:
    measure = SpotSensor(beams=beams(), quantum=QUANTUM, noise=noise, seed=5).start()
    reader, tracker = SpotReader(beams(), QUANTUM, noise, 5), PoseTracker(beams())
    for pose in np.concatenate([path(300, 1e-5), poses(300)]).tolist():
        assert measure(pose) == tracker(reader(pose))


def test_noise_is_seeded_white_and_ahead_of_the_steps() -> None:
    noise, pose = 1e-6, [1e-3, 0.0, -1e-3, 0.01, 0.0, 0.02]
    one, same, other = (SpotReader(beams(), 0.0, noise, seed) for seed in (3, 3, 4))
    quiet, drawn = np.array(FastBeams(beams()).spots(pose)), np.array([one(pose) for _ in range(2000)])
    random = np.random.default_rng(3)
    # six draws a call, no more: a remote device that reads alike draws alike
    np.testing.assert_array_equal(drawn, [quiet + noise * random.standard_normal(6) for _ in range(2000)])
    assert same(pose) == drawn[0].tolist() != other(pose)
    both = SpotReader(beams(), QUANTUM, noise, 3)
    np.testing.assert_array_equal([both(pose) for _ in range(50)], stepped(drawn[:50]))


def test_numbers_outside_their_bounds_are_refused() -> None:
    wrong: list[tuple[str, float]] = [("noise", -1.0), ("noise", math.nan), ("seed", -1), ("quantum", -1.0)]
    for name, value in wrong:
        for make in (SpotReader, lambda beams, **options: SpotSensor(beams=beams, **options)):
            with pytest.raises(ParameterError, match=f"{name} must be"):
                make(beams(), **{name: value})  # type: ignore[arg-type]
    for name, value in (("farthest", -1.0), ("farthest", math.nan), ("most_turned", 4.0)):
        with pytest.raises(ParameterError, match=f"{name} must be"):
            PoseTracker(beams(), **{name: value})

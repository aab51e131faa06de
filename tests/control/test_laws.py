"""Wall, braking pulse and hold against equations by hand."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES, Command, Controller, Hold, Sample, Wall
from maglev_mj.errors import ParameterError
from maglev_mj.theory import spectral_radius
from tests.sweeps import sweep

T = 0.005
K, B, PULSE, WIDTH = 6000.0, 80.0, 220.0, 0.003


def answer(controller: Controller, axis: str, positions: list[float]) -> list[Command]:
    """Return the commands for positions along one axis."""
    index = AXES.index(axis)
    controller.reset()
    commands = []
    for tick, position in enumerate(positions):
        pose = [0.0] * 6
        pose[index] = position
        commands.append(controller.step(Sample(tick, tick * T, pose)))
    return commands


def wall(**changes: Any) -> Wall:
    options: dict[str, Any] = {"axes": "z", "lower": 0.0, "stiffness": K, "damping": B} | changes
    return Wall(**options)


def test_pd_wall_is_equation_3() -> None:
    positions = [1e-3, -0.2e-3, -0.9e-3, -1.1e-3, -0.4e-3, 0.1e-3]
    commands = answer(Controller([wall()], period=T), "z", positions)
    for k, command in enumerate(commands):
        x, before = positions[k], positions[max(k - 1, 0)]
        expected = -K * x - B / T * (x - before) if x <= 0.0 else 0.0
        assert command.force[2] == pytest.approx(expected, rel=1e-14, abs=0.0)
        assert command.extra is None
        assert [command.force[i] for i in (0, 1, 3, 4, 5)] == [0.0] * 5


def test_the_edge_itself_is_inside() -> None:
    # The paper's rule is x[k-2] > 0 >= x[k-1]: a quantized sensor reads exactly 0 often.
    commands = answer(Controller([wall(pulse=PULSE, pulse_width=WIDTH)], period=T), "z", [1e-3, 0.0, 0.0, 1e-3])
    assert commands[1].extra is not None
    assert commands[1].force[2] == pytest.approx(B / T * 1e-3)
    assert commands[2].extra is None
    assert commands[3].force[2] == 0.0


def test_braking_pulse_is_equation_9() -> None:
    positions = [1.0e-3, 0.4e-3, -0.8e-3, -1.0e-3, 0.3e-3, -0.1e-3]
    commands = answer(Controller([wall(pulse=PULSE, pulse_width=WIDTH)], period=T), "z", positions)
    pulsed = [k for k, command in enumerate(commands) if command.extra is not None]
    assert pulsed == [2, 5]
    for k in pulsed:
        moved = positions[k] - positions[k - 1]
        command = commands[k]
        assert command.pulse_width == WIDTH
        assert command.extra is not None
        assert command.force[2] == pytest.approx(-K * positions[k] - B / T * moved, rel=1e-14)
        assert command.force[2] + command.extra[2] == pytest.approx(-(PULSE + B) / T * moved, rel=1e-14)


def test_upper_wall_mirrors_the_lower_one_bit_for_bit() -> None:
    path = [1.0e-3, 0.4e-3, -0.8e-3, -1.0e-3, 0.3e-3, -0.1e-3]
    low = answer(Controller([wall(pulse=PULSE, pulse_width=WIDTH)], period=T), "z", path)
    mirrored = wall(lower=-math.inf, upper=0.0, pulse=PULSE, pulse_width=WIDTH)
    high = answer(Controller([mirrored], period=T), "z", [-x for x in path])
    for one, other in zip(low, high, strict=True):
        assert one.force[2] == -other.force[2]
        assert (one.extra is None) == (other.extra is None)
        if one.extra is not None and other.extra is not None:
            assert one.extra[2] == -other.extra[2]


def test_every_axis_has_its_own_gains_side_and_position() -> None:
    stiffness = np.array([1e3, 2e3, 3e3, 4.0, 5.0, 6.0])
    lower = np.array([0.0, -math.inf, 1e-3, 0.0, -math.inf, -2e-3])
    upper = np.array([math.inf, 2e-3, math.inf, math.inf, 0.0, 3e-3])
    controller = Controller([Wall(lower=lower, upper=upper, stiffness=stiffness, damping=0.0)], period=T)
    pose = np.array([-1e-3, 5e-3, 0.5e-3, 1e-3, 1e-3, 4e-3])
    expected = stiffness * [1e-3, -3e-3, 0.5e-3, 0.0, -1e-3, -1e-3]
    np.testing.assert_allclose(controller.step(Sample(0, 0.0, pose.tolist())).wrench, expected, rtol=1e-13)


def test_hold_and_walls_add_up() -> None:
    hold = Hold(axes=("y", "rz"), stiffness=[100.0, 2.0], damping=[1.0, 0.5], target=[1e-3, 0.1])
    controller = Controller([hold, wall(axes="y", lower=0.0), hold], period=T)
    controller.step(Sample(0, 0.0, [0.0] * 6))
    command = controller.step(Sample(1, T, [0.0, -1e-3, 0.0, 0.0, 0.0, 0.2]))
    speed, spin = -1e-3 / T, 0.2 / T
    assert command.force[1] == pytest.approx(2 * (100.0 * 2e-3 - speed) + K * 1e-3 - B * speed)
    assert command.force[5] == pytest.approx(2 * (2.0 * -0.1 - 0.5 * spin))


def test_saturated_pulse_is_carried_over_without_losing_impulse() -> None:
    # What a 30 N limit cuts off one pulse follows in later ones, for as long as the flotor moves inward.
    limit = 30.0
    law = wall(stiffness=0.0, damping=0.0, pulse=PULSE, pulse_width=WIDTH, force_limit=limit)
    positions = [1e-3, -0.5e-3, -1.8e-3, -2.6e-3, -3.0e-3, -3.2e-3]
    commands = answer(Controller([law], period=T), "z", positions)
    wanted = PULSE * 1.5e-3 / T
    given = [0.0 if command.extra is None else command.extra[2] for command in commands]
    assert given[1:4] == pytest.approx([30.0, 30.0, wanted - 60.0])
    assert sum(given) == pytest.approx(wanted, rel=1e-12)
    assert commands[4].extra is None


def test_carried_braking_stops_when_the_flotor_turns_back() -> None:
    law = wall(stiffness=0.0, damping=0.0, pulse=PULSE, pulse_width=WIDTH, force_limit=30.0)
    commands = answer(Controller([law], period=T), "z", [1e-3, -0.5e-3, -0.4e-3, -0.6e-3])
    given = [0.0 if command.extra is None else command.extra[2] for command in commands]
    assert given == [0.0, 30.0, 0.0, 0.0]


@pytest.mark.parametrize(("period", "share"), sweep([0.0002, 0.005, 0.02], [0.0, 0.3, 1.0, 2.0, 5.0], every=3))
def test_critically_damped_hold_is_stable_at_every_delay(period: float, share: float) -> None:
    hold = Hold.critically_damped("z", inertia=0.7, period=period, delay=share * period)
    stiffness, damping = float(np.max(hold.stiffness)), float(np.max(hold.damping))
    assert spectral_radius(stiffness, damping, period=period, delay=share * period, mass=0.7) < 0.999
    frequency = min(50.0, 0.25 / (period * (1.0 + share)))
    assert stiffness == pytest.approx(0.7 * frequency**2)
    assert damping == pytest.approx(2.0 * 0.7 * frequency)


def test_a_critically_damped_hold_is_of_the_published_device_by_default() -> None:
    axes, timing = ("rz", "x"), {"period": 0.005, "delay": 0.0015}
    default, given = (
        Hold.critically_damped(axes, **timing),
        Hold.critically_damped(axes, inertia=[8.2e-4, 0.7], **timing),
    )
    assert np.array_equal(default.stiffness, given.stiffness) and np.array_equal(default.damping, given.damping)


def test_walls_and_laws_that_do_not_fit_are_refused() -> None:
    different = [wall(pulse=1.0, pulse_width=0.001), wall(axes="x", pulse=1.0, pulse_width=0.002)]
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: wall(lower=1e-3, upper=-1e-3), "lower must be below upper"),
        (lambda: wall(lower=-math.inf), "needs a finite lower or upper"),
        (lambda: wall(pulse=10.0), "pulse_width must be above 0"),
        (lambda: wall(stiffness=[1.0, 2.0]), "last dimension of 1"),
        (
            lambda: Hold(stiffness=np.ones((2, 6)), damping=np.ones((3, 6))),
            "Hold parameters must share a batch shape",
        ),
        (lambda: Controller(different, period=T), r"share one pulse_width [(]got \[0.001, 0.002\]"),
    ]
    for make, words in refused:
        with pytest.raises(ParameterError, match=words):
            make()


def test_samples_must_fit_the_laws() -> None:
    law = Wall(lower=np.zeros((3, 6)), stiffness=K, damping=B)
    with pytest.raises(ParameterError, match=r"batch shape \(3,\) of the laws [(]got \(\)"):
        Controller([law], period=T).step(Sample(0, 0.0, [0.0] * 6))
    with pytest.raises(ParameterError, match=r"6 position components [(]got 3"):
        Controller([wall()], period=T).step(Sample(0, 0.0, [0.0] * 3))


def test_pulses_on_one_sample_add_up() -> None:
    # Two walls on one axis and one on another are entered at once.
    laws = [
        wall(pulse=pulse, pulse_width=WIDTH, axes=axes) for pulse, axes in ((PULSE, "z"), (100.0, "z"), (50.0, "x"))
    ]
    controller = Controller(laws, period=T)
    controller.step(Sample(0, 0.0, [1e-3, 0.0, 1e-3, 0.0, 0.0, 0.0]))
    command = controller.step(Sample(1, T, [-1e-3, 0.0, -2e-3, 0.0, 0.0, 0.0]))
    assert command.extra == pytest.approx(
        [50.0 * 0.4 - K * 1e-3, 0.0, (PULSE + 100.0) * 0.6 - 2.0 * K * 2e-3, 0.0, 0.0, 0.0]
    )

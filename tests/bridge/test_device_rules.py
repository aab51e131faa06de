"""Rules of a device that protect the flotor from its host, the line and its own clock, in Python and in C.

Those that a host can test are checks of `conform`, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest

from maglev_mj.bridge import Twin, TwinParameters, wire
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.twin import twin as twins
from maglev_mj.bridge.twin.firmware import Reading
from maglev_mj.bridge.wire import Codec, Fault, Operation, State, WallMessage
from tests.bridge.firmware_core import FIRMWARE, FIRMWARES

PERIOD, WALL_PERIOD = 5_000_000, 1_000_000
STEP = 0.1 * 5e-3  # of an edge in a period [m]
CALIBRATION = Calibration.nominal()
HOVER = tuple(CALIBRATION.hover.tolist())
ZERO = (0.0,) * 6
STOP = tuple(CALIBRATION.controlled_stop(0.0065, 3.0))

firmwares = pytest.mark.parametrize("firmware", FIRMWARES)


class Host:
    """Host of a twin that is ACTIVE, in the air."""

    def __init__(self, firmware: str, monkeypatch: pytest.MonkeyPatch, pose: Sequence[float] = ZERO) -> None:
        monkeypatch.setattr(twins, "Firmware", FIRMWARE[firmware])
        quiet: dict[str, Any] = {"noise": 0.0, "quantum": 0.0, "plant": "exact"}
        self.twin, self.codec, self.sequence = Twin(TwinParameters(pose=pose, **quiet), draw=lambda: 7), Codec(), 0
        self.added: list[Sequence[float]] = []
        add = self.twin.board.add
        self.twin.board.add = lambda now, currents: (self.added.append(tuple(currents)), add(now, currents))[1]  # type: ignore
        self._send(0, 0, wire.Hello(1, CALIBRATION.digest))
        self.twin.sample()
        self._send(7, 0, wire.ControlRequest(1, Operation.ARM, 0, HOVER, STOP))
        self.twin.sample()

    @property
    def now(self) -> int:
        return self.twin.tick * PERIOD + 1_000

    @property
    def state(self) -> tuple[State, Fault]:
        return self.twin.firmware.state, self.twin.firmware.faults

    def _send(self, session: int, sequence: int, body: Any) -> None:
        now = max(self.twin.tick, 0) * PERIOD + 1_000
        assert (self.twin.receive(self.codec.encode(session, sequence, now, body), now, "host") is None) == bool(
            sequence
        )

    def spots(self) -> list[float]:
        return list(self.twin._read(self.twin.pose.tolist()))

    def command(self, *walls: WallMessage, back: int = 0, held: tuple[float, ...] = HOVER) -> None:
        """Answer the sample `back` samples before the last one."""
        self.sequence += 1
        self._send(7, self.sequence, wire.CommandFrame(self.twin.tick - back, 0, held, held, 0.0, walls))

    def trip(self, fault: Fault) -> None:
        self._send(7, 0, wire.ControlRequest(2, Operation.TRIP, int(fault), ZERO))


def wall(edge: float = -2e-3, side: int = 1, stiffness: float = 1e4, damping: float = 0.0) -> WallMessage:
    return WallMessage(2, side, edge, stiffness, damping, 0.0)


REFUSED = State.FAULT, Fault.INVALID_COMMAND
ACTIVE = State.ACTIVE, Fault(0)


@firmwares
@pytest.mark.parametrize("back", range(4))
def test_an_edge_does_not_jump_whichever_sample_is_answered(
    back: int, firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Host(firmware, monkeypatch)
    for _ in range(5):
        host.command(wall())
        host.twin.sample()
    # 4 mm below, then 2 mm above the flotor
    host.command(wall(2e-3), back=back)
    assert host.state == REFUSED
    for _ in range(12):
        host.twin.sample()
        assert abs(host.twin.plant.state()[1][2]) < 0.1  # it fell before the first command; thrown, it has 0.8 m/s


@firmwares
@pytest.mark.parametrize("back", range(1, 4))
def test_older_answers_between_newest_ones_gain_an_edge_no_time(
    back: int, firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    host, edge = Host(firmware, monkeypatch), -2e-3
    for _ in range(4):
        host.command(wall(edge))
        host.twin.sample()
    for _ in range(20):
        host.command(wall(edge), back=back)
        edge -= STEP
        host.command(wall(edge))
        host.command(wall(edge), back=back)
        host.twin.sample()
        assert host.state == ACTIVE
    host.command(wall(edge), back=back)
    host.command(wall(edge - 1.01 * STEP))
    assert host.state == REFUSED


@firmwares
@pytest.mark.parametrize(
    ("sides", "stiffness", "damping", "state"),
    [
        ((1,), 1e5, 400.0, ACTIVE),
        ((1,) * 6, 1e5, 0.0, REFUSED),
        ((1,) * 6, 1.6e4, 60.0, ACTIVE),
        ((1,) * 6, 1.6e4, 70.0, REFUSED),
        ((1,) * 6, 1.7e4, 60.0, REFUSED),
        ((1, -1), 1e5, 400.0, ACTIVE),
        ((1, 0), 6e4, 0.0, REFUSED),
        ((-1, 0), 0.0, 201.0, REFUSED),
        ((1, 0, -1), 5e4, 200.0, ACTIVE),
        ((0, 0), 5.1e4, 0.0, REFUSED),
    ],
)
def test_walls_that_push_the_same_way_share_the_limits(
    sides: Sequence[int],
    stiffness: float,
    damping: float,
    state: Any,
    firmware: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    host = Host(firmware, monkeypatch)
    host.command(*[wall(host.twin.pose[2] - 1e-3 * side, side, stiffness, damping) for side in sides])
    assert host.state == state
    host = Host(firmware, monkeypatch)  # on another axis they are others
    host.command(*[WallMessage(k % 3, 1, -4e-3, 1e5, 400.0, 0.0) for k in range(3)])
    assert host.state == ACTIVE


@firmwares
def test_wall_samples_at_one_time_keep_the_currents(firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host(firmware, monkeypatch)
    for _ in range(3):
        host.command(wall(0.0, stiffness=5e3, damping=20.0))
        host.twin.sample()
    device, now = host.twin.firmware, host.twin.tick * PERIOD
    spots = [spot + 1e-6 for spot in host.spots()]

    def rendered(time: int, shift: float) -> Sequence[float]:
        device.wall(time, Reading([spot + shift for spot in spots], 7, ZERO, ZERO))
        return host.added[-1]

    first = rendered(now + WALL_PERIOD, 0.0)
    assert any(first)
    assert rendered(now + WALL_PERIOD, 1e-5) == first and rendered(now + WALL_PERIOD, 2e-5) == first
    later = rendered(now + 2 * WALL_PERIOD, 3e-5)
    assert later != first and all(map(math.isfinite, later))
    # set back by 10 ms, the clock keeps the currents for one sample, not for ten
    back = now + 2 * WALL_PERIOD - 10_000_000
    assert rendered(back, 4e-5) == later
    assert rendered(back + WALL_PERIOD, 5e-5) != later and host.state == ACTIVE


@firmwares
@pytest.mark.parametrize("jump", [0, 3, 40, -100])
def test_a_controlled_stop_lasts_its_samples_whatever_the_clock_says(
    jump: int, firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Host(firmware, monkeypatch)
    for _ in range(20):
        host.command()
        host.twin.sample()
    host.twin.ahead = jump * 1_000_000
    host.command()
    host.twin.sample()
    host.trip(Fault.CLOCK)
    assert host.twin.firmware.stopping and host.state == (State.FAULT, Fault.CLOCK)
    samples, speeds = 0, [0.0]
    while host.twin.firmware.stopping:
        samples += 1
        host.twin.ahead = -host.twin.ahead  # again and again
        host.twin.sample()
        speeds.append(abs(host.twin.plant.state()[1][2]))
    assert samples * PERIOD == round(STOP[6] * 1e9) and max(speeds) < 0.08


@firmwares
def test_edges_recede_in_a_stop_by_samples(firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host(firmware, monkeypatch)
    for _ in range(5):
        host.command(wall(0.0, stiffness=5e3))
        host.twin.sample()
    host.trip(Fault.CLOCK)
    device, spots, time = host.twin.firmware, host.spots(), host.now
    host.added.clear()
    for step in (1, 1, 1, 40, 1, 70, 1):  # of the walls' samples, by a clock that jumps
        time += step * WALL_PERIOD
        device.wall(time, Reading(spots, 7, ZERO, ZERO))
    forces = [6.0 * currents[0] for currents in host.added]  # each of three coils gives 2 N/A
    receded = [before - after for before, after in pairwise(forces)]
    assert forces[-1] > 0.0 and receded == pytest.approx([5e3 * 0.03 * 1e-3] * 6, rel=1e-6)

"""Latency histograms, and restored real-time settings."""

import ctypes
import gc
import math
import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.connection import AnswerTiming
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.preflight import LoopTiming
from maglev_mj.bridge.realtime import LatencyHistogram, RealtimeError, realtime
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.recording import Recording, open_recording
from maglev_mj.scenes.interactive import TableTop
from tests.bridge.impaired import ImpairedLine, Impairment

SCHEDULED = hasattr(os, "sched_getscheduler")


State = tuple[object, ...]


def state() -> State:
    """Return the settings changed by a real-time loop."""
    if not SCHEDULED:
        return (gc.isenabled(), gc.get_freeze_count())
    parameters = os.sched_getparam(0).sched_priority
    return (gc.isenabled(), gc.get_freeze_count(), os.sched_getscheduler(0), parameters, os.sched_getaffinity(0))


@pytest.fixture
def unchanged(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(gc, "collect", partial(gc.collect, 0))  # slow in a worker with many objects
    gc.unfreeze()  # undo the worker's freeze, so that the loop unfreezes its own
    before = state()
    yield
    assert state() == before
    gc.freeze()


def some_processor() -> int | None:
    return min(os.sched_getaffinity(0)) if SCHEDULED else None


@pytest.mark.parametrize("collecting", [True, False])
@pytest.mark.usefixtures("unchanged")
def test_ignore_continues_and_settings_are_restored_after_an_error(collecting: bool) -> None:
    before = state()
    if not collecting:
        gc.disable()
    with pytest.raises(ZeroDivisionError), realtime("ignore", priority=1, cpu=some_processor()) as complaints:
        assert not gc.isenabled() and gc.get_freeze_count() > 0
        assert all("\n" not in complaint for complaint in complaints)
        if SCHEDULED:
            refused = any("SCHED_FIFO 1" in complaint for complaint in complaints)
            assert refused == (os.sched_getscheduler(0) != os.SCHED_FIFO)
        raise ZeroDivisionError
    assert gc.isenabled() == collecting
    gc.enable()
    assert state() == before


@pytest.mark.machine
@pytest.mark.usefixtures("unchanged")
def test_enforce_raises_exactly_where_ignore_reports_a_refusal() -> None:
    cpu = some_processor()
    with realtime("ignore", cpu=cpu) as complaints:
        pass
    if not complaints:
        with realtime("enforce", 70, cpu) as none:
            _, _, *set_to = state()
            assert none == [] and set_to == [os.SCHED_FIFO, 70, {cpu}]
        return
    with pytest.raises(RealtimeError) as error, realtime("enforce", cpu=cpu):
        raise AssertionError("entered")
    assert all(complaint in str(error.value) for complaint in complaints)


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


@pytest.mark.needs("linux")
@pytest.mark.usefixtures("unchanged")
def test_enforce_names_all_that_is_not_permitted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    wanted = r"SCHED_FIFO 80: Operation not permitted; .*processor 0: Operation not permitted"
    with pytest.raises(RealtimeError, match=wanted) as error, realtime("enforce", cpu=0):
        raise AssertionError("entered")
    assert isinstance(error.value, MaglevError) and "\n" not in str(error.value)
    with realtime("ignore", cpu=0) as complaints:
        assert {"SCHED_FIFO 80", "processor 0"} <= {complaint.split(":")[0] for complaint in complaints}
    assert gc.isenabled()


@pytest.mark.usefixtures("unchanged")
def test_a_system_without_real_time_settings_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.delattr(os, name, raising=False)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    with realtime("ignore", cpu=0) as complaints:
        assert len(complaints) == 4 and not gc.isenabled()
    with pytest.raises(RealtimeError, match="timer slack of 1 ns: Function not implemented; SCHED_FIFO"):
        realtime("enforce").__enter__()


def test_invalid_arguments_are_refused() -> None:
    for priority in (0, 100):
        with pytest.raises(ParameterError, match="priority"), realtime("ignore", priority):
            pass
    with pytest.raises(ParameterError, match="size"):
        LatencyHistogram(0)
    with pytest.raises(ParameterError, match=r"realtime must be one of enforce, ignore \(got 'maybe'\)"):
        realtime("maybe").__enter__()  # type: ignore[arg-type]


def test_the_histogram_stores_recent_latencies_and_the_maximum() -> None:
    latency = LatencyHistogram(100)
    assert math.isnan(latency.p50) and math.isnan(latency.p99) and math.isnan(latency.max)
    latency.add(7_000_000)
    for late in range(1000, 1000 * 251, 1000):
        latency.add(late)
    kept = np.arange(151, 251) * 1e-6
    assert latency.count == 251 and latency.worst == 7_000_000
    assert latency.p50 == pytest.approx(np.percentile(kept, 50.0))
    assert latency.p99 == pytest.approx(np.percentile(kept, 99.0))
    assert latency.max == pytest.approx(7e-3)


class Sampled:
    """Plant at one sample with given times.

    Number, time by the device's clock, arrival, and latency of its answer [ns]; the delay is of the answer before.
    """

    delay = 0.0015

    lockstep = False

    def __init__(self, tick: int, taken: int, came: int, answer: int, delay: float = math.nan) -> None:
        self.samples = SimpleNamespace(tick=tick, time=taken)
        self.answers = AnswerTiming(tick - 1, math.nan, delay, math.nan, came - taken)
        self.answer_latency = answer * 1e-9


def timed(late: Sequence[int], *, still: int = -1) -> tuple[LoopTiming, list[float]]:
    """Return the timing and the ages [ms] of samples that come late [ns].

    The device's clock stands still once for 9 ms.
    """
    timing, zero, found = LoopTiming(), 5_000_000_000, []
    for tick, more in enumerate(late):
        taken = tick * 5_000_000
        came = zero + taken + 40_000 + more + 9_000_000 * (0 <= still <= tick)
        before = late[tick - 1] + 100_000 if tick else 0
        timing.add(Sampled(tick, taken, came, 100_000, 0.0015 + before * 1e-9))  # type: ignore[arg-type]
        found.append(round(1e3 * timing.newest_age, 3))
    return timing, found


def test_the_age_of_a_sample_counts_transport_queueing_and_the_answer() -> None:
    timing, _ = timed((0, 0, 300_000, 0, 2_000_000))
    assert timing.age.worst == 2_100_000 and timing.answer.worst == 100_000
    assert timing.age.p50 == pytest.approx(1e-4)
    assert timing.delay.count == 5 and timing.delay.max == pytest.approx(1.9e-3)


def test_a_stalled_device_clock_is_not_a_slow_link() -> None:
    assert timed([0] * 12, still=5)[1] == [0.1] * 5 + [9.1] + [0.1] * 6
    assert timed([0] * 5 + [9_000_000] * 7)[1] == [0.1] * 5 + [9.1] * 7  # this one is


def test_clock_drift_does_not_count_as_age() -> None:
    timing = LoopTiming()
    for tick in range(20_000):  # 100 s: 10 ms apart at the end
        taken = tick * 5_000_000
        timing.add(Sampled(tick, taken, round(taken * (1.0 + 1e-4)), 100_000))  # type: ignore[arg-type]
    assert 1e-4 <= timing.age.max < 6e-4
    assert not timing.delay.count and "loop delay, sample to effect" not in timing.kinds


def test_the_delay_of_late_answers_is_measured_too(tmp_path: Path) -> None:
    # With 4 ms each way at 200 Hz no answer arrives before the next sample.
    twin = Twin(TwinParameters(), draw=lambda: 7)
    file = open_recording(tmp_path / "run.maglev")
    with RemotePlant(VirtualLink(twin, ImpairedLine(Impairment(delay=0.004, jitter=0.0005)))) as plant:
        scene = TableTop(period=plant.period, delay=plant.delay, friction=False)
        flown = Flight(plant, scene, file=file)
        report = flown.run(0.5)
        assert math.isnan(plant.last_delay)
    file.close()
    timing = flown.timing
    assert report.landing.at_rest and "at rest" in str(report)
    assert timing.delay.count > 90 and timing.delay.p50 == pytest.approx(0.008 + plant.delay, abs=3e-4)
    assert timing.age.max < 1.1e-3 < timing.delay.p50
    told = [event for event in Recording.load(tmp_path / "run.maglev").events if event.startswith("timing: ")]
    assert any("loop delay, sample to effect: median 9." in event for event in told)
    assert any("samples lost" in event for event in told)


def test_each_answer_is_measured_once_and_samples_are_missed_from_takeoff_on() -> None:
    twin = Twin(TwinParameters(limits=Limits(watchdog=1.0)), draw=lambda: 7)
    with RemotePlant(VirtualLink(twin, ImpairedLine(Impairment(loss=0.15, seed=3)))) as plant:
        for _ in range(40):
            plant.read()
        before = plant.samples.lost
        flown = Flight(plant, TableTop(period=plant.period, delay=plant.delay, friction=False))
        report = flown.run(1.0)
        assert 0 < before < plant.samples.lost and 0 < report.lost <= plant.samples.lost - before
        # after a lost answer the previous one stays in force: already measured
        assert 0.6 < flown.timing.delay.count / flown.timing.answer.count < 0.95

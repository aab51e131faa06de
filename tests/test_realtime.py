"""LatencyHistogram is shown as it is, and what was asked of the system is given back."""

import ctypes
import gc
import math
import os
import random
from collections.abc import Iterator

import numpy as np
import pytest

from maglev_mj.bridge.realtime import LatencyHistogram, RealtimeError, realtime
from maglev_mj.errors import MaglevError, ParameterError

SCHEDULED = hasattr(os, "sched_getscheduler")


State = tuple[object, ...]


def state() -> State:
    """Return what a real-time loop changes."""
    if not SCHEDULED:
        return (gc.isenabled(), gc.get_freeze_count())
    parameters = os.sched_getparam(0).sched_priority
    return (gc.isenabled(), gc.get_freeze_count(), os.sched_getscheduler(0), parameters, os.sched_getaffinity(0))


@pytest.fixture
def unchanged() -> Iterator[None]:
    before = state()
    yield
    assert state() == before


def some_processor() -> int | None:
    return min(os.sched_getaffinity(0)) if SCHEDULED else None


@pytest.mark.parametrize("collecting", [True, False])
@pytest.mark.usefixtures("unchanged")
def test_ignore_goes_on_and_gives_everything_back(collecting: bool) -> None:
    before = state()
    if not collecting:
        gc.disable()
    with realtime("ignore", priority=1, cpu=some_processor()) as complaints:
        assert not gc.isenabled() and gc.get_freeze_count() > 0
        assert all("\n" not in complaint for complaint in complaints)
        if SCHEDULED:
            refused = any("SCHED_FIFO 1" in complaint for complaint in complaints)
            assert refused == (os.sched_getscheduler(0) != os.SCHED_FIFO)
    assert gc.isenabled() == collecting
    gc.enable()
    assert state() == before


@pytest.mark.usefixtures("unchanged")
def test_everything_is_given_back_when_the_loop_fails() -> None:
    with pytest.raises(ZeroDivisionError), realtime("ignore"):
        raise ZeroDivisionError


@pytest.mark.usefixtures("unchanged")
def test_enforce_raises_just_where_ignore_complains() -> None:
    with realtime("ignore") as complaints:
        pass
    if not complaints:
        with realtime("enforce") as none:
            assert none == [] and os.sched_getscheduler(0) == os.SCHED_FIFO
        return
    with pytest.raises(RealtimeError) as error, realtime("enforce"):
        raise AssertionError("entered")
    assert all(complaint in str(error.value) for complaint in complaints)


def refuse(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


@pytest.mark.skipif(not SCHEDULED, reason="this system has no scheduler to ask")
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
def test_a_system_that_has_none_of_it_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.delattr(os, name, raising=False)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    with realtime("ignore", cpu=0) as complaints:
        assert len(complaints) == 4 and not gc.isenabled()
    with pytest.raises(RealtimeError, match="timer slack of 1 ns: Function not implemented; SCHED_FIFO"):
        realtime("enforce").__enter__()


@pytest.mark.parametrize("cpu", [-1, 4095, 10**30])
@pytest.mark.skipif(not SCHEDULED, reason="this system has no processors to choose")
@pytest.mark.usefixtures("unchanged")
def test_a_processor_that_is_not_there_is_a_complaint(cpu: int) -> None:
    with realtime("ignore", cpu=cpu) as complaints:
        assert any(complaint.startswith(f"processor {cpu}: ") for complaint in complaints)


def test_arguments_that_cannot_be_are_refused() -> None:
    for priority in (0, 100):
        with pytest.raises(ParameterError, match="priority"), realtime("ignore", priority):
            pass
    with pytest.raises(ParameterError, match="realtime must be one of enforce, ignore, not 'maybe'"):
        realtime("maybe").__enter__()  # type: ignore[arg-type]


def test_lateness_keeps_the_last_and_the_worst_of_all() -> None:
    latency = LatencyHistogram(100)
    latency.add(7_000_000)
    for late in range(1000, 1000 * 251, 1000):
        latency.add(late)
    kept = np.arange(151, 251) * 1e-6
    assert latency.count == 251 and latency.worst == 7_000_000
    assert latency.p50 == pytest.approx(np.percentile(kept, 50.0))
    assert latency.p99 == pytest.approx(np.percentile(kept, 99.0))
    assert latency.max == pytest.approx(7e-3)
    assert latency.histogram().startswith("latency of the last 100 of 251: p50 201 µs, p99 249 µs, max 7 ms\n")


def test_no_lateness_is_no_number() -> None:
    latency = LatencyHistogram(3)
    assert math.isnan(latency.p50) and math.isnan(latency.p99) and math.isnan(latency.max)
    assert latency.histogram() == "latency: none yet"
    with pytest.raises(ParameterError, match="size"):
        LatencyHistogram(0)


def test_the_histogram_as_it_is_seen() -> None:
    latency = LatencyHistogram()
    for late, count in ((30_000, 800), (70_000, 400), (150_000, 1), (999, 3), (3_000_000, 2)):
        for _ in range(count):
            latency.add(late)
    assert latency.histogram().splitlines() == [
        "latency of 1206: p50 30 µs, p99 70 µs, max 3 ms",
        "   below 1 µs       ▏                                                    3",
        "   1 µs to 2 µs                                                          0",
        "   2 µs to 5 µs                                                          0",
        "   5 µs to 10 µs                                                         0",
        "  10 µs to 20 µs                                                         0",
        "  20 µs to 50 µs    " + "█" * 44 + "       800",
        "  50 µs to 100 µs   " + "█" * 22 + " " * 22 + "       400",
        " 100 µs to 200 µs   ▏                                                    1",
        " 200 µs to 500 µs                                                        0",
        " 500 µs to 1 ms                                                          0",
        "   1 ms to 2 ms                                                          0",
        "   2 ms to 5 ms     ▏                                                    2",
    ]


def test_the_histogram_fits_a_terminal_and_counts_everything() -> None:
    latency = LatencyHistogram(5000)
    for late in [
        -5,
        0,
        999,
        1000,
        10**10,
        *(int(10 ** random.Random(seed).uniform(2.0, 10.0)) for seed in range(4000)),
    ]:
        latency.add(late)
    lines = latency.histogram().splitlines()
    assert max(map(len, lines)) <= 80
    assert sum(int(line.split()[-1]) for line in lines[1:]) == latency.count
    assert "below 1 µs" in lines[1] and "above 5 s" in lines[-1]

"""Ends of flights by Ctrl-C once and twice, SIGTERM, SIGHUP, a window's key; and the time to zero current."""

import math
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import maglev_mj
from maglev_mj.bridge import DeviceFault, Fault, RemotePlant, State, Twin, TwinParameters, landing
from maglev_mj.bridge.fault import load_fault
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.landing import StopSwitch
from maglev_mj.bridge.links import LinkError, UdpServer
from maglev_mj.bridge.preflight import measure_link
from maglev_mj.bridge.realtime import stopping
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import TwinServer
from maglev_mj.cli import bridge, main
from maglev_mj.errors import PlantError
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Snapshot
from tests.processes import COMMAND, PATIENCE, WEAK, Program, ended, running, said_by
from tests.sweeps import further

ZERO_CURRENT = 1e-9


@pytest.fixture(autouse=True)
def hang_up_is_heard() -> Iterator[None]:
    """Let programs hear SIGHUP, also where `nohup` runs the tests."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


class Moment(NamedTuple):
    """Sample of the twin for these tests.

    Time, state, faults, largest current [A], and height [m].
    """

    time: float
    state: State
    faults: Fault
    current: float
    height: float


class Watched:
    """A twin in this process, and every sample of it."""

    def __init__(self, **options: Any) -> None:
        self.twin = Twin(TwinParameters(limits=Limits(watchdog=1.0), **options))
        self.server = TwinServer(self.twin, UdpServer("127.0.0.1", 0))
        self.moments: list[Moment] = []
        self.active = 0
        self._thread = threading.Thread(target=self.server.run, kwargs={"each": self._look})

    def _look(self) -> None:
        firmware = self.twin.firmware
        current = float(np.abs(self.twin.plant.currents).max())
        self.active += firmware.state == State.ACTIVE
        self.moments.append(Moment(time.monotonic(), firmware.state, firmware.faults, current, self.twin.pose[2]))

    def __enter__(self) -> "Watched":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.server.stop()
        self._thread.join()
        self.server.close()

    @property
    def address(self) -> str:
        return "udp://{}:{}".format(*self.server.address)

    @property
    def last(self) -> Moment:
        return self.moments[-1]

    def flown(self, seconds: float) -> float:
        """Wait until the device has been active long enough by its own time; return the time of now [s]."""
        waited(lambda: self.active >= round(seconds / self.twin.parameters.period))
        return time.monotonic()

    def cut_after(self, when: float) -> float:
        """Return the time until the currents stay zero [s]."""
        flowing = [one.time for one in self.moments if one.time > when and one.current > ZERO_CURRENT]
        return flowing[-1] - when if flowing else 0.0


def waited(so: Callable[[], bool], pause: float = 0.002) -> None:
    """Wait until something is so, with pauses [s] for other threads and programs."""
    end = time.monotonic() + PATIENCE
    while not so():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(pause)


PATIENT = """
import sys
from inspect import unwrap
from maglev_mj.bridge import landing
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.cli import main
landing.LANDING_TIME = 60.0
unwrap(RemotePlant.__init__).__kwdefaults__["patience"] = 30.0
sys.exit(main())
"""
"""The command, patient with a busy machine."""


@contextmanager
def flight(twin: Watched, folder: Path) -> Iterator[Program]:
    with running(*[sys.executable, "-c", PATIENT], "bridge", twin.address, *WEAK, "--out", str(folder)) as child:
        yield child


# the command, in virtual time


class Timeline:
    """A twin in virtual time, with signals raised at given times since it is active.

    The alarm of this process runs on the twin's clock, too.

    Args:
        presses: Times since the device is active [s], and signals.
    """

    def __init__(self, presses: Sequence[tuple[float, signal.Signals]], monkeypatch: pytest.MonkeyPatch) -> None:
        self.twin = Twin(TwinParameters(limits=Limits(watchdog=1.0)), draw=lambda: 7)
        self.link = VirtualLink(self.twin)
        self.moments: list[Moment] = []
        self.sent: list[float] = []
        self._presses, self._alarm, self._active = list(presses), math.inf, math.inf
        monkeypatch.setattr(bridge, "_opened", self._opened)
        monkeypatch.setattr("maglev_mj.bridge.preflight.measure_link", lambda plant: measure_link(plant, 0.2))
        monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.0027)  # takes 0.4 s
        monkeypatch.setattr(signal, "setitimer", self._set_alarm)

    def _opened(self, *parameters: Any) -> RemotePlant:
        plant = RemotePlant(self.link, folder=parameters[-1])
        read = plant.read

        def interrupted() -> Any:
            sample = read()
            self._look()
            return sample

        plant.read = interrupted  # type: ignore[method-assign]
        return plant

    def _look(self) -> None:
        firmware, now = self.twin.firmware, self.link.time * 1e-9
        current = float(np.abs(self.twin.plant.currents).max())
        self.moments.append(Moment(now, firmware.state, firmware.faults, current, self.twin.pose[2]))
        if firmware.state == State.ACTIVE:
            self._active = min(self._active, now)
        if now >= self._alarm:
            self._alarm = math.inf
            signal.raise_signal(signal.SIGALRM)
        while self._presses and now - self._active > self._presses[0][0] - 1e-9:
            self.sent.append(now)
            signal.raise_signal(self._presses.pop(0)[1])

    def _set_alarm(self, _which: int, seconds: float) -> None:
        self._alarm = self.link.time * 1e-9 + seconds if seconds else math.inf

    def fly(self, folder: Path, *options: str) -> tuple[int, str]:
        """Run `bridge`; return its status and output."""
        outcome = said_by("bridge", "udp://127.0.0.1:1", "--out", str(folder), *options)
        self.link.receive(0.5)
        assert not self._presses
        return outcome

    @property
    def ended(self) -> tuple[State, Fault]:
        assert not self.twin.plant.currents.any()
        return self.twin.firmware.state, self.twin.firmware.faults

    @property
    def cut_after(self) -> float:
        """Time from the last signal to the last current of a sample [s]."""
        flowing = [one.time for one in self.moments if one.current > ZERO_CURRENT]
        return max(flowing[-1] - self.sent[-1], 0.0)


Presser = Callable[..., Timeline]


@pytest.fixture
def timeline(monkeypatch: pytest.MonkeyPatch) -> Presser:
    """Return a function that makes a twin in virtual time from presses."""
    return lambda *presses: Timeline(presses, monkeypatch)


@pytest.mark.parametrize(
    ("kind", "at"), [(signal.SIGINT, 0.02), (signal.SIGHUP, 1.1), *further((signal.SIGTERM, 0.3), (signal.SIGINT, 1.6))]
)
def test_the_first_signal_lands_at_any_time_of_takeoff_and_flight(
    kind: signal.Signals, at: float, timeline: Presser, tmp_path: Path
) -> None:
    record, device = tmp_path / "run.maglev", timeline((at, kind))
    status, said = device.fly(tmp_path, "--record", str(record))
    assert status == 0, said
    assert device.ended == (State.INACTIVE, Fault(0))
    assert 0.5 < device.cut_after < 1.5
    # from where it is, not from the centre
    assert max(one.height for one in device.moments) < (-0.002 if at < 0.1 else 1e-4)
    assert abs(device.twin.pose[2] + 0.0045) < 1e-4  # it lies where it lay
    assert record.exists() == (at > 1.05), said


@pytest.mark.parametrize(("at", "gap"), [(0.02, 0.05), (1.1, 0.05), *further((0.3, 0.4), (1.6, 0.05))])
def test_a_second_ctrl_c_cuts_now(at: float, gap: float, timeline: Presser, tmp_path: Path) -> None:
    record, device = tmp_path / "run.maglev", timeline((at, signal.SIGINT), (at + gap, signal.SIGINT))
    status, said = device.fly(tmp_path, "--record", str(record))
    assert status == 1 and "ESTOP" in said, said
    assert device.ended == (State.FAULT, Fault.ESTOP)
    assert device.cut_after < 0.02
    assert record.exists() == (at > 1.05), said
    (box,) = tmp_path.glob("fault-*.maglev")
    assert load_fault(box).faults == "ESTOP"


@pytest.mark.parametrize(("times", "fault"), [(2, Fault.ESTOP), *further((1, Fault(0)))])
def test_of_a_landing_that_has_begun_by_itself_the_second_ctrl_c_is_the_cut(
    times: int, fault: Fault, timeline: Presser, tmp_path: Path
) -> None:
    device = timeline(*((1.4 + 0.05 * press, signal.SIGINT) for press in range(times)))
    status, said = device.fly(tmp_path, "--seconds", "0.2")
    assert (status, device.ended[1]) == (1 if fault else 0, fault), said


def test_a_landing_that_takes_too_long_is_cut_at_the_stated_time(
    timeline: Presser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(landing, "LANDING_TIME", 0.25)
    device = timeline((1.0, signal.SIGTERM))
    status, said = device.fly(tmp_path)
    assert status == 1 and device.ended == (State.FAULT, Fault.ESTOP), said
    assert 0.24 < device.cut_after < 0.27


def test_identification_lands_when_asked_to_and_writes_nothing(timeline: Presser, tmp_path: Path) -> None:
    device = timeline((1.2, signal.SIGINT))
    status, said = device.fly(tmp_path, "--identify", str(tmp_path / "found.json"))
    assert status == 1 and "samples: nothing is written" in said, said
    assert device.ended == (State.INACTIVE, Fault(0))
    assert not list(tmp_path.iterdir())


# the command in a process, with signals of the system


@pytest.mark.machine
@pytest.mark.parametrize(("kind", "at"), [(signal.SIGTERM, 0.3), *further((signal.SIGHUP, 1.6), (signal.SIGINT, 0.02))])
def test_a_signal_lands_a_real_flight(kind: signal.Signals, at: float, tmp_path: Path) -> None:
    with Watched() as twin, flight(twin, tmp_path) as host:
        sent = twin.flown(at)
        host.child.send_signal(kind)
        status, said = ended(host, None)
        waited(lambda: twin.last.current <= ZERO_CURRENT)
        print(f"{kind.name} at {at} s: {twin.cut_after(sent) * 1e3:.0f} ms to zero current")
    assert status == 0, said
    assert (twin.last.state, twin.last.faults) == (State.INACTIVE, Fault(0))
    assert abs(twin.twin.pose[2] + 0.0045) < 1e-4


@pytest.mark.machine
@pytest.mark.parametrize("at", [1.6, *further(0.02)])
def test_a_second_ctrl_c_cuts_a_real_flight(at: float, tmp_path: Path) -> None:
    with Watched() as twin, flight(twin, tmp_path) as host:
        twin.flown(at)
        host.child.send_signal(signal.SIGINT)
        sent = twin.flown(at + 0.05)  # two signals at once would be one
        host.child.send_signal(signal.SIGINT)
        status, said = ended(host, None)
        waited(lambda: twin.last.current <= ZERO_CURRENT)
        print(f"twice, at {at} s: {twin.cut_after(sent) * 1e3:.1f} ms to zero current")
    assert status == 1 and "ESTOP" in said, said
    assert (twin.last.state, twin.last.faults) == (State.FAULT, Fault.ESTOP)


@pytest.mark.machine
def test_a_signal_ends_a_handshake_at_once() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.settimeout(60.0)
        with running(*COMMAND, "bridge", f"udp://127.0.0.1:{deaf.getsockname()[1]}") as host:
            deaf.recv(4096)  # a hello
            host.child.send_signal(signal.SIGHUP)
            assert ended(host, None) == (130, "maglev-mj bridge: stopped\n")


def test_only_ctrl_c_cuts() -> None:
    kinds = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    told: list[str] = []
    for first, then in product(kinds, kinds):
        told.clear()
        handlers = [signal.getsignal(kind) for kind in (first, then)]
        with stopping(lambda: told.append("land"), lambda: told.append("cut")):
            for kind in (first, then, then):
                signal.raise_signal(kind)
        assert told == ["land", *["cut"] * (2 * (then == signal.SIGINT))], (first, then)
        assert [signal.getsignal(kind) for kind in (first, then)] == handlers


def test_hangups_that_nohup_ignores_stay_ignored() -> None:
    asked: list[int] = []
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stopping(lambda: asked.append(1)):
        signal.raise_signal(signal.SIGHUP)
    assert not asked


HEARING = {
    "bridge udp://127.0.0.1:9": "maglev_mj.cli.bridge.open_link",
    "twin": "maglev_mj.bridge.twin.twin.TwinServer.run",
    "twin --haply 0": "maglev_mj.bridge.haply.twin.HaplyServer.run",
    "conform udp://127.0.0.1:9": "maglev_mj.bridge.links.open_link",
    "commission udp://127.0.0.1:9 spots": "maglev_mj.bridge.links.open_link",
}
"""Commands that end in their own way by a signal, each with a function that is called meanwhile."""


@pytest.mark.parametrize(("line", "called"), HEARING.items())
@pytest.mark.parametrize("ignored", [True, False])
def test_every_command_of_a_device_is_stopped_by_a_hangup_unless_nohup_ignores_it(
    line: str, called: str, ignored: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    survived = []

    def hangup(*_: Any, **__: Any) -> Any:
        signal.raise_signal(signal.SIGHUP)
        survived.append(True)
        raise LinkError("the test ends here")

    monkeypatch.setattr(called, hangup)

    def unhandled(*_: Any) -> None:  # the default action would end the tests
        raise AssertionError("this command does not handle SIGHUP")

    before: Any = signal.SIG_IGN if ignored else unhandled
    signal.signal(signal.SIGHUP, before)
    try:
        status = main([*line.split(), *(["--listen", "udp://127.0.0.1:0"] if line == "twin" else [])])
    finally:
        handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert handler == before and status == (1 if ignored or "twin" in line else 130)
    assert bool(survived) == (ignored or "twin" in line)  # a twin ends after what it is doing
    capsys.readouterr()


def test_signals_are_handled_in_one_place() -> None:
    texts = {path.stem: path.read_text(encoding="utf-8") for path in Path(maglev_mj.__file__).parent.rglob("*.py")}
    assert [name for name, text in texts.items() if re.search(r"signal\.SIGTERM|[\"']SIG", text)] == ["realtime"]


def test_time_cuts_once_and_is_over_with_the_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    told, set_to = list[str](), list[float]()
    monkeypatch.setattr(signal, "setitimer", lambda _, seconds: set_to.append(seconds))
    with stopping(lambda: told.append("land"), lambda: told.append("cut"), within=0.05):
        signal.raise_signal(signal.SIGTERM)
        assert set_to == [0.05]
        signal.raise_signal(signal.SIGALRM)
    assert told == ["land", "cut"] and set_to == [0.05, 0.0]


class Keys:
    """Window with a key pressed at one sample."""

    def __init__(self, switch: StopSwitch, plant: RemotePlant, at: int) -> None:
        self._switch, self._plant, self._at = switch, plant, at

    def take(self) -> None:
        if self._plant.samples.tick >= self._at:
            self._switch.cut()

    def show(self, snapshot: Snapshot) -> None: ...

    def close(self) -> None: ...


AT = {"takeoff": 80, "flight": 200, "landing": 480}


@pytest.mark.parametrize("phase", AT)
def test_a_windows_key_cuts_in_every_phase(phase: str, tmp_path: Path) -> None:
    twin = Twin(TwinParameters(), draw=lambda: 7)
    with RemotePlant(VirtualLink(twin), folder=str(tmp_path)) as plant:  # text serves as well as a Path
        switch, before = StopSwitch(), plant.read().tick
        scene = Joystick(period=plant.period, delay=plant.delay)
        keys = Keys(switch, plant, before + AT[phase])
        flown = Flight(plant, scene, switch=switch, publishers=[keys])
        with pytest.raises(DeviceFault, match="ESTOP: requested by this host; the last cycles are in"):
            flown.run(1.5)
        assert (twin.firmware.state, twin.firmware.faults) == (State.FAULT, Fault.ESTOP)
        assert plant.samples.tick - before - AT[phase] <= 3
        assert not twin.plant.currents.any()


def test_a_flight_whose_currents_are_off_is_not_cut_any_more() -> None:
    twin = Twin(TwinParameters(), draw=lambda: 7)
    with RemotePlant(VirtualLink(twin)) as plant:
        switch, disarm = StopSwitch(), plant.disarm

        def disarmed() -> None:
            disarm()
            switch.cut()  # while it looks at how the flotor lies

        plant.disarm = disarmed  # type: ignore[method-assign]
        flown = Flight(plant, Joystick(period=plant.period, delay=plant.delay), switch=switch)
        assert flown.run(0.2).landing.at_rest
    assert not twin.firmware.faults


@pytest.mark.machine
def test_estop_stops_any_flight_and_reset_clears_it(tmp_path: Path) -> None:
    with Watched() as twin, flight(twin, tmp_path) as host:
        twin.flown(1.0)
        status, said = said_by("estop", twin.address)
        assert status == 0 and "stopped: ESTOP, at most 0.25 A in each coil" in said
        status, told = ended(host, None)
        assert status == 1 and "ESTOP: reported by the device" in told
        status, said = said_by("bridge", twin.address, "--seconds", "0.2", "--out", str(tmp_path))
        assert status == 1 and "no takeoff: device state FAULT, faults ESTOP" in said
        status, said = said_by("bridge", twin.address, "--reset")
        assert status == 0 and "ESTOP: emergency stop requested" in said and " s ago" in said
        waited(lambda: twin.last.state == State.INACTIVE)
        since = len(twin.moments)
        waited(lambda: len(twin.moments) > since + 200)
        assert all(one.state == State.INACTIVE and not one.current for one in twin.moments[since:])
        status, said = said_by("bridge", twin.address, "--reset")
        assert status == 0 and "no fault latched; device inactive" in said
    (box,) = tmp_path.glob("fault-*.maglev")
    assert load_fault(box).faults == "ESTOP"


def test_a_stop_before_takeoff_arms_nothing_and_one_that_is_not_confirmed_says_to_cut_the_power() -> None:
    twin = Twin(TwinParameters(), draw=lambda: 7)
    with RemotePlant(VirtualLink(twin)) as plant:
        flown, switch = Flight(plant, Joystick(period=plant.period, delay=plant.delay)), StopSwitch()
        flown.switch.land()
        with pytest.raises(KeyboardInterrupt):
            flown.run(1.0)
        assert twin.firmware.answered is None
        with pytest.raises(KeyboardInterrupt, match="stopped before takeoff; ESTOP is latched"), switch.flying(plant):
            switch.cut()
        assert twin.firmware.faults == Fault.ESTOP
        twin.receive = lambda *_: None  # type: ignore[method-assign]  # deaf from now on
        switch = StopSwitch()
        with pytest.raises(PlantError, match="cut the power"), switch.flying(plant):
            switch.cut()


def test_estop_of_no_device_is_a_failure() -> None:
    for wrong in ("127.0.0.1:5678", "udp://192.0.2.1:5678"):
        status, said = said_by("estop", wrong)
        assert status == 2 and said.count("\n") == 1
    status, said = said_by("estop", "serial:///nowhere?baud=115200")
    assert status == 1 and "not confirmed: cut the power" in said and said.count("\n") == 1

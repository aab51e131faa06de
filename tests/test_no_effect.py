"""A refused call has no effect: over every public callable, and every method of a live device and session."""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

import pytest

from maglev_mj import RemotePlant, Session, Twin, TwinParameters, estop
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.errors import ParameterError
from maglev_mj.keywords import mismatch
from maglev_mj.scenes.interactive import Joystick
from tests.test_arguments import CHECKABLE, Foreign
from tests.test_parameters import calls

WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_APPEND
STARTS = ("socket.connect", "socket.sendto", "socket.bind", "subprocess.Popen", "os.mkdir", "os.remove", "os.rename")
effects: set[str] = set()
"""Effects seen since the last `watched` began."""
watching = False


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if watching and (event in STARTS or (event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITES)):
        effects.add(f"{event} {arguments[0]}")


sys.addaudithook(_audit)


@contextmanager
def watched(code: CodeType | None = None) -> Iterator[None]:
    """Note files written, sockets, processes and frames sent, and a function whose code runs."""
    global watching

    def profile(frame: Any, event: str, _: Any) -> None:
        if event == "call" and frame.f_code is code:
            effects.add("the function itself ran")
        elif event == "call" and frame.f_code.co_name == "send" and "bridge" in frame.f_code.co_filename:
            effects.add("a frame was sent")

    effects.clear()
    watching = True
    sys.setprofile(profile)
    try:
        yield
    finally:
        sys.setprofile(None)
        watching = False


class Like(Foreign):
    """Almost a sequence, as a tensor of another library may be."""

    def __len__(self) -> int:
        return 6

    def __getitem__(self, index: int) -> float:
        return [0.0, 0.0, 0.0, 0.0, 0.0, 0.0][index]


BAD = (Foreign(), [Foreign()], Like(), "no", 5, None, ["x"] * 6, [0.0], bytearray(b"0123456789abcdef"), float("nan"))


def refusal(call: Any, code: CodeType | None = None, /, **arguments: Any) -> str:
    """Return the message of a call that is refused for an argument, with effects noted; "" for any other."""
    with watched(code):
        try:
            call(**arguments)
        except (TypeError, ValueError, AttributeError) as error:  # also where a tick is not checked
            return f"{type(error).__name__}: {error}"
        except Exception:
            pass
    return ""


@pytest.mark.parametrize("name", sorted({row[0] for row in CHECKABLE}))
def test_a_call_that_is_refused_for_a_type_never_runs(name: str) -> None:
    """Constructors may run, but write, send and start nothing."""
    call = dict(calls())[name]
    code, own = (None, ()) if inspect.isclass(call) else (inspect.unwrap(call).__code__, vars(call)["own"])
    for argument in [row[2] for row in CHECKABLE if row[0] == name]:
        for value in BAD:
            is_type = code is not None and mismatch(call, (), {argument: value}, own)
            if said := refusal(call, code if is_type else None, **{argument: value}):
                assert not effects, f"{argument}={value!r}: {said}: {effects}"


class Live(NamedTuple):
    """Objects whose methods act, and the firmware behind them."""

    twin: Twin
    plant: RemotePlant
    session: Session | None

    @property
    def state(self) -> tuple[object, ...]:
        """What a refused call must leave as it is."""
        ticks = self.session.snapshot().tick if self.session is not None else None
        return self.twin.firmware.state, self.twin.tick, self.plant.state, self.plant.last_currents, ticks


def live(of: type) -> Live:
    """Return a device that has sent a sample, and a running session if it is asked for."""
    twin = Twin(TwinParameters())
    plant = RemotePlant(VirtualLink(twin))
    plant.read()
    return Live(twin, plant, Session("drop") if of is Session else None)


METHODS = [
    (kind, name, argument)
    for kind in (RemotePlant, Session)
    for name, call in inspect.getmembers(kind, inspect.isfunction)
    for argument in [*inspect.signature(call).parameters][1:]
    if not name.startswith("_")
]
NEEDED: dict[str, Any] = {"time": 0.0, "faults": 4096, "message": "test", "parameters": {}}
"""Right values of arguments without a default, where another one is wrong."""


@pytest.mark.parametrize(("kind", "method", "argument"), METHODS, ids=lambda item: getattr(item, "__name__", item))
def test_a_refused_method_leaves_its_object_as_it_was(
    kind: type, method: str, argument: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # records of faults
    parameters = [*inspect.signature(getattr(kind, method)).parameters.values()][1:]
    others = {one.name: NEEDED[one.name] for one in parameters if one.default is one.empty and one.name != argument}
    things, count = live(kind), 0
    for value in BAD:
        before = things.state
        if said := refusal(getattr(things.session or things.plant, method), None, **{argument: value}, **others):
            assert not effects and things.state == before, f"{argument}={value!r}: {said}: {effects}"
            count += 1
        else:
            things = live(kind)
    assert count  # else it takes all values


@pytest.mark.parametrize("argument", ["link", "key", "patience"])
def test_a_refused_emergency_stop_is_not_sent(argument: str) -> None:
    things, right = live(RemotePlant), [("key", None), ("patience", 5)]
    before, link = things.state, VirtualLink(things.twin)
    for value in [one for one in BAD if (argument, one) not in right]:
        assert refusal(estop, None, **{"link": link, argument: value})
        assert not effects and things.state == before, f"{argument}={value!r}: {effects}"


def test_a_refused_flight_does_not_take_off() -> None:
    things = live(RemotePlant)
    flight, before = Flight(things.plant, Joystick(period=things.plant.period, delay=things.plant.delay)), things.state
    for value in [one for one in BAD if one not in (None, 5)]:
        assert refusal(flight.run, None, duration=value)
        assert not effects and things.state == before, f"{value!r}: {effects}"


@pytest.mark.parametrize(
    ("method", "values"),
    [
        ("arm", ([0.0] * 5, [0.0] * 7, [math.nan] * 6, [math.inf] + [0.0] * 5, "xxxxxx", [[0.0] * 6])),
        ("drive", ([0.0] * 5, [0.0] * 7, [math.nan] * 6, [1e3] + [0.0] * 5)),
        ("write", (object(), None, [0.0] * 6, 1.0)),
    ],
)
def test_currents_and_commands_of_another_shape_are_not_sent(method: str, values: Sequence[Any]) -> None:
    things = live(RemotePlant)
    for value in values:
        before = things.state
        with watched(None), pytest.raises(ParameterError):
            getattr(things.plant, method)(value)
        assert not effects and things.state == before, f"{method}({value!r}): {effects}"

"""Parameters of a scene as other programs see them, and their requests to change them, one at a time."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, TypeAlias

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, Refusal, refusal, settable

__all__ = ["Answer", "Requests", "State", "Verdict", "check_requests", "checked", "give_way", "values_of"]

_NICE = 5

_NONE = "none"
"""The word for a value that is not given, as on the command line; the protocol has no null."""


class State(NamedTuple):
    """The scene that the control loop renders.

    Attributes:
        scene: The scene with its present parameters; None where none runs.
        delay: From a sample to its command taking effect, as measured [s].
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], (6,); None for the scene's own.
        state: "running", "paused", "stopped: " and why, or "flying".
    """

    scene: Scene | None = None
    delay: float = 0.0
    inertia: Sequence[float] | None = None
    state: str = ""


class Answer(NamedTuple):
    """The answer to a request.

    Attributes:
        since: The first sample answered under the new parameters; None where it is refused.
        reason: Why it is refused; empty where it is not.
        figures: Of the loop that would be unstable, see `Refusal`; None where that is not the reason.
    """

    since: int | None = None
    reason: str = ""
    figures: Mapping[str, Any] | None = None


Verdict: TypeAlias = Scene | Refusal | str
"""The scene that a program may have, or why it may not."""


def values_of(state: State) -> dict[str, Any]:
    """Return the parameters by name, ready for JSON; those that `checked` refuses to change are first."""
    scene = state.scene
    if scene is None:
        return {}
    names = *DEVICES_OWN, *settable(scene)
    values = {name: getattr(scene, name) for name in names}
    told = {name: _NONE if value is None else value for name, value in values.items()}
    found: dict[str, Any] = json.loads(json.dumps({"scene": scene.name, "state": state.state, **told}))
    return found


def checked(state: State, given: Mapping[str, Any]) -> Verdict:
    """Return the present scene with the parameters asked for, or why they are refused."""
    if state.scene is None:
        return state.state or "no scene runs here"
    try:
        wanted = _wanted(state.scene, given)
        return refusal(wanted.replace(delay=state.delay), inertia=state.inertia) or wanted
    except MaglevError as error:
        return str(error)
    except Exception as error:  # a scene or a law of the user's own
        return f"the parameters cannot be checked: {type(error).__name__}: {error}"


def _wanted(present: Scene, given: Mapping[str, Any]) -> Scene:
    if fixed := [name for name in DEVICES_OWN if name in given]:
        raise ParameterError(f"{fixed[0]} is the device's, or the person's at the machine; a program cannot set it")
    if unknown := sorted(set(given) - set(known := settable(present))):
        raise ParameterError(f"parameters must be of {', '.join(known)}, not {', '.join(unknown)}")
    optional = {name for name in given if present.parameter(name).optional}
    return present.replace(
        **{name: None if value == _NONE and name in optional else value for name, value in given.items()}
    )


def check_requests(line: Connection) -> None:
    """Check parameters until the line ends; in a process of its own."""
    give_way()
    with suppress(EOFError, OSError):
        line.send(None)  # it has loaded what it needs
        while True:
            line.send(checked(*line.recv()))


def give_way() -> None:
    """Let what has deadlines go first."""
    with suppress(AttributeError, OSError):
        os.nice(_NICE)


class _Request(NamedTuple):
    given: Mapping[str, Any]
    answer: Future[Answer]


class Requests:
    """Hold the newest request until the one before it is answered: each is checked with what that one has left."""

    def __init__(self) -> None:
        self._lock, self._ended = threading.Lock(), False
        self._waiting: _Request | None = None
        self._current: _Request | None = None

    def put(self, given: Mapping[str, Any]) -> Future[Answer]:
        """Let a request wait, from any thread, and return what its answer will be; an older one is refused."""
        request = _Request(given, Future())
        with self._lock:
            older, self._waiting = self._waiting, request
            ended = self._ended
        if older is not None:
            older.answer.set_result(Answer(reason="replaced by a newer request before it was in force"))
        if ended:
            self.end()
        return request.answer

    def next(self) -> Mapping[str, Any] | None:
        """Return the parameters that are to be checked now, once."""
        if self._current is not None:
            return None
        with self._lock:
            self._current, self._waiting = self._waiting, None
        return None if self._current is None else self._current.given

    def settle(self, answer: Answer) -> None:
        """Answer the request that was checked."""
        request, self._current = self._current, None
        if request is not None:
            request.answer.set_result(answer)

    def end(self) -> None:
        """Refuse all."""
        self._ended = True
        for _ in range(2):
            self.settle(Answer(reason="the scene has ended"))
            self.next()

"""Parameters of a scene for other programs, and their requests."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from multiprocessing import Pipe
from typing import Any, NamedTuple, TypeAlias

from maglev_mj.errors import MaglevError
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, REPLACED, UnstableLoop, changed, own_code_refused, settable, unstable_loop

_NONE = "none"  # as on the command line: the protocol has no null


class State(NamedTuple):
    """The scene that the control loop renders.

    Attributes:
        scene: The scene with its present parameters; None if none runs.
        delay: Measured time from a sample to its command's effect [s].
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], (6,); None for the scene's own.
        state: "running", "paused", "flying", "stopped: " and a reason; or the reason for having no scene.
    """

    scene: Scene | None = None
    delay: float = 0.0
    inertia: Sequence[float] | None = None
    state: str = "no scene runs here"


class Answer(NamedTuple):
    """Answer to a request.

    Attributes:
        since: The first sample answered under the new parameters; None if refused.
        reason: Reason of a refusal; empty otherwise.
        figures: Figures of a loop refused as unstable, see `UnstableLoop`; None otherwise.
    """

    since: int | None = None
    reason: str = ""
    figures: Mapping[str, Any] | None = None


Verdict: TypeAlias = Scene | UnstableLoop | str
"""Accepted scene, or the reason of its refusal."""


def values_of(state: State) -> dict[str, Any]:
    """Return the parameters by name, ready for JSON.

    Those of the device, scene name and state are included.
    """
    scene = state.scene
    if scene is None:
        return {}
    values = {name: getattr(scene, name) for name in (*DEVICES_OWN, *settable(scene))}
    told = {name: _NONE if value is None else value for name, value in values.items()}
    found: dict[str, Any] = json.loads(json.dumps({"scene": scene.name, "state": state.state, **told}))
    return found


def checked(state: State, given: Mapping[str, Any]) -> Verdict:
    """Return the scene with requested parameters, or the refusal."""
    scene = state.scene
    if scene is None:
        return state.state
    try:
        with own_code_refused():
            absent = [name for name in settable(scene) if given.get(name) == _NONE and scene.parameter(name).optional]
            wanted = changed(scene, {**given, **dict.fromkeys(absent)})
            return unstable_loop(wanted.replace(delay=state.delay), inertia=state.inertia) or wanted
    except MaglevError as error:
        return str(error)


class Requests:
    """Hold the newest request until the one before is answered.

    Each is checked with the parameters that the last one left.

    Attributes:
        arrived: Socket that is readable while a request waits and none is being checked.
    """

    def __init__(self) -> None:
        self.arrived, self._bell = Pipe(duplex=False)
        self._lock = threading.Lock()
        self._waiting: tuple[Mapping[str, Any], Future[Answer]] | None = None
        self._current: Future[Answer] | None = None

    def put(self, given: Mapping[str, Any]) -> Future[Answer]:
        """Queue a request from any thread; return its future answer.

        An older waiting request is refused.
        """
        answer = Future[Answer]()
        with self._lock:
            older, self._waiting = self._waiting, (given, answer)
            if older is None and self._current is None:
                self._bell.send(None)
        if older is not None:
            older[1].set_result(Answer(reason=REPLACED))
        return answer

    def next(self) -> Mapping[str, Any] | None:
        """Return the parameters to check now, once."""
        with self._lock:
            if self._current is not None or self._waiting is None:
                return None
            (given, self._current), self._waiting = self._waiting, None
            if self.arrived.poll():
                self.arrived.recv()
        return given

    def settle(self, answer: Answer) -> None:
        """Answer the checked request."""
        current, self._current = self._current, None
        if current is not None:
            current.set_result(answer)

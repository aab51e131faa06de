"""Verdict on a session's scene in words, with the boundary to draw; computed without delaying its viewer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from maglev_mj.colours import BAD, GOOD, Colour
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.process import SideAnswers
from maglev_mj.scenes import Scene
from maglev_mj.scenes.stability_check import UNKNOWN
from maglev_mj.session.snapshot import Snapshot
from maglev_mj.theory import Verdict, stability, stated_gains
from maglev_mj.theory.boundary import boundary_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.verdict import critical_stiffness_of, margin_words

_DAMPINGS = 32  # points of a stability boundary
_EMPTY = np.zeros(0)


@dataclass(frozen=True)
class _Words:
    """Words of a verdict on a scene's gains, and the loop to draw; a `Verdict` itself cannot be pickled.

    Attributes:
        words: Verdict, such as "stable: 59 % of critical stiffness".
        stable: None if not computed.
        loop: The loop with the smallest margin, see `Verdict.marginal`; None if the laws do not state their gains, or
            beside walls on the device, whose boundary takes long.
    """

    words: str
    stable: bool | None = None
    loop: Loop | None = None

    @property
    def colour(self) -> Colour | None:
        """Colour of the verdict; None if not computed."""
        return None if self.stable is None else GOOD if self.stable else BAD

    @cached_property
    def boundary(self) -> tuple[Array, Array]:
        """Dampings and the critical stiffness of the loop at each."""
        return (_EMPTY, _EMPTY) if self.loop is None else _boundary(self.loop)


def margin(
    scene: Scene, delay: float | None = None, inertia: Sequence[float] | None = None, *, linearised: bool = True
) -> _Words:
    """Return the verdict on a scene with its smallest margin over axes and states, free and in the scene's hand.

    Args:
        scene: The scene.
        delay: See `stability`.
        inertia: See `stability`.
        linearised: False to skip what takes long: laws that do not declare their gains, walls on the device.
    """
    body, lag = scene.body.inertia if inertia is None else np.array(inertia), scene.delay if delay is None else delay
    try:
        controller = scene.controller()
        if ((gains := stated_gains(controller)) is None or controller.on_device) and not linearised:
            return _COMPUTING
        verdict = stability(scene, inertia=body, delay=lag)
        return _Words(str(verdict), verdict.stable) if gains is None else _words_of(verdict, bool(controller.on_device))
    except Exception as error:  # of a user's laws, too
        return _not_computed(error)


def _not_computed(error: Exception) -> _Words:
    return _Words(f"{UNKNOWN}: {str(error).removeprefix(f'{UNKNOWN}: ')}")


def _words_of(verdict: Verdict, on_device: bool) -> _Words:
    loop, _ = verdict.marginal
    if loop is None:
        return _Words(str(verdict), verdict.stable)
    ratio = critical_stiffness_of(verdict.loops, loop).ratio
    if not verdict.stable:
        words = f"unstable on {verdict.axes[0]}"
        if 0.0 < ratio <= 1.0:
            words += f": {100.0 / ratio:.0f} % of critical stiffness"
    else:
        words = margin_words(True, ratio) if loop.total[0] else "stable: no stiffness"
    return _Words(words, verdict.stable, None if on_device else loop)


class LiveVerdict:
    """Verdict on the newest scene.

    It is computed at once from declared gains, in milliseconds. Linearisation can take seconds, and walls on the device
    tenths: they run in a side process without a deadline.
    """

    def __init__(self) -> None:
        self._answers: Any = None
        self._arguments: tuple[Any, ...] = (None,)
        self._margin, self._waiting, self._reused = _COMPUTING, False, False

    def of(self, snapshot: Snapshot, *, wait: bool = False) -> _Words:
        """Return the margin of a snapshot's scene; that of the last delay while another one is computed.

        Args:
            snapshot: The snapshot.
            wait: True to linearise in this process.
        """
        arguments = snapshot.scene, measured_delay(snapshot), snapshot.inertia
        if arguments != self._arguments or (wait and self._waiting):
            computed = margin(*arguments, linearised=wait)
            self._waiting = computed is _COMPUTING
            if not self._waiting or arguments[0] != self._arguments[0]:
                self._margin = computed
            self._arguments = arguments
            if self._waiting:
                self._reused = self._answers is not None and not self._answers.ended
                if not self._reused:
                    self._answers = SideAnswers(margin, UNKNOWN)
                self._answers.ask(*arguments)
        if self._waiting:
            try:
                answer: _Words | None = self._answers.answer()
            except Exception as error:  # the process has ended, or a scene that cannot be pickled
                answer = _not_computed(error)
                if self._answers.ended and self._reused:  # perhaps before the question: ask a new one
                    answer, self._arguments = None, (None,)
            if answer is not None:
                self._margin, self._waiting = answer, False
        return self._margin


_COMPUTING = _Words("computing stability")
STABILITY = LiveVerdict()
"""Shared by all viewers of this process."""


def measured_delay(snapshot: Snapshot) -> float | None:
    """Return the delay of a flight, rounded to 0.1 ms because it fluctuates [s]; None for the scene's own."""
    is_measured = snapshot.state == "flying" and not math.isnan(snapshot.delay)
    return round(snapshot.delay, 4) if is_measured else None


def _boundary(loop: Loop) -> tuple[Array, Array]:
    """Return dampings and the critical stiffness of a loop at each."""
    # no damping above this is stable at any stiffness
    largest = 0.5 * np.pi * float(loop.array().moving_mass) / (0.5 * loop.period + loop.delay) * 1.1
    dampings = np.linspace(0.0, largest, _DAMPINGS)
    try:
        stiffnesses = boundary_of(loop.array(), dampings)
    except ParameterError:  # no boundary above 1 s of delay
        stiffnesses = np.zeros_like(dampings)
    end = int(np.flatnonzero(stiffnesses).max(initial=-2)) + 2
    return dampings[:end], stiffnesses[:end]

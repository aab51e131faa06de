"""The tour in a real browser."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from maglev_mj.session import Session
from maglev_mj.session.tour import Tour
from tests.views.test_web_browser import Run, browser, opened, press, pull

pytestmark = pytest.mark.needs("browser")
__all__ = ["browser"]  # a fixture

STIFFNESS, DAMPING, _, DELAY = range(4)
"""Places of the sliders."""


@pytest.fixture
def run() -> Iterator[Run]:
    one = Run(Tour(Session()))
    yield one
    one.close()


def done(number: int) -> Callable[[Any], bool]:
    def so(shown: Any) -> bool:
        line = shown.tour
        return line is not None and (line.number > number or (line.number == number and line.done))

    return so


def begun(run: Run, tab: Any, number: int) -> None:
    """Wait for the beginning of a step.

    Its controls show its parameters a second after the last move of one.
    """
    run.until(lambda shown: shown.tour is not None and shown.tour.number == number)
    tab.wait_for_selector(f"text=step {number} of 8")
    time.sleep(1.2)
    assert not done(number)(run.shown)


def held(run: Run, tab: Any, number: int, force: float, stride: int = 4) -> None:
    """Pull the knob with a force until a step ends.

    The force is [N]; it moves some pixels at a time.
    """
    run.until(lambda shown: np.abs(shown.pose).max() < 1e-3)
    time.sleep(1.0)  # until it is drawn there
    x, y = press(tab, run)
    for far in range(8, 200, stride):
        if done(number)(run.shown) or np.linalg.norm(run.shown.hand[:3]) >= force:
            break
        tab.mouse.move(x + far, y)
        time.sleep(0.1)
    pull(tab, run, x + far, y, done(number))
    tab.mouse.up()
    run.until(lambda shown: shown.target is None)


def turned(run: Run, tab: Any, index: int, so: Callable[[Any], Any]) -> None:
    """Move a slider by keys until the scene is so."""
    tab.locator("[role=slider]").nth(index).focus()
    for _ in range(120):
        tab.keyboard.press("ArrowRight")
        time.sleep(0.02)
        if so(run.shown):
            break
    run.until(so)


@pytest.mark.study  # a minute and a half of drags by software drawing
def test_the_tour_is_done_in_a_browser(browser: Any, run: Run) -> None:
    tab = opened(browser, run)
    for number, force, stride in ((1, 0.4, 4), (2, 2.2, 4), (3, 2.2, 60), (4, 0.6, 4)):  # the third hits fast
        begun(run, tab, number)
        held(run, tab, number, force, stride)
    begun(run, tab, 5)
    turned(run, tab, STIFFNESS, done(5))
    begun(run, tab, 6)
    held(run, tab, 6, 2.5)
    begun(run, tab, 7)
    turned(run, tab, DELAY, lambda shown: shown.scene.delay > 0.0039)
    held(run, tab, 7, 2.5)
    begun(run, tab, 8)
    turned(run, tab, DAMPING, lambda shown: shown.scene.damping > 38.0)
    held(run, tab, 8, 2.5)
    tab.wait_for_selector("text=That was the tour")

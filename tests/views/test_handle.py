"""Force arrows: lengths and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maglev_mj.device import Knob
from maglev_mj.plants.shapes import ARROW
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Snapshot
from maglev_mj.views.handle import FORCES, ForceArrow, force_arrows
from maglev_mj.views.page.panel import _gauge


@pytest.mark.parametrize("name", FORCES)
def test_a_force_arrow_is_to_scale_and_has_the_number_of_the_panel(name: str) -> None:
    drawn = list[ForceArrow]()
    for size in (0.01, np.nan, 0.1, 0.5, 1.0, 7.0, 20.0, 1000.0, 3.249):
        wrench = size * np.array([0.6, 0.0, 0.8, 0.0, 0.0, 0.0])
        wrenches: dict[str, Any] = {{"device": "force"}.get(name, name): wrench}
        shown = Snapshot(scene=Joystick(), **wrenches)
        arrow = force_arrows(shown).get(name)
        assert (arrow is None) is (not size >= 0.1)
        if arrow is not None:
            length = np.linalg.norm(arrow.end - arrow.start)
            assert length == pytest.approx(min(ARROW * size, 0.06))
            assert np.linalg.norm(arrow.place - Knob().centre) > 0.02 + length  # clear of tip and knob
            drawn.append(arrow)
            assert name == "stops" or arrow.text in _gauge(shown)
    assert [arrow.text for arrow in drawn[:6]] == ["", "0.5 N", "1.0 N", "7.0 N", "20.0 N", "1000.0 N"]
    assert drawn[1].size < drawn[2].size < drawn[3].size == drawn[5].size == 1.0  # of the head


def test_parallel_force_arrows_are_stacked_and_their_numbers_apart() -> None:
    """A hand that lifts half of the weight: both arrows together are as long as that of the weight."""
    up = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for hand, device, stacked in ((3.4, 3.5, True), (3.4, -3.5, False), (0.5, 6.4, True)):
        arrows = force_arrows(Snapshot(scene=Joystick(), hand=hand * up, force=device * up))
        lower, upper = arrows["hand"], arrows["device"]
        assert np.array_equal(lower.end, upper.start) is stacked
        assert np.linalg.norm(lower.place - upper.place) > 0.01
        assert stacked is not np.allclose(lower.place[:2], lower.end[:2])  # aside of the upper shaft

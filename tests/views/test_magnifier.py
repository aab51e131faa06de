"""Magnified motion: the drawing alone, the same contact, a drag divided by it. Force arrows: lengths and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maglev_mj.plants.shapes import ARROW, GRIP
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Snapshot
from maglev_mj.views import handle
from maglev_mj.views.handle import FORCES, MAGNIFICATIONS, ForceArrow, dragged_pose, force_arrows, magnified
from maglev_mj.views.page.panel import _gauge

POSE = np.array([1e-3, -2e-3, 3.4e-3, 0.01, 0.02, -0.03])
FACES = [(0, -1.0, 1e-3), (2, -1.0, 3.5e-3), (3, 1.0, -0.05)]


@pytest.mark.parametrize("factor", MAGNIFICATIONS)
def test_pose_stick_position_and_walls_are_magnified_and_a_drag_is_divided(factor: float) -> None:
    stuck = np.array([np.nan, 1e-3, np.nan, np.nan, np.nan, np.nan])
    true = Snapshot(scene=Joystick(), pose=POSE, anchors=stuck, faces=FACES, force=np.ones(6), history=np.ones((3, 25)))
    drawn = magnified(true, factor)
    assert drawn.pose.tolist() == (factor * POSE).tolist() and drawn.anchors is not None
    assert drawn.anchors[1] == factor * 1e-3 and np.isnan(np.delete(drawn.anchors, 1)).all()
    assert [edge for _, _, edge in drawn.faces] == [factor * edge for _, _, edge in FACES]
    assert np.allclose(dragged_pose(np.zeros(6), drawn.pose[:3], factor, tilts=False)[:3], POSE[:3], rtol=1e-15)
    for axis, normal, edge in true.faces:  # what is touched is touched in the drawing, too
        met = [n * (drawn.pose[a] - e) <= 0.0 for a, n, e in drawn.faces if a == axis]
        assert met == [normal * (POSE[axis] - edge) <= 0.0]
    assert drawn.force is true.force and drawn.history is true.history and true.pose is POSE
    assert handle.motion_words(factor) == {1: "", 3: "motion x3", 5: "motion x5"}[int(factor)]


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
            assert length == pytest.approx(min(ARROW * size, 0.12))
            assert np.linalg.norm(arrow.place - GRIP) > 0.02 + length  # clear of tip and knob
            drawn.append(arrow)
            assert name == "stops" or arrow.text in _gauge(shown)
    assert [arrow.text for arrow in drawn[:6]] == ["", "0.5 N", "1.0 N", "7.0 N", "20.0 N", "1000.0 N"]
    assert drawn[1].size < drawn[2].size < drawn[3].size == drawn[5].size == 1.0  # of the head

"""Magnified motion: the drawing alone, the same contact, and a drag divided by it."""

from __future__ import annotations

import numpy as np
import pytest

from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Snapshot
from maglev_mj.views.magnifier import MAGNIFICATIONS, magnified, motion_words, true_pose

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
    assert np.allclose(true_pose(drawn.pose, factor), POSE, rtol=1e-15)
    for axis, normal, edge in true.faces:  # what is touched is touched in the drawing, too
        met = [n * (drawn.pose[a] - e) <= 0.0 for a, n, e in drawn.faces if a == axis]
        assert met == [normal * (POSE[axis] - edge) <= 0.0]
    assert drawn.force is true.force and drawn.history is true.history and true.pose is POSE
    assert motion_words(factor) == {1: "", 3: "motion x3", 5: "motion x5"}[int(factor)]

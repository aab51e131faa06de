"""Shapes of a device for any drawing program.

The model's geoms, the knob, and plates for walls.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.lazy import mujoco
from maglev_mj.plants.model import Device, Model, load_model

ARROW = 0.003
"""Length of an arrow for each newton [m]."""

LEAST_FORCE = 0.05
"""Least force with an arrow [N]."""

GRIP = np.array([0.0, 0.0, 0.079])
"""Middle of the handle's knob in the flotor [m]."""

KNOB = 0.0165, 0.0125
"""Radius and half height of the knob [m]."""

UNDER_KNOB = 0.0676
"""Height of its lower side in the flotor [m]."""

_PLATE, _THIN = 0.024, 0.0002
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
}
_HIDDEN = 3  # the first group of geoms that is not drawn


class Shape(NamedTuple):
    """Geom of a device with its flotor at the centre.

    Attributes:
        moves: True for a shape of the flotor.
        kind: box, cylinder or ellipsoid.
        half: Half lengths along its own axes; a cylinder is along its z [m], (3,).
        position: Position of its centre, from the flotor's [m], (3,).
        turn: Unit quaternion (w, x, y, z).
        colour: Red, green, blue, opacity, each from 0 to 1.
    """

    moves: bool
    kind: str
    half: Array
    position: Array
    turn: Sequence[float]
    colour: Sequence[float]


def shapes(model: Model) -> list[Shape]:
    """Return the visible geoms of a model.

    Planes and meshes are left out; a capsule is three shapes.

    Raises:
        ModelError: If the file is missing or cannot be used.
    """
    device = load_model(model, lean=False)
    compiled, data = device.model, mujoco.MjData(device.model)
    mujoco.mj_kinematics(compiled, data)
    origin, turn, found = data.xpos[device.flotor], np.zeros(4), []
    moving = {device.flotor}
    for body in range(compiled.nbody):  # parents come first
        moving |= {body} if int(compiled.body_parentid[body]) in moving else set()
    for geom in range(compiled.ngeom):
        kind, material = _KINDS.get(int(compiled.geom_type[geom])), compiled.geom_matid[geom]
        colour = compiled.geom_rgba[geom] if material < 0 else compiled.mat_rgba[material]
        if kind is None or compiled.geom_group[geom] >= _HIDDEN or not colour[3]:
            continue
        moves = int(compiled.geom_bodyid[geom]) in moving
        mujoco.mju_mat2Quat(turn, data.geom_xmat[geom])
        place, (radius, half, third) = data.geom_xpos[geom] - origin, compiled.geom_size[geom]
        about = turn.tolist(), colour.tolist()
        if kind in ("cylinder", "capsule"):
            found.append(Shape(moves, "cylinder", np.array([radius, radius, half]), place, *about))
            along = half * data.geom_xmat[geom][2::3]
            ends = (place - along, place + along) if kind == "capsule" else ()
            found += [Shape(moves, "ellipsoid", np.full(3, radius), end, *about) for end in ends]
        else:
            found.append(Shape(moves, kind, np.array([radius, half or radius, third or radius]), place, *about))
    return found


def wall_plate(face: tuple[int, float, float]) -> tuple[Array, Array] | None:
    """Return centre and half lengths of a wall's plate [m].

    (3,) each; the knob meets this plate. None for a rotation.

    Args:
        face: Index into AXES, normal (1 or -1), edge [m, rad].
    """
    axis, normal, edge = face
    if axis > 2:
        return None
    radius, half_height = KNOB
    centre, size = GRIP.copy(), np.array([_PLATE, _PLATE, half_height + 0.004])
    size[axis] = _THIN
    if axis < 2:
        centre[axis] = edge - normal * (radius + _THIN)
    else:
        size[:2] = _PLATE
        centre[2] = edge + (UNDER_KNOB - _THIN if normal > 0.0 else GRIP[2] + half_height + _THIN)
    return centre, size


def arrow_start(knob: Array, force: Array) -> Array:
    """Return the start of a force arrow [m], (3,).

    It is on the surface of the knob.
    """
    radius, half_height = KNOB
    start: Array = knob + force / np.linalg.norm(force / [radius, radius, half_height])
    return start


def envelope(device: Device) -> tuple[float, float]:
    """Return radius and height of the device's envelope [m].

    It is an upright cylinder around the device without its handle.
    """
    model = device.model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    handle = model.body("handle").id
    radius, low, high = 0.0, math.inf, -math.inf
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    for geom in np.flatnonzero(model.geom_bodyid != handle):
        turn, centre = data.geom_xmat[geom].reshape(3, 3).T, data.geom_xpos[geom]
        bounds = model.geom_aabb[geom]
        corners = (bounds[:3] + signs * bounds[3:]) @ turn + centre
        low, high = min(low, corners[:, 2].min()), max(high, corners[:, 2].max())
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            reach = np.hypot(corners[:, 0], corners[:, 1]).max()
        else:  # round about its own z axis: the ends of the axis, and the radius beyond them
            ends = centre[:2] + np.outer((-size[1], size[1]), turn[2, :2])
            reach = np.hypot(ends[:, 0], ends[:, 1]).max() + size[0]
        radius = max(radius, float(reach))
    return radius, float(high - low)

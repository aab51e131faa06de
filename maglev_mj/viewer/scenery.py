"""What is drawn of a scene: the device, walls, stick position, forces, and coils coloured by their current."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from maglev_mj.frames import Array, quaternion, rotation_matrix
from maglev_mj.model import COILS, load
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.shapes import ARROW, GRIP, LEAST_FORCE, UNDER_KNOB, arrow_start, wall_plate
from maglev_mj.spec import Spec

__all__ = ["ARROW", "GRIP", "Scenery"]

_WALL, _TOUCHED, _GHOST = (0.25, 0.47, 0.85, 0.16), (1.0, 0.55, 0.10, 0.36), (0.10, 0.60, 0.35, 0.35)
_HAND, _DEVICE = (0.13, 0.62, 0.30, 1.0), (0.80, 0.16, 0.14, 1.0)
_COLD, _WARM, _LIMIT = np.array([0.84, 0.49, 0.22]), np.array([1.0, 0.90, 0.20]), np.array([1.0, 0.05, 0.05])
_MOST = Spec.peak_current.value
_GLOW, _GHOST_SIZE = 1.12, 1.08
_SLICES = 32, 16
_IDENTITY = np.eye(3).ravel()


class Scenery:
    """The model of a scene to look at, and what is drawn over it.

    Args:
        scene: The scene, or its class.

    Attributes:
        shown: What file that is.
        model: The compiled model, with all its shapes.
        data: Its state, which follows what is seen.

    Raises:
        ModelError: If the scene's file is missing or cannot be used.
    """

    def __init__(self, scene: Scene | type[Scene]) -> None:
        device = load(scene.model, lean=False)
        self.shown = scene.model
        self.model = device.model
        self.model.vis.quality.numslices, self.model.vis.quality.numstacks = _SLICES
        self.data = mujoco.MjData(self.model)
        self.flotor = device.flotor
        self._address = device.position_address
        mujoco.mj_forward(self.model, self.data)
        handle = self.model.body("handle").id
        self._handle_shapes = np.flatnonzero(self.model.geom_bodyid == handle)
        self._handle = handle
        self._windings = self._find_windings()

    def place(self, snapshot: Snapshot) -> None:
        """Put the model where the flotor is."""
        qpos, first = self.data.qpos, self._address
        qpos[first : first + 3] = snapshot.pose[:3]
        qpos[first + 3 : first + 7] = quaternion(snapshot.pose[3:])
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def decorate(self, scene: Any, snapshot: Snapshot) -> None:
        """Add what the model does not have to a scene of the engine's, behind what is in it."""
        self._draw_coils(scene, snapshot)
        for face in snapshot.faces:
            self._draw_wall(scene, face, snapshot.pose)
        if snapshot.anchors is not None:
            self._draw_ghost(scene, snapshot)
        knob = self.data.xpos[self.flotor] + rotation_matrix(snapshot.pose[3:]) @ GRIP
        _draw_arrow(scene, knob, snapshot.hand[:3], _HAND)
        _draw_arrow(scene, knob, snapshot.force[:3], _DEVICE)

    def _find_windings(self) -> list[tuple[int, int]]:
        """Return the shapes of the coils' windings, each with the number of its coil."""
        model = self.model
        copper = model.material("copper").id
        shapes = np.flatnonzero(model.geom_matid == copper)
        places = self.data.site_xpos[model.actuator_trnid[: len(COILS), 0]]
        away = np.linalg.norm(self.data.geom_xpos[shapes][:, None] - places, axis=-1)
        return list(zip(shapes.tolist(), away.argmin(axis=1).tolist(), strict=True))

    def _draw_coils(self, scene: Any, snapshot: Snapshot) -> None:
        """Draw a winding over each of the model's, coloured from copper over yellow to red at the limit."""
        for shape, coil in self._windings:
            share = min(abs(float(snapshot.currents[coil])) / _MOST, 1.0)
            colour = _LIMIT if share > 0.999 else _COLD + share * (_WARM - _COLD)
            _add(
                scene,
                int(self.model.geom_type[shape]),
                self.model.geom_size[shape] * [_GLOW, 1.0, 1.0],
                self.data.geom_xpos[shape],
                self.data.geom_xmat[shape],
                (*colour, 1.0),
                emission=0.2 + 0.6 * share,
            )

    def _draw_wall(self, scene: Any, face: tuple[int, float, float], pose: Array) -> None:
        """Draw the plane that the knob meets; a stop of a rotation lights the rim of the knob."""
        axis, normal, edge = face
        touched = normal * (pose[axis] - edge) <= 0.0
        colour = _TOUCHED if touched else _WALL
        plate = wall_plate(face)
        if plate is None:
            if touched:
                ring = self.data.xpos[self.flotor] + rotation_matrix(pose[3:]) @ [0.0, 0.0, UNDER_KNOB + 0.0012]
                turn = rotation_matrix(pose[3:]).ravel()
                _add(scene, int(mujoco.mjtGeom.mjGEOM_CYLINDER), [0.0118, 0.0012, 0.0], ring, turn, colour)
            return
        centre, size = plate
        _add(scene, int(mujoco.mjtGeom.mjGEOM_BOX), size, centre, _IDENTITY, colour)

    def _draw_ghost(self, scene: Any, snapshot: Snapshot) -> None:
        """Draw the handle where it sticks; along axes that do not stick it is where the handle is."""
        assert snapshot.anchors is not None
        if np.isnan(snapshot.anchors).all():
            return
        stuck = np.where(np.isnan(snapshot.anchors), snapshot.pose, snapshot.anchors)
        turn = rotation_matrix(stuck[3:])
        back = turn @ rotation_matrix(snapshot.pose[3:]).T
        origin = self.data.xpos[self.flotor]
        for shape in self._handle_shapes:
            place = stuck[:3] + back @ (self.data.geom_xpos[shape] - origin)
            matrix = (back @ self.data.geom_xmat[shape].reshape(3, 3)).ravel()
            size = self.model.geom_size[shape] * _GHOST_SIZE
            _add(scene, int(self.model.geom_type[shape]), size, place, matrix, _GHOST)


def _draw_arrow(scene: Any, knob: Array, force: Array, colour: tuple[float, ...]) -> None:
    """Draw a force to scale, from the surface of the knob on; below 0.05 N there is nothing to see."""
    size = float(np.linalg.norm(force))
    if size < LEAST_FORCE:
        return
    shape = _next(scene)
    if shape is None:
        return
    start = arrow_start(knob, force)
    # an arrow between two points is drawn from the first on, at half the length between them
    arrow = int(mujoco.mjtGeom.mjGEOM_ARROW)
    mujoco.mjv_connector(shape, arrow, 0.0016, start, start + 2.0 * ARROW * force)
    _style(shape, colour, 0.3)


def _add(
    scene: Any, kind: int, size: Any, place: Any, matrix: Any, colour: tuple[float, ...], emission: float = 0.1
) -> None:
    shape = _next(scene)
    if shape is not None:
        parts = (np.asarray(part, dtype=np.float64) for part in (size, place, matrix))
        mujoco.mjv_initGeom(shape, kind, *parts, np.array(colour, np.float32))
        _style(shape, colour, emission)


def _next(scene: Any) -> Any:
    """Return the next free shape of a scene; None where it is full, and the rest is left out."""
    if scene.ngeom >= scene.maxgeom:
        return None
    scene.ngeom += 1
    shape = scene.geoms[scene.ngeom - 1]
    mujoco.mjv_initGeom(
        shape, int(mujoco.mjtGeom.mjGEOM_SPHERE), np.zeros(3), np.zeros(3), _IDENTITY, np.ones(4, np.float32)
    )
    return shape


def _style(shape: Any, colour: tuple[float, ...], emission: float) -> None:
    shape.rgba[:] = colour
    shape.emission, shape.specular, shape.shininess = emission, 0.2, 0.3
    shape.category = int(mujoco.mjtCatBit.mjCAT_DECOR)

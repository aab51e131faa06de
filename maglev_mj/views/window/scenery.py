"""3D view of a scene: device, walls, stick position, forces, currents, camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.colours import FIRST, HAND, STOP, STUCK, TOUCHED, WALL, Colour
from maglev_mj.frames import AXES, Array, quaternion, rotation_matrix
from maglev_mj.lazy import mujoco
from maglev_mj.plants.model import load_model
from maglev_mj.plants.shapes import KNOB_BOTTOM, Face, coil_colour, geom_parts, wall_box
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.arrows import FORCES, ForceArrows
from maglev_mj.views.magnifier import magnified, stretched, widening
from maglev_mj.views.readings import stop_contacts

_WALL, _TOUCHED, _GHOST, _STOP = (*WALL, 0.08), (*TOUCHED, 0.11), 0.40, (*STOP, 0.40)
_EDGE, _EDGE_WIDTH = 0.45, 3.0
"""Brightness and width [pixels] of a wall's edge; the face is faint, so that it does not tint what is behind."""

_GHOST_SIZE, _AXIS, _ARROW_WIDTH = 1.08, 44, 0.0016
_SIMPLE = 2
"""Group of simple geoms that the mesh of a scene's ring replaces."""

_IDENTITY = np.eye(3).ravel()
_SPHERE, _UNSEEN = int(mujoco.mjtGeom.mjGEOM_SPHERE), (0.0, 0.0, 0.0, 0.0)

_Shade: TypeAlias = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""


class Scenery:
    """Displayed model of a scene, with added geoms.

    Args:
        scene: The scene, or its class.

    Attributes:
        path: File of the model.
        model: Compiled model with all geoms.
        data: State, which follows the snapshots.
        half_text: Half the width of a number [m], (3,): MuJoCo writes to the right of a point.

    Raises:
        ModelError: If the model file is missing or invalid.
    """

    def __init__(self, scene: Scene | type[Scene]) -> None:
        device = load_model(scene.model, lean=False)
        self.path = scene.model
        self.model = device.model
        self.data = mujoco.MjData(self.model)
        self.flotor = device.flotor
        self._address = device.position_address
        mujoco.mj_forward(self.model, self.data)
        parts = geom_parts(self.model, self.data)
        self._knob, self._stem = ([geom for geom in parts if parts[geom] == name] for name in ("handle", "stem"))
        self._coils = {geom: int(name[4:]) for geom, name in parts.items() if name.startswith("coil")}
        if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_MESH, "ring") >= 0:
            self.model.geom_rgba[self.model.geom_group == _SIMPLE] = 0.0
        along = self.model.geom_size[self._stem, 1:2] * (0.0, 0.0, 1.0)
        self._ends = self.data.geom_xpos[self._stem] - self.data.xpos[self.flotor] + np.array([-along, along])
        self._arrows, self.half_text = ForceArrows(), np.zeros(3)
        self._copper = self.model.material("copper").rgba[:3].tolist()
        rgba: Any = self.model.vis.rgba
        # MuJoCo's decoration of a drag: spring, rotated box, grip
        rgba.constraint[:] = rgba.inertia[:] = rgba.selectpoint[:] = (*HAND, 1.0)

    def set_pose(self, snapshot: Snapshot, factor: float = 1.0) -> None:
        """Set currents and pose of the flotor, and the knob's magnified pose on a stretched stem; see `magnified`."""
        for geom, coil in self._coils.items():
            self.model.geom_rgba[geom] = *coil_colour(self._copper, snapshot.currents[coil]), 1.0
        qpos, first = self.data.qpos, self._address
        qpos[first : first + 3] = snapshot.pose[:3]
        qpos[first + 3 : first + 7] = quaternion(snapshot.pose[3:])
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        data = self.data
        for index, stem in enumerate(self._stem):
            foot, turn, length = stretched(self._ends[:, index], snapshot.pose, factor)
            mujoco.mju_quat2Mat(data.geom_xmat[stem], turn)
            data.geom_xpos[stem] = foot + 0.5 * length * data.geom_xmat[stem, 2::3]
            self.model.geom_size[stem, 1] = 0.5 * length
        for shape, position, rotation in self._moved(self._knob, snapshot.pose, factor * snapshot.pose):
            data.geom_xpos[shape], data.geom_xmat[shape] = position, rotation.ravel()

    def decorate(self, scene: Any, snapshot: Snapshot, factor: float = 1.0) -> None:
        """Add walls, stops, forces, and the stick position or the first attempt, to an MjvScene.

        Args:
            scene: The MjvScene.
            snapshot: The true snapshot.
            factor: Magnification of the handle's motion.
        """
        snapshot, wider = magnified(snapshot, factor), widening(factor)
        touched = {face for face in snapshot.faces if face[1] * (snapshot.pose[face[0]] - face[2]) <= 0.0}
        self._draw_walls(scene, snapshot.faces, touched, _TOUCHED, wider)
        if any(axis > 2 for axis, _, _ in touched):
            self._draw_ring(scene, snapshot.pose, _TOUCHED)
        stops = stop_contacts(snapshot)
        self._draw_walls(scene, stops.faces, {*stops.faces}, _STOP, wider)
        if stops.rotation:
            self._draw_ring(scene, snapshot.pose, _STOP)
        if (ghost := snapshot.ghost) is not None:
            self._draw_ghost(scene, snapshot.pose, ghost, FIRST if len(snapshot.first) else STUCK)
        for name, arrow in self._arrows.of(snapshot).items():
            # mjGEOM_ARROW is drawn at half the distance between its points
            _connect(scene, arrow.start, 2.0 * arrow.end - arrow.start, arrow.size * _ARROW_WIDTH, FORCES[name])
            place = arrow.place - self.half_text
            _add(scene, _SPHERE, np.zeros(3), place, _IDENTITY, _UNSEEN, label=arrow.text)

    def draw_axes(self, scene: Any, origin: Array, pixel: float) -> None:
        """Add labelled arrows along x, y and z.

        Args:
            scene: The MjvScene.
            origin: Origin of the arrows [m], (3,).
            pixel: Height of a pixel at the origin [m].
        """
        length = _AXIS * pixel
        for name, direction in zip(AXES[:3], np.eye(3), strict=True):
            _connect(scene, origin, origin + 2.0 * length * direction, 0.05 * length, STOP)
            # an invisible sphere past the tip carries the label
            _add(scene, _SPHERE, np.zeros(3), origin + 1.25 * length * direction, _IDENTITY, _UNSEEN, label=name)

    def _draw_walls(self, scene: Any, faces: Iterable[Face], lit: set[Face], colour: _Shade, wider: float) -> None:
        """Draw walls along x, y or z, some of them lit in a colour, with their edges."""
        plates, edges = wall_box(faces, wider)
        for face, (centre, size) in plates.items():
            _add(scene, int(mujoco.mjtGeom.mjGEOM_BOX), size, centre, _IDENTITY, colour if face in lit else _WALL)
        for ends, walls in edges:
            red, green, blue = (_EDGE * part for part in (_WALL if lit.isdisjoint(walls) else colour)[:3])
            _connect(scene, ends[0], ends[1], _EDGE_WIDTH, (red, green, blue), mujoco.mjtGeom.mjGEOM_LINE)

    def _draw_ring(self, scene: Any, pose: Array, colour: _Shade) -> None:
        """Highlight the rim of the knob: contact with a wall or stop of a rotation."""
        rotation = rotation_matrix(pose[3:])
        centre = pose[:3] + rotation @ [0.0, 0.0, KNOB_BOTTOM + 0.0012]
        _add(scene, int(mujoco.mjtGeom.mjGEOM_CYLINDER), [0.0118, 0.0012, 0.0], centre, rotation.ravel(), colour)

    def _draw_ghost(self, scene: Any, pose: Array, ghost: Array, colour: Colour) -> None:
        """Draw the knob at another pose."""
        for shape, position, rotation in self._moved(self._knob, pose, ghost):
            size = self.model.geom_size[shape] * _GHOST_SIZE
            _add(scene, int(self.model.geom_type[shape]), size, position, rotation.ravel(), (*colour, _GHOST))

    def _moved(self, shapes: Sequence[int], start: Array, end: Array) -> list[tuple[int, Array, Array]]:
        """Return geoms with position and rotation, moved from one pose to another."""
        back, data = rotation_matrix(end[3:]) @ rotation_matrix(start[3:]).T, self.data
        return [
            (shape, end[:3] + back @ (data.geom_xpos[shape] - start[:3]), back @ data.geom_xmat[shape].reshape(3, 3))
            for shape in shapes
        ]


def _connect(
    scene: Any, start: Array, end: Array, width: float, colour: Colour, kind: int = mujoco.mjtGeom.mjGEOM_ARROW
) -> None:
    if (shape := _add(scene, _SPHERE, np.zeros(3), start, _IDENTITY, (*colour, 1.0), 0.3)) is not None:
        mujoco.mjv_connector(shape, int(kind), width, start, end)


def _add(
    scene: Any, kind: int, size: Any, at: Any, matrix: Any, colour: _Shade, emission: float = 0.1, label: str = ""
) -> Any:
    """Add a geom to a scene; return it, or None if the scene is full."""
    if scene.ngeom >= scene.maxgeom:
        return None
    shape = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    parts = (np.asarray(part, dtype=np.float64) for part in (size, at, matrix))
    mujoco.mjv_initGeom(shape, kind, *parts, np.array(colour, np.float32))
    shape.label, shape.category = label, int(mujoco.mjtCatBit.mjCAT_DECOR)
    shape.emission, shape.specular, shape.shininess = emission, 0.2, 0.3
    return shape

"""3D view of a scene: device, walls, stick position, forces, currents, camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.colours import DEVICE, FIRST, HAND, STOP, STUCK, TOUCHED, WALL, Colour
from maglev_mj.frames import AXES, Array, quaternion, rotation_matrix
from maglev_mj.lazy import mujoco
from maglev_mj.plants.model import COILS, load_model
from maglev_mj.plants.shapes import ARROW, GRIP, KNOB_BOTTOM, MIN_ARROW_FORCE, arrow_start, wall_plate
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.spec import Spec
from maglev_mj.views.magnifier import magnified, widening
from maglev_mj.views.readings import stop_contacts

_WALL, _TOUCHED, _GHOST, _STOP = (*WALL, 0.08), (*TOUCHED, 0.11), 0.40, (*STOP, 0.40)
_EDGE = 0.6  # brightness of a wall's edge; the face is faint, so that it does not tint what is behind
_COLD, _WARM, _LIMIT = np.array([0.84, 0.49, 0.22]), np.array([1.0, 0.90, 0.20]), np.array([1.0, 0.05, 0.05])
_PEAK = Spec.peak_current.value
_GLOW, _GHOST_SIZE, _AXIS = 1.06, 1.08, 44
_QUALITY = 40, 16, 2048, 4  # slices, stacks, shadow size, offscreen samples
_SIMPLE = 2
"""Group of simple geoms that a scene's meshes replace."""

_TURNS, _UPRIGHT = (-0.0015, 0.0, 0.0015), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Offsets of the turns along the axis of a winding [m]; rotation of a vertical coil."""

_IDENTITY = np.eye(3).ravel()
_SPHERE, _UNSEEN = int(mujoco.mjtGeom.mjGEOM_SPHERE), (0.0, 0.0, 0.0, 0.0)

_Shade: TypeAlias = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""


_Winding: TypeAlias = tuple[int, int, int, Array, int, Array, Array]
"""Geom of a winding: coil, site, type, size, mesh; position and rotation in the site's frame."""


class Scenery:
    """Displayed model of a scene, with added geoms.

    Args:
        scene: The scene, or its class.

    Attributes:
        path: File of the model.
        model: Compiled model with all geoms.
        data: State, which follows the snapshots.

    Raises:
        ModelError: If the model file is missing or invalid.
    """

    def __init__(self, scene: Scene | type[Scene]) -> None:
        device = load_model(scene.model, lean=False)
        self.path = scene.model
        self.model = device.model
        quality: Any = self.model.vis.quality
        quality.numslices, quality.numstacks, quality.shadowsize, quality.offsamples = _QUALITY
        self.data = mujoco.MjData(self.model)
        self.flotor = device.flotor
        self._address = device.position_address
        mujoco.mj_forward(self.model, self.data)
        handle = np.flatnonzero(self.model.geom_bodyid == self.model.body("handle").id).tolist()
        cylinder, heights = int(mujoco.mjtGeom.mjGEOM_CYLINDER), self.data.geom_xpos[:, 2]
        halves = np.where(self.model.geom_type == cylinder, self.model.geom_size[:, 1], 0.0)
        self._knob = [shape for shape in handle if heights[shape] > KNOB_BOTTOM]
        self._stem = [shape for shape in handle if heights[shape] <= KNOB_BOTTOM < heights[shape] + halves[shape]]
        self._halves = halves[self._stem]
        self._windings = self._find_windings()
        rgba: Any = self.model.vis.rgba
        # MuJoCo's decoration of a drag: spring, rotated box, grip
        rgba.constraint[:] = rgba.inertia[:] = rgba.selectpoint[:] = (*HAND, 1.0)

    def set_pose(self, snapshot: Snapshot, factor: float = 1.0) -> None:
        """Set the flotor's pose, and the knob's magnified one, on a stem stretched from the flotor; see `magnified`."""
        qpos, first = self.data.qpos, self._address
        qpos[first : first + 3] = snapshot.pose[:3]
        qpos[first + 3 : first + 7] = quaternion(snapshot.pose[3:])
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        ends, turn, data = (snapshot.pose, factor * snapshot.pose), np.zeros(4), self.data
        for half, (stem, position, rotation) in zip(self._halves, self._moved(self._stem, *ends), strict=True):
            foot, top = data.geom_xpos[stem] - half * data.geom_xmat[stem, 2::3], position + half * rotation[:, 2]
            mujoco.mju_quatZ2Vec(turn, top - foot)
            mujoco.mju_quat2Mat(data.geom_xmat[stem], turn)
            data.geom_xpos[stem], self.model.geom_size[stem, 1] = 0.5 * (foot + top), 0.5 * np.linalg.norm(top - foot)
        for shape, position, rotation in self._moved(self._knob, *ends):
            data.geom_xpos[shape], data.geom_xmat[shape] = position, rotation.ravel()

    def decorate(self, scene: Any, snapshot: Snapshot, factor: float = 1.0) -> None:
        """Add walls, stops, coils, forces, and the stick position or the first attempt, to an MjvScene.

        Args:
            scene: The MjvScene.
            snapshot: The true snapshot.
            factor: Magnification of the handle's motion.
        """
        self._draw_coils(scene, snapshot)
        snapshot, wider = magnified(snapshot, factor), widening(factor)
        for face in snapshot.faces:
            touched = face[1] * (snapshot.pose[face[0]] - face[2]) <= 0.0
            self._draw_plate(scene, face, _TOUCHED if touched else _WALL, wider)
            if face[0] > 2 and touched:
                self._draw_ring(scene, snapshot.pose, _TOUCHED)
        stops = stop_contacts(snapshot)
        for face in stops.faces:
            self._draw_plate(scene, face, _STOP, wider)
        if stops.rotation:
            self._draw_ring(scene, snapshot.pose, _STOP)
        if (ghost := snapshot.ghost) is not None:
            self._draw_ghost(scene, snapshot.pose, ghost, FIRST if len(snapshot.first) else STUCK)
        knob = snapshot.pose[:3] + rotation_matrix(snapshot.pose[3:]) @ GRIP
        hand, device, stop = snapshot.hand[:3], snapshot.force[:3], snapshot.stops[:3]
        _draw_arrow(scene, knob, hand, HAND)
        _draw_arrow(scene, knob, device, DEVICE)
        # stack the stop's arrow on the device's, so that balanced forces have equal lengths
        size = float(np.linalg.norm(stop)) or 1.0
        _draw_arrow(scene, knob + max(float(device @ stop) / size, 0.0) * ARROW / size * stop, stop, STOP)

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

    def _find_windings(self) -> list[_Winding]:
        """Return the windings: turns of the scene's mesh, else the simple geoms."""
        model, data = self.model, self.data
        sites = model.actuator_trnid[: len(COILS), 0]
        mesh = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MESH, "winding")
        if mesh >= 0:
            model.geom_rgba[model.geom_group == _SIMPLE] = 0.0
            own, none = np.zeros(9), np.zeros(3)
            mujoco.mju_quat2Mat(own, model.mesh_quat[mesh])
            turns = [_UPRIGHT if name.startswith("vertical") else np.eye(3) for name in COILS]
            kind = int(mujoco.mjtGeom.mjGEOM_MESH)
            return [
                (coil, sites[coil], kind, none, 2 * mesh, along * turn[:, 2], turn @ own.reshape(3, 3))
                for coil, turn in enumerate(turns)
                for along in _TURNS
            ]
        windings = []
        for shape in np.flatnonzero(model.geom_matid == model.material("copper").id):
            coil = int(np.linalg.norm(data.site_xpos[sites] - data.geom_xpos[shape], axis=1).argmin())
            back = data.site_xmat[sites[coil]].reshape(3, 3).T
            offset, rotation = data.geom_xpos[shape] - data.site_xpos[sites[coil]], data.geom_xmat[shape].reshape(3, 3)
            kind, size = int(model.geom_type[shape]), _GLOW * model.geom_size[shape]
            windings.append((coil, sites[coil], kind, size, -1, back @ offset, back @ rotation))
        return windings

    def _draw_coils(self, scene: Any, snapshot: Snapshot) -> None:
        """Draw the windings, coloured by current: copper at 0, yellow, red at the limit."""
        for coil, site, kind, size, mesh, offset, rotation in self._windings:
            share = min(abs(float(snapshot.currents[coil])) / _PEAK, 1.0)
            colour = _LIMIT if share > 0.999 else _COLD + share * (_WARM - _COLD)
            frame = self.data.site_xmat[site].reshape(3, 3)
            at, matrix = self.data.site_xpos[site] + frame @ offset, (frame @ rotation).ravel()
            if (shape := _add(scene, kind, size, at, matrix, (*colour.tolist(), 1.0), 0.8 * share)) is not None:
                shape.dataid = mesh

    def _draw_plate(self, scene: Any, face: tuple[int, float, float], colour: _Shade, wider: float) -> None:
        """Draw a wall along x, y or z; walls of rotations are not drawn."""
        if (plate := wall_plate(face)) is not None:
            centre, size = plate
            size = size + wider * (np.arange(3) != face[0])
            _add(scene, int(mujoco.mjtGeom.mjGEOM_BOX), size, centre, _IDENTITY, colour)
            red, green, blue, _ = colour
            edge = _EDGE * red, _EDGE * green, _EDGE * blue, 1.0
            _add(scene, int(mujoco.mjtGeom.mjGEOM_LINEBOX), size, centre, _IDENTITY, edge)

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


def _draw_arrow(scene: Any, knob: Array, force: Array, colour: Colour) -> None:
    """Draw a force to scale from the surface of the knob; none below 0.05 N."""
    if float(np.linalg.norm(force)) >= MIN_ARROW_FORCE:
        start = arrow_start(knob, force)
        # mjGEOM_ARROW is drawn at half the distance between its points
        _connect(scene, start, start + 2.0 * ARROW * force, 0.0016, colour)


def _connect(scene: Any, start: Array, end: Array, width: float, colour: Colour) -> None:
    if (shape := _add(scene, _SPHERE, np.zeros(3), start, _IDENTITY, (*colour, 1.0), 0.3)) is not None:
        mujoco.mjv_connector(shape, int(mujoco.mjtGeom.mjGEOM_ARROW), width, start, end)


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

"""Drawing of snapshots with MuJoCo into the current OpenGL context, shared by window and pictures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.colours import FIRST, STOP, STUCK, TOUCHED, WALL, Colour, on_white
from maglev_mj.frames import AXES, Array, quaternion, rotation_matrix
from maglev_mj.lazy import mujoco
from maglev_mj.plants.model import drawn_model
from maglev_mj.plants.shapes import RIM, Face, coil_colour, coil_geoms, wall_box
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.handle import FORCES, force_arrows, hand_spring
from maglev_mj.views.readings import stop_contacts
from maglev_mj.views.window.screen import Area, Layout, Screen

_WALL, _TOUCHED, _GHOST, _STOP = (*WALL, 0.08), (*TOUCHED, 0.11), 0.40, (*STOP, 0.40)
_EDGE, _EDGE_WIDTH = 0.45, 3.0
"""Brightness and width [pixels] of a wall's edge; the face is faint, so that it does not tint what is behind."""

_GHOST_SIZE, _ARROW_WIDTH, _WIRE = 1.08, 0.0016, 0.0004
_ORIGIN, _AXIS = np.array([0.075, -0.075, -0.05]), 44 * 4.5e-4
"""Origin of the coordinate axes, beside the base, and their length [m]."""

_SIMPLE = 2
"""Group of simple geoms that the mesh of a scene's ring replaces."""

_IDENTITY = np.eye(3).ravel()
_SPHERE, _BOX = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_BOX)
_CYLINDER, _ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)

_Shade: TypeAlias = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""


class Scenery:
    """Displayed model of a scene, with added geoms.

    Args:
        scene: The scene.

    Attributes:
        source: File of the model, and device.
        model: Compiled model with all geoms.
        data: State, which follows the snapshots.

    Raises:
        ModelError: If the model file is missing or invalid.
    """

    def __init__(self, scene: Scene) -> None:
        device = drawn_model(scene.model, scene.hardware)
        self.source = scene.model, scene.hardware
        self.model, self.data = device.model, mujoco.MjData(device.model)
        self._address = device.position_address
        mujoco.mj_forward(self.model, self.data)
        self._coils = coil_geoms(self.model, self.data)
        moves = self.model.body_weldid[self.model.geom_bodyid] > 0
        self._knob = np.flatnonzero(moves & (self.data.geom_xpos[:, 2] > scene.hardware.knob.bottom)).tolist()
        if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_MESH, "ring") >= 0:
            self.model.geom_rgba[self.model.geom_group == _SIMPLE] = 0.0
        self._copper = self.model.material("copper").rgba[:3].tolist()

    def set_pose(self, snapshot: Snapshot) -> None:
        """Set currents and pose of the flotor."""
        model, data, first = self.model, self.data, self._address
        for geom, coil in self._coils.items():
            model.geom_rgba[geom] = *coil_colour(self._copper, snapshot.currents[coil], snapshot.scene.hardware), 1.0
        data.qpos[first : first + 7] = *snapshot.pose[:3], *quaternion(snapshot.pose[3:])
        for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            update(model, data)

    def decorate(self, scene: Any, snapshot: Snapshot) -> None:
        """Add walls, stops, forces, the hand's spring, and the stick position or the first attempt, to an MjvScene."""
        touched = {face for face in snapshot.faces if face[1] * (snapshot.pose[face[0]] - face[2]) <= 0.0}
        self._draw_walls(scene, snapshot, snapshot.faces, touched, _TOUCHED)
        stops, _ = stop_contacts(snapshot)
        self._draw_walls(scene, snapshot, stops, {*stops}, _STOP)
        if (ghost := snapshot.ghost) is not None:
            colour = FIRST if len(snapshot.first) else STUCK
            turn, data = rotation_matrix(ghost[3:]) @ rotation_matrix(snapshot.pose[3:]).T, self.data
            for shape in self._knob:
                size, kind = self.model.geom_size[shape] * _GHOST_SIZE, int(self.model.geom_type[shape])
                place = ghost[:3] + turn @ (data.geom_xpos[shape] - snapshot.pose[:3])
                matrix = turn @ data.geom_xmat[shape].reshape(3, 3)
                _add(scene, kind, size, place, matrix.ravel(), (*colour, _GHOST))
        for solid, row in zip(snapshot.scene.beside(), snapshot.beside):
            kind = {"box": _BOX, "cylinder": _CYLINDER}.get(solid.kind, _ELLIPSOID)
            mujoco.mju_quat2Mat(matrix := np.zeros(9), row[3:])
            red, green, blue, opacity = solid.colour
            _add(scene, kind, solid.half, row[:3], matrix, (red, green, blue, opacity))
        for name, arrow in force_arrows(snapshot).items():
            # mjGEOM_ARROW is drawn at half the distance between its points
            _connect(scene, arrow.start, 2.0 * arrow.end - arrow.start, arrow.size * _ARROW_WIDTH, FORCES[name])
        for start, end in pairwise(hand_spring(snapshot)):
            _connect(scene, start, end, _WIRE, FORCES["hand"], mujoco.mjtGeom.mjGEOM_CAPSULE)

    def draw_axes(self, scene: Any) -> None:
        """Add arrows along x, y and z, beside the base, to an MjvScene; see `_number` for their names."""
        for direction in np.eye(3):
            _connect(scene, _ORIGIN, _ORIGIN + 2.0 * _AXIS * direction, 0.05 * _AXIS, STOP)

    def _draw_walls(
        self, scene: Any, snapshot: Snapshot, faces: Iterable[Face], lit: set[Face], colour: _Shade
    ) -> None:
        """Draw walls with their edges, some of them lit in a colour; the rim of the knob for one of a rotation."""
        knob = snapshot.scene.hardware.knob
        plates, edges = wall_box(faces, knob)
        for face, (centre, size) in plates.items():
            _add(scene, _BOX, size, centre, _IDENTITY, colour if face in lit else _WALL)
        for ends, walls in edges:
            red, green, blue = (_EDGE * part for part in (_WALL if lit.isdisjoint(walls) else colour)[:3])
            _connect(scene, ends[0], ends[1], _EDGE_WIDTH, (red, green, blue), mujoco.mjtGeom.mjGEOM_LINE)
        if any(axis > 2 for axis, _, _ in lit):
            rotation = rotation_matrix(snapshot.pose[3:])
            radius, half = knob.radius * np.array(RIM)
            centre = snapshot.pose[:3] + rotation @ [0.0, 0.0, knob.bottom + half]
            _add(scene, _CYLINDER, [radius, half, 0.0], centre, rotation.ravel(), colour)


def _connect(
    scene: Any, start: Array, end: Array, width: float, colour: Colour, kind: int = mujoco.mjtGeom.mjGEOM_ARROW
) -> None:
    if (shape := _add(scene, _SPHERE, np.zeros(3), start, _IDENTITY, (*colour, 1.0), 0.0)) is not None:
        mujoco.mjv_connector(shape, int(kind), width, start, end)


def _add(scene: Any, kind: int, size: Any, at: Any, matrix: Any, colour: _Shade, emission: float = 0.1) -> Any:
    """Add a geom to a scene; return it, or None if the scene is full."""
    if scene.ngeom >= scene.maxgeom:
        return None
    shape = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    parts = (np.asarray(part, dtype=np.float64) for part in (size, at, matrix))
    mujoco.mjv_initGeom(shape, kind, *parts, np.array(colour, np.float32))
    shape.category = int(mujoco.mjtCatBit.mjCAT_DECOR)
    shape.emission, shape.specular, shape.shininess = emission, 0.2, 0.3
    return shape


_HIGH, _WIDE = 0.92, 0.95
"""Fractions of the default view's height that stay visible, vertically and horizontally."""

_SHADOW = 4096  # pixels of the shadow of a picture: smooth edges
_MAX_GEOMS, _TURN = 2000, 180.0  # [deg] per height of the picture
_LABEL, _LETTER, _PADDING = 0.21, 0.07, 0.1
"""Height, width of a letter and padding of a label [pixels], at a font scale of 1 %."""
_EDGE_GAP = 6
"""Distance of a label from the edge of its area [pixels]."""
_PAPER: Colour = (0.93, 0.94, 0.96)


class Painter:
    """Renderer of snapshots.

    Args:
        scene: The scene; others are loaded as snapshots show them.
        screen: Overlay.
        scale: Font scale, 100 to 300 [%].
        size: Width and height of an offscreen buffer [pixels]; None to draw into the window.
        shadows: True to draw shadows.

    Attributes:
        scenery: Displayed model.
        camera: The camera, which the user may move.

    Raises:
        ModelError: If the model file is missing or invalid.
    """

    def __init__(
        self, scene: Scene, screen: Screen, *, scale: int, size: tuple[int, int] | None = None, shadows: bool = True
    ) -> None:
        self._screen, self._scale, self._size, self._shadows = screen, scale, size, shadows
        self._option, self.camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._context: Any = None
        self._load(scene)

    def _load(self, scene: Scene) -> None:
        self.close()
        self.scenery = Scenery(scene)
        model = self.scenery.model
        if self._size is not None:
            model.vis.global_.offwidth, model.vis.global_.offheight = self._size
            model.vis.quality.shadowsize = _SHADOW
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self._context = mujoco.MjrContext(model, self._scale)
        if self._size is not None:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self.reset()

    def reset(self) -> None:
        """Reset the camera to the default view."""
        default_view(self.scenery.model, self.camera)
        self._zoom = 1.0

    def device_area(self, view: Area) -> Area:
        """Return the area of the 3D view in a picture."""
        return Layout(view, self._scale).device if self._screen.plots else view

    def draw(self, snapshot: Snapshot, view: Area, notes: Sequence[str] = ()) -> None:
        """Draw a snapshot into a picture."""
        if (snapshot.scene.model, snapshot.scene.hardware) != self.scenery.source:
            self._load(snapshot.scene)
        scenery, scene, area = self.scenery, self._scene, self.device_area(view)
        last, self._zoom = self._zoom, zoom(area)
        self.camera.distance *= self._zoom / last  # the user's own zoom is kept
        scenery.set_pose(snapshot)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(scenery.model, scenery.data, self._option, None, self.camera, everything, scene)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._shadows
        scenery.decorate(scene, snapshot)
        if self._screen.plots:
            scenery.draw_axes(scene)
        mujoco.mjr_render(mujoco.MjrRect(*area), scene, self._context)
        self._number(snapshot, area)
        if self._screen.plots:
            self._screen.draw(snapshot, view, self._scale, notes).render(self._context)

    def _number(self, snapshot: Snapshot, area: Area) -> None:
        """Write forces and names of axes on light labels: MuJoCo's own labels in a scene are hard to read."""
        arrows = [(arrow.text, arrow.end, arrow.place, FORCES[name]) for name, arrow in force_arrows(snapshot).items()]
        if self._screen.plots:
            ends = zip(AXES[:3], _ORIGIN + _AXIS * np.eye(3), _ORIGIN + 1.25 * _AXIS * np.eye(3), strict=True)
            arrows += [(name, end, place, STOP) for name, end, place in ends]
        for text, end, place, colour in arrows:
            if text:
                tip, centre = (project(self.scenery.model, self.camera, area, point)[0] for point in (end, place))
                label = mujoco.MjrRect(*label_area(text, tip, centre, area, self._scale))
                font = int(mujoco.mjtFont.mjFONT_NORMAL)
                mujoco.mjr_label(label, font, text, *_PAPER, 1.0, *on_white(colour), self._context)

    def pixels(self, view: Area) -> NDArray[np.uint8]:
        """Return the picture drawn last, (height, width, 3)."""
        pixels = np.empty((view.height, view.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, mujoco.MjrRect(*view), self._context)
        return pixels[::-1]

    def orbit(self, right: float, up: float) -> None:
        """Turn the camera by a drag, as a fraction of the picture's height."""
        self.camera.azimuth -= _TURN * right
        self.camera.elevation = min(max(self.camera.elevation + _TURN * up, -89.0), 89.0)

    def pan(self, right: float, up: float, view: Area) -> None:
        """Move the camera across by a drag, as a fraction of the picture's height."""
        area = self.device_area(view)
        _, across, above = project(self.scenery.model, self.camera, area, self.camera.lookat.copy())
        self.camera.lookat -= view.height * (right * across + up * above)

    def knob(self, snapshot: Snapshot, view: Area) -> tuple[Array, Array, Array]:
        """Return the knob's pixel, (2,), and the displacement of one pixel right and up there [m], (3,) each."""
        point = snapshot.pose[:3] + rotation_matrix(snapshot.pose[3:]) @ snapshot.scene.hardware.knob.centre
        return project(self.scenery.model, self.camera, self.device_area(view), point)

    def close(self) -> None:
        """Free the OpenGL resources."""
        if self._context is not None:
            self._context.free()


def label_area(text: str, tip: Array, place: Array, area: Area, scale: int) -> Area:
    """Return the area of a label beside the tip of an arrow, whatever the direction, and inside the 3D view.

    Args:
        text: The label.
        tip: Tip of the arrow [pixels], (2,).
        place: Nearest point of the label [pixels], (2,).
        area: Area of the 3D view.
        scale: Font scale [%].
    """
    size = np.array([int((len(text) * _LETTER + _PADDING) * scale), int(_LABEL * scale)])
    way = (place - tip) / max(float(np.linalg.norm(place - tip)), 1.0)
    centre = place + way * (0.5 * size / np.maximum(np.abs(way), 0.1)).min()
    low = np.array(area[:2])
    left, bottom = np.clip(centre - 0.5 * size, low + _EDGE_GAP, low + area[2:] - size - _EDGE_GAP).astype(int).tolist()
    return Area(left, bottom, *size.tolist())


def default_view(model: Any, camera: Any) -> None:
    """Set a camera to the default view of a square picture."""
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.lookat[:2] = 0.0  # the flotor's axis


def zoom(area: Area) -> float:
    """Return the factor of the default view's distance at which the device fits an area."""
    return max(_HIGH, _WIDE * area.height / area.width)


def project(model: Any, camera: Any, area: Area, point: Array) -> tuple[Array, Array, Array]:
    """Return a point's pixel, (2,), and the displacement of one pixel right and up there [m], (3,) each.

    Args:
        model: Compiled model.
        camera: Free camera.
        area: Area of the 3D view.
        point: The point [m], (3,).
    """
    azimuth, lift = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array([math.cos(lift) * math.cos(azimuth), math.cos(lift) * math.sin(azimuth), math.sin(lift)])
    across = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    up, away = np.cross(across, forward), point - (camera.lookat - camera.distance * forward)
    pixel = 2.0 * float(away @ forward) * math.tan(math.radians(0.5 * model.vis.global_.fovy)) / area.height
    centre = area.left + 0.5 * area.width, area.bottom + 0.5 * area.height
    return centre + np.array([away @ across, away @ up]) / pixel, pixel * across, pixel * up

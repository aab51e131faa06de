"""3D view of the page: device, walls, stick position, forces; drags of the knob."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import trimesh
from trimesh import creation
from trimesh.transformations import quaternion_matrix
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from maglev_mj.colours import FIRST, STUCK, TOUCHED, WALL
from maglev_mj.frames import Array, quaternion, rotation_matrix
from maglev_mj.plants.shapes import RIM, Shape, coil_colour, shapes, wall_box
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot
from maglev_mj.views.handle import FORCES, dragged_pose, force_arrows
from maglev_mj.views.readings import banner
from maglev_mj.views.viewer_process import SILENCE

_LOOKS = {"frame": (0.9, 0.38), "steel": (0.7, 0.4), "base": (0.25, 0.45), "psd": (0.2, 0.08), "grip": (0.0, 0.75)}
_LOOK = 0.5, 0.35
"""Metallic and roughness factors of the model's materials; default."""

_GAMMA = 2.2  # glTF colours are linear
_MIN_SIDES, _SIDES_PER_METRE, _MAX_SIDES = 8, 2000.0, 48
"""Number of sides of round shapes: even, larger for larger shapes."""


def glb(shapes: Sequence[Shape]) -> bytes:
    """Return shapes as binary glTF, one mesh per material."""
    scene, looks = trimesh.Scene(), [(shape.material, tuple(shape.colour)) for shape in shapes]
    for look in sorted(set(looks)):
        mesh = _joined([solid(shape) for shape, each in zip(shapes, looks) if each == look])
        material, (*colour, opacity) = look
        surface: dict[str, Any] = dict(zip(("metallicFactor", "roughnessFactor"), _LOOKS.get(material, _LOOK)))
        surface["baseColorFactor"] = [*np.power(colour, _GAMMA), opacity]
        surface["alphaMode"] = "OPAQUE" if opacity == 1.0 else "BLEND"
        mesh.visual = TextureVisuals(material=PBRMaterial(**surface))
        scene.add_geometry(mesh)
    data: bytes = scene.export(file_type="glb")
    return data


def solid(shape: Shape) -> trimesh.Trimesh:
    """Return a shape as a mesh in place, with sharp edges and smooth round sides."""
    mesh = _unit(shape.kind, min(_MIN_SIDES + 2 * int(_SIDES_PER_METRE * max(shape.half[:2])), _MAX_SIDES)).copy()
    mesh.apply_scale(shape.half)
    mesh.apply_transform(quaternion_matrix(shape.turn))
    mesh.apply_translation(shape.position)
    return mesh


@lru_cache(maxsize=64)
def _unit(kind: str, sides: int) -> trimesh.Trimesh:
    if kind == "ellipsoid":
        return creation.uv_sphere(1.0, count=(sides // 2, sides // 2))  # twice as many around the axis
    mesh = creation.box((2.0, 2.0, 2.0)) if kind == "box" else creation.cylinder(1.0, 2.0, sections=sides)
    facing = np.round(mesh.face_normals @ ([1.0, 2.0, 3.0] if kind == "box" else [0.0, 0.0, 1.0]))
    return _joined(mesh.submesh([np.flatnonzero(facing == side) for side in np.unique(facing)]))  # no shared vertices


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    return cast(trimesh.Trimesh, trimesh.util.concatenate(meshes))


_PUSH = 3.0
"""Displacement of the target by an arrow key, in ranges, as by a gamepad's full deflection."""

Aim = Callable[[list[float] | None], object]
"""Receives a target pose [m, rad], (6,); None on release."""


class Grab:
    """Drags of the knob: plain drags translate, Shift tilts; one browser at a time.

    All methods run in viser's event loop.

    Args:
        server: viser's server.
        knob: Scene node to drag.
        aim: Called with each target.
        scene: Initial scene.

    Attributes:
        pose: Pose of the flotor [m, rad], (6,).
        scene: Scene in use.
    """

    def __init__(self, server: Any, knob: Any, aim: Aim, scene: Scene) -> None:
        self._server, self._aim, self.scene = server, aim, scene
        self._holder: int | None = None
        self._monitor: asyncio.Task[None] | None = None
        self._tilts = self._unresponsive = False
        self.pose = self._start_pose = np.zeros(6)
        self._start, self._target = np.zeros(3), [0.0] * 6
        for modifier in (None, "shift"):
            knob.on_drag("left", modifier=modifier)(self._dragged)

    async def _dragged(self, event: Any) -> None:
        if event.phase == "start" and (self._holder is None or self._unresponsive):
            self._release()
            self._holder, self._tilts = event.client_id, event.modifier == "shift"
            self._start_pose, self._start = self.pose, np.array(event.start_position)
            self._monitor = asyncio.create_task(self._watch(event.client_id))
        if event.client_id != self._holder:
            return
        if event.phase == "end":
            self._release()
        else:
            moved = np.array(event.end_position) - self._start
            self._target = dragged_pose(self._start_pose, moved, self.scene.hardware.knob, tilts=self._tilts).tolist()
            self._aim(self._target)

    async def push(self, event: Any) -> None:
        """Drag the knob by a browser's arrow keys: the value names signed axes, such as "+x-z"."""
        signs = [(f"+{axis}" in event.target.value) - (f"-{axis}" in event.target.value) for axis in "xyz"]
        phase = "end" if not any(signs) else "update" if self._holder == event.client_id else "start"
        end = self._start + _PUSH * self.scene.body.bounded.range[:3] * signs
        at = {"modifier": None, "start_position": self._start, "end_position": end}
        await self._dragged(SimpleNamespace(phase=phase, client_id=event.client_id, **at))

    def _release(self) -> None:
        self._holder, self._unresponsive = None, False
        if self._monitor is not None:
            self._monitor.cancel()
        self._aim(None)

    async def _watch(self, client: int) -> None:
        """Release the knob while its browser does not respond: a drag held still sends no messages."""
        while self._holder == client:
            response = asyncio.ensure_future(self._ping(client))
            self._unresponsive = not (await asyncio.wait([response], timeout=SILENCE))[0]
            if self._unresponsive:
                self._aim(None)
                await asyncio.wait([response])
            if self._holder != client:
                return
            if response.exception() is not None:  # disconnected: its drag may never end
                self._release()
                return
            if self._unresponsive:
                self._unresponsive = False
                self._aim(self._target)
            await asyncio.sleep(SILENCE / 5.0)

    async def _ping(self, client: int) -> None:
        """Wait for a browser's pong; viser reports closed connections, but not suspended browsers.

        Raises:
            Exception: If the browser is disconnected.
        """
        await (await self._server._websock_server._live_connections[client].ping())


VIEWS = {
    "home": ((0.194, -0.309, 0.234), (0.0, 0.0, 0.037)),
    "front": ((0.0, -0.36, 0.05), (0.0, 0.0, 0.02)),
    "top": ((0.0, -0.02, 0.40), (0.0, 0.0, 0.03)),
    "knob": ((0.09, -0.13, 0.14), (0.0, 0.0, 0.072)),
}
"""Camera presets: position and target [m]."""

_WIDTH = 0.175  # of the device with a margin [m]
FIELD = 0.62
"""Vertical field of view [rad]."""
_FAINT, _LIT = 0.07, 0.36
_SKY = (206.0, 213.0, 224.0), (247.0, 248.0, 250.0)
"""Background colours, top and bottom."""
_FLOOR = -0.0552
_REACH = 1.27  # radius of the invisible ball that can be grabbed, in radii of the knob
_GHOST_SIZE = 1.06
_EDGE, _SHADE = 0.001, 0.85
"""Thickness [m] and brightness of a wall's edge."""
_ARROW = {"shaft_radius": 0.0013, "head_radius": 0.0032, "head_length": 0.0065}
"""Sizes of a long arrow [m]."""
_ABOVE = 0.037
"""Height of the text above the knob's centre [m]."""


def update(handle: Any, **properties: Any) -> None:
    """Set only the properties of a viser element that differ; viser would resend unchanged ones to every browser."""
    for name, value in properties.items():
        if not np.array_equal(getattr(handle, name), value):
            setattr(handle, name, value)


def look(client: Any, view: str) -> None:
    """Set a browser's camera to a preset."""
    camera = client.camera
    with client.atomic():
        camera.position, camera.look_at = placed(view, camera.image_width, camera.image_height)


def placed(view: str, width: int, height: int) -> tuple[Array, Array]:
    """Return position and target of a camera [m], (3,) each, far enough to fit the device into a narrow picture.

    Args:
        view: One of VIEWS.
        width: Width of the picture [px].
        height: Height of the picture [px].
    """
    position, target = np.array(VIEWS[view])
    back = position - target
    visible = 2.0 * np.linalg.norm(back) * np.tan(0.5 * FIELD) * width / max(height, 1)
    return target + back * max(_WIDTH / max(visible, 1e-3), 1.0), target


class Stage:
    """3D view of a scene.

    Args:
        server: viser's server.
        snapshot: Initial snapshot.

    Attributes:
        knob: Scene node to drag.
        hint: Text above the knob; empty for none.
    """

    def __init__(self, server: Any, snapshot: Snapshot) -> None:
        self._server, scene = server, server.scene
        server.initial_camera.position, server.initial_camera.look_at = VIEWS["home"]
        server.initial_camera.fov, server.initial_camera.near = FIELD, 0.005
        scene.configure_environment_map("studio", environment_intensity=0.4)
        scene.configure_default_lights(False)
        scene.add_light_directional("/light", intensity=1.6, position=(0.3, -0.4, 0.8))
        scene.set_background_image(np.linspace(*_SKY, 256).astype(np.uint8)[:, None], format="png")
        scene.add_image("/shadow", _shadow(), 0.24, 0.24, position=(0.0, 0.0, _FLOOR + 2e-4), **_PLAIN)
        scene.add_grid(
            "/floor",
            width=1.0,
            height=1.0,
            cell_size=0.01,
            section_size=0.05,
            cell_color=(214, 218, 224),
            section_color=(196, 201, 208),
            fade_distance=0.62,
            fade_strength=1.5,
            position=(0.0, 0.0, _FLOOR),
        )
        self._flotor = scene.add_frame("/flotor", show_axes=False)
        # as glTF: viser's own transparent sphere would occlude the walls behind it
        knob = snapshot.scene.hardware.knob
        reach = np.full(3, _REACH * knob.radius)
        ball = Shape(True, "ellipsoid", reach, knob.centre, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
        self.knob = scene.add_glb("/flotor/knob", glb([ball]), **_PLAIN)
        size = _GHOST_SIZE * knob.half
        self._ghost = scene.add_icosphere(
            "/stuck", 1.0, rgb(STUCK), scale=tuple(size), opacity=0.45, visible=False, **_PLAIN
        )
        radius, half = knob.radius * np.array(RIM)
        self._rim = scene.add_cylinder("/flotor/rim", radius, 2.0 * half, rgb(TOUCHED), visible=False, **_PLAIN)
        self._rim.position = 0.0, 0.0, knob.bottom + half
        points = np.array([[knob.centre, 1.001 * knob.centre]], dtype=np.float32)  # inside the knob
        self._forces: dict[str, tuple[Any, Any]] = {}
        for name, colour in FORCES.items():
            shade = rgb([part**_GAMMA for part in colour])  # viser expects linear colours for arrows
            shaft = scene.add_arrows(f"/forces/{name}", points, shade, visible=False, **_ARROW)
            number = scene.add_label(f"/numbers/{name}", "0.0 N", anchor="center-center", visible=False)
            self._forces[name] = shaft, number
        self._walls: list[Any] = []
        self._edges = scene.add_line_segments("/edges", np.zeros((1, 2, 3)), rgb(WALL), thickness=_EDGE)
        place = 0.0, 0.0, knob.height + _ABOVE
        self._label = scene.add_label("/word", "", position=place, anchor="bottom-center", visible=False)
        self._model: Any = None
        self._beside: list[Any] = []
        self._coils: dict[int, Any] = {}
        self.hint = ""
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if (type(snapshot.scene), snapshot.scene.model) != self._model:
            self._load(snapshot)
        for node, row in zip(self._beside, snapshot.beside):
            update(node, position=np.round(row[:3], 5), wxyz=np.round(row[3:], 5), visible=True)
        for coil, winding in self._coils.items():
            update(winding, color=rgb(coil_colour(self._copper, snapshot.currents[coil], snapshot.scene.hardware)))
        self._set_pose(self._flotor, snapshot.pose)
        arrows = force_arrows(snapshot)
        for name, (shaft, number) in self._forces.items():
            if (arrow := arrows.get(name)) is not None:
                points = np.round([[arrow.start, arrow.end]], 5).astype(np.float32)
                update(shaft, points=points, **{name: round(arrow.size * size, 6) for name, size in _ARROW.items()})
                update(number, text=arrow.text or number.text, position=np.round(arrow.place, 4))
            # last, since a busy browser applies visibility before the rest
            update(shaft, visible=arrow is not None)
            update(number, visible=arrow is not None and bool(arrow.text))
        self._show_walls(snapshot)
        if (ghost := snapshot.ghost) is not None:
            place = ghost[:3] + rotation_matrix(ghost[3:]) @ snapshot.scene.hardware.knob.centre
            self._set_pose(self._ghost, np.concatenate([place, ghost[3:]]))
            update(self._ghost, color=rgb(FIRST if len(snapshot.first) else STUCK))
        update(self._ghost, visible=ghost is not None)
        content = banner(snapshot)
        hint = "" if "stops" in arrows else self.hint  # whose arrow may point to its place
        text = hint if content is None else content.text.split(":")[0]
        update(self._label, visible=bool(text), text=text or self._label.text)  # viser draws an empty one as a bar

    def _set_pose(self, node: Any, pose: Array) -> None:
        update(node, position=np.round(pose[:3], 6), wxyz=np.round(quaternion(pose[3:]), 6))

    def _load(self, snapshot: Snapshot) -> None:
        """Load the device of a snapshot's scene."""
        self._model, scene = (type(snapshot.scene), snapshot.scene.model), self._server.scene
        for node in self._beside:
            node.remove()
        self._beside = [
            scene.add_glb(f"/beside/{index}", glb([shape._replace(turn=_UPRIGHT)]), visible=False, **_PLAIN)
            for index, shape in enumerate(snapshot.scene.beside())
        ]
        nodes: dict[str, list[Shape]] = {}
        for shape in shapes(snapshot.scene.model, snapshot.scene.hardware):
            rest = "flotor/rest" if shape.moves else "device"
            nodes.setdefault(shape.coil or rest, []).append(shape)
        for node in self._coils.values():
            node.remove()
        self._coils = {}
        for name, parts in nodes.items():
            if name.startswith("coil"):
                mesh, coil = _joined([solid(shape) for shape in parts]), int(name[4:])
                self._coils[coil] = scene.add_mesh_simple(f"/flotor/{name}", mesh.vertices, mesh.faces, **_PLAIN)
                self._copper = parts[0].colour
            else:
                scene.add_glb(f"/{name}", glb(parts), **_PLAIN)

    def _show_walls(self, snapshot: Snapshot) -> None:
        """Show the walls as one box; those in contact are lit."""
        plates, edges = wall_box(snapshot.faces, snapshot.scene.hardware.knob)
        lit = {face for face in snapshot.faces if face[1] * (snapshot.pose[face[0]] - face[2]) <= 0.0}
        update(self._rim, visible=any(axis > 2 for axis, _, _ in lit))
        while len(self._walls) < len(plates):
            name = f"/walls/{len(self._walls)}"
            self._walls.append(self._server.scene.add_box(name, side="double", opacity=_FAINT, **_PLAIN))
        for wall in self._walls[len(plates) :]:
            update(wall, visible=False)
        for wall, (face, (centre, half)) in zip(self._walls, plates.items()):
            colour, opacity = (TOUCHED, _LIT) if face in lit else (WALL, _FAINT)
            place = {"position": np.round(centre, 6), "dimensions": tuple(np.round(2.0 * half, 6))}
            update(wall, color=rgb(colour), opacity=opacity, **place, visible=True)
        edges = edges or [(np.zeros((2, 3)), [])]  # no walls: one point, since viser cannot draw an empty set
        colours = [[rgb(_SHADE * np.array(WALL if lit.isdisjoint(walls) else TOUCHED))] * 2 for _, walls in edges]
        points = np.array([ends for ends, _ in edges], np.float32)
        update(self._edges, points=points, colors=np.array(colours, np.uint8))


_UPRIGHT = 1.0, 0.0, 0.0, 0.0
_PLAIN = {"cast_shadow": False, "receive_shadow": False}


def _shadow() -> Any:
    """Return the soft shadow of the base on the floor, (H, W, 4)."""
    across = np.linspace(-0.12, 0.12, 128)
    shade = np.full((128, 128, 4), (30.0, 36.0, 46.0, 130.0))
    shade[..., 3] /= 1.0 + np.exp((np.hypot(across, across[:, None]) - 0.074) / 0.0075)
    return shade.astype(np.uint8)


def rgb(colour: Sequence[float] | Array) -> tuple[int, int, int]:
    """Return a colour as red, green and blue from 0 to 255."""
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue

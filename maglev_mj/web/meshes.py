"""Triangle meshes of a device, one for each colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual.material import PBRMaterial

from maglev_mj.frames import Array
from maglev_mj.plants.shapes import Shape

_Faces: TypeAlias = NDArray[np.int64]
_Mesh: TypeAlias = tuple[Array, Array, _Faces]

_METALLIC, _ROUGHNESS = 0.1, 0.45
_GAMMA = 2.2  # glTF's colours are linear
_FEWEST, _PER_METRE, _MOST = 8, 2000.0, 48
"""Sides of round shapes: even, and more for larger shapes."""


def glb(shapes: Sequence[Shape]) -> bytes:
    """Return shapes as binary glTF, one mesh a colour."""
    scene = trimesh.Scene()
    for colour in sorted({tuple(shape.colour) for shape in shapes}):
        parts = [triangles(shape) for shape in shapes if tuple(shape.colour) == colour]
        first = np.cumsum([0, *(len(points) for points, _, _ in parts)])
        material = PBRMaterial(
            baseColorFactor=[*np.power(colour[:3], _GAMMA), colour[3]],
            metallicFactor=_METALLIC,
            roughnessFactor=_ROUGHNESS,
            alphaMode="OPAQUE" if colour[3] == 1.0 else "BLEND",
        )
        points, normals = (np.concatenate([part[index] for part in parts]) for index in (0, 1))
        faces = np.concatenate([part[2] + start for part, start in zip(parts, first)])
        visual = trimesh.visual.TextureVisuals(material=material)
        mesh = trimesh.Trimesh(points, faces, vertex_normals=normals, visual=visual, process=False)
        scene.add_geometry(mesh)
    made: bytes = scene.export(file_type="glb")
    return made


def triangles(shape: Shape) -> _Mesh:
    """Return corners, normals and triangles of a shape.

    Corners (N, 3) [m], their normals (N, 3), and triangles as indices of corners (M, 3).
    """
    sides = min(_FEWEST + 2 * int(_PER_METRE * max(shape.half[:2])), _MOST)
    points, normals, faces = {"box": _box, "cylinder": _cylinder, "ellipsoid": _ellipsoid}[shape.kind](sides)
    w, x, y, z = shape.turn
    turn = np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
    across = normals / shape.half
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return points * shape.half @ turn.T + shape.position, across @ turn.T, faces


def _grid(rows: int, columns: int) -> _Faces:
    """Return the triangles of a grid of corners."""
    corner = np.arange(rows * columns, dtype=np.int64).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    return np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)


def _box(_: int) -> _Mesh:
    points: list[Array] = []
    normals, faces = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            corners = np.empty((4, 3))
            corners[:, axis] = sign
            corners[:, (axis + 1) % 3] = np.array([-1.0, 1.0, -1.0, 1.0]) * sign
            corners[:, (axis + 2) % 3] = [-1.0, -1.0, 1.0, 1.0]
            faces.append(_grid(2, 2) + 4 * len(points))
            points.append(corners)
            normals.append(np.eye(3)[[axis] * 4] * sign)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(faces)


def _circle(sides: int) -> Array:
    angles = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(sides + 1)], -1)


def _cylinder(sides: int) -> _Mesh:
    rim, up, centre = _circle(sides), np.array([0.0, 0.0, 1.0]), np.zeros((sides + 1, 3))
    sheets = [(rim - up, rim + up, rim), (rim + up, centre + up, centre + up), (centre - up, rim - up, centre - up)]
    points = np.concatenate([part for low, high, _ in sheets for part in (low, high)])
    normals = np.concatenate([part for _, _, normal in sheets for part in (normal, normal)])
    faces = np.concatenate([_grid(2, sides + 1) + 2 * (sides + 1) * index for index in range(len(sheets))])
    return points, normals, faces


def _ellipsoid(sides: int) -> _Mesh:
    heights = np.linspace(-0.5 * np.pi, 0.5 * np.pi, sides // 2 + 1)[:, None, None]
    points = (np.cos(heights) * _circle(sides) + np.sin(heights) * [0.0, 0.0, 1.0]).reshape(-1, 3)
    return points, points, _grid(sides // 2 + 1, sides + 1)

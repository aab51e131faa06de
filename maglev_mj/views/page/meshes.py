"""Triangle meshes of a device, one for each colour."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import cast

import numpy as np
import trimesh
from trimesh import creation
from trimesh.transformations import quaternion_matrix
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from maglev_mj.plants.shapes import Shape

_METALLIC, _ROUGHNESS = 0.1, 0.45
_GAMMA = 2.2  # glTF's colours are linear
_FEWEST, _PER_METRE, _MOST = 8, 2000.0, 48
"""Sides of round shapes: even, and more for larger shapes."""


def glb(shapes: Sequence[Shape]) -> bytes:
    """Return shapes as binary glTF, one mesh a colour."""
    scene = trimesh.Scene()
    for colour in sorted({tuple(shape.colour) for shape in shapes}):
        mesh = _joined([solid(shape) for shape in shapes if tuple(shape.colour) == colour])
        mesh.visual = TextureVisuals(
            material=PBRMaterial(
                baseColorFactor=[*np.power(colour[:3], _GAMMA), colour[3]],
                metallicFactor=_METALLIC,
                roughnessFactor=_ROUGHNESS,
                alphaMode="OPAQUE" if colour[3] == 1.0 else "BLEND",
            )
        )
        scene.add_geometry(mesh)
    made: bytes = scene.export(file_type="glb")
    return made


def solid(shape: Shape) -> trimesh.Trimesh:
    """Return a shape in place, its edges sharp and its round sides smooth."""
    mesh = _unit(shape.kind, min(_FEWEST + 2 * int(_PER_METRE * max(shape.half[:2])), _MOST)).copy()
    mesh.apply_scale(shape.half)
    mesh.apply_transform(quaternion_matrix(shape.turn))
    mesh.apply_translation(shape.position)
    return mesh


@lru_cache(maxsize=64)
def _unit(kind: str, sides: int) -> trimesh.Trimesh:
    if kind == "ellipsoid":
        return creation.uv_sphere(1.0, count=(sides // 2, sides // 2))  # twice as many around
    mesh = creation.box((2.0, 2.0, 2.0)) if kind == "box" else creation.cylinder(1.0, 2.0, sections=sides)
    facing = np.round(mesh.face_normals @ ([1.0, 2.0, 3.0] if kind == "box" else [0.0, 0.0, 1.0]))
    return _joined(mesh.submesh([np.flatnonzero(facing == one) for one in np.unique(facing)]))  # which share no corners


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    return cast(trimesh.Trimesh, trimesh.util.concatenate(meshes))

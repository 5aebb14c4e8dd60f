"""Meshes with a color per vertex, and paint for objects that have none."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import trimesh

from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.human_hand import mirror_points
from fungrasp.media.surfaces import SurfaceMesh, linear
from fungrasp.objects import ObjectModel

CREASE = float(np.cos(np.radians(35.0)))
"""A corner's normal is smooth if it differs from its triangle's by no more than this angle (cosine)."""

EDGE = 0.006
"""Longest edge of a painted object's triangles [m]: the finest thing its paint can show."""


@dataclass(frozen=True)
class PaintedMesh:
    """A triangle mesh with colors."""

    vertices: np.ndarray
    """Positions of the vertices [m], object frame, shape [V, 3]."""
    faces: np.ndarray
    """Counter-clockwise from outside, shape [T, 3]."""
    colors: np.ndarray
    """sRGB from 0 to 1, shape [V, 3]."""

    def surface(self, specular: float = 0.1, shininess: float = 10.0) -> SurfaceMesh:
        """The mesh as it is drawn. specular, shininess: strength and exponent of the highlight."""
        normals = fine_mesh_normals(self.vertices, self.faces)
        return SurfaceMesh(self.vertices, self.faces, normals, linear(self.colors), specular, shininess)

    def moved(self, pose: np.ndarray) -> PaintedMesh:
        """The mesh at a pose, shape [7]."""
        return replace(self, vertices=transform_points(pose, self.vertices))


def fine_mesh_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals at the triangles' corners, those of the vertices except at creases, shape [T, 3, 3]
    float32. For meshes so fine that triangles beside a crease are small; ``rendering`` has one for all.
    """
    corners = vertices[faces]
    # The length of these is twice the triangle's area, by which it counts at its vertices.
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    vertex = np.stack(
        [np.bincount(faces.ravel(), np.repeat(weighted[:, k], 3), minlength=len(vertices)) for k in range(3)],
        axis=-1,
    )
    vertex /= np.maximum(np.linalg.norm(vertex, axis=-1, keepdims=True), 1e-300)
    flat = weighted / np.maximum(np.linalg.norm(weighted, axis=-1, keepdims=True), 1e-300)
    smooth = vertex[faces]
    soft = np.einsum("tci,ti->tc", smooth, flat) > CREASE
    return np.where(soft[..., None], smooth, flat[:, None]).astype(np.float32)


def mixed(a: np.ndarray, b: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Colors from ``a`` (part 0) to ``b`` (part 1). part: shape [V]. Returns shape [V, 3]."""
    return a + part[:, None] * (b - a)


@lru_cache(maxsize=64)
def painted_object(model: ObjectModel) -> PaintedMesh:
    """An object with paint of our own: one color per part, a band, a label and fine grain.

    The same object always gets the same paint: it is decided by the object's name.
    """
    rng = np.random.default_rng(zlib.crc32(model.name.encode()))
    vertices, faces, face_index = _fine(model)
    base, second, third = _palette(rng)
    colors = np.tile(base, (len(vertices), 1))
    parts = list(model.parts.values())
    if len(parts) > 1:
        for i, part in enumerate(parts):
            color = (base, second, third, 0.5 * (base + third))[i % 4]
            colors[np.unique(faces[part[face_index]])] = color
    low, size = vertices.min(0), np.ptp(vertices, axis=0)
    unit = (vertices - low) / size
    axis = int(np.argmax(size))
    middle, width = rng.uniform(0.3, 0.7), rng.uniform(0.08, 0.2)
    colors = mixed(colors, third, _step(width - np.abs(unit[:, axis] - middle), 0.02))
    label = np.stack([unit[:, axis] - middle, unit[:, (axis + 1) % 3] - rng.uniform(0.3, 0.7)], axis=-1)
    side = _step(unit[:, (axis + 2) % 3] - 0.5, 0.02)
    spot = _step(rng.uniform(0.10, 0.18) - np.linalg.norm(label * [1.0, 0.7], axis=1), 0.02) * side
    colors = mixed(colors, second, spot)
    waves = rng.normal(size=(3, 3)) * 2 * np.pi / 0.02
    grain = np.prod(np.sin(vertices @ waves.T + rng.uniform(0, 6, 3)), axis=1)
    return PaintedMesh(vertices, faces, np.clip(colors * (1 + 0.06 * grain[:, None]), 0.0, 1.0))


def _fine(model: ObjectModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces with no edge longer than ``EDGE``, and the face each came from."""
    fine: Any = trimesh.remesh.subdivide_to_size(
        model.vertices, model.faces, EDGE, max_iter=12, return_index=True
    )
    return fine[0], fine[1], fine[2]


def _palette(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    hue = rng.uniform(0, 1) + np.array([0.0, rng.uniform(0.25, 0.45), rng.uniform(0.55, 0.75)])
    saturation, value = rng.uniform(0.25, 0.85, 3), rng.uniform(0.3, 0.95, 3)
    phase = np.abs((hue[:, None] % 1.0 * 6 + [0, 4, 2]) % 6 - 3) - 1
    colors = value[:, None] * (1 - saturation[:, None] * (1 - np.clip(phase, 0, 1)))
    return colors[0], colors[1], colors[2]


def _step(x: np.ndarray, width: float) -> np.ndarray:
    return np.clip(0.5 + x / width, 0.0, 1.0)


def mirrored_mesh(mesh: PaintedMesh) -> PaintedMesh:
    """The mesh reflected in the plane y = 0."""
    return replace(mesh, vertices=mirror_points(mesh.vertices), faces=mesh.faces[:, ::-1].copy())

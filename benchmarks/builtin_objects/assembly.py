"""One watertight mesh, its parts and its convex pieces from convex solids with part names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from benchmarks.builtin_objects.shapes import Solid
from fungrasp.geometry.triangle_mesh import volume_and_center
from fungrasp.objects.mesh_repair import hull_solid, vertex_components

PartSolids = Mapping[str, Sequence[Solid]]
"""Convex solids by the name of the functional part they make up."""

GEOMETRY_TOLERANCE = 1e-8
"""Tolerance of lengths [m], and of volumes relative to them."""

SPECK = 1e-10
"""Volume below which a closed surface is rounding [m3]."""

FLAT = 1e-3
"""Normals whose angle is smaller belong to one face of the hull [rad]."""


def assemble(
    parts: PartSolids,
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], list[Solid]]:
    """Unite convex solids, turn them to where they come to rest, put the origin at their box's center.

    Returns:
        vertices: [m], shape [V, 3] float64.
        faces: outward, shape [F, 3] int32.
        masks: faces of each part, shape [F] bool each; a face belongs to exactly one part.
        pieces: the solids, those joined that are convex together.
    """
    solids = [points for part in parts.values() for points in part]
    names = [name for name, part in parts.items() for _ in part]
    hulls = [hull_solid(points).as_original() for points in solids]
    mesh = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add).to_mesh64()
    owner = {hull.original_id(): name for hull, name in zip(hulls, names, strict=True)}
    runs = np.diff(np.asarray(mesh.run_index, dtype=int)) // 3
    part_of_face = np.repeat([owner[int(i)] for i in mesh.run_original_id], runs)
    vertices, faces, kept_faces = _without_specks(
        mesh.vert_properties[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64)
    )
    part_of_face = part_of_face[kept_faces]
    turn = _resting_rotation(vertices, volume_and_center(vertices[faces])[1])
    vertices = vertices @ turn.T
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    masks = {name: part_of_face == name for name in parts}
    pieces = [points @ turn.T - center for points in _joined(solids)]
    return vertices - center, faces.astype(np.int32), masks, pieces


def _without_specks(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Without closed surfaces of less than ``SPECK``, which rounding leaves where solids meet.

    Returns:
        vertices, faces, and the rows of ``faces`` that were kept.
    """
    count, label = vertex_components(faces, len(vertices))
    label_of_face = label[faces[:, 0]]
    corners = vertices[faces]
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    large = np.abs(np.bincount(label_of_face, weights=volumes, minlength=count)) > SPECK
    kept_faces = np.flatnonzero(large[label_of_face])
    used, renumbered = np.unique(faces[kept_faces], return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3), kept_faces


def _joined(solids: Sequence[Solid]) -> list[Solid]:
    """The solids, pairs that are convex together joined, again and again."""
    left = list(solids)
    joined = []
    while left:
        points = left.pop(0)
        partner = next((k for k, other in enumerate(left) if _convex_together(points, other)), None)
        if partner is None:
            joined.append(points)
        else:
            left.insert(0, np.concatenate([points, left.pop(partner)]))
    return joined


def _convex_together(a: Solid, b: Solid) -> bool:
    """Whether the hull of two solids is no larger than their union."""
    if np.any(a.min(axis=0) > b.max(axis=0) + GEOMETRY_TOLERANCE) or np.any(
        b.min(axis=0) > a.max(axis=0) + GEOMETRY_TOLERANCE
    ):
        return False
    first, second = hull_solid(a), hull_solid(b)
    hull = hull_solid(np.concatenate([a, b])).volume()
    if hull * (1 - GEOMETRY_TOLERANCE) > first.volume() + second.volume():
        return False
    return hull * (1 - GEOMETRY_TOLERANCE) <= (first + second).volume()


def _resting_rotation(vertices: np.ndarray, center_of_mass: np.ndarray) -> np.ndarray:
    """The smallest rotation after which an object is stable: its center of mass is above a face of its hull.

    Args:
        vertices: [m], shape [V, 3].
        center_of_mass: [m], shape [3].

    Returns:
        Rotation matrix, shape [3, 3]; the identity if it stands already.
    """
    hull = ConvexHull(vertices)
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    for row in np.argsort(normals[:, 2]):
        normal = normals[row]
        face = np.linalg.norm(normals - normal, axis=1) < FLAT
        foot = center_of_mass - (normal @ center_of_mass + offsets[row]) * normal
        if any(_inside(vertices[corners], foot, normal) for corners in hull.simplices[face]):
            if normal[2] < -1 + FLAT**2:
                return np.eye(3)
            return Rotation.align_vectors([[0, 0, -1]], [normal])[0].as_matrix()
    raise AssertionError("the center of mass lies inside the hull, so it is above one of its faces")


def _inside(triangle: np.ndarray, point: np.ndarray, normal: np.ndarray) -> bool:
    turns = [np.cross(triangle[(k + 1) % 3] - triangle[k], point - triangle[k]) @ normal for k in range(3)]
    return bool(min(turns) >= -1e-12 or max(turns) <= 1e-12)

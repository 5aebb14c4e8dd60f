"""Basic triangle mesh functions without trimesh, whose import takes a third of a second."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull

if TYPE_CHECKING:
    import trimesh


def triangle_mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """Create a trimesh mesh with unchanged vertices and faces, importing trimesh on the first call.

    Args:
        vertices: [m], shape [V, 3].
        faces: vertex indices, shape [F, 3].
    """
    import trimesh

    return trimesh.Trimesh(vertices, faces, process=False)


def volume_and_center(triangles: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the volume and center of mass of a closed surface, by surface integrals (Eberly, Polyhedral
    mass properties, 2002).

    Args:
        triangles: outward [m], shape [F, 3, 3].

    Returns:
        volume [m3], negative if the faces point inward; center of mass [m], shape [3].
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    total = a + b + c
    squares = a**2 + b**2 + a * b + c * total
    across = np.cross(b - a, c - b)
    integrals = np.empty((4, len(triangles)))
    integrals[0], integrals[1:] = across[:, 0] * total[:, 0], (across * squares).T
    sums = integrals.sum(axis=1) / [6, 24, 24, 24]
    return float(sums[0]), sums[1:] / sums[0]


def normals_and_areas(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals, zero for degenerate triangles, shape [F, 3], and areas, shape [F], of triangles
    [F, 3, 3]."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 1])
    length = np.sqrt(np.square(across) @ np.ones(3))
    return across * (1.0 / np.maximum(length, 1e-300))[:, None], 0.5 * length


def hull_triangles(points: np.ndarray) -> np.ndarray:
    """Return the outward triangles of the convex hull of points, without degenerate ones.

    Args:
        points: [m], shape [P, 3], not all in one plane.

    Returns:
        [m], shape [F, 3, 3].
    """
    # Flat objects need scaling to a unit box.
    hull = ConvexHull(points, qhull_options="QbB Pp Qt")
    triangles = hull.points[hull.simplices]
    normals, areas = normals_and_areas(triangles)
    backwards = np.sum(normals * hull.equations[:, :3], axis=1) < 0
    triangles[backwards] = triangles[backwards, ::-1]
    return triangles[areas > 1e-14]

"""Meshes for pictures with fewer faces."""

from __future__ import annotations

import manifold3d
import numpy as np

from fungrasp.geometry.shell_from_triangles import shell_from_triangles

MAX_FACES = 4000
"""Of a mesh for pictures; finer ones are coarsened."""

FIRST_TOLERANCE, LAST_TOLERANCE = 1e-4, 5e-3
"""By how much a step of simplifying may move a surface at first and at last [m]."""

SHELL = 2e-3
"""Thickness of the shell that takes the place of a surface that is not closed [m]."""


def coarse(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A surface of at most about ``MAX_FACES``, without holes where there were none.

    Args:
        vertices: [m], shape [V, 3].
        faces: shape [F, 3].
    """
    if len(faces) <= MAX_FACES:
        return vertices, faces
    # Files of triangles name each corner anew.
    places, which = np.unique(np.round(vertices, 7), axis=0, return_inverse=True)
    corners = which.reshape(-1)[faces]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    solid = _solid(places, corners[whole])
    if solid.status() != manifold3d.Error.NoError:
        solid = _solid(*shell_from_triangles(vertices[faces], SHELL)[:2])
    tolerance = FIRST_TOLERANCE
    while solid.num_tri() > MAX_FACES and tolerance < LAST_TOLERANCE:
        solid = solid.simplify(tolerance)
        tolerance *= 1.5
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(int)


def _solid(vertices: np.ndarray, faces: np.ndarray) -> manifold3d.Manifold:
    return manifold3d.Manifold(manifold3d.Mesh64(vertices.astype(float), faces.astype(np.uint64)))

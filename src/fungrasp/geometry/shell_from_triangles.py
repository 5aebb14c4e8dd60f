"""Closed surface at a distance around arbitrary triangles, from a distance grid."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from fungrasp.geometry.signed_distance import points_on_triangles

MOST_CORNERS = 2_000_000
"""Maximum number of grid corners."""

MOST_CELLS = 50_000
"""Approximate maximum number of grid cells that the triangles intersect."""

MOST_SAMPLES = 3_000_000
"""Approximate maximum number of points sampled on the triangles."""

AT_ONCE = 200_000
"""Triangles that are sampled at a time, to limit memory."""

# Six tetrahedra around the diagonal of a cube, as corner offsets, shape [6, 4, 3].
_TETRAHEDRA = np.array(
    [
        np.concatenate([np.zeros((1, 3)), np.cumsum(np.eye(3)[list(order)], axis=0)])
        for order in itertools.permutations(range(3))
    ],
    dtype=int,
)


def shell_from_triangles(triangles: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the closed surface at half the thickness from the triangles, with cavities filled.

    Args:
        triangles: [m], shape [F, 3, 3].
        thickness: shell thickness [m]; increased if the grid would be too fine.

    Returns:
        vertices: [m], shape [V, 3].
        faces: outward, shape [G, 3]; closed.
        thickness: thickness that was used [m].
    """
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    area = 0.5 * np.linalg.norm(np.cross(*np.moveaxis(np.diff(triangles, axis=1), 1, 0)), axis=1).sum()
    spacing = max(thickness / 2, float(np.sqrt(area / MOST_CELLS)))
    thickness = 2 * spacing
    for _ in range(100):
        border = 3 * spacing + thickness / 2
        shape = np.ceil((high - low + 2 * border) / spacing).astype(int) + 1
        if np.prod(shape, dtype=float) <= MOST_CORNERS:
            break
        spacing *= 1.05
        thickness = 2 * spacing
    origin = low - border
    gap = max(spacing / 2, float(np.sqrt(area / MOST_SAMPLES)))
    points = (
        _thinned(
            np.concatenate(
                [
                    _thinned(points_on_triangles(triangles[i : i + AT_ONCE], gap)[0] - origin, gap / 2)
                    for i in range(0, len(triangles), AT_ONCE)
                ]
            ),
            gap / 2,
        )
        + origin
    )
    # The import takes as long as NumPy's, and shells are rare.
    from scipy import ndimage

    touched = np.zeros(shape, dtype=bool)
    touched[tuple(np.round((points - origin) / spacing).astype(int).T)] = True
    steps: Any = ndimage.distance_transform_edt(~touched)
    band = np.flatnonzero(steps.ravel() <= thickness / 2 / spacing + 2.5)
    values = np.full(steps.size, spacing)
    corners = origin + spacing * np.stack(np.unravel_index(band, shape), axis=1)
    values[band] = KDTree(points).query(corners, workers=-1)[0] - thickness / 2
    values = values.reshape(shape)
    # Fill cavities that are not connected to the outside.
    parts: Any = ndimage.label(values > 0)
    values = np.where((parts[0] > 0) & (parts[0] != parts[0][0, 0, 0]), -spacing, values)
    vertices, faces = zero_surface(values)
    return origin + spacing * vertices, faces, thickness


def _thinned(points: np.ndarray, width: float) -> np.ndarray:
    """Return one of the points, shape [N, 3], in each cube of a width [m]."""
    cells = (points / width).astype(np.int64)
    sides = cells.max(axis=0) + 1
    codes = (cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2]
    order = np.argsort(codes)
    return points[order[np.append(True, np.diff(codes[order]) > 0)]]


def zero_surface(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the zero level set of grid values, by marching tetrahedra (Doi and Koide, 1991). It is closed if
    no border value is negative.

    Args:
        values: values at the grid corners, shape [X, Y, Z].

    Returns:
        vertices: in units of cells, shape [V, 3].
        faces: facing the non-negative side, shape [F, 3].
    """
    shape = np.array(values.shape)
    stride = np.array([shape[1] * shape[2], shape[2], 1])
    inside = values < 0
    cubes = np.stack([inside[tuple(slice(o, s - 1 + o) for o, s in zip(corner, shape, strict=True))]
                      for corner in np.ndindex(2, 2, 2)])  # fmt: skip
    crossed = np.argwhere(cubes.any(axis=0) & ~cubes.all(axis=0)) @ stride
    tetrahedra = (crossed[:, None, None] + _TETRAHEDRA @ stride).reshape(-1, 4)
    flat = values.ravel()
    # Sort the corners of each tetrahedron, inner corners first, and count the inner corners.
    order = np.argsort(flat[tetrahedra] >= 0, axis=1, kind="stable")
    sorted_corners = np.take_along_axis(tetrahedra, order, axis=1)
    count = (flat[tetrahedra] < 0).sum(axis=1)
    one, two, three = (sorted_corners[count == n] for n in (1, 2, 3))
    edges = np.concatenate([
        one[:, [[0, 1], [0, 2], [0, 3]]],
        three[:, [[0, 3], [1, 3], [2, 3]]],
        two[:, [[0, 2], [0, 3], [1, 3]]],
        two[:, [[0, 2], [1, 3], [1, 2]]],
    ])  # fmt: skip
    # An edge is identified by its inner and outer corner.
    codes, faces = np.unique(edges[..., 0] * flat.size + edges[..., 1], return_inverse=True)
    faces = faces.reshape(-1, 3)
    inner, outer = np.divmod(codes, flat.size)
    part = flat[inner] / (flat[inner] - np.maximum(flat[outer], 1e-9))
    inner_at, outer_at = (np.stack(np.unravel_index(i, values.shape), axis=1) for i in (inner, outer))
    vertices = inner_at + np.clip(part, 1e-4, 1 - 1e-4)[:, None] * (outer_at - inner_at)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    ways = (outer_at - inner_at)[faces].sum(axis=1)
    turned = np.sum(np.cross(b - a, c - a) * ways, axis=1) < 0
    faces[turned] = faces[turned, ::-1]
    return vertices, faces

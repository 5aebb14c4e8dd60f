"""The surface that several depth images agree on: a truncated signed distance on a grid (Curless and Levoy,
1996).

A cell that no view has seen through is taken for the inside, so that the mesh is closed: what no view shows
becomes as large as the views allow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from scipy import ndimage
from trimesh.visual import ColorVisuals

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.geometry.shell_from_triangles import zero_surface
from fungrasp.objects.mesh_repair import simplify
from fungrasp.perception.io.capture import depth_noise
from fungrasp.perception.scan.table_view import TableView, depth_at

TRUNCATION = 4.0
"""Distances are cut off at so many cells."""

MOST_CELLS = 12_000_000
"""A grid with more takes too much memory."""

BORDER = 0.012
"""The grid reaches so far beyond the points that were seen [m]."""

HIDDEN = 0.5
"""A cell at which no view saw anything is inside if it is behind what is seen in this part of the views, else
outside: behind it there was no depth."""

NEAR_TABLE = 0.004
"""Below this height object and table can't be told apart [m]; the object goes on straight down to the
table."""

SMOOTHING = 0.7
"""Standard deviation of the filter against noise [cells]."""

MOST_FACES = 20_000
"""The mesh has no more triangles."""

SAME = 0.006
"""A point of the mesh is seen in a view if depth there is so near to it [m]."""


def fused_mesh(views: Sequence[TableView], cell: float) -> trimesh.Trimesh:
    """The mesh of the object that stands on the table in all views, with colors.

    Args:
        views: in one table frame.
        cell: edge of the grid's cells [m].

    Returns:
        Closed, table frame, colors per vertex.

    Raises:
        FungraspError: the grid would be too large, or the views agree on no surface.
    """
    seen = np.concatenate([view.points for view in views])
    low, high = np.percentile(seen, (0.2, 99.8), axis=0)
    low, high = low - BORDER, high + BORDER
    low[2] = -2 * cell
    shape = np.ceil((high - low) / cell).astype(int) + 1
    if np.prod(shape.astype(float)) > MOST_CELLS:
        raise FungraspError(
            f"a grid of {shape[0]} x {shape[1]} x {shape[2]} cells is too large: give a cell larger than "
            f"{1000 * cell:g} mm, or keep other things away from the object"
        )
    values = _signed_distance(views, low, shape, cell)
    values = ndimage.gaussian_filter(values, SMOOTHING)
    # What stands on the table goes on down to it; below it there is nothing.
    height = low[2] + cell * np.arange(shape[2])
    first = int(np.searchsorted(height, NEAR_TABLE))
    values[:, :, :first] = values[:, :, first : first + 1]
    values[:, :, height < -0.5 * cell] = 1.0
    for axis in range(3):
        border = [slice(None)] * 3
        border[axis] = [0, -1]  # type: ignore[call-overload]
        values[tuple(border)] = 1.0
    vertices, faces = zero_surface(_largest(values))
    if not len(faces):
        raise FungraspError("the views agree on no surface: are they of the same object, standing as before?")
    mesh = trimesh.Trimesh(low + cell * vertices, faces, process=False)
    mesh, _ = simplify(mesh, MOST_FACES)
    mesh.visual = ColorVisuals(mesh, vertex_colors=_colors(np.array(mesh.vertices), views))
    return mesh


def _signed_distance(
    views: Sequence[TableView], low: np.ndarray, shape: np.ndarray, cell: float
) -> np.ndarray:
    """Truncated signed distance, -1 to 1; shape of the grid."""
    axes = [low[k] + cell * np.arange(shape[k]) for k in range(3)]
    band = TRUNCATION * cell
    total, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    hidden = np.zeros(shape, np.uint8)
    # Layer by layer, so that memory stays small.
    x, y = np.meshgrid(axes[0], axes[1], indexing="ij")
    for k, z in enumerate(axes[2]):
        points = np.stack([x, y, np.full_like(x, z)], axis=-1)
        for view in views:
            there = inverse_transform_points(view.pose_table_camera, points.reshape(-1, 3))
            depth = depth_at(view, there)
            off = depth - there[:, 2]
            known = (depth > 0) & (off > -band)
            # Noise grows with distance: a near view knows more.
            trust = np.where(known, (depth_noise(np.ones(())) / depth_noise(depth)) ** 2, 0.0).reshape(
                x.shape
            )
            total[:, :, k] += trust * np.clip(off / band, -1.0, 1.0).reshape(x.shape)
            weight[:, :, k] += trust
            hidden[:, :, k] += ((depth > 0) & (off <= -band)).reshape(x.shape)
    unseen = np.where(hidden >= HIDDEN * len(views), -1.0, 1.0)
    return np.where(weight > 0, total / np.maximum(weight, 1e-9), unseen)


def _largest(values: np.ndarray) -> np.ndarray:
    """The values with only the largest inside; the rest becomes outside."""
    names, count = ndimage.label(values < 0)  # type: ignore[reportGeneralTypeIssues]
    if count < 2:
        return values
    size = np.bincount(names.ravel())
    size[0] = 0
    return np.where((names > 0) & (names != size.argmax()), 1.0, values)


def _colors(vertices: np.ndarray, views: Sequence[TableView]) -> np.ndarray:
    """Mean color of each vertex in the views that see it, gray where none does, uint8, shape [V, 3]."""
    total, count = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for view in views:
        there = inverse_transform_points(view.pose_table_camera, vertices)
        depth = depth_at(view, there)
        seen = (depth > 0) & (np.abs(depth - there[:, 2]) < SAME)
        u, v = np.rint(view.capture.intrinsics.project(there[seen])).astype(int).T
        total[seen] += view.capture.color[v, u]
        count[seen] += 1
    mean = total / np.maximum(count, 1)[:, None]
    return np.where(count[:, None] > 0, mean, 128).round().astype(np.uint8)

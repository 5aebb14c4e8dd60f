"""Signed distance queries for any array-API library; ``geometry.distance_queries`` has the compiled loops for
the CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fungrasp.geometry.poses import Array, array_namespace, norm, side_by_side


class GridArrays(NamedTuple):
    """O concatenated grids, for compiled loops."""

    values: np.ndarray
    """Values at all corners, shape [sum X Y Z], float32."""
    start: np.ndarray
    """Index of the first corner of each grid, shape [O]."""
    stride: np.ndarray
    """Index difference of neighboring corners along each axis, shape [O, 3]."""
    last: np.ndarray
    """Slightly less than the last corner's index along each axis, shape [O, 3]."""
    origin: np.ndarray
    """Position of the first corner [m], shape [O, 3]."""
    spacing: np.ndarray
    """Edge of a cell [m], shape [O]."""


def array_distances(grids: GridArrays, grid: Array, points: Array) -> tuple[Array, Array]:
    """Return signed distances and gradients as ``SignedDistanceBank.query`` does.

    Args:
        grids: on the device of the points.
        grid: index of each row's grid, shape [N] int.
        points: [m], shape [N, P, 3], object frame.
    """
    xp = array_namespace(points)
    cell = grids.spacing[grid][:, None, None]
    u = (points - grids.origin[grid][:, None]) / cell
    # NaN points are looked up at 0 and masked below.
    known = xp.isfinite(u)
    inside = xp.minimum(xp.where(known, xp.clip(u, min=0.0), 0.0), grids.last[grid][:, None])
    corner = xp.floor(inside)
    fx, fy, fz = (inside[..., k] - corner[..., k] for k in range(3))
    stride = grids.stride[grid][:, None]
    at = grids.start[grid][:, None] + xp.sum(xp.astype(corner, stride.dtype) * stride, axis=-1)
    sx, sy = stride[..., 0], stride[..., 1]
    v = grids.values
    c000, c001, c010, c011 = v[at], v[at + 1], v[at + sy], v[at + sy + 1]
    c100, c101, c110, c111 = v[at + sx], v[at + sx + 1], v[at + sx + sy], v[at + sx + sy + 1]
    d00, d01, d10, d11 = c100 - c000, c101 - c001, c110 - c010, c111 - c011
    e00, e01, e10, e11 = c000 + fx * d00, c001 + fx * d01, c010 + fx * d10, c011 + fx * d11
    near, far = e00 + fy * (e10 - e00), e01 + fy * (e11 - e01)
    x_near, x_far = d00 + fy * (d10 - d00), d01 + fy * (d11 - d01)
    y_near, y_far = e10 - e00, e11 - e01
    gradient = side_by_side(x_near + fz * (x_far - x_near), y_near + fz * (y_far - y_near), far - near) / cell
    # Outside the grid, add the distance to the border; its gradient points away from the border.
    beyond = (u - inside) * cell
    away = norm(beyond)
    gradient = xp.where(beyond != 0, beyond / xp.where(away > 0, away, 1.0), gradient)
    distance = near + fz * (far - near) + away[..., 0]
    nothing = ~xp.all(known, axis=-1)
    nan = float("nan")
    return xp.where(nothing, nan, distance), xp.where(nothing[..., None], nan, gradient)

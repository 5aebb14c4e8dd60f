"""Signed distances of points on any array-API library, as ``geometry.distance_queries`` has them in compiled
loops on the processor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fungrasp.geometry.poses import Array, array_namespace, norm, side_by_side


class GridArrays(NamedTuple):
    """Several grids one behind the other, for compiled loops; O grids."""

    values: np.ndarray
    """All corners, shape [sum X Y Z], float32."""
    start: np.ndarray
    """First corner of each grid, shape [O]."""
    stride: np.ndarray
    """Corners between neighbors along each axis, shape [O, 3]."""
    last: np.ndarray
    """Just less than the last corner's index along each axis, shape [O, 3]."""
    origin: np.ndarray
    """First corner's place [m], shape [O, 3]."""
    spacing: np.ndarray
    """Edge of a cell [m], shape [O]."""


def array_distances(grids: GridArrays, grid: Array, points: Array) -> tuple[Array, Array]:
    """What ``SignedDistanceBank.query`` returns.

    Args:
        grids: on the device of the points.
        grid: index of the grid of each row, shape [N] int.
        points: [m], shape [N, P, 3], that object's frame.
    """
    xp = array_namespace(points)
    cell = grids.spacing[grid][:, None, None]
    u = (points - grids.origin[grid][:, None]) / cell
    # NaN keeps to itself: where it is looked up does not matter.
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
    # Outside, the distance to the border is added, and leads away from it.
    beyond = (u - inside) * cell
    away = norm(beyond)
    gradient = xp.where(beyond != 0, beyond / xp.where(away > 0, away, 1.0), gradient)
    distance = near + fz * (far - near) + away[..., 0]
    nothing = ~xp.all(known, axis=-1)
    nan = float("nan")
    return xp.where(nothing, nan, distance), xp.where(nothing[..., None], nan, gradient)

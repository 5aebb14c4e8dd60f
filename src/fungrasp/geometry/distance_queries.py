"""Signed distance queries in compiled loops."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.array_distances import GridArrays
from fungrasp.geometry.compiling import compiled, compiled_part


@compiled_part
def _within(value: float, last: float) -> float:
    return 0.0 if value < 0.0 else last if value > last else value


@compiled
def signed_distances(
    grids: GridArrays, grid: np.ndarray, points: np.ndarray, distance: np.ndarray, gradient: np.ndarray
) -> None:
    """Write the results of ``SignedDistanceBank.query``."""
    for i in range(points.shape[0]):
        for p in range(points.shape[1]):
            at = (points[i, p, 0], points[i, p, 1], points[i, p, 2])
            value, x, y, z = signed_distance(grids, grid[i], at)
            distance[i, p] = value
            gradient[i, p, 0], gradient[i, p, 1], gradient[i, p, 2] = x, y, z


@compiled_part
def signed_distance(grids: GridArrays, grid: int, point):
    """Return the distance [m] and its gradient (x, y, z)."""
    h = grids.spacing[grid]
    ux = (point[0] - grids.origin[grid, 0]) / h
    uy = (point[1] - grids.origin[grid, 1]) / h
    uz = (point[2] - grids.origin[grid, 2]) / h
    if not math.isfinite(ux + uy + uz):
        return math.nan, math.nan, math.nan, math.nan
    lx, ly, lz = grids.last[grid, 0], grids.last[grid, 1], grids.last[grid, 2]
    ix, iy, iz = _within(ux, lx), _within(uy, ly), _within(uz, lz)
    cx, cy, cz = int(ix), int(iy), int(iz)
    fx, fy, fz = ix - cx, iy - cy, iz - cz
    sx, sy = grids.stride[grid, 0], grids.stride[grid, 1]
    at = grids.start[grid] + cx * sx + cy * sy + cz
    v = grids.values
    c000, c001, c010, c011 = v[at], v[at + 1], v[at + sy], v[at + sy + 1]
    at += sx
    c100, c101, c110, c111 = v[at], v[at + 1], v[at + sy], v[at + sy + 1]
    # Interpolate along x on the four edges of the cell, then along y, then along z.
    d00, d01, d10, d11 = c100 - c000, c101 - c001, c110 - c010, c111 - c011
    e00, e01, e10, e11 = c000 + fx * d00, c001 + fx * d01, c010 + fx * d10, c011 + fx * d11
    near, far = e00 + fy * (e10 - e00), e01 + fy * (e11 - e01)
    x_near, x_far = d00 + fy * (d10 - d00), d01 + fy * (d11 - d01)
    y_near, y_far = e10 - e00, e11 - e01
    distance = near + fz * (far - near)
    gx = (x_near + fz * (x_far - x_near)) / h
    gy = (y_near + fz * (y_far - y_near)) / h
    gz = (far - near) / h
    bx, by, bz = (ux - ix) * h, (uy - iy) * h, (uz - iz) * h
    away = math.sqrt(bx * bx + by * by + bz * bz)
    if away > 0:
        distance += away
        if bx != 0:
            gx = bx / away
        if by != 0:
            gy = by / away
        if bz != 0:
            gz = bz / away
    return distance, gx, gy, gz


@compiled_part
def distance_bound(grids: GridArrays, grid: int, point) -> float:
    """Return a lower bound of the distance [m] of a point, from one corner of the grid.

    A corner's value is too large by up to two half diagonals of a cell if it refers to a neighboring cell's
    surface point. The point is up to half a diagonal away from the corner: 2.6 cells in total.
    """
    h = grids.spacing[grid]
    ux = (point[0] - grids.origin[grid, 0]) / h
    uy = (point[1] - grids.origin[grid, 1]) / h
    uz = (point[2] - grids.origin[grid, 2]) / h
    if not math.isfinite(ux + uy + uz):
        return math.nan
    ix = _within(ux, grids.last[grid, 0])
    iy = _within(uy, grids.last[grid, 1])
    iz = _within(uz, grids.last[grid, 2])
    at = int(ix + 0.5) * grids.stride[grid, 0] + int(iy + 0.5) * grids.stride[grid, 1] + int(iz + 0.5)
    distance = grids.values[grids.start[grid] + at] - 3 * h
    away = h * math.sqrt((ux - ix) ** 2 + (uy - iy) ** 2 + (uz - iz) ** 2)
    # The object lies within the grid, so it is at least as far away as the border.
    if away > 0:
        return away - h if away - h > distance - away else distance - away
    return distance


@compiled_part
def unit_vector(x: float, y: float, z: float):
    """Return a vector divided by its length."""
    length = math.sqrt(x * x + y * y + z * z)
    length = 1e-9 if length < 1e-9 else length
    return x / length, y / length, z / length


@compiled_part
def nearest_surface(grids: GridArrays, grid: int, point, iterations: int):
    """Return the surface point [m] nearest to a point, by Newton steps ``p - d(p) n(p)``, and the outward
    unit normal there, which defines *as shown*."""
    x, y, z = point
    for _ in range(iterations):
        distance, gx, gy, gz = signed_distance(grids, grid, (x, y, z))
        nx, ny, nz = unit_vector(gx, gy, gz)
        x, y, z = x - distance * nx, y - distance * ny, z - distance * nz
    _, gx, gy, gz = signed_distance(grids, grid, (x, y, z))
    return (x, y, z), unit_vector(gx, gy, gz)


@compiled
def nearest_surfaces(
    grids: GridArrays,
    grid: np.ndarray,
    points: np.ndarray,
    iterations: int,
    surface: np.ndarray,
    normal: np.ndarray,
) -> None:
    """Write ``nearest_surface`` of points, shape [N, P, 3]. grid: shape [N]."""
    for i in range(points.shape[0]):
        for p in range(points.shape[1]):
            at = (points[i, p, 0], points[i, p, 1], points[i, p, 2])
            place, direction = nearest_surface(grids, grid[i], at, iterations)
            for k in range(3):
                surface[i, p, k], normal[i, p, k] = place[k], direction[k]


@compiled_part
def gradient_derivative(grids: GridArrays, grid: int, point, reach: float, result: np.ndarray) -> None:
    """Write the derivative of the distance gradient [1/m], shape [3, 3], by central differences over
    ``reach`` [m], which also smooth edges. The last axis is the coordinate of the point."""
    for axis in range(3):
        x, y, z = point
        dx, dy, dz = reach * (axis == 0), reach * (axis == 1), reach * (axis == 2)
        _, ax, ay, az = signed_distance(grids, grid, (x + dx, y + dy, z + dz))
        _, bx, by, bz = signed_distance(grids, grid, (x - dx, y - dy, z - dz))
        result[0, axis] = (ax - bx) / (2 * reach)
        result[1, axis] = (ay - by) / (2 * reach)
        result[2, axis] = (az - bz) / (2 * reach)


@compiled
def gradient_derivatives(
    grids: GridArrays, grid: np.ndarray, points: np.ndarray, reach: float, result: np.ndarray
) -> None:
    """Write ``gradient_derivative`` of points, shape [N, P, 3]. grid: shape [N]."""
    for i in range(points.shape[0]):
        for p in range(points.shape[1]):
            at = (points[i, p, 0], points[i, p, 1], points[i, p, 2])
            gradient_derivative(grids, grid[i], at, reach, result[i, p])

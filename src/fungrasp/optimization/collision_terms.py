"""Collision terms: penetration of the object, the table and the hand itself."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.geometry.distance_queries import signed_distance
from fungrasp.optimization.frames import (
    AddTerm,
    Equations,
    Frames,
    add_point,
    empty_row,
    finish_row,
    place,
)
from fungrasp.optimization.hand_state import Groups, HandPoints, Spheres
from fungrasp.optimization.link_contacts import Shapes, least_clearance, shapes_of
from fungrasp.optimization.problem import CollisionScene


class Measure(NamedTuple):
    """Parameters of the residual of a penetration depth."""

    unit: float
    """Depth that counts as one unit [m]."""
    margin: float
    """Distance outside the surface at which depth begins [m]."""
    count: int
    """Number of deepest penetrations that count."""
    smoothing: float
    """Smoothing length [m]. If zero, residuals are depth / unit. Otherwise half their squares are
    (sqrt(depth^2 + smoothing^2) - smoothing) / unit, about depth / unit."""


class Planes(NamedTuple):
    """Planes that the hand must stay above; T = 0 for penetration of the object."""

    up: np.ndarray
    """Normals, shape [N, T, 3]."""
    height: np.ndarray
    """Height of the object's origin above each plane [m], shape [N, T]."""


def object_penetration(
    points: HandPoints,
    problem: CollisionScene,
    unit: float = 0.001,
    margin: float = 0.0,
    count: int = 24,
    smoothing: float = 0.0,
) -> AddTerm:
    """Penalize max(0, margin - clearance) / unit of the ``count`` deepest spheres (L_pen of IV.A).
    See ``Measure`` for the parameters."""
    shapes, measure = shapes_of(points, problem), Measure(unit, margin, count, smoothing)
    none = Planes(np.empty((len(problem), 0, 3)), np.empty((len(problem), 0)))
    return lambda frames, equations, *_: _add_penetration(frames, equations, shapes, none, measure)


def table_penetration(
    points: HandPoints, problem: CollisionScene, unit: float = 0.001, margin: float = 0.001, count: int = 12
) -> AddTerm:
    """Penalize max(0, margin - height) / unit of the ``count`` lowest spheres (h_{i-table} in L_col of IV.A).
    See ``Measure`` for the parameters."""
    shapes, measure = shapes_of(points, problem), Measure(unit, margin, count, 0.0)
    table = Planes(plain(problem.up), plain(problem.height))
    return lambda frames, equations, *_: _add_penetration(frames, equations, shapes, table, measure)


@compiled
def _add_penetration(
    frames: Frames, equations: Equations, shapes: Shapes, planes: Planes, measure: Measure
) -> None:
    """Add ``table_penetration`` if there are planes, otherwise ``object_penetration``."""
    spheres, groups, grids, grid = shapes
    up, height = planes
    table = height.shape[1] > 0
    row = empty_row(equations.gradient.shape[1])
    total = len(spheres.radius)
    depth, ball, normal = np.empty(total), np.empty(total, np.int64), np.empty((total, 3))
    order, margin = np.empty(total, np.int64), measure.margin
    for i in range(len(grid)):
        if not equations.active[i]:
            continue
        number = np.int64(0)
        for group in range(len(groups.reach)):
            bound = -math.inf
            if table:
                center = place(frames, i, groups.body[group], groups.center[group])
                bound = _lowest(center, up, height, i)[0] - groups.reach[group]
            elif groups.start[group + 1] - groups.start[group] > 2:
                bound = least_clearance(frames, i, groups, group, grids, grid[i])
            if bound >= margin:
                continue
            for k in range(groups.start[group], groups.start[group + 1]):
                member = groups.members[k]
                point = place(frames, i, spheres.body[member], spheres.offset[member])
                if table:
                    distance, t = _lowest(point, up, height, i)
                    nx, ny, nz = up[i, t, 0], up[i, t, 1], up[i, t, 2]
                else:
                    distance, nx, ny, nz = signed_distance(grids, grid[i], point)
                deep = margin - distance + spheres.radius[member]
                if deep > 0:
                    depth[number], ball[number] = deep, member
                    normal[number, 0], normal[number, 1], normal[number, 2] = nx, ny, nz
                    number += 1
        for k in range(_deepest(depth, number, measure.count, order)):
            n = order[k]
            body = spheres.body[ball[n]]
            point = place(frames, i, body, spheres.offset[ball[n]])
            value, unit = _residual(depth[n], measure)
            push = (-normal[n, 0] / unit, -normal[n, 1] / unit, -normal[n, 2] / unit)
            add_point(row, frames, i, body, point, push)
            finish_row(row, equations, i, value)


@compiled_part
def _lowest(point, up: np.ndarray, height: np.ndarray, i: int):
    """Return the smallest height of a point above the planes [m] and the index of that plane."""
    least, plane = math.inf, 0
    for t in range(height.shape[1]):
        above = up[i, t, 0] * point[0] + up[i, t, 1] * point[1] + up[i, t, 2] * point[2] + height[i, t]
        if above < least:
            least, plane = above, t
    return least, plane


@compiled_part
def _deepest(depth: np.ndarray, number: int, count: int, order: np.ndarray) -> int:
    """Write the indices of the ``count`` largest of ``number`` depths to ``order``; return how many."""
    for k in range(number):
        order[k] = k
    if number <= count:
        return number
    for k in range(count):
        best = k
        for m in range(k + 1, number):
            if depth[order[m]] > depth[order[best]]:
                best = m
        order[k], order[best] = order[best], order[k]
    return count


@compiled_part
def _residual(depth: float, measure: Measure):
    """Return the residual of a depth and the inverse of its derivative [m]."""
    if measure.smoothing > 0:
        hypotenuse = math.sqrt(depth * depth + measure.smoothing * measure.smoothing)
        root = math.sqrt(2 / measure.unit / (hypotenuse + measure.smoothing))
        return root * depth, measure.unit * hypotenuse * root
    return depth / measure.unit, measure.unit


def self_penetration(
    points: HandPoints,
    problem: CollisionScene,
    unit: float = 0.002,
    margin: float = 0.001,
    count: int = 8,
    smoothing: float = 0.0,
) -> AddTerm:
    """Penalize max(0, margin - d_ij) / unit of the ``count`` closest pairs of spheres of different fingers.

    d_ij is the distance between the spheres' surfaces (L_col of IV.A, which uses distances between joints).
    See ``Measure`` for the parameters."""
    spheres, groups, pairs = points.arrays.spheres, points.arrays.groups, points.arrays.pairs
    measure = Measure(unit, margin, count, smoothing)
    return lambda frames, equations, *_: _add_self_penetration(
        frames, equations, spheres, groups, pairs, measure
    )


@compiled
def _add_self_penetration(
    frames: Frames,
    equations: Equations,
    spheres: Spheres,
    groups: Groups,
    pairs: np.ndarray,
    measure: Measure,
) -> None:
    """Add ``self_penetration``. pairs: pairs of groups, shape [Q, 2]."""
    row = empty_row(equations.gradient.shape[1])
    margin, total = measure.margin, len(spheres.radius)
    centers = np.empty((len(groups.reach), 3))
    # Only a hand folded into itself would have more pairs than this.
    most = 4 * total
    depth, first, second = np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64)
    order = np.empty(most, np.int64)
    for i in range(len(equations.cost)):
        if not equations.active[i]:
            continue
        for group in range(len(groups.reach)):
            x, y, z = place(frames, i, groups.body[group], groups.center[group])
            centers[group, 0], centers[group, 1], centers[group, 2] = x, y, z
        number = np.int64(0)
        for pair in range(len(pairs)):
            g, h = pairs[pair, 0], pairs[pair, 1]
            within = groups.reach[g] + groups.reach[h] + margin
            x, y, z = (
                centers[g, 0] - centers[h, 0],
                centers[g, 1] - centers[h, 1],
                centers[g, 2] - centers[h, 2],
            )
            if x * x + y * y + z * z >= within * within:
                continue
            for k in range(groups.start[g], groups.start[g + 1]):
                a = groups.members[k]
                pa = place(frames, i, spheres.body[a], spheres.offset[a])
                for m in range(groups.start[h], groups.start[h + 1]):
                    b = groups.members[m]
                    within = spheres.radius[a] + spheres.radius[b] + margin
                    pb = place(frames, i, spheres.body[b], spheres.offset[b])
                    x, y, z = pa[0] - pb[0], pa[1] - pb[1], pa[2] - pb[2]
                    squared = x * x + y * y + z * z
                    if squared < within * within and number < most:
                        squared = 1e-12 if squared < 1e-12 else squared
                        depth[number] = within - math.sqrt(squared)
                        first[number], second[number] = a, b
                        number += 1
        for k in range(_deepest(depth, number, measure.count, order)):
            n = order[k]
            a, b = first[n], second[n]
            pa = place(frames, i, spheres.body[a], spheres.offset[a])
            pb = place(frames, i, spheres.body[b], spheres.offset[b])
            x, y, z = pa[0] - pb[0], pa[1] - pb[1], pa[2] - pb[2]
            length = math.sqrt(x * x + y * y + z * z)
            length = 1e-9 if length < 1e-9 else length
            value, unit = _residual(depth[n], measure)
            scale = 1.0 / (length * unit)
            add_point(row, frames, i, spheres.body[a], pa, (-x * scale, -y * scale, -z * scale))
            add_point(row, frames, i, spheres.body[b], pb, (x * scale, y * scale, z * scale))
            finish_row(row, equations, i, value)

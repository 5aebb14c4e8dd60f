"""Terms of contact and collision: the loops of ``fungrasp.optimization.terms``."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.signed_distance import GridArrays
from fungrasp.optimization.compiled.compiling import compiled
from fungrasp.optimization.compiled.distances import distance_bound, signed_distance
from fungrasp.optimization.compiled.frames import (
    Equations,
    Frames,
    add_point,
    empty_row,
    finish_row,
    place,
)
from fungrasp.optimization.compiled.hand_arrays import HandArrays


@compiled
def least_clearance(grids: GridArrays, grid: int, hand: HandArrays, frames: Frames, i: int, group: int):
    """A bound below the clearances [m] of a group's spheres."""
    point = place(frames, i, hand.groups.body[group], hand.groups.center[group])
    return distance_bound(grids, grid, point) - hand.groups.reach[group]


@compiled
def add_gaps(
    hand: HandArrays,
    frames: Frames,
    equations: Equations,
    grids: GridArrays,
    grid: np.ndarray,
    wanted: np.ndarray,
    unit: float,
) -> None:
    """max(0, gap) / unit for links that should touch, as ``contact_gap``. wanted: shape [N, L] bool."""
    row = empty_row(equations.gradient.shape[1])
    groups = hand.groups
    for i in range(len(wanted)):
        if not equations.active[i]:
            continue
        for link in range(1, wanted.shape[1]):
            if not wanted[i, link]:
                continue
            least, nearest, nx, ny, nz = math.inf, -1, 0.0, 0.0, 0.0
            for group in range(groups.link_start[link], groups.link_start[link + 1]):
                size = groups.start[group + 1] - groups.start[group]
                if size > 2 and least_clearance(grids, grid[i], hand, frames, i, group) > least:
                    continue
                for k in range(groups.start[group], groups.start[group + 1]):
                    ball = groups.members[k]
                    point = place(frames, i, hand.spheres.body[ball], hand.spheres.offset[ball])
                    distance, gx, gy, gz = signed_distance(grids, grid[i], point)
                    clearance = distance - hand.radius[ball]
                    if clearance < least:
                        least, nearest, nx, ny, nz = clearance, ball, gx, gy, gz
            if nearest >= 0 and least > 0:
                body = hand.spheres.body[nearest]
                point = place(frames, i, body, hand.spheres.offset[nearest])
                add_point(row, hand.tree, frames, i, body, point, (nx / unit, ny / unit, nz / unit))
                finish_row(row, equations, i, least / unit)


@compiled
def _keep_deepest(depth: np.ndarray, number: int, count: int, order: np.ndarray) -> int:
    """Puts the indices of the ``count`` largest of the first ``number`` depths into ``order``; how many."""
    if number <= count:
        for k in range(number):
            order[k] = k
        return number
    order[:count] = np.argsort(-depth[:number])[:count]
    return count


@compiled
def add_object_penetration(
    hand: HandArrays,
    frames: Frames,
    equations: Equations,
    grids: GridArrays,
    grid: np.ndarray,
    unit: float,
    margin: float,
    count: int,
) -> None:
    """max(0, margin - clearance) / unit for the deepest spheres, as ``object_penetration``."""
    row = empty_row(equations.gradient.shape[1])
    groups = hand.groups
    total = len(hand.radius)
    depth, ball, normal, order = (
        np.empty(total),
        np.empty(total, np.int64),
        np.empty((total, 3)),
        np.arange(total),
    )
    for i in range(len(grid)):
        if not equations.active[i]:
            continue
        number = 0
        for group in range(len(groups.reach)):
            size = groups.start[group + 1] - groups.start[group]
            if size > 2 and least_clearance(grids, grid[i], hand, frames, i, group) >= margin:
                continue
            for k in range(groups.start[group], groups.start[group + 1]):
                member = groups.members[k]
                point = place(frames, i, hand.spheres.body[member], hand.spheres.offset[member])
                distance, gx, gy, gz = signed_distance(grids, grid[i], point)
                deep = margin - distance + hand.radius[member]
                if deep > 0:
                    depth[number], ball[number] = deep, member
                    normal[number, 0], normal[number, 1], normal[number, 2] = gx, gy, gz
                    number += 1
        for k in range(_keep_deepest(depth, number, count, order)):
            n = order[k]
            member = ball[n]
            body = hand.spheres.body[member]
            point = place(frames, i, body, hand.spheres.offset[member])
            push = (-normal[n, 0] / unit, -normal[n, 1] / unit, -normal[n, 2] / unit)
            add_point(row, hand.tree, frames, i, body, point, push)
            finish_row(row, equations, i, depth[n] / unit)


@compiled
def add_table_penetration(
    hand: HandArrays,
    frames: Frames,
    equations: Equations,
    up: np.ndarray,
    height: np.ndarray,
    unit: float,
    margin: float,
    count: int,
) -> None:
    """max(0, margin - height) / unit for the lowest spheres, as ``table_penetration``.

    Args:
        up: normals of the planes, shape [N, T, 3].
        height: of the object's origin above each plane [m], shape [N, T].
    """
    row = empty_row(equations.gradient.shape[1])
    groups = hand.groups
    total = len(hand.radius)
    depth, ball, plane, order = (
        np.empty(total),
        np.empty(total, np.int64),
        np.empty(total, np.int64),
        np.arange(total),
    )
    for i in range(len(up)):
        if not equations.active[i]:
            continue
        number = 0
        for group in range(len(groups.reach)):
            center = place(frames, i, groups.body[group], groups.center[group])
            if _lowest(center, up, height, i)[0] - groups.reach[group] >= margin:
                continue
            for k in range(groups.start[group], groups.start[group + 1]):
                member = groups.members[k]
                point = place(frames, i, hand.spheres.body[member], hand.spheres.offset[member])
                above, t = _lowest(point, up, height, i)
                deep = margin - above + hand.radius[member]
                if deep > 0:
                    depth[number], ball[number], plane[number] = deep, member, t
                    number += 1
        for k in range(_keep_deepest(depth, number, count, order)):
            n = order[k]
            member, t = ball[n], plane[n]
            body = hand.spheres.body[member]
            point = place(frames, i, body, hand.spheres.offset[member])
            push = (-up[i, t, 0] / unit, -up[i, t, 1] / unit, -up[i, t, 2] / unit)
            add_point(row, hand.tree, frames, i, body, point, push)
            finish_row(row, equations, i, depth[n] / unit)


@compiled
def _lowest(point, up: np.ndarray, height: np.ndarray, i: int):
    """Least height [m] of a point above the planes, and which plane."""
    least, plane = math.inf, 0
    for t in range(height.shape[1]):
        above = up[i, t, 0] * point[0] + up[i, t, 1] * point[1] + up[i, t, 2] * point[2] + height[i, t]
        if above < least:
            least, plane = above, t
    return least, plane


@compiled
def add_self_penetration(
    hand: HandArrays, frames: Frames, equations: Equations, unit: float, margin: float, count: int
) -> None:
    """max(0, margin - d) / unit for the closest pairs of spheres, as ``self_penetration``."""
    row = empty_row(equations.gradient.shape[1])
    groups, pairs, spheres = hand.groups, hand.pairs, hand.spheres
    total = len(hand.radius)
    centers = np.empty((len(groups.reach), 3))
    # More pairs than this at once would be a hand that is folded into itself.
    most = 4 * total
    depth, first, second = np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64)
    order = np.arange(most)
    for i in range(len(equations.cost)):
        if not equations.active[i]:
            continue
        for group in range(len(groups.reach)):
            x, y, z = place(frames, i, groups.body[group], groups.center[group])
            centers[group, 0], centers[group, 1], centers[group, 2] = x, y, z
        number = 0
        for pair in range(len(pairs.first)):
            g, h = pairs.first[pair], pairs.second[pair]
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
                    within = hand.radius[a] + hand.radius[b] + margin
                    pb = place(frames, i, spheres.body[b], spheres.offset[b])
                    x, y, z = pa[0] - pb[0], pa[1] - pb[1], pa[2] - pb[2]
                    squared = x * x + y * y + z * z
                    if squared < within * within and number < most:
                        depth[number] = within - math.sqrt(max(squared, 1e-12))
                        first[number], second[number] = a, b
                        number += 1
        for k in range(_keep_deepest(depth, number, count, order)):
            n = order[k]
            a, b = first[n], second[n]
            pa = place(frames, i, spheres.body[a], spheres.offset[a])
            pb = place(frames, i, spheres.body[b], spheres.offset[b])
            x, y, z = pa[0] - pb[0], pa[1] - pb[1], pa[2] - pb[2]
            scale = 1.0 / (max(math.sqrt(x * x + y * y + z * z), 1e-9) * unit)
            add_point(row, hand.tree, frames, i, spheres.body[a], pa, (-x * scale, -y * scale, -z * scale))
            add_point(row, hand.tree, frames, i, spheres.body[b], pb, (x * scale, y * scale, z * scale))
            finish_row(row, equations, i, depth[n] / unit)

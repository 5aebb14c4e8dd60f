"""Compiled loops: distances from capsules, rays near an object, and the equations of a pose fit.

Products of capsules are summed in the order x, z, y, as in NumPy's einsum.
"""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.array_distances import GridArrays
from fungrasp.geometry.compiling import compiled, compiled_part
from fungrasp.geometry.distance_queries import signed_distance


@compiled_part
def _along(point, first, last):
    """Return the nearest point of a segment, 0 to 1, and the offset of the point from it (x, y, z)."""
    lx, ly, lz = last[0] - first[0], last[1] - first[1], last[2] - first[2]
    x, y, z = point[0] - first[0], point[1] - first[1], point[2] - first[2]
    square = lx * lx + ly * ly + lz * lz
    part = (x * lx + z * lz + y * ly) / (square if square > 1e-12 else 1e-12)
    part = 0.0 if part < 0.0 else 1.0 if part > 1.0 else part
    return part, x - part * lx, y - part * ly, z - part * lz


@compiled
def capsule_distances(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray, distance: np.ndarray
) -> None:
    """Write the result of ``hand_capsules.capsule_distances`` to ``distance``, shape [P]."""
    for p in range(len(points)):
        nearest = math.inf
        for c in range(len(first)):
            part, x, y, z = _along(points[p], first[c], last[c])
            apart = math.sqrt(x * x + y * y + z * z) - (radius[c, 0] + part * (radius[c, 1] - radius[c, 0]))
            nearest = apart if apart < nearest else nearest
        distance[p] = nearest


@compiled
def nearest_capsules(
    points: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    radius: np.ndarray,
    far_side: float,
    penalty: float,
    which: np.ndarray,
    distance: np.ndarray,
    along: np.ndarray,
    normal: np.ndarray,
) -> None:
    """Write the results of ``hand_capsules.nearest_capsules`` for S hands.

    Args: points: shape [P, 3]; first, last: shape [S, C, 3]; radius: at both ends, shape [C, 2]; far_side,
    penalty: ``FAR_SIDE`` and ``FAR_SIDE_PENALTY``; which: int64, shape [S, P], as distance and along; normal:
    shape [S, P, 3].
    """
    for p in range(len(points)):
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        length = math.sqrt(px * px + py * py + pz * pz)
        px, py, pz = px / length, py / length, pz / length
        for s in range(len(first)):
            which[s, p], distance[s, p], along[s, p] = 0, math.nan, math.nan
            normal[s, p, 0] = normal[s, p, 1] = normal[s, p, 2] = math.nan
            least = math.inf
            for c in range(first.shape[1]):
                part, x, y, z = _along(points[p], first[s, c], last[s, c])
                length = math.sqrt(x * x + z * z + y * y)
                divisor = length if length > 1e-9 else 1e-9
                x, y, z = x / divisor, y / divisor, z / divisor
                apart = length - (radius[c, 0] + part * (radius[c, 1] - radius[c, 0]))
                if x * px + z * pz + y * py > far_side:
                    apart += penalty
                if abs(apart) < least:
                    least = abs(apart)
                    which[s, p], distance[s, p], along[s, p] = c, apart, part
                    normal[s, p, 0], normal[s, p, 1], normal[s, p, 2] = x, y, z


@compiled
def count_rays(slopes: np.ndarray, middles: np.ndarray, least: np.ndarray, counts: np.ndarray) -> None:
    """Write the number of rays that pass the bounding sphere of the object in each of H poses.

    Args:
        slopes: unit vectors along the rays from the camera's center, shape [R, 3].
        middles: centers of the spheres [m], camera frame, shape [H, 3].
        least: smallest distance of a sphere's center along a ray that passes it [m], shape [H].
        counts: int64, shape [H].
    """
    for h in range(len(middles)):
        count = np.int64(0)
        x, y, z, limit = middles[h, 0], middles[h, 1], middles[h, 2], least[h]
        for r in range(len(slopes)):
            if slopes[r, 0] * x + slopes[r, 1] * y + slopes[r, 2] * z >= limit:
                count += 1
        counts[h] = count


@compiled
def local_rays(
    slopes: np.ndarray,
    middles: np.ndarray,
    least: np.ndarray,
    directions: np.ndarray,
    axes: np.ndarray,
    pose: np.ndarray,
    ray: np.ndarray,
    local: np.ndarray,
) -> None:
    """Write pose and ray of each ray that passes a sphere, int64, shape [N], and its direction in the object
    frame, float32, shape [N, 3].

    Args: as of ``count_rays``; directions: rays of any length, shape [R, 3]; axes: axes of the object as
    columns, shape [H, 3, 3].
    """
    n = np.int64(0)
    for h in range(len(middles)):
        x, y, z, limit, a = middles[h, 0], middles[h, 1], middles[h, 2], least[h], axes[h]
        for r in range(len(slopes)):
            if slopes[r, 0] * x + slopes[r, 1] * y + slopes[r, 2] * z >= limit:
                u, v, w = directions[r, 0], directions[r, 1], directions[r, 2]
                pose[n], ray[n] = h, r
                for i in range(3):
                    local[n, i] = u * a[0, i] + v * a[1, i] + w * a[2, i]
                n += 1


@compiled_part
def intrusion(x, y, z, depth, refuge, lens, table):
    """Return how far a point [m], camera frame, must move to leave forbidden space (``FreeSpace``) [m], and
    the gradient of this distance; 0 for allowed points."""
    near = z if z > 1e-3 else 1e-3
    ux, uy = x / near, y / near
    column = int(np.rint(lens[0] * ux + lens[2]))
    row = int(np.rint(lens[1] * uy + lens[3]))
    distance, gx, gy, gz = 0.0, 0.0, 0.0, -1.0
    if 0 <= column < depth.shape[1] and 0 <= row < depth.shape[0]:
        short = depth[row, column] - near
        # Most points are allowed: they need no look at ``refuge``, which is far away in memory.
        if short > 0:
            distance = short
            away_v, away_u = row - refuge[0, row, column], column - refuge[1, row, column]
            pixels = np.sqrt(float(away_u * away_u + away_v * away_v))
            sideways = pixels * near / lens[0]
            if pixels > 0 and sideways < short:
                du, dv = away_u / pixels, away_v / pixels
                distance, gx, gy, gz = sideways, du, dv, -(du * ux + dv * uy)
    below = -(x * table[0] + y * table[1] + z * table[2] + table[3])
    if below > distance:
        return below, -table[0], -table[1], -table[2]
    return distance, gx, gy, gz


@compiled_part
def _add(sums, arm, gradient, residual, weight):
    """Add a residual, with its gradient by the point's position, to the normal equations of a turn and a
    shift: the matrix's upper triangle, row by row, then the vector, in one short array."""
    ax, ay, az = arm
    gx, gy, gz = gradient
    j = (ay * gz - az * gy, az * gx - ax * gz, ax * gy - ay * gx, gx, gy, gz)
    n = 0
    for a in range(6):
        part = weight * j[a]
        for b in range(a, 6):
            sums[n] += part * j[b]
            n += 1
        sums[21 + a] += part * residual


@compiled
def fit_terms(
    grids: GridArrays,
    points: np.ndarray,
    weight: np.ndarray,
    scale: np.ndarray,
    samples: np.ndarray,
    free_scale: float,
    depth: np.ndarray,
    refuge: np.ndarray,
    lens: np.ndarray,
    table: np.ndarray,
    rotation: np.ndarray,
    position: np.ndarray,
    matrix: np.ndarray,
    vector: np.ndarray,
    cost: np.ndarray,
) -> None:
    """Write matrix [H, 6, 6], vector [H, 6] and cost [H] of each pose.

    Args: as in ``fit_poses``; weight, scale: per point, shape [P]; depth, refuge, lens (focal lengths and
    center [pixels], shape [4]), table (far below if there is none): free space; rotation [H, 3, 3] and
    position [H, 3]: poses.
    """
    sums = np.empty(27)
    for h in range(len(position)):
        r, t = rotation[h], position[h]
        cost[h] = 0.0
        for n in range(27):
            sums[n] = 0.0
        for p in range(len(points)):
            x, y, z = points[p, 0] - t[0], points[p, 1] - t[1], points[p, 2] - t[2]
            local = (
                x * r[0, 0] + y * r[1, 0] + z * r[2, 0],
                x * r[0, 1] + y * r[1, 1] + z * r[2, 1],
                x * r[0, 2] + y * r[1, 2] + z * r[2, 2],
            )
            distance, gx, gy, gz = signed_distance(grids, 0, local)
            squared = (distance / scale[p]) ** 2
            gradient = (
                -(r[0, 0] * gx + r[0, 1] * gy + r[0, 2] * gz),
                -(r[1, 0] * gx + r[1, 1] * gy + r[1, 2] * gz),
                -(r[2, 0] * gx + r[2, 1] * gy + r[2, 2] * gz),
            )
            share = weight[p] / len(points)
            _add(sums, (x, y, z), gradient, distance, share / (1.0 + squared) ** 2)
            cost[h] += share * scale[p] ** 2 * squared / (1.0 + squared)
        share = 1.0 / len(samples)
        for s in range(len(samples)):
            a, b, c = samples[s, 0], samples[s, 1], samples[s, 2]
            arm = (
                r[0, 0] * a + r[0, 1] * b + r[0, 2] * c,
                r[1, 0] * a + r[1, 1] * b + r[1, 2] * c,
                r[2, 0] * a + r[2, 1] * b + r[2, 2] * c,
            )
            distance, gx, gy, gz = intrusion(
                arm[0] + t[0], arm[1] + t[1], arm[2] + t[2], depth, refuge, lens, table
            )
            squared = (distance / free_scale) ** 2
            _add(sums, arm, (gx, gy, gz), distance, share / (1.0 + squared) ** 2)
            cost[h] += share * free_scale**2 * squared / (1.0 + squared)
        n = 0
        for a in range(6):
            vector[h, a] = sums[21 + a]
            for b in range(a, 6):
                matrix[h, a, b] = matrix[h, b, a] = sums[n]
                n += 1

"""Edges of friction cones, and distances of forces from the cones."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part
from fungrasp.geometry.distance_queries import unit_vector
from fungrasp.geometry.poses import cross


def friction_cone_edges(normals: np.ndarray, friction: float, count: int) -> np.ndarray:
    """Return the edges of pyramids inscribed in friction cones, each with a normal component of 1.

    Args:
        normals: unit vectors along the cone axes, into the object, shape [..., 3].
        friction: coefficient, the tangent of the half angle.
        count: number of edges E.

    Returns:
        shape [..., E, 3].
    """
    # The same sums as in ``cone_edges``, in the same order.
    n = np.asarray(normals, dtype=float)
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    zero, flat = np.zeros_like(x), (np.abs(x) < 0.9)[..., None]
    first = np.where(flat, np.stack([zero, z, -y], axis=-1), np.stack([-z, zero, x], axis=-1))
    length = np.sqrt(first[..., 0] ** 2 + first[..., 1] ** 2 + first[..., 2] ** 2)
    first = (first / np.maximum(length, 1e-9)[..., None])[..., None, :]
    second = cross(n[..., None, :], first)
    angles = [2 * math.pi * e / count for e in range(count)]
    along = friction * np.array([math.cos(angle) for angle in angles])[:, None]
    across = friction * np.array([math.sin(angle) for angle in angles])[:, None]
    return n[..., None, :] + along * first + across * second


@compiled
def outside_cones(
    force: np.ndarray, answers: np.ndarray, floor: np.ndarray, axis: np.ndarray, friction: float
) -> np.ndarray:
    """Return the sum over all loads of the vectors from the nearest point of the friction cone to the contact
    force [N], shape [N, C, 3]. The vector is zero for a force within its cone.

    Args:
        force: contact forces without a load [N], shape [N, C, 3].
        answers: change of the contact forces under each load [N], shape [N, K, C, 3].
        floor: apexes of the cones [N], shape [N, C, 3].
        axis: unit vectors along the cone axes, shape [N, C, 3].
        friction: coefficient, the tangent of the half angle.
    """
    total = np.empty(force.shape)
    x, tangent = np.empty(3), np.empty(3)
    for n in range(answers.shape[0]):
        for k in range(answers.shape[1]):
            for c in range(answers.shape[2]):
                a = axis[n, c]
                if k == 0:
                    for i in range(3):
                        total[n, c, i] = 0.0
                for i in range(3):
                    x[i] = force[n, c, i] + answers[n, k, c, i] - floor[n, c, i]
                normal = x[0] * a[0] + x[1] * a[1] + x[2] * a[2]
                for i in range(3):
                    tangent[i] = x[i] - normal * a[i]
                size = math.sqrt(tangent[0] ** 2 + tangent[1] ** 2 + tangent[2] ** 2)
                if size <= friction * normal:
                    continue
                if friction * size <= -normal:
                    for i in range(3):
                        total[n, c, i] += x[i]
                    continue
                along = (normal + friction * size) / (1.0 + friction * friction)
                least = 1e-12 if size < 1e-12 else size
                for i in range(3):
                    total[n, c, i] += x[i] - along * (a[i] + friction * tangent[i] / least)
    return total


@compiled_part
def circle(count: int):
    """Return ``count`` points on the unit circle, shape [count, 2]: directions of a cone's edges."""
    points = np.empty((count, 2))
    for e in range(count):
        angle = 2 * math.pi * e / count
        points[e, 0], points[e, 1] = math.cos(angle), math.sin(angle)
    return points


@compiled_part
def cone_edges(inward, friction: float, around, edges, first: int) -> None:
    """Write the edges of the pyramid inscribed in a friction cone, each with a normal component of 1.

    Args:
        inward: unit vector along the cone's axis, into the object.
        friction: coefficient, the tangent of the half angle.
        around: result of ``circle``.
        edges: output, written from row ``first`` on, shape [K, 3].
    """
    nx, ny, nz = inward[0], inward[1], inward[2]
    # Any vector that is not parallel to the normal gives a first tangent.
    if abs(nx) < 0.9:
        ax, ay, az = 0.0, nz, -ny
    else:
        ax, ay, az = -nz, 0.0, nx
    ax, ay, az = unit_vector(ax, ay, az)
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    for e in range(len(around)):
        c, s = friction * around[e, 0], friction * around[e, 1]
        edges[first + e, 0] = nx + c * ax + s * bx
        edges[first + e, 1] = ny + c * ay + s * by
        edges[first + e, 2] = nz + c * az + s * bz


@compiled_part
def largest_eigenvalue(matrix, size: int, count: int) -> float:
    """Return an upper bound of the largest eigenvalue of matrix matrix^T, at most a factor size^(1/16) too
    large: the sixteenth root of the sum of the sixteenth powers of all eigenvalues.

    Args:
        matrix: only the first ``size`` rows and ``count`` columns are used.
    """
    gram, squared = np.empty((size, size)), np.empty((size, size))
    trace = 0.0
    for a in range(size):
        for b in range(a + 1):
            total = 0.0
            for k in range(count):
                total += matrix[a, k] * matrix[b, k]
            gram[a, b] = gram[b, a] = total
        trace += gram[a, a]
    for a in range(size):
        for b in range(size):
            gram[a, b] = gram[a, b] / trace
    for _ in range(3):
        for a in range(size):
            for b in range(size):
                squared[a, b] = 0.0
            for k in range(size):
                factor = gram[a, k]
                if factor != 0.0:
                    for b in range(size):
                        squared[a, b] += factor * gram[k, b]
        for a in range(size):
            for b in range(size):
                gram[a, b] = squared[a, b]
    # The Frobenius norm of the eighth power is the root of the sum of the eigenvalues' sixteenth powers.
    total = 0.0
    for a in range(size):
        for b in range(size):
            total += gram[a, b] * gram[a, b]
    return trace * total ** (1.0 / 16)

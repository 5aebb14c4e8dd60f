"""Force closure: the loops of ``force_closure`` and ``balanced_forces``."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.signed_distance import GridArrays
from fungrasp.optimization.compiled.compiling import compiled
from fungrasp.optimization.compiled.distances import nearest_surface, signed_distance
from fungrasp.optimization.compiled.frames import Equations, Frames, place
from fungrasp.optimization.compiled.hand_arrays import HandArrays
from fungrasp.optimization.contact_forces import BALANCE_CONE_EDGES


@compiled
def add_force_closure(
    hand: HandArrays,
    frames: Frames,
    equations: Equations,
    grids: GridArrays,
    grid: np.ndarray,
    which: np.ndarray,
    wanted: np.ndarray,
    center: np.ndarray,
    extent: np.ndarray,
    unit: float,
    friction: float,
    reach: float,
    iterations: int,
) -> None:
    """Balance of the best contact forces over ``unit``, as ``force_closure``.

    Args:
        which: key point of each link, shape [S].
        wanted: links that should touch, shape [N, S] bool.
        center: of mass [m], shape [N, 3].
        extent: unit of lever arms [m], shape [N].
    """
    size = equations.gradient.shape[1]
    most = len(which)
    point, lever, normal = np.empty((most, 3)), np.empty((most, 3)), np.empty((most, 3))
    force, curve, link = np.empty((most, 3)), np.empty((3, 3)), np.empty(most, np.int64)
    jacobian = np.empty((6, size))
    edges = np.empty((most * BALANCE_CONE_EDGES, 3))
    matrix = np.empty((7, most * BALANCE_CONE_EDGES))
    around = circle(BALANCE_CONE_EDGES)
    for i in range(len(wanted)):
        if not equations.active[i]:
            continue
        number = 0
        for s in range(most):
            if wanted[i, s]:
                body = hand.keypoints.body[which[s]]
                p = place(frames, i, body, hand.keypoints.offset[which[s]])
                surface, n = nearest_surface(grids, grid[i], p, 2)
                for k in range(3):
                    point[number, k], normal[number, k] = p[k], n[k]
                    lever[number, k] = (surface[k] - center[i, k]) / extent[i]
                link[number] = which[s]
                number += 1
        if number < 2:
            continue
        _balance(lever, normal, number, friction, around, iterations, edges, matrix, force)
        jacobian[:] = 0.0
        residual = np.zeros(6)
        for c in range(number):
            pressure = 0.0
            for k in range(3):
                pressure -= force[c, k] * normal[c, k]
                residual[k] += force[c, k] / unit
                m, n = (k + 1) % 3, (k + 2) % 3
                residual[3 + k] += (lever[c, m] * force[c, n] - lever[c, n] * force[c, m]) / unit
            _curvature(grids, grid[i], point[c], reach, curve)
            _add_motion(
                hand, frames, i, hand.keypoints.body[link[c]], point[c], lever[c], force[c], pressure, curve,
                extent[i], unit, jacobian,
            )  # fmt: skip
        for k in range(6):
            equations.cost[i] += 0.5 * residual[k] * residual[k]
        hessian, gradient = equations.hessian[i], equations.gradient[i]
        for p in range(size):
            for k in range(6):
                value = jacobian[k, p]
                gradient[p] += residual[k] * value
                for q in range(p + 1):
                    hessian[p, q] += value * jacobian[k, q]


@compiled
def _curvature(grids: GridArrays, grid: int, point: np.ndarray, reach: float, result: np.ndarray) -> None:
    """Derivative of the distance's gradient by central differences [1/m], as ``gradient_derivative``."""
    for axis in range(3):
        x, y, z = point[0], point[1], point[2]
        dx, dy, dz = reach * (axis == 0), reach * (axis == 1), reach * (axis == 2)
        _, ax, ay, az = signed_distance(grids, grid, (x + dx, y + dy, z + dz))
        _, bx, by, bz = signed_distance(grids, grid, (x - dx, y - dy, z - dz))
        result[0, axis] = (ax - bx) / (2 * reach)
        result[1, axis] = (ay - by) / (2 * reach)
        result[2, axis] = (az - bz) / (2 * reach)


@compiled
def _add_motion(
    hand: HandArrays, frames: Frames, i, body, point, lever, force, pressure, curve, extent, unit, jacobian
) -> None:
    """Derivative of a contact's force and moment with respect to the tangent vector."""
    tree = hand.tree
    x, y, z = point[0], point[1], point[2]
    rx, ry, rz = x - frames.wrist[i, 0], y - frames.wrist[i, 1], z - frames.wrist[i, 2]
    for k in range(3):
        a, b, c = 1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2)
        _add_column(jacobian, k, a, b, c, lever, force, pressure, curve, extent, unit)
        turned = (b * rz - c * ry, c * rx - a * rz, a * ry - b * rx)
        _add_column(
            jacobian, 3 + k, turned[0], turned[1], turned[2], lever, force, pressure, curve, extent, unit
        )
    for entry in range(tree.chain_start[body], tree.chain_start[body + 1]):
        joint, factor = tree.chain_joint[entry], tree.chain_factor[entry]
        rx, ry, rz = (
            x - frames.anchor[i, joint, 0],
            y - frames.anchor[i, joint, 1],
            z - frames.anchor[i, joint, 2],
        )
        a, b, c = frames.axis[i, joint, 0], frames.axis[i, joint, 1], frames.axis[i, joint, 2]
        mx, my, mz = factor * (b * rz - c * ry), factor * (c * rx - a * rz), factor * (a * ry - b * rx)
        _add_column(
            jacobian, tree.chain_column[entry], mx, my, mz, lever, force, pressure, curve, extent, unit
        )


@compiled
def _add_column(jacobian, column: int, mx, my, mz, lever, force, pressure, curve, extent, unit) -> None:
    """The change of force and moment where the contact's point moves along (mx, my, mz)."""
    # With the forces fixed in the contact frames, a force turns as the normal does: df = -pressure dn.
    fx = -pressure * (curve[0, 0] * mx + curve[0, 1] * my + curve[0, 2] * mz) / unit
    fy = -pressure * (curve[1, 0] * mx + curve[1, 1] * my + curve[1, 2] * mz) / unit
    fz = -pressure * (curve[2, 0] * mx + curve[2, 1] * my + curve[2, 2] * mz) / unit
    jacobian[0, column] += fx
    jacobian[1, column] += fy
    jacobian[2, column] += fz
    ax, ay, az = mx / (extent * unit), my / (extent * unit), mz / (extent * unit)
    jacobian[3, column] += ay * force[2] - az * force[1] + lever[1] * fz - lever[2] * fy
    jacobian[4, column] += az * force[0] - ax * force[2] + lever[2] * fx - lever[0] * fz
    jacobian[5, column] += ax * force[1] - ay * force[0] + lever[0] * fy - lever[1] * fx


@compiled
def _balance(
    lever, normal, number: int, friction: float, around, iterations: int, edges, matrix, force
) -> None:
    """``balanced_forces`` of ``number`` contacts into ``force``. edges, matrix: space to work in."""
    count = number * BALANCE_CONE_EDGES
    for c in range(number):
        cone_edges(normal[c], friction, around, edges[c * BALANCE_CONE_EDGES : (c + 1) * BALANCE_CONE_EDGES])
        for e in range(BALANCE_CONE_EDGES):
            k = c * BALANCE_CONE_EDGES + e
            x, y, z = edges[k, 0], edges[k, 1], edges[k, 2]
            matrix[0, k], matrix[1, k], matrix[2, k] = x, y, z
            matrix[3, k] = lever[c, 1] * z - lever[c, 2] * y
            matrix[4, k] = lever[c, 2] * x - lever[c, 0] * z
            matrix[5, k] = lever[c, 0] * y - lever[c, 1] * x
            matrix[6, k] = 1.0
    regular = 1e-3
    step = 1.0 / (largest_eigenvalue(matrix, 7, count) + regular)
    weights = np.full(count, 1.0 / count)
    ahead = weights.copy()
    momentum = 1.0
    for _ in range(iterations):
        # One accumulator for each row: sums that do not wait for each other.
        fx, fy, fz, mx, my, mz, normal_sum = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0
        for k in range(count):
            w = ahead[k]
            fx += matrix[0, k] * w
            fy += matrix[1, k] * w
            fz += matrix[2, k] * w
            mx += matrix[3, k] * w
            my += matrix[4, k] * w
            mz += matrix[5, k] * w
            normal_sum += w
        following = 0.5 * (1 + math.sqrt(1 + 4 * momentum * momentum))
        carry = (momentum - 1) / following
        for k in range(count):
            change = normal_sum + regular * ahead[k]
            change += matrix[0, k] * fx + matrix[1, k] * fy + matrix[2, k] * fz
            change += matrix[3, k] * mx + matrix[4, k] * my + matrix[5, k] * mz
            moved = max(ahead[k] - step * change, 0.0)
            ahead[k] = moved + carry * (moved - weights[k])
            weights[k] = moved
        momentum = following
    total = max(weights.sum(), 1e-9)
    for c in range(number):
        for m in range(3):
            force[c, m] = 0.0
            for e in range(BALANCE_CONE_EDGES):
                k = c * BALANCE_CONE_EDGES + e
                force[c, m] += weights[k] * edges[k, m] / total


@compiled
def circle(count: int):
    """``count`` points on the unit circle, shape [count, 2]: directions of a cone's edges."""
    points = np.empty((count, 2))
    for e in range(count):
        angle = 2 * math.pi * e / count
        points[e, 0], points[e, 1] = math.cos(angle), math.sin(angle)
    return points


@compiled
def cone_edges(normal, friction: float, around, edges) -> None:
    """``friction_cone_edges`` around a normal that points out of the object. around: ``circle``."""
    nx, ny, nz = -normal[0], -normal[1], -normal[2]
    if abs(nx) < 0.9:
        ax, ay, az = 0.0, nz, -ny
    else:
        ax, ay, az = -nz, 0.0, nx
    length = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-9)
    ax, ay, az = ax / length, ay / length, az / length
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    for e in range(len(edges)):
        c, s = friction * around[e, 0], friction * around[e, 1]
        edges[e, 0] = nx + c * ax + s * bx
        edges[e, 1] = ny + c * ay + s * by
        edges[e, 2] = nz + c * az + s * bz


@compiled
def largest_eigenvalue(matrix, size: int, count: int) -> float:
    """Of matrix matrix^T, from above by at most a factor size^(1/16), as ``largest_eigenvalue_bound``.

    Args:
        matrix: its first ``size`` rows and ``count`` columns count.
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
    gram /= trace
    for _ in range(3):
        squared[:] = 0.0
        for a in range(size):
            for k in range(size):
                factor = gram[a, k]
                if factor != 0.0:
                    for b in range(size):
                        squared[a, b] += factor * gram[k, b]
        gram[:] = squared
    # The Frobenius norm of the eighth power is the root of the sum of sixteenth powers of the eigenvalues.
    total = 0.0
    for a in range(size):
        for b in range(size):
            total += gram[a, b] * gram[a, b]
    return trace * total ** (1.0 / 16)

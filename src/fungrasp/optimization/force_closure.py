"""Force closure: balance of contact forces within friction cones, as a term of the objective and as a
metric."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from fungrasp.geometry.array_distances import GridArrays
from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.geometry.distance_queries import gradient_derivative, nearest_surface
from fungrasp.hands.kinematics import BodyPoints
from fungrasp.optimization.frames import AddTerm, Equations, Frames, joint_motion, place
from fungrasp.optimization.friction_cones import circle, cone_edges, friction_cone_edges, largest_eigenvalue
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import RetargetingProblem

BALANCE_CONE_EDGES = 6
"""Edges of the pyramids that approximate friction cones in the term."""
BALANCE_ITERATIONS = 40
"""Iterations of the descent to the best contact forces."""
CLOSURE_CONE_EDGES = 8
"""Edges of the pyramids that approximate friction cones in the metrics."""


def force_closure(
    points: HandPoints,
    problem: RetargetingProblem,
    unit: float = 0.05,
    friction: float = 0.3,
    reach: float = 0.006,
) -> AddTerm:
    """Penalize (sum f_j, sum (x_j - center) x f_j / extent) / unit over wanted contacts (L_fc of IV.A).

    x_j is the surface point nearest to the far key point of link j. The f_j are the contact forces within
    the friction cones that balance best; their normal components sum to 1. With zero ``friction`` this is Liu
    et al., "Synthesizing diverse and physically stable grasps", 2021. The forces are optimal, so the
    derivative holds them fixed in the contact frames.

    Args:
        unit: dimensionless.
        friction: assumed coefficient, well below the true one.
        reach: half width of the finite difference for the curvature [m]; it also smooths edges.
    """
    targets = _Targets(
        points.arrays.keypoints[points.match.far],
        plain(problem.contacts[:, 1:], bool),
        plain(problem.center),
        plain(problem.extent),
        plain(problem.grid, np.int64),
    )
    grids, numbers = problem.bank.arrays, (unit, friction, reach)
    return lambda frames, equations, *_: _add_force_closure(frames, equations, grids, targets, numbers)


class _Targets(NamedTuple):
    far: BodyPoints
    """Far key points of the links."""
    wanted: np.ndarray
    """Links that should touch, shape [N, S] bool."""
    center: np.ndarray
    """Centers of mass [m], shape [N, 3]."""
    extent: np.ndarray
    """Unit of lever arms [m], shape [N]."""
    grid: np.ndarray
    """Index of each object, shape [N]."""


@compiled
def _add_force_closure(
    frames: Frames,
    equations: Equations,
    grids: GridArrays,
    targets: _Targets,
    numbers: tuple[float, float, float],
) -> None:
    """Add ``force_closure``. numbers: unit, friction and reach."""
    unit, friction, reach = numbers
    wanted, center, extent, grid = targets.wanted, targets.center, targets.extent, targets.grid
    body, offset = targets.far.bodies, targets.far.offsets
    size = equations.gradient.shape[1]
    most = len(body)
    point, lever, inward = np.empty((most, 3)), np.empty((most, 3)), np.empty((most, 3))
    force, curve, link = np.empty((most, 3)), np.empty((3, 3)), np.empty(most, np.int64)
    jacobian, residual = np.empty((6, size)), np.empty(6)
    for i in range(len(wanted)):
        if not equations.active[i]:
            continue
        number = np.int64(0)
        for s in range(most):
            if wanted[i, s]:
                p = place(frames, i, body[s], offset[s])
                surface, n = nearest_surface(grids, grid[i], p, 2)
                for k in range(3):
                    point[number, k], inward[number, k] = p[k], -n[k]
                    lever[number, k] = (surface[k] - center[i, k]) / extent[i]
                link[number] = s
                number += 1
        if number < 2:
            continue
        _balance(lever, inward, number, friction, BALANCE_ITERATIONS, force)
        for k in range(6):
            residual[k] = 0.0
            for d in range(size):
                jacobian[k, d] = 0.0
        for c in range(number):
            pressure = 0.0
            for k in range(3):
                pressure += force[c, k] * inward[c, k]
                residual[k] += force[c, k] / unit
                m, n = (k + 1) % 3, (k + 2) % 3
                residual[3 + k] += (lever[c, m] * force[c, n] - lever[c, n] * force[c, m]) / unit
            at = (point[c, 0], point[c, 1], point[c, 2])
            gradient_derivative(grids, grid[i], at, reach, curve)
            _add_motion(
                frames, i, body[link[c]], at, lever[c], force[c], pressure, curve, extent[i], unit, jacobian
            )
        for k in range(6):
            equations.cost[i] += 0.5 * residual[k] * residual[k]
        hessian, gradient = equations.hessian[i], equations.gradient[i]
        for p in range(size):
            for k in range(6):
                value = jacobian[k, p]
                gradient[p] += residual[k] * value
                for q in range(p + 1):
                    hessian[p, q] += value * jacobian[k, q]


@compiled_part
def _add_motion(
    frames: Frames, i, body, point, lever, force, pressure, curve, extent, unit, jacobian
) -> None:
    """Add the derivative of a contact's force and moment with respect to the tangent vector."""
    chains = frames.chains
    rx, ry, rz = point[0] - frames.wrist[i, 0], point[1] - frames.wrist[i, 1], point[2] - frames.wrist[i, 2]
    for k in range(6):
        a, b, c = 1.0 * (k % 3 == 0), 1.0 * (k % 3 == 1), 1.0 * (k % 3 == 2)
        if k >= 3:
            a, b, c = b * rz - c * ry, c * rx - a * rz, a * ry - b * rx
        _add_column(jacobian, k, a, b, c, lever, force, pressure, curve, extent, unit)
    for entry in range(chains.start[body], chains.start[body + 1]):
        factor = chains.factor[entry]
        a, b, c = joint_motion(frames, i, chains.joint[entry], point)
        _add_column(
            jacobian, chains.column[entry], factor * a, factor * b, factor * c, lever, force, pressure, curve,
            extent, unit,
        )  # fmt: skip


@compiled_part
def _add_column(jacobian, column: int, mx, my, mz, lever, force, pressure, curve, extent, unit) -> None:
    """Add the change of force and moment when the contact point moves along (mx, my, mz)."""
    # The forces are fixed in the contact frames and rotate with the normal: df = -pressure dn.
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


@compiled_part
def _balance(lever, inward, number: int, friction: float, iterations: int, force) -> None:
    """Write the contact forces within friction cones with the smallest sum and moment; their normal
    components sum to 1.

    Minimize |sum f|^2 + |sum lever x f|^2 + 1e-3 |w|^2 + (sum w - 1)^2 over the weights w >= 0 of the cone
    edges by accelerated projected gradient descent (Nesterov), then scale the sum of the weights to 1.

    Args:
        lever: contact points relative to the center, divided by the extent, shape [C, 3]; only the first
            ``number`` are used.
        inward: unit normals into the object, shape [C, 3].
        force: output, shape [C, 3].
    """
    count, around = number * BALANCE_CONE_EDGES, circle(np.int64(BALANCE_CONE_EDGES))
    edges, matrix = np.empty((count, 3)), np.empty((7, count))
    for c in range(number):
        cone_edges(inward[c], friction, around, edges, c * BALANCE_CONE_EDGES)
        for e in range(BALANCE_CONE_EDGES):
            k = c * BALANCE_CONE_EDGES + e
            x, y, z = edges[k, 0], edges[k, 1], edges[k, 2]
            matrix[0, k], matrix[1, k], matrix[2, k] = x, y, z
            matrix[3, k] = lever[c, 1] * z - lever[c, 2] * y
            matrix[4, k] = lever[c, 2] * x - lever[c, 0] * z
            matrix[5, k] = lever[c, 0] * y - lever[c, 1] * x
            matrix[6, k] = 1.0
    regular = 1e-3
    # The step is one over the largest eigenvalue of the objective's Hessian, the Lipschitz constant.
    step = 1.0 / (largest_eigenvalue(matrix, np.int64(7), count) + regular)
    weights, ahead = np.empty(count), np.empty(count)
    for k in range(count):
        weights[k] = ahead[k] = 1.0 / count
    momentum = 1.0
    for _ in range(iterations):
        # One accumulator per row keeps the sums independent of each other.
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
            moved = ahead[k] - step * change
            moved = 0.0 if moved < 0.0 else moved
            ahead[k] = moved + carry * (moved - weights[k])
            weights[k] = moved
        momentum = following
    total = 0.0
    for k in range(count):
        total += weights[k]
    total = 1e-9 if total < 1e-9 else total
    for c in range(number):
        for m in range(3):
            force[c, m] = 0.0
            for e in range(BALANCE_CONE_EDGES):
                k = c * BALANCE_CONE_EDGES + e
                force[c, m] += weights[k] * edges[k, m] / total


def primitive_wrenches(points: np.ndarray, inward: np.ndarray, length: float, friction: float) -> np.ndarray:
    """Return the wrenches of forces along the edges of the friction cones, with a normal component of 1.

    Args:
        points: contacts relative to the center of mass [m], shape [C, 3].
        inward: unit normals into the object, shape [C, 3].
        length: divisor of torques [m].

    Returns:
        force and torque divided by ``length``, shape [C * CLOSURE_CONE_EDGES, 6].
    """
    forces = friction_cone_edges(inward, friction, CLOSURE_CONE_EDGES)
    torques = np.cross(points[:, None] / length, forces)
    return np.concatenate([forces, torques], axis=-1).reshape(-1, 6)


def closure_residual(wrenches: np.ndarray) -> float:
    """Return the smallest norm of a convex combination of wrenches, by non-negative least squares.

    It is zero if contact forces exist that cancel out (the condition on the grasp matrix), and 1 without
    contacts.

    Args:
        wrenches: shape [K, 6].
    """
    if not len(wrenches):
        return 1.0
    # A heavily weighted equation makes the weights sum to 1; ``nnls`` keeps them non-negative.
    heavy = 1e3
    weights, _ = nnls(np.vstack([wrenches.T, np.full(len(wrenches), heavy)]), np.array([0.0] * 6 + [heavy]))
    return float(np.linalg.norm(wrenches.T @ (weights / weights.sum())))


def closure_epsilon(wrenches: np.ndarray) -> float:
    """Return the radius of the largest ball around the origin within the convex hull of wrenches.

    It is the smallest wrench that breaks a grasp whose normal forces sum to 1 (Ferrari and Canny, 1992). Zero
    if the origin is not inside.

    Args:
        wrenches: shape [K, 6].
    """
    if len(wrenches) <= 6 or np.linalg.matrix_rank(wrenches - wrenches.mean(axis=0), tol=1e-6) < 6:
        return 0.0
    try:
        hull = ConvexHull(wrenches)
    except QhullError:
        return 0.0
    return float(max(0.0, -hull.equations[:, -1].max()))

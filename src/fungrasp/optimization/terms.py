"""The terms of the retargeting objective (paper IV.A), each one pure function.

The objective is half the sum of squares of all residuals. A term returns its residuals, shape [N, R], already
divided by the length or angle at which it counts as one unit, and their Jacobian, shape [N, R, D].
"""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import cross, quaternion_conjugate, quaternion_multiply, rotation_vector
from fungrasp.optimization.collision_scene import CollisionScene, gradient_derivative, project_to_surface
from fungrasp.optimization.contact_forces import balanced_forces
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.retargeting_problem import RetargetingProblem

Residual = tuple[np.ndarray, np.ndarray]


def fingertip_position(state: HandState[RetargetingProblem], unit: float = 0.01) -> Residual:
    """(p_tip - p_human tip) / unit for each finger: the first initialisation of IV.A. unit: [m]."""
    match = state.points.match
    far, human = match.far[match.is_last], match.human_far[match.is_last]
    residual = (state.keypoints[:, far] - state.problem.joints[:, human]) / unit
    return _flat(residual, state.keypoint_jacobian(far) / unit)


def keypoint_position(
    state: HandState[CollisionScene], which: np.ndarray, target: np.ndarray, weight: np.ndarray
) -> Residual:
    """weight (p - target) for some key points p.

    Args:
        which: key points, shape [Q].
        target: [m], shape [N, Q, 3].
        weight: [1/m], shape [N, Q].
    """
    residual = weight[..., None] * (state.keypoints[:, which] - target)
    return _flat(residual, weight[..., None, None] * state.keypoint_jacobian(which))


def link_direction(
    state: HandState[RetargetingProblem], unit: float = 0.5, links: np.ndarray | slice = slice(None)
) -> Residual:
    """(d_robot - d_human) / unit for finger links, d the unit vector from the near to the far key point
    (IV.A).

    Args:
        unit: dimensionless.
        links: which of the S finger links; all by default.
    """
    match = state.points.match
    near, far = match.near[links], match.far[links]
    robot = state.keypoints[:, far] - state.keypoints[:, near]
    human = state.problem.joints[:, match.human_far[links]] - state.problem.joints[:, match.human_near[links]]
    length = np.linalg.norm(robot, axis=-1, keepdims=True)
    robot, human = robot / length, human / np.linalg.norm(human, axis=-1, keepdims=True)
    move = (state.keypoint_jacobian(far) - state.keypoint_jacobian(near)) / length[..., None]
    # Derivative of a normalized vector: (I - d d^T) applied to the derivative of the vector over its length.
    jacobian = move - robot[..., None] * np.einsum("nsi,nsid->nsd", robot, move)[:, :, None]
    return _flat((robot - human) / unit, jacobian / unit)


def contact_position(
    state: HandState[RetargetingProblem], unit: float = 0.005, inner_weight: float = 0.4
) -> Residual:
    """L_pos of IV.A, on the surface: c_j (p_j - (s_j + rho_j n_j)) / unit.

    p_j is the far key point of robot link j, s_j the surface point nearest to the corresponding human joint,
    n_j the normal there and rho_j the robot finger's radius, so that thick robot fingers touch where thin
    human fingers did.

    Args:
        unit: [m].
        inner_weight: factor for links that don't end in a fingertip.
    """
    far = state.points.match.far
    target, weight = contact_targets(state.points, state.problem, unit, inner_weight)
    residual = weight[..., None] * (state.keypoints[:, far] - target)
    return _flat(residual, weight[..., None, None] * state.keypoint_jacobian(far))


def contact_targets(
    points: HandPoints, problem: RetargetingProblem, unit: float, inner_weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Targets of ``contact_position`` [m], shape [N, S, 3], and factors of the distances from them [1/m],
    shape [N, S]."""
    match = points.match
    human = match.human_far
    target = problem.surface[:, human] + points.far_radius[:, None] * problem.normals[:, human]
    return target, problem.contacts[:, 1:] * np.where(match.is_last, 1.0, inner_weight) / unit


def contact_gap(state: HandState[RetargetingProblem], unit: float = 0.003) -> Residual:
    """c_j max(0, gap_j) / unit, gap_j the smallest clearance of link j's surface from the object. unit:
    [m]."""
    links = [
        link for link in range(1, len(state.points.link_members)) if len(state.points.link_members[link])
    ]
    nearest = np.stack(
        [
            m[np.argmin(state.clearance[:, m], axis=1)]
            for m in (state.points.link_members[link] for link in links)
        ],
        axis=1,
    )
    clearance = np.take_along_axis(state.clearance, nearest, axis=1)
    wanted = state.problem.contacts[:, links] & (clearance > 0)
    normal = np.take_along_axis(state.normals, nearest[..., None], axis=1)
    jacobian = (normal[:, :, None] @ state.sphere_jacobian(nearest))[:, :, 0]
    return wanted * clearance / unit, wanted[..., None] * jacobian / unit


def object_penetration(
    state: HandState[CollisionScene], unit: float = 0.001, margin: float = 0.0, count: int = 24
) -> Residual:
    """max(0, margin - clearance) / unit for the ``count`` deepest spheres (L_pen of IV.A).

    Args:
        unit, margin: [m].
    """
    deepest = _smallest(state.clearance, count)
    depth = margin - np.take_along_axis(state.clearance, deepest, axis=1)
    active = depth > 0
    normal = np.take_along_axis(state.normals, deepest[..., None], axis=1)
    jacobian = -(normal[:, :, None] @ state.sphere_jacobian(deepest))[:, :, 0]
    return active * depth / unit, active[..., None] * jacobian / unit


def table_penetration(
    state: HandState[CollisionScene], unit: float = 0.001, margin: float = 0.001, count: int = 12
) -> Residual:
    """max(0, margin - height) / unit for the ``count`` lowest spheres (h_{i-table} in L_col of IV.A).

    Args:
        unit, margin: [m].
    """
    lowest = _smallest(state.heights, count)
    depth = margin - np.take_along_axis(state.heights, lowest, axis=1)
    active = depth > 0
    up = np.take_along_axis(
        state.problem.up, np.take_along_axis(state.plane, lowest, axis=1)[..., None], axis=1
    )
    jacobian = -(up[:, :, None] @ state.sphere_jacobian(lowest))[:, :, 0]
    return active * depth / unit, active[..., None] * jacobian / unit


def self_penetration(
    state: HandState[CollisionScene], unit: float = 0.002, margin: float = 0.001, count: int = 8
) -> Residual:
    """max(0, margin - d_ij) / unit for the ``count`` closest pairs of spheres of different fingers, d_ij the
    distance between their surfaces (L_col of IV.A, with the distance of shapes in place of that of joints).

    Args:
        unit, margin: [m].
    """
    pairs = state.points.self_pairs
    spheres, radius = state.spheres, state.points.spheres.radius
    # |a - b|^2 = |a|^2 + |b|^2 - 2 a . b for all pairs at once, shape [N, A, B].
    squared = np.sum(spheres**2, axis=-1)
    product = spheres[:, pairs.first] @ np.swapaxes(spheres[:, pairs.second], 1, 2)
    distance = squared[:, pairs.first, None] + squared[:, None, pairs.second] - 2 * product
    gap = np.sqrt(np.maximum(distance, 1e-12)) - radius[pairs.first, None] - radius[pairs.second]
    gap = np.where(pairs.apart, gap, 1.0).reshape(len(spheres), -1)
    closest = _smallest(gap, count)
    depth = margin - np.take_along_axis(gap, closest, axis=1)
    active = depth > 0
    a, b = pairs.first[closest // len(pairs.second)], pairs.second[closest % len(pairs.second)]
    between = np.take_along_axis(spheres, a[..., None], axis=1) - np.take_along_axis(
        spheres, b[..., None], axis=1
    )
    direction = between / np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-9)
    move = state.sphere_jacobian(a) - state.sphere_jacobian(b)
    jacobian = np.where(active[..., None], -np.einsum("nqi,nqid->nqd", direction, move) / unit, 0.0)
    return active * depth / unit, jacobian


def force_closure(
    state: HandState[RetargetingProblem], unit: float = 0.05, friction: float = 0.3, reach: float = 0.006
) -> Residual:
    """(sum f_j, sum (x_j - center) x f_j / extent) / unit, over links that should touch (L_fc of IV.A).

    x_j is the surface point nearest to the far key point of link j. The f_j are the contact forces within
    friction cones, normal parts summing to one, that balance best: with ``friction`` zero this is Liu et al.,
    "Synthesizing diverse and physically stable grasps", 2021. As the forces are optimal, the derivative holds
    them fixed in the contact frames.

    Args:
        unit: dimensionless.
        friction: coefficient to count on, well below the true one.
        reach: half width of the difference that gives the curvature [m]; it also smooths edges.
    """
    match, problem = state.points.match, state.problem
    wanted = problem.contacts[:, 1:]
    x = state.keypoints[:, match.far]
    place, normal = project_to_surface(problem.bank, problem.grid, x, iterations=2)
    curvature = gradient_derivative(problem.bank, problem.grid, x, reach)
    lever = (place - problem.center[:, None]) / problem.extent[:, None, None]
    force = balanced_forces(lever, -normal, wanted, friction)
    pressure = -np.sum(force * normal, axis=-1)
    # With the forces fixed in the contact frames, a force turns as the normal does: df = -pressure dn.
    move = state.keypoint_jacobian(match.far)
    force_d = -pressure[..., None, None] * np.einsum("nsij,nsjd->nsid", curvature, move)
    # Product rule of lever x force; cross products want xyz last, so that the D derivatives are swapped
    # forward.
    torque = cross(lever, force)
    torque_d = cross(np.swapaxes(move, 2, 3) / problem.extent[:, None, None, None], force[:, :, None])
    torque_d = torque_d + cross(lever[:, :, None], np.swapaxes(force_d, 2, 3))
    residual = np.concatenate([force.sum(axis=1), torque.sum(axis=1)], axis=1)
    jacobian = np.concatenate([force_d.sum(axis=1), np.swapaxes(torque_d.sum(axis=1), 1, 2)], axis=1)
    enough = (wanted.sum(axis=1) >= 2)[:, None]
    return enough * residual / unit, enough[..., None] * jacobian / unit


def stay_near(
    state: HandState[CollisionScene],
    start: tuple[np.ndarray, np.ndarray],
    unit: float = 1.0,
    position_unit: float = np.inf,
    rotation_unit: float = np.inf,
) -> Residual:
    """Differences of joints, wrist position and wrist rotation from ``start`` over their units.

    Args:
        start: wrist poses [N, 7] and independent joints [rad], shape [N, U].
        unit, position_unit, rotation_unit: [rad], [m], [rad].
    """
    pose, independent = start
    turn = rotation_vector(quaternion_multiply(state.wrist_pose[:, 3:], quaternion_conjugate(pose[:, 3:])))
    difference = np.concatenate(
        [state.wrist_pose[:, :3] - pose[:, :3], turn, state.independent - independent], axis=1
    )
    units = np.repeat([position_unit, rotation_unit, unit], [3, 3, independent.shape[1]])
    jacobian = np.broadcast_to(np.diag(1.0 / units), (len(pose), len(units), len(units)))
    return difference / units, jacobian


def _flat(residual: np.ndarray, jacobian: np.ndarray) -> Residual:
    """[N, S, 3] and [N, S, 3, D] to [N, 3 S] and [N, 3 S, D]."""
    count = len(residual)
    return residual.reshape(count, -1), jacobian.reshape(count, -1, jacobian.shape[-1])


def _smallest(values: np.ndarray, count: int) -> np.ndarray:
    """Indices of the ``count`` smallest values of each row, in no order, shape [N, count]."""
    if values.shape[1] <= count:
        return np.broadcast_to(np.arange(values.shape[1]), values.shape)
    return np.argpartition(values, count, axis=1)[:, :count]

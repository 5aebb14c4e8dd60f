"""Plain NumPy versions of the compiled terms, solver and loads, with which the tests compare them.

A term here takes a ``HandState`` and returns its residuals, shape [N, R], already divided by the length or
angle at which they count as one unit, and their Jacobian, shape [N, R, D].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fungrasp.geometry.poses import cross, quaternion_conjugate, quaternion_multiply, rotation_vector
from fungrasp.optimization.force_closure import BALANCE_CONE_EDGES, BALANCE_ITERATIONS
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import (
    EASING,
    LEAST_DAMPING,
    MOST_DAMPING,
    PATIENCE,
    STIFFENING,
    TOLERANCE,
)
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE, LinkContacts
from fungrasp.optimization.problem import (
    CollisionScene,
    RetargetingProblem,
    gradient_derivative,
    project_to_surface,
)
from fungrasp.optimization.wrench_resistance import (
    CONE_EDGES,
    DEEPEST,
    LIMIT_WEIGHT,
    LOAD_ITERATIONS,
    NO_GRIP,
    Grip,
    lift_loads,
)

Residual = tuple[np.ndarray, np.ndarray]
Term = Callable[[HandState[Any]], Residual]


def keypoint_jacobian(state: HandState[Any], which: np.ndarray) -> np.ndarray:
    """Jacobian of some key points. which: indices, shape [Q]; returns shape [N, Q, 3, D]."""
    return state.points.kinematics.jacobian(state.points.keypoints.bodies[which], state.keypoints[:, which])


def fingertip_position(state: HandState[RetargetingProblem], unit: float = 0.01) -> Residual:
    """(p_tip - p_human tip) / unit for each finger: the first initialisation of IV.A. unit: [m]."""
    match = state.points.match
    far, human = match.far[match.is_last], match.human_far[match.is_last]
    residual = (state.keypoints[:, far] - state.problem.joints[:, human]) / unit
    return _flat(residual, keypoint_jacobian(state, far) / unit)


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
    return _flat(residual, weight[..., None, None] * keypoint_jacobian(state, which))


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
    move = (keypoint_jacobian(state, far) - keypoint_jacobian(state, near)) / length[..., None]
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
    return _flat(residual, weight[..., None, None] * keypoint_jacobian(state, far))


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
    problem = state.problem
    plane = (np.einsum("npi,nti->npt", state.spheres, problem.up) + problem.height[:, None]).argmin(axis=2)
    up = np.take_along_axis(problem.up, np.take_along_axis(plane, lowest, axis=1)[..., None], axis=1)
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
    move = keypoint_jacobian(state, match.far)
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


def smooth_absolute(lengths: Residual, weight: float, smoothing: float) -> Residual:
    """Residuals whose halved squares are weight (sqrt(r^2 + smoothing^2) - smoothing): about
    weight |r|.

    Args:
        lengths: r [m] and its Jacobian.
        weight: [1/m].
    """
    r, jacobian = lengths
    hypotenuse = np.sqrt(r**2 + smoothing**2)
    root = np.sqrt(2 * weight / (hypotenuse + smoothing))
    slope = weight / (hypotenuse * root)
    return root * r, slope[..., None] * jacobian


def balanced_forces(
    lever: np.ndarray,
    inward: np.ndarray,
    used: np.ndarray,
    friction: float,
    iterations: int = BALANCE_ITERATIONS,
) -> np.ndarray:
    """Contact forces within friction cones whose sum and moment are as small as possible; their normal parts
    sum to one.

    Minimizes |sum f|^2 + |sum lever x f|^2 + 1e-3 |w|^2 + (sum w - 1)^2 over the weights w >= 0 of the cones'
    edges, by accelerated projected gradient descent (Nesterov), then scales the sum of the weights to one.

    Args:
        lever: contact points relative to the center, over a length of the caller's, shape [N, C, 3].
        inward: unit normals into the object, shape [N, C, 3].
        used: which contacts may press, shape [N, C] bool.
        friction: coefficient.
        iterations: of the descent.

    Returns:
        shape [N, C, 3]; zero where no contact may press.
    """
    count, number, _ = inward.shape
    edges = friction_cone_edges(inward, friction, BALANCE_CONE_EDGES)
    moments = np.cross(lever[:, :, None], edges)
    ones = np.ones((*edges.shape[:-1], 1))
    # Rows are the C * BALANCE_CONE_EDGES edges; columns are force, moment, and the normal part with its goal
    # of one.
    matrix = np.concatenate([edges, moments, ones], axis=-1).reshape(count, number * BALANCE_CONE_EDGES, 7)
    allowed = np.repeat(used, BALANCE_CONE_EDGES, axis=1)
    matrix = matrix * allowed[..., None]
    goal = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    regular = 1e-3
    # The step is one over the largest eigenvalue of the objective's Hessian, the Lipschitz constant.
    step = 1.0 / (largest_eigenvalue_bound(np.swapaxes(matrix, 1, 2) @ matrix)[:, None] + regular)
    weights = allowed / np.maximum(allowed.sum(axis=1, keepdims=True), 1)
    ahead, momentum = weights, 1.0
    for _ in range(iterations):
        error = np.einsum("nke,nk->ne", matrix, ahead) - goal
        gradient = np.einsum("nke,ne->nk", matrix, error) + regular * ahead
        moved = np.maximum(ahead - step * gradient, 0.0) * allowed
        next_momentum = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = moved + (momentum - 1) / next_momentum * (moved - weights)
        weights, momentum = moved, next_momentum
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    return (weights.reshape(count, number, BALANCE_CONE_EDGES, 1) * edges).sum(axis=2)


def largest_eigenvalue_bound(matrix: np.ndarray) -> np.ndarray:
    """Largest eigenvalue of symmetric, positive semidefinite matrices, from above: the sixteenth root of the
    sum of the sixteenth powers of all E eigenvalues, by at most E^(1/16) too large.

    Args:
        matrix: shape [N, E, E].

    Returns:
        shape [N].
    """
    trace = np.trace(matrix, axis1=1, axis2=2)
    power = matrix / np.maximum(trace, 1e-300)[:, None, None]
    for _ in range(3):
        power = power @ power
    return trace * np.sum(power**2, axis=(1, 2)) ** (1 / 16)


def friction_cone_edges(normals: np.ndarray, friction: float, count: int) -> np.ndarray:
    """Edges of the pyramids inscribed in friction cones, each with a normal part of one.

    Args:
        normals: unit vectors along the cones' axes, into the object, shape [..., 3].
        friction: coefficient, the tangent of the cones' half angle.
        count: E, the number of edges.

    Returns:
        shape [..., E, 3].
    """
    # Any vector that is not parallel to the normal gives a first tangent.
    helper = np.where(np.abs(normals[..., :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    first = np.cross(normals, helper)
    first = first / np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-9)
    second = np.cross(normals, first)
    angles = 2 * np.pi * np.arange(count) / count
    tangents = np.cos(angles)[:, None] * first[..., None, :] + np.sin(angles)[:, None] * second[..., None, :]
    return normals[..., None, :] + friction * tangents


def contacts_of_links(state: HandState[Any]) -> LinkContacts:
    """The point of each link that is nearest to the object."""
    points = state.points
    nearest = np.stack([m[np.argmin(state.clearance[:, m], axis=1)] for m in points.link_members], axis=1)
    clearance = np.take_along_axis(state.clearance, nearest, axis=1)
    normal = np.take_along_axis(state.normals, nearest[..., None], axis=1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    centers = np.take_along_axis(state.spheres, nearest[..., None], axis=1)
    place = centers - points.spheres.radius[nearest][..., None] * normal
    jacobian = points.kinematics.jacobian(points.spheres.points.bodies[nearest], place)[..., 6:]
    return LinkContacts(place, -normal, clearance, jacobian)


def unresisted_wrenches(
    grip: Grip, loads: np.ndarray, unit: np.ndarray, iterations: int = LOAD_ITERATIONS
) -> np.ndarray:
    """``fungrasp.optimization.wrench_resistance.unresisted_wrenches``."""
    contacts, used, center, reach, torque_limit, friction = grip
    count, number = loads.shape[:2]
    edges = friction_cone_edges(contacts.inward, friction, CONE_EDGES)
    lever = (contacts.place - center[:, None]) / reach[:, None, None]
    allowed = np.repeat(used, CONE_EDGES, axis=1)[..., None]
    wrench = np.concatenate([edges, cross(lever[:, :, None], edges)], axis=-1).reshape(count, -1, 6) * allowed
    torque = (edges @ contacts.jacobian).reshape(count, wrench.shape[1], -1) * allowed
    # In that unit: forces over it, torques over what a joint can do.
    torque = torque * (LIMIT_WEIGHT * unit[:, None, None] / torque_limit)
    both = np.concatenate([wrench, torque], axis=2)
    step = 1.0 / (largest_eigenvalue_bound(np.swapaxes(both, 1, 2) @ both)[:, None, None] + 1e-3)
    goal = -loads / unit[:, None, None]
    weights = np.zeros((count, number, wrench.shape[1]))
    ahead, momentum = weights, 1.0
    for _ in range(iterations):
        error = ahead @ both
        load = error[..., 6:]
        error[..., 6:] = load - np.clip(load, -LIMIT_WEIGHT, LIMIT_WEIGHT)
        error[..., :6] -= goal
        moved = np.maximum(ahead - step * (error @ np.swapaxes(both, 1, 2) + 1e-3 * ahead), 0.0)
        next_momentum = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = moved + (momentum - 1) / next_momentum * (moved - weights)
        weights, momentum = moved, next_momentum
    return (weights @ wrench - goal) * unit[:, None, None]


def unresisted_share(
    points: HandPoints,
    problem: RetargetingProblem,
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    which: np.ndarray,
) -> np.ndarray:
    """``fungrasp.optimization.wrench_resistance.unresisted_share``."""
    limits = np.array([servo.force_limit for servo in points.kinematics.hand.actuators.values()])
    state = HandState(points, problem, wrist_pose, independent)
    contacts = contacts_of_links(state)
    weight, up = problem.weight, problem.up[:, -1]
    used = (contacts.clearance < CONTACT_DISTANCE) & problem.contacts
    grip = Grip(contacts, used, problem.center, problem.extent, limits)
    left = unresisted_wrenches(grip, lift_loads(up, weight), weight)
    share = np.sqrt(np.max(np.sum(left**2, axis=-1), axis=1)) / weight
    share = np.where(state.clearance.min(axis=1) < -DEEPEST, NO_GRIP, share)
    return np.where(which, share, np.inf)


def minimize(
    points: HandPoints,
    problem: CollisionScene,
    terms: Sequence[Term],
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    iterations: int,
    tolerance: float = TOLERANCE,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimise half the sum of squares of all terms for each grasp by itself.

    Joints at a limit that would be pushed beyond it are held there; steps are clipped to the limits.

    Args:
        points: kinematics made for N hands.
        problem: N grasps, object frame.
        terms: of this file.
        wrist_pose: start, object frame, shape [N, 7].
        independent: start [rad], shape [N, U].
        iterations: number of steps tried.
        tolerance: share of its objective that a grasp must gain in ``PATIENCE`` steps to go on.

    Returns:
        wrist poses [N, 7], independent joints [N, U], objective [N].
    """
    kinematics = points.kinematics
    wrist_pose, independent = wrist_pose.copy(), independent.copy()
    damping, stiffening = np.full(len(problem), 1e-2), np.full(len(problem), STIFFENING)
    stalled = np.zeros(len(problem), dtype=int)
    cost, hessian, gradient = objective_equations(HandState(points, problem, wrist_pose, independent), terms)
    diagonal = np.arange(kinematics.size)
    for _ in range(iterations):
        h, g = hessian.copy(), gradient.copy()
        # Active set: a joint at a limit whose descent step (minus the gradient) points outwards is held
        # there, by a zero gradient, zero off-diagonals and one on the diagonal of its row. Columns 0 to 5 are
        # the wrist.
        stuck = np.zeros(g.shape, dtype=bool)
        stuck[:, 6:] = ((independent <= kinematics.lower + 1e-9) & (g[:, 6:] > 0)) | (
            (independent >= kinematics.upper - 1e-9) & (g[:, 6:] < 0)
        )
        g[stuck] = 0.0
        h *= ~(stuck[:, :, None] | stuck[:, None, :])
        scale = h[:, diagonal, diagonal]
        h[:, diagonal, diagonal] += (
            damping[:, None] * (scale + 1e-3 * scale.max(axis=1, keepdims=True)) + stuck + 1e-9
        )
        step = -np.linalg.solve(h, g[..., None])[..., 0]
        # Longer steps than 0.5 (meters and radians together) leave where the linearization holds.
        step *= np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
        new_pose, new_independent = kinematics.step(wrist_pose, independent, step)
        new_cost, new_hessian, new_gradient = objective_equations(
            HandState(points, problem, new_pose, new_independent), terms
        )
        active = stalled < PATIENCE
        enough = cost - new_cost >= tolerance * cost
        stalled = np.where(active, np.where(enough, 0, stalled + 1), stalled)
        better = active & (new_cost < cost)
        damping = np.clip(damping * np.where(better, EASING, stiffening), LEAST_DAMPING, MOST_DAMPING)
        stiffening = np.where(better, STIFFENING, 2 * stiffening)
        for old, new in (
            (wrist_pose, new_pose),
            (independent, new_independent),
            (cost, new_cost),
            (hessian, new_hessian),
            (gradient, new_gradient),
        ):
            old[better] = new[better]
        if np.all(stalled >= PATIENCE):
            break
    return wrist_pose, independent, cost


def objective_equations(state: HandState, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Objective [N], Gauss-Newton Hessian J^T J [N, D, D] and gradient J^T r [N, D]."""
    cost, hessian, gradient = 0.0, 0.0, 0.0
    for term in terms:
        residual, jacobian = term(state)
        transposed = np.swapaxes(jacobian, 1, 2)
        cost = cost + 0.5 * np.sum(residual**2, axis=1)
        hessian = hessian + transposed @ jacobian
        gradient = gradient + (transposed @ residual[..., None])[..., 0]
    return np.asarray(cost), np.asarray(hessian), np.asarray(gradient)

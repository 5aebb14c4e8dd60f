"""How hard each finger should press: contact forces within friction cones and the servos' torque limits that
balance, as many newtons as asked for where the hand has them."""

from __future__ import annotations

import numpy as np

from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.contact_forces import BALANCE_CONE_EDGES, friction_cone_edges
from fungrasp.optimization.hand_state import HandPoints, HandState

TORQUE_SHARE = 0.9
"""Share of the servos' torque limits that the squeeze may use; what is left holds weight and disturbances."""
SQUEEZE_WEIGHT = 0.3
"""Weight of a missing newton of squeeze against an unbalanced newton: pushing the object is worse than a soft
grip."""
LIMIT_WEIGHT = 2.0
"""Weight of a torque at twice its limit against an unbalanced newton. A servo stops at its limit by itself;
ten times as much costs contacts (docs/decisions/0035-firm-grasps.md)."""


def limited_forces(
    lever: np.ndarray,
    inward: np.ndarray,
    jacobian: np.ndarray,
    used: np.ndarray,
    normal_force: np.ndarray,
    torque_limit: np.ndarray,
    friction: float,
    iterations: int = 300,
) -> np.ndarray:
    """Balanced contact forces within friction cones and about within torque limits [N], shape [N, C, 3].

    Minimizes, over the weights w >= 0 of the cones' edges,

        |sum f|^2 + |sum lever x f|^2 + (SQUEEZE_WEIGHT (sum w - normal_force))^2
        + sum_j (LIMIT_WEIGHT max(0, |tau_j| / torque_limit_j - 1))^2 + 1e-3 |w|^2,

    where tau = sum J^T f, by accelerated projected gradient descent (Nesterov).

    Args:
        lever: contact points relative to the center, over a length of the caller's, shape [N, C, 3].
        inward: unit normals into the object, shape [N, C, 3].
        jacobian: of the contact points with respect to the joints [m/rad], shape [N, C, 3, U].
        used: which contacts may press, shape [N, C] bool.
        normal_force: wanted sum of the normal forces [N], shape [N].
        torque_limit: [N m], shape [U].
        friction: coefficient.
        iterations: of the descent.
    """
    count, number, _ = inward.shape
    edges = friction_cone_edges(inward, friction, BALANCE_CONE_EDGES)
    moments = np.cross(lever[:, :, None], edges)
    ones = np.full((*edges.shape[:-1], 1), SQUEEZE_WEIGHT)
    # Rows are the C * BALANCE_CONE_EDGES edges; columns are force, moment, squeeze, and then the torques.
    allowed = np.repeat(used, BALANCE_CONE_EDGES, axis=1)
    wrench = np.concatenate([edges, moments, ones], axis=-1).reshape(count, -1, 7) * allowed[..., None]
    torque = (edges @ jacobian).reshape(count, allowed.shape[1], -1) * allowed[..., None]
    torque *= LIMIT_WEIGHT / torque_limit
    goal = np.zeros((count, 7))
    goal[:, 6] = SQUEEZE_WEIGHT * normal_force
    regular = 1e-3
    # The step is one over the largest eigenvalue of the objective's Hessian with all limits exceeded.
    both = np.concatenate([wrench, torque], axis=2)
    step = 1.0 / (np.linalg.eigvalsh(np.swapaxes(both, 1, 2) @ both)[:, -1:] + regular)
    weights = allowed * (normal_force / np.maximum(allowed.sum(axis=1), 1))[:, None]
    ahead, momentum = weights, 1.0
    for _ in range(iterations):
        error = (ahead[:, None] @ wrench)[:, 0] - goal
        load = (ahead[:, None] @ torque)[:, 0]
        excess = load - np.clip(load, -LIMIT_WEIGHT, LIMIT_WEIGHT)
        gradient = (both @ np.concatenate([error, excess], axis=1)[..., None])[..., 0] + regular * ahead
        moved = np.maximum(ahead - step * gradient, 0.0) * allowed
        next_momentum = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = moved + (momentum - 1) / next_momentum * (moved - weights)
        weights, momentum = moved, next_momentum
    return (weights.reshape(count, number, BALANCE_CONE_EDGES, 1) * edges).sum(axis=2)


def squeeze_torques(
    hand: Hand,
    around: CollisionScene,
    objects: list[ObjectModel],
    wrist_in_object: np.ndarray,
    grasp: np.ndarray,
    contacts: np.ndarray,
    normal_force: np.ndarray,
    friction: float = 0.6,
    near: float = 0.006,
) -> np.ndarray:
    """Joint torques that squeeze [N m], shape [N, U]: of balanced forces about within the torque limits.

    Args:
        hand: the robot hand.
        around: N objects and tables.
        objects: of each grasp, length N.
        wrist_in_object: shape [N, 7].
        grasp: independent joints [rad], shape [N, U].
        contacts: links that should touch, palm first, shape [N, L] bool.
        normal_force: wanted sum of the normal forces [N], shape [N].
        friction: coefficient to plan with; less than the true one, to be safe.
        near: links farther from the object than this are left out [m].
    """
    points = HandPoints(HandKinematics(hand, len(around)))
    state = HandState(points, around, wrist_in_object, grasp)
    nearest = np.stack([m[np.argmin(state.clearance[:, m], axis=1)] for m in points.link_members], axis=1)
    # nearest [N, L]: of each link the collision sphere that is nearest to the object.
    clearance = np.take_along_axis(state.clearance, nearest, axis=1)
    normal = np.take_along_axis(state.normals, nearest[..., None], axis=1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    place = (
        np.take_along_axis(state.spheres, nearest[..., None], axis=1)
        - points.spheres.radius[nearest][..., None] * normal
    )
    jacobian = points.kinematics.jacobian(points.spheres.points.bodies[nearest], place)[..., 6:]
    used = contacts & (clearance < near)
    lonely = used.sum(axis=1) < 2
    used[lonely] = (clearance <= np.sort(clearance, axis=1)[:, 2:3])[lonely]
    centers = np.array([model.center_of_mass for model in objects])
    reach = np.array([0.5 * float(np.max(model.size)) for model in objects])
    limit = TORQUE_SHARE * np.array([servo.force_limit for servo in hand.actuators.values()])
    lever = (place - centers[:, None]) / reach[:, None, None]
    force = limited_forces(lever, -normal, jacobian, used, normal_force, limit, friction)
    # Virtual work: tau = sum over contacts of J^T f, with the columns of the joints alone, shape [N, U].
    return np.einsum("nci,nciu->nu", force, jacobian)

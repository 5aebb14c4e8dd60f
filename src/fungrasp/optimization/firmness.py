"""How firmly a hand could hold: the load that its contacts cannot take within friction and torque limits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fungrasp.geometry.poses import cross
from fungrasp.optimization.contact_forces import (
    CONTACT_DISTANCE,
    friction_cone_edges,
    largest_eigenvalue_bound,
)
from fungrasp.optimization.hand_state import HandPoints, HandState
from fungrasp.optimization.levenberg_marquardt import COMPILED, only_hinges
from fungrasp.optimization.retargeting_problem import RetargetingProblem

LOAD_CONE_EDGES = 6
"""Edges of the pyramids that stand for friction cones."""
LIMIT_WEIGHT = 5.0
"""Weight of a torque at twice its limit against an unresisted load of the object's weight; large, as a servo
cannot exceed its limit."""
FRICTION = 0.9
"""Coefficient between hand and object: the nominal one."""
DISTURBANCE = 0.5
"""What a grip must resist besides the weight, in weights."""
LOAD_ITERATIONS = 100
"""Of the descent to the best contact forces."""

FIRMNESS_WEIGHT = 40.0
"""What a load of the object's weight that the contacts cannot take adds to the objective where solutions are
compared: how much likeness to the given grasp a firm grip is worth."""

DEEPEST = 0.001
"""A hand that goes farther into the object than this has no grip, however firm it would be [m]."""
NO_GRIP = 1.5
"""Share of the weight that is unresisted without any contact: the weight, and half of it pulling down."""


class LinkContacts(NamedTuple):
    """Where the L links of N hands touch, or would, object frame."""

    place: np.ndarray
    """Point of each link's surface that is nearest to the object [m], shape [N, L, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [N, L, 3]."""
    clearance: np.ndarray
    """Distance from the object [m], shape [N, L]."""
    jacobian: np.ndarray
    """Of the points with respect to the independent joints [m/rad], shape [N, L, 3, U]."""


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


def unresisted_load(
    contacts: LinkContacts,
    used: np.ndarray,
    center: np.ndarray,
    reach: np.ndarray,
    weight: np.ndarray,
    up: np.ndarray,
    torque_limit: np.ndarray,
    friction: float = FRICTION,
    disturbance: float = DISTURBANCE,
    iterations: int = LOAD_ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """The force [N] and torque [N m] that the contacts cannot take of the worst of six loads, shape [N] each.

    A load is the object's weight at its center of mass and a disturbance of ``disturbance`` times the weight
    there, up, down or in one of four horizontal directions. The acceleration of the lift is small against it.
    The contact forces f within their friction cones minimize

        |sum f + load|^2 + |sum (x - center) x f|^2 / reach^2
        + sum_j (LIMIT_WEIGHT weight max(0, |tau_j| / torque_limit_j - 1))^2,   tau = sum J^T f.

    What is left of the first two terms is what they cannot take. Both are zero for a firm grasp.

    Args:
        contacts: of N hands.
        used: which links touch, shape [N, L] bool.
        center: center of mass [m], object frame, shape [N, 3].
        reach: lever arm at which a torque counts like a force [m], shape [N].
        weight: of the object [N], shape [N].
        up: unit vector against gravity, object frame, shape [N, 3].
        torque_limit: of the independent joints [N m], shape [U].
        friction: coefficient.
        disturbance: in weights.
        iterations: of the accelerated projected gradient descent.
    """
    loads = np.zeros((len(weight), 6, 6))
    loads[..., :3] = weight[:, None, None] * (disturbance * load_directions(up) - up[:, None])
    left = unresisted_wrenches(
        contacts, used, center, reach, loads, weight, torque_limit, friction, iterations
    )
    worst = np.argmax(np.sum(left**2, axis=-1), axis=1)
    left = left[np.arange(len(weight)), worst]
    return np.linalg.norm(left[:, :3], axis=1), np.linalg.norm(left[:, 3:], axis=1) * reach


def unresisted_wrenches(
    contacts: LinkContacts,
    used: np.ndarray,
    center: np.ndarray,
    reach: np.ndarray,
    loads: np.ndarray,
    unit: np.ndarray,
    torque_limit: np.ndarray,
    friction: float = FRICTION,
    iterations: int = LOAD_ITERATIONS,
) -> np.ndarray:
    """What the contacts cannot take of each load: force [N] and torque over ``reach`` [N], shape [N, K, 6].
    The contact forces minimize what ``unresisted_load`` says.

    Args:
        contacts, used, center, reach, torque_limit, friction, iterations: as for ``unresisted_load``.
        loads: forces [N], and torques over ``reach`` [N], on the object, shape [N, K, 6].
        unit: force against which a torque beyond its limit counts [N], shape [N].
    """
    count, number = loads.shape[:2]
    edges = friction_cone_edges(contacts.inward, friction, LOAD_CONE_EDGES)
    lever = (contacts.place - center[:, None]) / reach[:, None, None]
    allowed = np.repeat(used, LOAD_CONE_EDGES, axis=1)[..., None]
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
    which: np.ndarray | None = None,
    compiled: bool = COMPILED,
) -> np.ndarray:
    """``unresisted_load`` of the links in contact as a share of the objects' weight, shape [N]: force and
    torque over the object's extent together; zero for a firm grasp, ``NO_GRIP`` without contacts and where
    the hand goes into the object by more than ``DEEPEST``.

    Args:
        points: kinematics made for N hands; the denser, the less goes into the object unseen.
        problem: N grasps, object frame.
        wrist_pose: object frame, shape [N, 7].
        independent: joints [rad], shape [N, U].
        which: grasps to judge, shape [N] bool; others have infinity. All if None.
        compiled: by compiled loops, which need Numba and hinge joints, or by NumPy.
    """
    hand = points.kinematics.hand
    which = np.ones(len(problem), dtype=bool) if which is None else which
    limits = np.array([servo.force_limit for servo in hand.actuators.values()])
    if compiled and only_hinges(hand.model):
        from fungrasp.optimization.compiled.contact_loads import LoadRule
        from fungrasp.optimization.compiled.solver import compiled_shares

        rule = LoadRule(
            CONTACT_DISTANCE,
            DEEPEST,
            NO_GRIP,
            LOAD_CONE_EDGES,
            LIMIT_WEIGHT,
            FRICTION,
            DISTURBANCE,
            LOAD_ITERATIONS,
        )
        return compiled_shares(points, problem, wrist_pose, independent, which, limits, rule)
    state = HandState(points, problem, wrist_pose, independent)
    contacts = contacts_of_links(state)
    force, torque = unresisted_load(
        contacts,
        contacts.clearance < CONTACT_DISTANCE,
        problem.center,
        problem.extent,
        problem.weight,
        problem.up[:, -1],
        limits,
    )
    share = np.hypot(force, torque / problem.extent) / problem.weight
    share = np.where(state.clearance.min(axis=1) < -DEEPEST, NO_GRIP, share)
    return np.where(which, share, np.inf)


def load_directions(up: np.ndarray) -> np.ndarray:
    """Up, down and four horizontal directions, unit vectors, shape [N, 6, 3]. up: shape [N, 3]."""
    helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = cross(up, helper)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = cross(up, first)
    return np.stack([up, -up, first, -first, second, -second], axis=1)

"""Wrenches that contacts can resist within friction cones and torque limits.

A wrench has six components: a force [N], and a torque divided by a lever arm that the caller chooses [N].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.geometry.poses import cross
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.optimization.friction_cones import circle, cone_edges, largest_eigenvalue
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE, LinkContacts, contacts_of_links
from fungrasp.optimization.problem import CollisionScene, RetargetingProblem

CONE_EDGES = 6
"""Edges of the pyramids that approximate friction cones."""
LIMIT_WEIGHT = 5.0
"""Weight of a torque at twice its limit relative to an unresisted load of the object's weight; large, because
a servo cannot exceed its limit."""
FRICTION = 0.6
"""Assumed friction coefficient between hand and object: less than the nominal 0.9, because real contacts
deviate from planned ones."""
DISTURBANCE = 0.5
"""Disturbance that a grip must resist, relative to the object's weight."""
LOAD_ITERATIONS = 100
"""Iterations of the descent to the best contact forces."""
DEEPEST = 0.001
"""Maximum penetration of a valid grip [m]."""
NO_GRIP = 1.5
"""Unresisted share of the weight without contacts: the weight and a disturbance of half the weight."""
NEAR = 0.006
"""Maximum clearance of links that are counted as contacts when the hand closes [m]."""


class Grip(NamedTuple):
    """Contacts and torque limits of N hands that hold objects."""

    contacts: LinkContacts
    """Contacts of the links."""
    used: np.ndarray
    """Links that touch, shape [N, L] bool."""
    center: np.ndarray
    """Center of mass [m], object frame, shape [N, 3]."""
    reach: np.ndarray
    """Lever arm that converts torques to forces [m], shape [N]."""
    torque_limit: np.ndarray
    """Torque limits of the independent joints [N m], shape [U]."""
    friction: float = FRICTION
    """Assumed friction coefficient."""


def grip_of(
    points: HandPoints,
    around: CollisionScene,
    objects: Sequence[ObjectModel],
    wrist_pose: np.ndarray,
    independent: np.ndarray,
) -> Grip:
    """Return the grip of all links nearer to the object than ``NEAR``.

    Args:
        around: collision geometry of N hands.
        objects: object of each hand, length N.
        wrist_pose: object frame, shape [N, 7].
        independent: joints [rad], shape [N, U].
    """
    contacts = contacts_of_links(points, around, wrist_pose, independent)
    centers = np.array([model.center_of_mass for model in objects])
    reach = np.array([0.5 * float(np.max(model.size)) for model in objects])
    return Grip(contacts, contacts.clearance < NEAR, centers, reach, torque_limits(points.kinematics.hand))


def torque_limits(hand: Hand) -> np.ndarray:
    """Return the torque limits of the servos [N m], shape [U]."""
    return np.array([servo.force_limit for servo in hand.actuators.values()])


def lift_loads(up: np.ndarray, weight: np.ndarray, disturbance: float = DISTURBANCE) -> np.ndarray:
    """Return the loads of a lift at the center of mass: forces [N] and torques [N m], object frame, shape
    [N, 6, 6].

    Each load is the weight plus ``disturbance`` times the weight, down, up or in one of four horizontal
    directions. The acceleration of the lift is small compared with the disturbance.

    Args:
        up: unit vectors against gravity, object frame, shape [N, 3].
        weight: [N], shape [N].
    """
    helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = cross(up, helper)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = cross(up, first)
    directions = np.stack([-up, up, first, -first, second, -second], axis=1)
    force = weight[:, None, None] * (disturbance * directions - up[:, None])
    return np.concatenate([force, np.zeros_like(force)], axis=-1)


def unresisted_share(
    contacts: LinkContacts,
    problem: RetargetingProblem,
    torque_limit: np.ndarray,
    lower: float = 0.0,
    upper: np.ndarray | None = None,
) -> np.ndarray:
    """Return the ``unresisted_load`` of wanted contacts relative to the objects' weight, shape [N].

    The share combines force and torque divided by the object's extent. It is zero for a firm grasp, and
    ``NO_GRIP`` without contacts or if the hand penetrates the object by more than ``DEEPEST``.

    Args:
        contacts: contacts of N hands; denser spheres detect more penetration.
        problem: N grasps.
        torque_limit: torque limits of the independent joints [N m], shape [U].
        lower, upper: as for ``unresisted_load``; the share is infinite if upper <= lower.
    """
    which = np.ones(len(problem), dtype=bool) if upper is None else upper > lower
    inside = contacts.clearance.min(axis=1) < -DEEPEST
    used = (contacts.clearance < CONTACT_DISTANCE) & problem.contacts & (which & ~inside)[:, None]
    grip = Grip(contacts, used, problem.center, problem.extent, torque_limit)
    force, torque = unresisted_load(grip, problem.weight, problem.up[:, -1], LOAD_ITERATIONS, lower, upper)
    share = np.where(inside, NO_GRIP, np.hypot(force, torque / problem.extent) / problem.weight)
    return np.where(which, share, np.inf)


def unresisted_load(
    grip: Grip,
    weight: np.ndarray,
    up: np.ndarray,
    iterations: int = LOAD_ITERATIONS,
    lower: float = 0.0,
    upper: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the force [N] and torque [N m] of the worst of ``lift_loads`` that a grip cannot resist, shape
    [N] each.

    The contact forces f within their friction cones minimize

        |sum f + load|^2 + |sum (x - center) x f|^2 / reach^2
        + sum_j (LIMIT_WEIGHT weight max(0, |tau_j| / torque_limit_j - 1))^2,   tau = sum J^T f.

    The remainder of the first two terms is the unresisted load. Both are zero for a firm grasp.

    Args:
        grip: grip of N hands.
        weight: weight of the object [N], shape [N].
        up: unit vector against gravity, object frame, shape [N, 3].
        iterations: iterations of the accelerated projected gradient descent.
        lower: share of the weight; the descent stops early at a remainder of at most this.
        upper: share of the weight, shape [N]; once a remainder reaches it, the other loads are skipped.
    """
    left = unresisted_wrenches(grip, lift_loads(up, weight), weight, iterations, (lower, upper))
    worst = np.argmax(np.sum(left**2, axis=-1), axis=1)
    left = left[np.arange(len(weight)), worst]
    return np.linalg.norm(left[:, :3], axis=1), np.linalg.norm(left[:, 3:], axis=1) * grip.reach


def unresisted_wrenches(
    grip: Grip,
    loads: np.ndarray,
    unit: np.ndarray,
    iterations: int,
    worst: tuple[float, np.ndarray | None],
) -> np.ndarray:
    """Return the unresisted part of each load, wrenches over the grip's reach, shape [N, K, 6]. Only that of
    the worst load is accurate.

    The contact forces minimize the objective of ``unresisted_load``.

    Args:
        grip: grip of N hands.
        loads: wrenches over the grip's reach, shape [N, K, 6].
        unit: force scale of the torque limit term [N], shape [N].
        worst: ``lower`` and ``upper`` of ``unresisted_load``, shares of ``unit``.
    """
    left = np.zeros(loads.shape)
    lower, upper = worst
    flat = Grip(
        LinkContacts(*(plain(x) for x in grip.contacts)),
        plain(grip.used, bool),
        plain(grip.center),
        plain(grip.reach),
        plain(LIMIT_WEIGHT * unit[:, None] / grip.torque_limit),
        float(grip.friction),
    )
    upper = np.full(len(unit), np.inf) if upper is None else plain(upper)
    _descend(flat, plain(loads / unit[:, None, None]), iterations, float(lower), upper, left)
    return left * unit[:, None, None]


class _Columns(NamedTuple):
    """Wrench and joint torques of each edge of a hand's friction cones, ordered by contact."""

    wrench: np.ndarray
    """Wrenches, shape [K, 6]."""
    torque: np.ndarray
    """Weighted torques on the joints that move the contact, shape [K, U]."""
    joints: np.ndarray
    """Joints that move each contact, shape [C, U]."""
    joint_count: np.ndarray
    """Number of these joints, shape [C]."""


@compiled
def _descend(
    grip: Grip, loads: np.ndarray, iterations: int, lower: float, upper: np.ndarray, left: np.ndarray
) -> None:
    """Write ``unresisted_wrenches`` by accelerated projected gradient descent (Nesterov).

    Args:
        grip: its ``torque_limit`` holds the weights of joint torques [1/m], shape [N, U].
        loads: divided by the unit of force, shape [N, K, 6].
        lower, upper: as for ``unresisted_load``.
        left: output, shape [N, K, 6].
    """
    contacts, used, torque_weight = grip.contacts, grip.used, grip.torque_limit
    links, joints = used.shape[1], torque_weight.shape[1]
    room = links * CONE_EDGES
    edges, around = np.empty((room, 3)), circle(np.int64(CONE_EDGES))
    wrench, torque = np.empty((room, 6)), np.empty((room, joints))
    columns, used_columns = np.empty((links, joints), np.int64), np.empty(links, np.int64)
    matrix = np.empty((6 + joints, room))
    for i in range(len(used)):
        number = np.int64(0)
        for link in range(links):
            if not used[i, link]:
                continue
            first, count = number * CONE_EDGES, np.int64(0)
            cone_edges(contacts.inward[i, link], grip.friction, around, edges, first)
            lx = (contacts.place[i, link, 0] - grip.center[i, 0]) / grip.reach[i]
            ly = (contacts.place[i, link, 1] - grip.center[i, 1]) / grip.reach[i]
            lz = (contacts.place[i, link, 2] - grip.center[i, 2]) / grip.reach[i]
            for k in range(first, first + CONE_EDGES):
                x, y, z = edges[k, 0], edges[k, 1], edges[k, 2]
                wrench[k, 0], wrench[k, 1], wrench[k, 2] = x, y, z
                wrench[k, 3], wrench[k, 4], wrench[k, 5] = ly * z - lz * y, lz * x - lx * z, lx * y - ly * x
            for u in range(joints):
                mx = contacts.jacobian[i, link, 0, u]
                my = contacts.jacobian[i, link, 1, u]
                mz = contacts.jacobian[i, link, 2, u]
                if mx == 0 and my == 0 and mz == 0:
                    continue
                for k in range(first, first + CONE_EDGES):
                    pressed = edges[k, 0] * mx + edges[k, 1] * my + edges[k, 2] * mz
                    torque[k, count] = torque_weight[i, u] * pressed
                columns[number, count] = u
                count += 1
            used_columns[number] = count
            number += 1
        total = number * CONE_EDGES
        for k in range(total):
            for d in range(6 + joints):
                matrix[d, k] = wrench[k, d] if d < 6 else 0.0
            contact = k // CONE_EDGES
            for q in range(used_columns[contact]):
                matrix[6 + columns[contact, q], k] = torque[k, q]
        step, steps = 1.0, np.int64(0)
        if number > 0:
            # The step is one over the largest eigenvalue of the objective's Hessian, the Lipschitz constant.
            step, steps = 1.0 / (largest_eigenvalue(matrix, 6 + joints, total) + 1e-3), iterations
        bound, made = lower, _Columns(wrench, torque, columns, used_columns)
        for load in range(loads.shape[1]):
            found = left[i, load]
            _resist(made, total, loads[i, load], step, steps, bound, found)
            # A load matters only if its remainder exceeds those of the loads before it.
            size = 0.0
            for part in range(6):
                size += found[part] * found[part]
            if size > bound * bound:
                bound = math.sqrt(size)
            if bound >= upper[i]:
                break


@compiled_part
def _resist(
    made: _Columns, count: int, load, step: float, iterations: int, lower: float, left: np.ndarray
) -> None:
    """Write the remainder of a load under the best contact forces, given by ``count`` weights of cone edges,
    or under the first forces with a remainder of at most ``lower``."""
    wrench, torque, columns, used_columns = made
    joints = torque.shape[1]
    weights, ahead, excess = np.empty(count), np.empty(count), np.empty(joints)
    for k in range(count):
        weights[k] = ahead[k] = 0.0
    momentum = 1.0
    for _ in range(iterations):
        # One accumulator per component keeps the sums independent of each other.
        a, b, c, d, e, f = load[0], load[1], load[2], load[3], load[4], load[5]
        for u in range(joints):
            excess[u] = 0.0
        for k in range(count):
            w = ahead[k]
            if w != 0.0:
                a += wrench[k, 0] * w
                b += wrench[k, 1] * w
                c += wrench[k, 2] * w
                d += wrench[k, 3] * w
                e += wrench[k, 4] * w
                f += wrench[k, 5] * w
                contact = k // CONE_EDGES
                for q in range(used_columns[contact]):
                    excess[columns[contact, q]] += torque[k, q] * w
        beyond = 0.0
        for u in range(joints):
            if abs(excess[u]) <= LIMIT_WEIGHT:
                excess[u] = 0.0
            else:
                excess[u] -= LIMIT_WEIGHT if excess[u] > 0 else -LIMIT_WEIGHT
                beyond += excess[u] * excess[u]
        if lower > 0.0 and a * a + b * b + c * c + d * d + e * e + f * f + beyond <= lower * lower:
            pushing = True
            for k in range(count):
                pushing = pushing and ahead[k] >= 0.0
            if pushing:
                for k in range(count):
                    weights[k] = ahead[k]
                break
        following = 0.5 * (1 + math.sqrt(1 + 4 * momentum * momentum))
        carry = (momentum - 1) / following
        momentum = following
        for k in range(count):
            contact = k // CONE_EDGES
            change = 1e-3 * ahead[k]
            change += (
                wrench[k, 0] * a + wrench[k, 1] * b + wrench[k, 2] * c
                + wrench[k, 3] * d + wrench[k, 4] * e + wrench[k, 5] * f
            )  # fmt: skip
            for q in range(used_columns[contact]):
                change += torque[k, q] * excess[columns[contact, q]]
            moved = ahead[k] - step * change
            moved = 0.0 if moved < 0.0 else moved
            ahead[k] = moved + carry * (moved - weights[k])
            weights[k] = moved
    for part in range(6):
        left[part] = load[part]
        for k in range(count):
            left[part] += wrench[k, part] * weights[k]


def wrenches_over_reach(loads: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return wrenches from forces [N] and torques [N m], shape [N, K, 6]. reach: [m], shape [N]."""
    return np.concatenate([loads[..., :3], loads[..., 3:] / reach[:, None, None]], axis=-1)

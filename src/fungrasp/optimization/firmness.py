"""How firmly a hand could hold: the load that its contacts cannot take within friction and torque limits."""

from __future__ import annotations

import math

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part, plain
from fungrasp.geometry.poses import cross
from fungrasp.optimization.friction_cones import circle, cone_edges, largest_eigenvalue
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import CONTACT_DISTANCE, LinkContacts, contacts_of_links
from fungrasp.optimization.retargeting_problem import RetargetingProblem

LOAD_CONE_EDGES = 6
"""Edges of the pyramids that stand for friction cones."""
LIMIT_WEIGHT = 5.0
"""Weight of a torque at twice its limit against an unresisted load of the object's weight; large, as a servo
cannot exceed its limit."""
FRICTION = 0.6
"""Coefficient between hand and object that is counted on: less than the nominal 0.9, as contacts come to lie
beside where they are planned."""
DISTURBANCE = 0.5
"""What a grip must resist besides the weight, in weights."""
LOAD_ITERATIONS = 100
"""Of the descent to the best contact forces."""

DEEPEST = 0.001
"""A hand that goes farther into the object than this has no grip, however firm it would be [m]."""
NO_GRIP = 1.5
"""Share of the weight that is unresisted without any contact: the weight, and half of it pulling down."""


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
    enough: float = 0.0,
    most: np.ndarray | None = None,
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
        enough: share of the weight; no more than it is as good as any less, which is found sooner.
        most: the same, shape [N]; as much as it is as bad as any more.
    """
    loads = np.zeros((len(weight), 6, 6))
    loads[..., :3] = weight[:, None, None] * (disturbance * load_directions(up) - up[:, None])
    left = unresisted_wrenches(
        contacts, used, center, reach, loads, weight, torque_limit, friction, iterations, (enough, most)
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
    worst: tuple[float, np.ndarray | None] | None = None,
) -> np.ndarray:
    """What the contacts cannot take of each load: force [N] and torque over ``reach`` [N], shape [N, K, 6].
    The contact forces minimize what ``unresisted_load`` says.

    Args:
        contacts, used, center, reach, torque_limit, friction, iterations: as for ``unresisted_load``.
        loads: forces [N], and torques over ``reach`` [N], on the object, shape [N, K, 6].
        unit: force against which a torque beyond its limit counts [N], shape [N].
        worst: ``enough`` and ``most`` of ``unresisted_load``, shares of ``unit``; what is left is then
            right for the worst load alone. For each if None.
    """
    left = np.zeros(loads.shape)
    enough, most = (-1.0, None) if worst is None else worst
    _descend(
        LinkContacts(*(plain(x) for x in contacts)),
        plain(used, bool),
        plain(center),
        plain(reach),
        plain(loads / unit[:, None, None]),
        plain(LIMIT_WEIGHT * unit[:, None] / torque_limit),
        float(friction),
        iterations,
        float(enough),
        np.full(len(unit), np.inf) if most is None else plain(most),
        left,
    )
    return left * unit[:, None, None]


@compiled
def _descend(
    contacts: LinkContacts,
    used: np.ndarray,
    center: np.ndarray,
    reach: np.ndarray,
    loads: np.ndarray,
    torque_weight: np.ndarray,
    friction: float,
    iterations: int,
    enough: float,
    most: np.ndarray,
    left: np.ndarray,
) -> None:
    """Write what ``unresisted_wrenches`` leaves of each load, by accelerated projected gradient descent
    (Nesterov).

    Args:
        contacts, used, center, reach, friction, iterations: as there.
        enough, most: as there; where enough is negative, each load counts.
        loads: in units of force, shape [N, K, 6].
        torque_weight: what a torque of each joint weighs [1/(N m)], shape [N, U].
        left: shape [N, K, 6].
    """
    links, joints = used.shape[1], torque_weight.shape[1]
    room = links * LOAD_CONE_EDGES
    edges, around = np.empty((room, 3)), circle(np.int64(LOAD_CONE_EDGES))
    wrench, torque = np.empty((room, 6)), np.empty((room, joints))
    columns, used_columns = np.empty((links, joints), np.int64), np.empty(links, np.int64)
    matrix = np.empty((6 + joints, room))
    for i in range(len(used)):
        number = np.int64(0)
        for link in range(links):
            if not used[i, link]:
                continue
            first, count = number * LOAD_CONE_EDGES, np.int64(0)
            cone_edges(contacts.inward[i, link], friction, around, edges, first)
            lx = (contacts.place[i, link, 0] - center[i, 0]) / reach[i]
            ly = (contacts.place[i, link, 1] - center[i, 1]) / reach[i]
            lz = (contacts.place[i, link, 2] - center[i, 2]) / reach[i]
            for k in range(first, first + LOAD_CONE_EDGES):
                x, y, z = edges[k, 0], edges[k, 1], edges[k, 2]
                wrench[k, 0], wrench[k, 1], wrench[k, 2] = x, y, z
                wrench[k, 3], wrench[k, 4], wrench[k, 5] = ly * z - lz * y, lz * x - lx * z, lx * y - ly * x
            for u in range(joints):
                mx = contacts.jacobian[i, link, 0, u]
                my = contacts.jacobian[i, link, 1, u]
                mz = contacts.jacobian[i, link, 2, u]
                if mx == 0 and my == 0 and mz == 0:
                    continue
                for k in range(first, first + LOAD_CONE_EDGES):
                    pressed = edges[k, 0] * mx + edges[k, 1] * my + edges[k, 2] * mz
                    torque[k, count] = torque_weight[i, u] * pressed
                columns[number, count] = u
                count += 1
            used_columns[number] = count
            number += 1
        total = number * LOAD_CONE_EDGES
        for k in range(total):
            for d in range(6 + joints):
                matrix[d, k] = wrench[k, d] if d < 6 else 0.0
            contact = k // LOAD_CONE_EDGES
            for q in range(used_columns[contact]):
                matrix[6 + columns[contact, q], k] = torque[k, q]
        step, steps = 1.0, np.int64(0)
        if number > 0:
            # The step is one over the largest eigenvalue of the objective's Hessian, the Lipschitz constant.
            step, steps = 1.0 / (largest_eigenvalue(matrix, 6 + joints, total) + 1e-3), iterations
        bound = enough
        for load in range(loads.shape[1]):
            found = left[i, load]
            _resist(wrench, torque, columns, used_columns, total, loads[i, load], step, steps, bound, found)
            if enough < 0.0:
                continue
            # Only a load of which more is left than of those before matters.
            size = 0.0
            for part in range(6):
                size += found[part] * found[part]
            if size > bound * bound:
                bound = math.sqrt(size)
            if bound >= most[i]:
                break


@compiled_part
def _resist(
    wrench,
    torque,
    columns,
    used_columns,
    count: int,
    load,
    step: float,
    iterations: int,
    enough: float,
    left,
) -> None:
    """Write what the best contact forces, of ``count`` weights of cones' edges, leave of a load; or others
    that leave no more than ``enough`` of it."""
    joints = torque.shape[1]
    weights, ahead, excess = np.empty(count), np.empty(count), np.empty(joints)
    for k in range(count):
        weights[k] = ahead[k] = 0.0
    momentum = 1.0
    for _ in range(iterations):
        # One accumulator each: sums that do not wait for each other.
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
                contact = k // LOAD_CONE_EDGES
                for q in range(used_columns[contact]):
                    excess[columns[contact, q]] += torque[k, q] * w
        beyond = 0.0
        for u in range(joints):
            if abs(excess[u]) <= LIMIT_WEIGHT:
                excess[u] = 0.0
            else:
                excess[u] -= LIMIT_WEIGHT if excess[u] > 0 else -LIMIT_WEIGHT
                beyond += excess[u] * excess[u]
        if enough > 0.0 and a * a + b * b + c * c + d * d + e * e + f * f + beyond <= enough * enough:
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
            contact = k // LOAD_CONE_EDGES
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


def unresisted_share(
    points: HandPoints,
    problem: RetargetingProblem,
    wrist_pose: np.ndarray,
    independent: np.ndarray,
    enough: float = 0.0,
    most: np.ndarray | None = None,
) -> np.ndarray:
    """``unresisted_load`` of the links in contact that should be, as a share of the objects' weight, shape
    [N]: force and torque over the object's extent together; zero for a firm grasp, ``NO_GRIP`` without
    contacts and where the hand goes into the object by more than ``DEEPEST``.

    Args:
        points: kinematics made for N hands; the denser, the less goes into the object unseen.
        problem: N grasps, object frame.
        wrist_pose: object frame, shape [N, 7].
        independent: joints [rad], shape [N, U].
        enough, most: as for ``unresisted_load``; where most is no more than enough, the share is infinite.
    """
    limits = np.array([servo.force_limit for servo in points.kinematics.hand.actuators.values()])
    which = None if most is None else most > enough
    contacts = contacts_of_links(points, problem, wrist_pose, independent, CONTACT_DISTANCE, which)
    inside = contacts.clearance.min(axis=1) < -DEEPEST
    force, torque = unresisted_load(
        contacts,
        np.isfinite(contacts.clearance) & problem.contacts & ~inside[:, None],
        problem.center,
        problem.extent,
        problem.weight,
        problem.up[:, -1],
        limits,
        enough=enough,
        most=most,
    )
    share = np.where(inside, NO_GRIP, np.hypot(force, torque / problem.extent) / problem.weight)
    return share if which is None else np.where(which, share, np.inf)


def load_directions(up: np.ndarray) -> np.ndarray:
    """Down, up and four horizontal directions, unit vectors, shape [N, 6, 3]. up: shape [N, 3]."""
    helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = cross(up, helper)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = cross(up, first)
    return np.stack([-up, up, first, -first, second, -second], axis=1)

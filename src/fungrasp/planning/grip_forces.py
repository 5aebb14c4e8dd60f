"""How hard each finger should press before the lift: the softest contact forces that stay within friction
cones and the servos' torque limits whatever of the expected loads then comes."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import cross
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.collision_scene import CollisionScene
from fungrasp.optimization.friction_cones import outside_cones
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import contacts_of_links

NEAR = 0.006
"""Links that close onto the object are at most so far from it in the grasp [m]."""
FRICTION = 0.6
"""Coefficient to plan with; less than the true one, to be safe."""
TORQUE_SHARE = 0.9
"""Share of the servos' torque limits that the squeeze and its answer to a load may use."""
BALANCE_WEIGHT = 10.0
"""Weight of the square of an unbalanced newton against one outside a friction cone: pushing the object is
worse than a soft grip."""
LIMIT_WEIGHT = 2.0
"""Weight of a torque at twice its limit against an unbalanced newton. A servo stops at its limit by itself;
ten times as much costs contacts (lab/decisions.md, 0035)."""
CONTACT_COMPLIANCE = 1e-4
"""Yielding of a contact that no joint can move, as of a link pressed along its own length [m/N]: small
against that of the fingers, of about 2e-3 m/N."""
MOST_CONTACTS = 8
"""Links that press; more are hardly ever as near."""
SQUEEZE_ITERATIONS = 200
"""Of the descent in ``holding_forces``."""


def elastic_forces(
    lever: np.ndarray, jacobian: np.ndarray, used: np.ndarray, stiffness: np.ndarray, loads: np.ndarray
) -> np.ndarray:
    """What contacts add to their forces when a load comes [N], shape [N, K, C, 3], as long as nothing slips.

    Fingers are springs: with the compliance of the contact points C = J diag(1 / k) J^T, the stiffness
    K = C^-1 and the grasp map G, a load w is answered by -K G^T (G K G^T)^-1 w (Cutkosky and Kao, "Computing
    and controlling the compliance of a robotic hand", 1989).

    Args:
        lever: contact points relative to the center of mass, over a length of the caller's, shape [N, C, 3].
        jacobian: of the contact points with respect to the joints [m/rad], shape [N, C, 3, U].
        used: which contacts may press, shape [N, C] bool.
        stiffness: of the servos [N m/rad], shape [N, U].
        loads: forces [N], and torques over that length [N], on the object, shape [N, K, 6].
    """
    count, number = used.shape
    flat = jacobian.reshape(count, 3 * number, -1)
    allowed = np.repeat(used, 3, axis=1)
    compliance = (flat / stiffness[:, None]) @ np.swapaxes(flat, 1, 2)
    compliance[:, np.arange(3 * number), np.arange(3 * number)] += CONTACT_COMPLIANCE
    # Contacts that are not used get the identity, and no part in anything.
    both = allowed[:, :, None] & allowed[:, None, :]
    inverse = np.linalg.inv(np.where(both, compliance, np.eye(3 * number))) * both
    grasp_map = _grasp_map(lever) * allowed[:, None]
    answer = inverse @ np.swapaxes(grasp_map, 1, 2)
    resistance = grasp_map @ answer
    # Two point contacts do not resist a turn about the line between them: that part has no answer.
    resistance += 1e-3 * np.trace(resistance, axis1=1, axis2=2)[:, None, None] / 6 * np.eye(6)
    change = -answer @ np.linalg.solve(resistance, np.swapaxes(loads, 1, 2))
    return np.swapaxes(change, 1, 2).reshape(count, -1, number, 3)


def holding_forces(
    lever: np.ndarray,
    inward: np.ndarray,
    jacobian: np.ndarray,
    used: np.ndarray,
    stiffness: np.ndarray,
    loads: np.ndarray,
    least: np.ndarray,
    torque_limit: np.ndarray,
    friction: float,
    iterations: int = SQUEEZE_ITERATIONS,
) -> np.ndarray:
    """Contact forces before any load that keep every contact from slipping under each load [N], shape
    [N, C, 3].

    With the answers e_k of the contacts to the loads (``elastic_forces``; e_0 = 0 for none), minimizes

        BALANCE_WEIGHT (|sum f|^2 + |sum lever x f|^2)
        + sum_k sum_c distance(f_c + e_kc - least_c n_c, cone_c)^2
        + sum_k sum_j (LIMIT_WEIGHT max(0, |tau_kj| / torque_limit_j - 1))^2 + 1e-3 |f|^2

    by accelerated gradient descent (Nesterov), tau_k = sum J^T (f + e_k), least_c = least over the number of
    contacts.

    Args:
        lever, jacobian, used, stiffness, loads: as for ``elastic_forces``.
        inward: unit normals into the object, shape [N, C, 3].
        least: sum of the normal forces at least [N], shape [N].
        torque_limit: [N m], shape [U].
        friction: coefficient.
        iterations: of the descent.
    """
    count, number = used.shape
    answers = elastic_forces(lever, jacobian, used, stiffness, loads)
    answers = np.concatenate([np.zeros((count, 1, number, 3)), answers], axis=1)
    cases = answers.shape[1]
    grasp_map = _grasp_map(lever) * np.repeat(used, 3, axis=1)[:, None]
    torques = jacobian.reshape(count, 3 * number, -1) * np.repeat(used, 3, axis=1)[..., None] / torque_limit
    floor = (least / np.maximum(used.sum(axis=1), 1))[:, None, None] * inward * used[..., None]
    # The step is one over a bound of the Hessian's largest eigenvalue: all cones and limits exceeded.
    balance = BALANCE_WEIGHT * grasp_map @ np.swapaxes(grasp_map, 1, 2)
    largest = np.linalg.eigvalsh(balance)[:, -1] + cases
    largest += cases * LIMIT_WEIGHT**2 * np.linalg.eigvalsh(np.swapaxes(torques, 1, 2) @ torques)[:, -1]
    step = (1.0 / (largest + 1e-3))[:, None, None]
    forces, ahead, momentum = floor, floor, 1.0
    for _ in range(iterations):
        wrench = (grasp_map @ ahead.reshape(count, -1, 1))[..., 0]
        slope = BALANCE_WEIGHT * (wrench[:, None] @ grasp_map).reshape(count, number, 3) + 1e-3 * ahead
        slope += outside_cones(ahead, answers, floor, inward, friction)
        loaded = ahead[:, None] + answers
        share = loaded.reshape(count, cases, -1) @ torques
        excess = (share - np.clip(share, -1.0, 1.0)).sum(axis=1, keepdims=True)
        slope += LIMIT_WEIGHT**2 * (excess @ np.swapaxes(torques, 1, 2)).reshape(count, number, 3)
        moved = (ahead - step * slope) * used[..., None]
        following = 0.5 * (1 + np.sqrt(1 + 4 * momentum**2))
        ahead = moved + (momentum - 1) / following * (moved - forces)
        forces, momentum = moved, following
    return forces


def squeeze_torques(
    hand: Hand,
    around: CollisionScene,
    objects: list[ObjectModel],
    wrist_in_object: np.ndarray,
    grasp: np.ndarray,
    contacts: np.ndarray,
    stiffness: np.ndarray,
    loads: np.ndarray,
    least: np.ndarray,
    friction: float = FRICTION,
    near: float = NEAR,
) -> np.ndarray:
    """Joint torques that squeeze [N m], shape [N, U]: those of ``holding_forces``.

    Args:
        hand: the robot hand.
        around: N objects and tables.
        objects: of each grasp, length N.
        wrist_in_object: shape [N, 7].
        grasp: independent joints [rad], shape [N, U].
        contacts: links that should touch, palm first, shape [N, L] bool.
        stiffness: of the servos [N m/rad], shape [N, U].
        loads: forces [N] at the center of mass and torques [N m] on the objects, object frame, shape
            [N, K, 6].
        least: sum of the normal forces at least [N], shape [N].
        friction: coefficient to plan with; less than the true one, to be safe.
        near: links farther from the object than this are left out [m].
    """
    points = HandPoints(HandKinematics(hand, len(around)))
    touch = contacts_of_links(points, around, wrist_in_object, grasp)
    used = contacts & (touch.clearance < near)
    lonely = used.sum(axis=1) < 2
    used[lonely] = (touch.clearance <= np.sort(touch.clearance, axis=1)[:, 2:3])[lonely]
    centers = np.array([model.center_of_mass for model in objects])
    reach = np.array([0.5 * float(np.max(model.size)) for model in objects])[:, None, None]
    limit = TORQUE_SHARE * np.array([servo.force_limit for servo in hand.actuators.values()])
    # Used contacts first, and of these the nearest.
    first = np.argsort(touch.clearance + ~used, axis=1, kind="stable")[:, :MOST_CONTACTS]
    place, inward, jacobian, used = (
        np.take_along_axis(x, first.reshape(first.shape + (1,) * (x.ndim - 2)), axis=1)
        for x in (touch.place, touch.inward, touch.jacobian, used)
    )
    lever = (place - centers[:, None]) / reach
    scaled = np.concatenate([loads[..., :3], loads[..., 3:] / reach], axis=-1)
    force = holding_forces(lever, inward, jacobian, used, stiffness, scaled, least, limit, friction)
    # Virtual work: tau = sum over contacts of J^T f, with the columns of the joints alone, shape [N, U].
    return np.einsum("nci,nciu->nu", force, jacobian)


def _grasp_map(lever: np.ndarray) -> np.ndarray:
    """Sum of forces and of their moments as a matrix, shape [N, 6, 3 C]. lever: shape [N, C, 3]."""
    count, number, _ = lever.shape
    # Column i of the matrix of a cross product is lever x (unit vector i); [N, C, i, 3] to [N, 3, C, i].
    moments = np.moveaxis(cross(lever[:, :, None], np.eye(3)), 3, 1)
    forces = np.broadcast_to(np.eye(3)[:, None], (count, 3, number, 3))
    return np.concatenate([forces, moments], axis=1).reshape(count, 6, 3 * number)

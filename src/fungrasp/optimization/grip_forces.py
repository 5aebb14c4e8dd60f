"""Squeeze before the lift: the smallest contact forces that stay within the friction cones and the servos'
torque limits under each expected load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fungrasp.geometry.poses import cross
from fungrasp.optimization.friction_cones import outside_cones
from fungrasp.optimization.wrench_resistance import Grip, wrenches_over_reach

TORQUE_SHARE = 0.9
"""Share of the servos' torque limits that the squeeze and its reaction to a load may use."""
BALANCE_WEIGHT = 10.0
"""Weight of a squared unbalanced newton relative to a squared newton outside a friction cone: pushing the
object is worse than a soft grip."""
LIMIT_WEIGHT = 2.0
"""Weight of a torque at twice its limit relative to a newton outside a friction cone. A servo stops at its
limit by itself; a tenfold weight costs contacts."""
CONTACT_COMPLIANCE = 1e-4
"""Compliance of a contact that no joint can move, such as a link pressed along its length [m/N]; small
compared with the fingers' compliance of about 2e-3 m/N."""
MOST_CONTACTS = 8
"""Maximum number of links that press; more are rarely as near."""
SQUEEZE_ITERATIONS = 200
"""Iterations of the descent in ``holding_forces``."""


class Fingers(NamedTuple):
    """C contacts of N hands, modeled as springs."""

    lever: np.ndarray
    """Contact points relative to the center of mass, divided by the caller's unit length, shape [N, C, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [N, C, 3]."""
    jacobian: np.ndarray
    """Jacobian of the contact points with respect to the joints [m/rad], shape [N, C, 3, U]."""
    used: np.ndarray
    """Contacts that may press, shape [N, C] bool."""
    stiffness: np.ndarray
    """Servo stiffness [N m/rad], shape [N, U]."""


def squeeze_torques(
    grip: Grip, wanted: np.ndarray, stiffness: np.ndarray, loads: np.ndarray, least: np.ndarray
) -> np.ndarray:
    """Return the joint torques of the squeeze before the lift [N m], shape [N, U], from ``holding_forces``.

    Args:
        grip: grip of N hands.
        wanted: links that should touch, palm first, shape [N, L] bool. If fewer than two of them touch, the
            three nearest links are used.
        stiffness: servo stiffness [N m/rad], shape [N, U].
        loads: forces [N] at the center of mass and torques [N m] on the objects, object frame, shape
            [N, K, 6].
        least: minimum sum of the normal forces [N], shape [N].
    """
    touch, used = grip.contacts, wanted & grip.used
    lonely = used.sum(axis=1) < 2
    used[lonely] = (touch.clearance <= np.sort(touch.clearance, axis=1)[:, 2:3])[lonely]
    # Used contacts come first, ordered by clearance.
    first = np.argsort(touch.clearance + ~used, axis=1, kind="stable")[:, :MOST_CONTACTS]
    place, inward, jacobian, used = (
        np.take_along_axis(x, first.reshape(first.shape + (1,) * (x.ndim - 2)), axis=1)
        for x in (touch.place, touch.inward, touch.jacobian, used)
    )
    lever = (place - grip.center[:, None]) / grip.reach[:, None, None]
    fingers = Fingers(lever, inward, jacobian, used, stiffness)
    limit = TORQUE_SHARE * grip.torque_limit
    force = holding_forces(fingers, wrenches_over_reach(loads, grip.reach), least, limit, grip.friction)
    # Virtual work: tau = sum over contacts of J^T f, shape [N, U].
    return np.einsum("nci,nciu->nu", force, jacobian)


def holding_forces(
    fingers: Fingers,
    loads: np.ndarray,
    least: np.ndarray,
    torque_limit: np.ndarray,
    friction: float,
    iterations: int = SQUEEZE_ITERATIONS,
) -> np.ndarray:
    """Return contact forces before any load that keep every contact from slipping under each load [N], shape
    [N, C, 3].

    With the reactions e_k of the contacts to the loads (``elastic_forces``; e_0 = 0 without a load), they
    minimize

        BALANCE_WEIGHT (|sum f|^2 + |sum lever x f|^2)
        + sum_k sum_c distance(f_c + e_kc - least_c n_c, cone_c)^2
        + sum_k sum_j (LIMIT_WEIGHT max(0, |tau_kj| / torque_limit_j - 1))^2 + 1e-3 |f|^2

    by accelerated gradient descent (Nesterov), where tau_k = sum J^T (f + e_k) and least_c is ``least``
    divided by the number of contacts.

    Args:
        loads: wrenches, torques divided by the unit length of the levers, shape [N, K, 6].
        least: minimum sum of the normal forces [N], shape [N].
        torque_limit: [N m], shape [U].
    """
    inward, used = fingers.inward, fingers.used
    count, number = used.shape
    answers = elastic_forces(fingers, loads)
    answers = np.concatenate([np.zeros((count, 1, number, 3)), answers], axis=1)
    cases, allowed = answers.shape[1], np.repeat(used, 3, axis=1)
    grasp_map = _grasp_map(fingers.lever) * allowed[:, None]
    torques = fingers.jacobian.reshape(count, 3 * number, -1) * allowed[..., None] / torque_limit
    floor = (least / np.maximum(used.sum(axis=1), 1))[:, None, None] * inward * used[..., None]
    # The step is one over a bound of the Hessian's largest eigenvalue: all cones and limits exceeded.
    balance = BALANCE_WEIGHT * grasp_map @ np.swapaxes(grasp_map, 1, 2)
    largest = np.linalg.eigvalsh(balance)[:, -1] + cases
    gram = np.swapaxes(torques, 1, 2) @ torques
    largest += cases * LIMIT_WEIGHT**2 * np.linalg.eigvalsh(gram)[:, -1]
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


def elastic_forces(fingers: Fingers, loads: np.ndarray) -> np.ndarray:
    """Return the change of the contact forces under each load [N], shape [N, K, C, 3], if no contact slips.

    Fingers are springs. With the compliance of the contact points C = J diag(1 / k) J^T, the stiffness
    K = C^-1 and the grasp map G, the reaction to a load w is -K G^T (G K G^T)^-1 w (Cutkosky and Kao,
    "Computing and controlling the compliance of a robotic hand", 1989). Arguments as for ``holding_forces``.
    """
    count, number = fingers.used.shape
    flat = fingers.jacobian.reshape(count, 3 * number, -1)
    allowed = np.repeat(fingers.used, 3, axis=1)
    compliance = (flat / fingers.stiffness[:, None]) @ np.swapaxes(flat, 1, 2)
    compliance[:, np.arange(3 * number), np.arange(3 * number)] += CONTACT_COMPLIANCE
    # Unused contacts get the identity and contribute nothing.
    both = allowed[:, :, None] & allowed[:, None, :]
    inverse = np.linalg.inv(np.where(both, compliance, np.eye(3 * number))) * both
    grasp_map = _grasp_map(fingers.lever) * allowed[:, None]
    answer = inverse @ np.swapaxes(grasp_map, 1, 2)
    resistance = grasp_map @ answer
    # Two point contacts do not resist rotation about the line between them; regularize that direction.
    resistance += 1e-3 * np.trace(resistance, axis1=1, axis2=2)[:, None, None] / 6 * np.eye(6)
    change = -answer @ np.linalg.solve(resistance, np.swapaxes(loads, 1, 2))
    return np.swapaxes(change, 1, 2).reshape(count, -1, number, 3)


def _grasp_map(lever: np.ndarray) -> np.ndarray:
    """Return the grasp map of contact forces to their wrench, shape [N, 6, 3 C]. lever: shape [N, C, 3]."""
    count, number, _ = lever.shape
    # Column i of the cross product matrix is lever x (unit vector i); [N, C, i, 3] to [N, 3, C, i].
    moments = np.moveaxis(cross(lever[:, :, None], np.eye(3)), 3, 1)
    forces = np.broadcast_to(np.eye(3)[:, None], (count, 3, number, 3))
    return np.concatenate([forces, moments], axis=1).reshape(count, 6, 3 * number)

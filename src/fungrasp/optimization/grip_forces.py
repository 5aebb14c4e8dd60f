"""How hard each finger should press before the lift: the softest contact forces that stay within friction
cones and the servos' torque limits whatever of the expected loads then comes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fungrasp.geometry.poses import cross
from fungrasp.optimization.friction_cones import outside_cones
from fungrasp.optimization.wrench_resistance import Grip, wrenches_over_reach

TORQUE_SHARE = 0.9
"""Share of the servos' torque limits that the squeeze and its answer to a load may use."""
BALANCE_WEIGHT = 10.0
"""Weight of the square of an unbalanced newton against one outside a friction cone: pushing the object is
worse than a soft grip."""
LIMIT_WEIGHT = 2.0
"""Weight of a torque at twice its limit against an unbalanced newton. A servo stops at its limit by itself;
ten times as much costs contacts."""
CONTACT_COMPLIANCE = 1e-4
"""Yielding of a contact that no joint can move, as of a link pressed along its own length [m/N]: small
against that of the fingers, of about 2e-3 m/N."""
MOST_CONTACTS = 8
"""Links that press; more are hardly ever as near."""
SQUEEZE_ITERATIONS = 200
"""Of the descent in ``holding_forces``."""


class Fingers(NamedTuple):
    """C contacts of N hands, as springs: what moves them, and where they press."""

    lever: np.ndarray
    """Contact points relative to the center of mass, over a length of the caller's, shape [N, C, 3]."""
    inward: np.ndarray
    """Unit normals into the object, shape [N, C, 3]."""
    jacobian: np.ndarray
    """Of the contact points with respect to the joints [m/rad], shape [N, C, 3, U]."""
    used: np.ndarray
    """Which contacts may press, shape [N, C] bool."""
    stiffness: np.ndarray
    """Of the servos [N m/rad], shape [N, U]."""


def squeeze_torques(
    grip: Grip, wanted: np.ndarray, stiffness: np.ndarray, loads: np.ndarray, least: np.ndarray
) -> np.ndarray:
    """Joint torques that squeeze before the lift [N m], shape [N, U]: those of the softest contact forces
    that stay within friction cones and torque limits whatever of the expected loads then comes
    (``holding_forces``).

    Args:
        grip: of N hands.
        wanted: links that should touch, palm first, shape [N, L] bool; the two nearest links where fewer of
            them do.
        stiffness: of the servos [N m/rad], shape [N, U].
        loads: forces [N] at the center of mass and torques [N m] on the objects, object frame, shape
            [N, K, 6].
        least: sum of the normal forces at least [N], shape [N].
    """
    touch, used = grip.contacts, wanted & grip.used
    lonely = used.sum(axis=1) < 2
    used[lonely] = (touch.clearance <= np.sort(touch.clearance, axis=1)[:, 2:3])[lonely]
    # Used contacts first, and of these the nearest.
    first = np.argsort(touch.clearance + ~used, axis=1, kind="stable")[:, :MOST_CONTACTS]
    place, inward, jacobian, used = (
        np.take_along_axis(x, first.reshape(first.shape + (1,) * (x.ndim - 2)), axis=1)
        for x in (touch.place, touch.inward, touch.jacobian, used)
    )
    lever = (place - grip.center[:, None]) / grip.reach[:, None, None]
    fingers = Fingers(lever, inward, jacobian, used, stiffness)
    limit = TORQUE_SHARE * grip.torque_limit
    force = holding_forces(fingers, wrenches_over_reach(loads, grip.reach), least, limit, grip.friction)
    # Virtual work: tau = sum over contacts of J^T f, with the columns of the joints alone, shape [N, U].
    return np.einsum("nci,nciu->nu", force, jacobian)


def holding_forces(
    fingers: Fingers,
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
        loads: wrenches over the length of the levers, shape [N, K, 6].
        least: sum of the normal forces at least [N], shape [N].
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
    """What contacts add to their forces when a load comes [N], shape [N, K, C, 3], as long as nothing slips.

    Fingers are springs: with the compliance of the contact points C = J diag(1 / k) J^T, the stiffness
    K = C^-1 and the grasp map G, a load w is answered by -K G^T (G K G^T)^-1 w (Cutkosky and Kao, "Computing
    and controlling the compliance of a robotic hand", 1989). Arguments as for ``holding_forces``.
    """
    count, number = fingers.used.shape
    flat = fingers.jacobian.reshape(count, 3 * number, -1)
    allowed = np.repeat(fingers.used, 3, axis=1)
    compliance = (flat / fingers.stiffness[:, None]) @ np.swapaxes(flat, 1, 2)
    compliance[:, np.arange(3 * number), np.arange(3 * number)] += CONTACT_COMPLIANCE
    # Contacts that are not used get the identity, and no part in anything.
    both = allowed[:, :, None] & allowed[:, None, :]
    inverse = np.linalg.inv(np.where(both, compliance, np.eye(3 * number))) * both
    grasp_map = _grasp_map(fingers.lever) * allowed[:, None]
    answer = inverse @ np.swapaxes(grasp_map, 1, 2)
    resistance = grasp_map @ answer
    # Two point contacts do not resist a turn about the line between them: that part has no answer.
    resistance += 1e-3 * np.trace(resistance, axis1=1, axis2=2)[:, None, None] / 6 * np.eye(6)
    change = -answer @ np.linalg.solve(resistance, np.swapaxes(loads, 1, 2))
    return np.swapaxes(change, 1, 2).reshape(count, -1, number, 3)


def _grasp_map(lever: np.ndarray) -> np.ndarray:
    """Sum of forces and of their moments as a matrix, shape [N, 6, 3 C]. lever: shape [N, C, 3]."""
    count, number, _ = lever.shape
    # Column i of the matrix of a cross product is lever x (unit vector i); [N, C, i, 3] to [N, 3, C, i].
    moments = np.moveaxis(cross(lever[:, :, None], np.eye(3)), 3, 1)
    forces = np.broadcast_to(np.eye(3)[:, None], (count, 3, number, 3))
    return np.concatenate([forces, moments], axis=1).reshape(count, 6, 3 * number)

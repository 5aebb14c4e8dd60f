"""Reward of a policy: one pure function per term, and their weighted sum.

The terms follow section IV.B of the paper (position, contact, safety, posture) and D-Grasp (force); approach,
lift, stability and action are additions. Every term is bounded, so that a single world cannot dominate.
Arrays may be of any array-API library; the first axis is W worlds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import reduce
from operator import add

from array_api_compat import array_namespace

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.records import CheckedRecord
from fungrasp.geometry.poses import Array
from fungrasp.grasps.as_shown import NEAR
from fungrasp.objects.object_model import GRAVITY


@dataclass(frozen=True)
class RewardWeights(CheckedRecord):
    """Weights of the reward terms, by the names used in ``total``."""

    position: float = 0.3
    """Weight of ``position_reward``, in [-1, 0]."""
    approach: float = 1.0
    """Weight of ``approach_reward``, in [-1, 0]."""
    contact: float = 0.5
    """Weight of ``contact_reward``, in [0, 2], times ``dynamic_contact_weight``."""
    safety: float = 0.3
    """Weight of ``safety_reward``, in [-1, 0]."""
    posture: float = 0.1
    """Weight of ``posture_reward``, in [-2, 0]."""
    lift: float = 1.0
    """Weight of ``lift_reward``, in [0, 1]."""
    stability: float = 0.5
    """Weight of ``stability_reward``, in [-1, 0]."""
    action: float = 0.02
    """Weight of ``action_reward``, in [-5, 0] for actions in [-1, 1]."""
    success: float = 5.0
    """Reward for a successful end of the episode."""
    shown: float = 10.0
    """Reward for a successful end of the episode, times ``shown_share``."""
    drop: float = -3.0
    """Reward for losing the object."""


def total(terms: Mapping[str, Array], weights: RewardWeights) -> Array:
    """Return the weighted sum ``sum_i weights_i terms_i``, shape [W].

    Args:
        terms: terms by name of their weight, shape [W] each. Missing terms count as zero.

    Raises:
        FungraspError: there is no term, or a name has no weight.
    """
    if not terms:
        raise FungraspError("a reward needs at least one term")
    known = [field.name for field in fields(weights)]
    for name in terms:
        if name not in known:
            raise UnknownNameError("reward term", name, known)
    return reduce(add, (getattr(weights, name) * term for name, term in terms.items()))


def position_reward(keypoints: Array, targets: Array, weights: Array, scale: float = 0.05) -> Array:
    """Penalize key points away from the reference (r_p of section IV.B.2, after D-Grasp).

    ``r_p = -sum_k w_k min(1, |p_k - p'_k|^2 / scale^2) / sum_k w_k``. The penalty of a point is constant
    beyond ``scale``: far from the object, the other terms guide the motion.

    Args:
        keypoints: key points [m], object frame, shape [W, K, 3].
        targets: key points of the reference [m], object frame, shape [W, K, 3].
        weights: not negative, not all zero, shape [K].
        scale: distance of the largest penalty [m].

    Returns:
        In [-1, 0], shape [W].
    """
    xp = array_namespace(keypoints, targets, weights)
    squared = xp.sum((keypoints - targets) ** 2, axis=-1) / scale**2
    return -xp.sum(weights * xp.clip(squared, 0.0, 1.0), axis=-1) / xp.sum(weights)


def approach_reward(keypoints: Array, targets: Array, distance: float) -> Array:
    """Penalize the distance from the reference: ``-mean_k min(1, |p_k - p'_k| / distance)``.

    For policies without a planned motion: the paper's r_p is unbounded, and ``position_reward`` is constant
    far from the reference.

    Args:
        keypoints: key points [m], object frame, shape [W, K, 3].
        targets: key points of the reference [m], object frame, shape [W, K, 3].
        distance: initial distance of the episodes [m].

    Returns:
        In [-1, 0], shape [W].
    """
    xp = array_namespace(keypoints, targets)
    away = xp.linalg.vector_norm(keypoints - targets, axis=-1) / distance
    return -xp.mean(xp.clip(away, 0.0, 1.0), axis=-1)


def dynamic_contact_weight(keypoints: Array, targets: Array, contacts: Array) -> Array:
    """Return the weight of the contact reward (omega_c of section IV.B.2).

    ``omega_c = sum_j c'_j |p_j|^2 / sum_j c'_j |p'_j|^2``, in [0, 2], over the links that should touch. The
    paper does not name the frame of the positions. In the world or object frame, the ratio would depend on
    the origin, so the palm frame is used. The weight is about 1 if these links reach as far as in the
    reference, less if the hand is closed too far, and more if it still reaches out. It measures distances but
    not directions, which ``position_reward`` measures. The printed ratio is unbounded and undefined without
    targets; here it is clipped at 2, and 1 without targets.

    Args:
        keypoints: a point on each link [m], palm frame, shape [W, L, 3].
        targets: these points in the reference [m], palm frame, shape [W, L, 3].
        contacts: links that should touch, shape [W, L] bool.

    Returns:
        In [0, 2], shape [W].
    """
    xp = array_namespace(keypoints, targets, contacts)
    wanted = xp.astype(contacts, keypoints.dtype)
    current = xp.sum(wanted * xp.sum(keypoints**2, axis=-1), axis=-1)
    reference = xp.sum(wanted * xp.sum(targets**2, axis=-1), axis=-1)
    given = reference > 1e-9
    one = xp.ones_like(current)
    ratio = xp.where(given, current, one) / xp.where(given, reference, one)
    return xp.clip(ratio, 0.0, 2.0)


def closeness(keypoints: Array, targets: Array, near: float = NEAR) -> Array:
    """Return how close links are to the reference: 1 at no distance, 1/2 at ``near``, 0 from ``2 near``.

    Args:
        keypoints: a point on each link [m], object frame, shape [W, L, 3].
        targets: these points in the reference [m], object frame, shape [W, L, 3].
        near: largest distance of contacts at the same place (``grasps.as_shown``) [m].

    Returns:
        In [0, 1], shape [W, L].
    """
    xp = array_namespace(keypoints, targets)
    return xp.clip(1.0 - xp.linalg.vector_norm(keypoints - targets, axis=-1) / (2.0 * near), 0.0, 1.0)


def shown_share(contacts: Array, targets: Array, closeness: Array) -> Array:
    """Return the share of target links in contact, weighted by closeness: ``sum_j c_j c'_j k_j / |c'|``, 0
    without targets.

    Args:
        contacts: links that touch the object, shape [W, L] bool.
        targets: links that should touch, shape [W, L] bool.
        closeness: in [0, 1], shape [W, L].

    Returns:
        In [0, 1], shape [W].
    """
    xp = array_namespace(contacts, targets, closeness)
    wanted = xp.astype(targets, closeness.dtype)
    touching = wanted * xp.astype(contacts, closeness.dtype)
    return xp.sum(touching * closeness, axis=-1) / xp.clip(xp.sum(wanted, axis=-1), 1.0, None)


def contact_reward(
    contacts: Array, targets: Array, forces: Array, mass: Array, closeness: Array, cap: float = 5.0
) -> Array:
    """Reward contacts and forces of the target links (r_c of section IV.B.2, after D-Grasp).

    ``r_c = sum_j c_j c'_j k_j / |c'| + min(sum_j c'_j k_j f_j, F) / F`` with ``F = cap m g``. The total force
    of the target links is rewarded up to ``cap`` times the object's weight. Without targets the reward is
    zero. The paper's term has no closeness ``k``: policies trained with it hold objects, but not as shown.

    Args:
        contacts: links that touch the object, shape [W, L] bool.
        targets: links that should touch, shape [W, L] bool.
        forces: net contact force of each link on the object [N], magnitude, shape [W, L].
        mass: object mass [kg], positive, shape [W].
        closeness: in [0, 1], shape [W, L].
        cap: largest rewarded force, in units of the object's weight.

    Returns:
        In [0, 2], shape [W].
    """
    xp = array_namespace(contacts, targets, forces, mass)
    wanted = xp.astype(targets, forces.dtype)
    pressed = xp.sum(wanted * closeness * forces, axis=-1) / (cap * GRAVITY * mass)
    return shown_share(contacts, targets, closeness) + xp.clip(pressed, 0.0, 1.0)


def safety_reward(table_forces: Array, self_force: Array, unit: float = 10.0) -> Array:
    """Penalize contact forces of the hand with the table and itself (r_s of section IV.B.2).

    ``r_s = -tanh((sum_l |f_l| + |f_self|) / unit)``: for small forces the paper's sum, but bounded.

    Args:
        table_forces: forces between each link and the table [N], shape [W, L].
        self_force: force between links of the hand [N], shape [W].
        unit: [N].

    Returns:
        In [-1, 0], shape [W].
    """
    xp = array_namespace(table_forces, self_force)
    return -xp.tanh((xp.sum(xp.abs(table_forces), axis=-1) + xp.abs(self_force)) / unit)


def posture_reward(directions: Array, targets: Array) -> Array:
    """Penalize finger link directions that differ from the reference (r_q of section IV.B.2).

    ``r_q = mean_ij (cos(v_ij, v'_ij) - 1)`` over the links of all fingers. Zero vectors, which pad fingers
    with fewer links, do not count.

    Args:
        directions: direction of each link, any length, object frame, shape [W, F, K, 3].
        targets: directions in the reference, any length, object frame, shape [W, F, K, 3].

    Returns:
        In [-2, 0], shape [W].
    """
    xp = array_namespace(directions, targets)
    lengths = xp.linalg.vector_norm(directions, axis=-1) * xp.linalg.vector_norm(targets, axis=-1)
    counts = lengths > 1e-12
    one = xp.ones_like(lengths)
    cosine = xp.where(counts, xp.sum(directions * targets, axis=-1) / xp.where(counts, lengths, one), one)
    number = xp.sum(xp.astype(counts, lengths.dtype), axis=(-2, -1))
    return xp.sum(cosine - 1.0, axis=(-2, -1)) / xp.clip(number, 1.0, None)


def lift_reward(height: Array, goal: float) -> Array:
    """Reward the height of the object: ``clip(height / goal, 0, 1)``.

    Args:
        height: height of the object's center of mass above its settled height [m], shape [W].
        goal: height of the full reward [m].

    Returns:
        In [0, 1], shape [W].
    """
    xp = array_namespace(height)
    return xp.clip(height / goal, 0.0, 1.0)


def stability_reward(
    slip_velocity: Array, spin: Array, velocity_unit: float = 0.1, spin_unit: float = 2.0
) -> Array:
    """Penalize slip in the hand: ``-(tanh(|v| / velocity_unit) + tanh(|w| / spin_unit)) / 2``.

    Use it only once the object is held: during the approach, the object has to move relative to the palm.

    Args:
        slip_velocity: velocity of the object relative to the palm [m/s], shape [W, 3].
        spin: angular velocity of the object relative to the palm [rad/s], shape [W, 3].
        velocity_unit: unit of velocity [m/s].
        spin_unit: unit of angular velocity [rad/s].

    Returns:
        In [-1, 0], shape [W].
    """
    xp = array_namespace(slip_velocity, spin)
    slip = xp.tanh(xp.linalg.vector_norm(slip_velocity, axis=-1) / velocity_unit)
    return -0.5 * (slip + xp.tanh(xp.linalg.vector_norm(spin, axis=-1) / spin_unit))


def action_reward(action: Array, previous: Array) -> Array:
    """Penalize large and changing actions: ``-(mean_i a_i^2 + mean_i (a_i - b_i)^2)``.

    Args:
        action: residual action ``a``, dimensionless, shape [W, A].
        previous: previous action ``b``, shape [W, A].

    Returns:
        Not positive, in [-5, 0] for actions in [-1, 1], shape [W].
    """
    xp = array_namespace(action, previous)
    return -(xp.mean(action**2, axis=-1) + xp.mean((action - previous) ** 2, axis=-1))

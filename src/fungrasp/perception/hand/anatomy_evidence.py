"""What anatomy says about a hand: sizes, proportions and angles of people, and no finger inside another.

A finger that is hidden by another one is behind it; landmarks alone would have both at the same place.
"""

from __future__ import annotations

import numpy as np

from fungrasp.perception.hand.hand_capsules import HAND_CAPSULES, offsets_from_lines
from fungrasp.perception.hand.skeleton import (
    ALIKE_SPREAD,
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_MEAN,
    ANGLE_SPREAD,
    PARAMETERS,
    SIZE,
    HandEvidence,
    Skeleton,
)

SIZE_SPREAD = 0.1
"""Standard deviation of the logarithm of adults' hand sizes: both sexes together."""

BONE_SPREAD = 0.06
"""Standard deviation of the logarithm of a bone's length in hands of one size, and what different makers of
landmarks mean by the same joint."""

BASE_SPREAD = 0.005
"""Standard deviation of where a finger's base is in the palm [m]."""

LIMIT_SOFTNESS = np.radians(5.0)
"""A joint bent beyond its limit by this much [rad] is one standard deviation out."""

OVERLAP_SLACK = 0.0015
"""Soft tissue gives way by so much [m]: nine in ten of the human grasps at hand have at most that."""


def anatomy_evidence(hand: Skeleton) -> list[HandEvidence]:
    """Sizes, proportions and angles are those of people."""
    beyond = np.minimum(hand.angles - ANGLE_LOW, 0.0) + np.maximum(hand.angles - ANGLE_HIGH, 0.0)
    unusual = (hand.angles - ANGLE_MEAN) / ANGLE_SPREAD
    return [
        _prior("size", np.array([hand.size]) / SIZE_SPREAD, 1 / SIZE_SPREAD),
        _prior("bases", hand.bases.ravel() / BASE_SPREAD, 1 / BASE_SPREAD),
        _prior("bones", hand.bones.ravel() / BONE_SPREAD, 1 / BONE_SPREAD),
        _prior("angles", unusual.ravel(), (1 / ANGLE_SPREAD).ravel()),
        HandEvidence(_ALIKE @ (hand.angles - ANGLE_MEAN).ravel(), _ALIKE_COLUMNS),
        _prior("angles", beyond.ravel() / LIMIT_SOFTNESS, (beyond != 0).ravel() / LIMIT_SOFTNESS),
    ]


def _alike() -> np.ndarray:
    """Differences of what neighboring fingers' flexion is beyond the usual, over their spread, by angle,
    shape [9, 45]."""
    rows = np.zeros((3, 3, 5, 3, 3))
    for finger in range(3):
        for joint in range(3):
            rows[finger, joint, finger : finger + 2, joint, 1] = np.array([1.0, -1.0]) / ALIKE_SPREAD[joint]
    return rows.reshape(9, 45)


_ALIKE = _alike()

_ALIKE_COLUMNS = np.zeros((9, SIZE))
_ALIKE_COLUMNS[:, PARAMETERS["angles"]] = _ALIKE


def _prior(kind: str, residual: np.ndarray, slope: np.ndarray | float) -> HandEvidence:
    jacobian = np.zeros((len(residual), SIZE))
    jacobian[:, PARAMETERS[kind]] = np.diag(np.broadcast_to(slope, residual.shape))
    return HandEvidence(residual, jacobian)


def _pairs() -> tuple[np.ndarray, np.ndarray]:
    """Capsules that may meet: links of different fingers, and the palm with the outer links of its four."""
    first, last = [], []
    for i, one in enumerate(HAND_CAPSULES.finger):
        for j in range(i + 1, len(HAND_CAPSULES.finger)):
            other = HAND_CAPSULES.finger[j]
            outer = HAND_CAPSULES.near[j] % 4 != 1 and HAND_CAPSULES.near[i] % 4 != 1
            palm = (one < 0) != (other < 0) and 4 not in (one, other) and outer
            if (one != other and min(one, other) >= 0) or palm:
                first.append(i)
                last.append(j)
    return np.array(first), np.array(last)


_ONE, _OTHER = _pairs()


def nearest_between(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where lines a-b and c-d are nearest to each other, 0 to 1 on each.

    a, b, c, d: shape [N, 3]; returns two of shape [N].
    """
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = np.sum(u * u, axis=1), np.sum(u * v, axis=1), np.sum(v * v, axis=1)
    uw, vw = np.sum(u * w, axis=1), np.sum(v * w, axis=1)
    uu, vv = np.maximum(uu, 1e-12), np.maximum(vv, 1e-12)
    s = np.clip((uv * vw - vv * uw) / np.maximum(uu * vv - uv**2, 1e-12), 0.0, 1.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    return np.clip((uv * t - uw) / uu, 0.0, 1.0), t


def overlap_evidence(hand: Skeleton, joints: np.ndarray, jacobian: np.ndarray, spread: float) -> HandEvidence:
    """Fingers are apart.

    Args:
        hand, joints, jacobian: the skeleton, its joints and their derivatives.
        spread: standard deviation of how deep two of them are in each other [m].
    """
    first, last = HAND_CAPSULES.ends(joints)
    a, b, c, d = first[_ONE], last[_ONE], first[_OTHER], last[_OTHER]
    s, t = nearest_between(a, b, c, d)
    apart = a + s[:, None] * (b - a) - c - t[:, None] * (d - c)
    distance = np.linalg.norm(apart, axis=1)
    radius = HAND_CAPSULES.radius * np.exp(hand.size)
    thick = _between(radius[_ONE], s) + _between(radius[_OTHER], t)
    gap = distance - thick + OVERLAP_SLACK
    inside = np.flatnonzero((gap < 0) & (distance > 1e-6))
    normal = apart[inside] / distance[inside, None]
    slopes = _slopes(jacobian, _ONE[inside], s[inside]) - _slopes(jacobian, _OTHER[inside], t[inside])
    return HandEvidence(gap[inside] / spread, np.einsum("pi,pin->pn", normal, slopes) / spread)


def finger_overlap(points: np.ndarray, radius: np.ndarray, hand: Skeleton, finger: int) -> np.ndarray:
    """How deep points of a finger are in the other fingers [m], shape [S, P].

    Args:
        points: in several postures [m], shape [S, P, 3].
        radius: half the finger's thickness there [m], shape [P].
        hand: the others.
        finger: whose points these are.
    """
    others = (HAND_CAPSULES.finger >= 0) & (HAND_CAPSULES.finger != finger)
    first, last = HAND_CAPSULES.ends(hand.joints())
    thick = HAND_CAPSULES.radius[others] * np.exp(hand.size)
    along, away = offsets_from_lines(points, first[others], last[others])
    distance = np.sqrt(np.einsum("spci,spci->spc", away, away))
    gap = distance - thick[:, 0] - along * (thick[:, 1] - thick[:, 0]) - radius[:, None] + OVERLAP_SLACK
    return np.maximum(-gap.min(axis=-1), 0.0)


def _between(ends: np.ndarray, part: np.ndarray) -> np.ndarray:
    return ends[:, 0] + part * (ends[:, 1] - ends[:, 0])


def _slopes(jacobian: np.ndarray, capsules: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Derivatives of points on the lines of capsules, shape [N, 3, n]."""
    part = (part * HAND_CAPSULES.end[capsules])[:, None, None]
    return (1 - part) * jacobian[HAND_CAPSULES.near[capsules]] + part * jacobian[HAND_CAPSULES.far[capsules]]

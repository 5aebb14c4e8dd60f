"""Fingers are not inside each other, nor in the palm.

A finger that is hidden by another one is behind it; landmarks alone would have both at the same place.
"""

from __future__ import annotations

import numpy as np

from fungrasp.perception.hand.evidence import Evidence
from fungrasp.perception.hand.hand_capsules import FLESH, offsets_from_lines
from fungrasp.perception.hand.skeleton import Skeleton

SLACK = 0.0015
"""Flesh gives way by so much [m]: nine in ten of the human grasps at hand have at most that."""


def _pairs() -> tuple[np.ndarray, np.ndarray]:
    """Capsules that may meet: links of different fingers, and the palm with the outer links of its four."""
    first, last = [], []
    for i, one in enumerate(FLESH.finger):
        for j in range(i + 1, len(FLESH.finger)):
            other = FLESH.finger[j]
            outer = FLESH.near[j] % 4 != 1 and FLESH.near[i] % 4 != 1
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


def overlap_evidence(hand: Skeleton, joints: np.ndarray, jacobian: np.ndarray, spread: float) -> Evidence:
    """Fingers are apart.

    Args:
        hand, joints, jacobian: the skeleton, its joints and their derivatives.
        spread: standard deviation of how deep two of them are in each other [m].
    """
    first, last = FLESH.ends(joints)
    a, b, c, d = first[_ONE], last[_ONE], first[_OTHER], last[_OTHER]
    s, t = nearest_between(a, b, c, d)
    apart = a + s[:, None] * (b - a) - c - t[:, None] * (d - c)
    distance = np.linalg.norm(apart, axis=1)
    radius = FLESH.radius * np.exp(hand.size)
    thick = _between(radius[_ONE], s) + _between(radius[_OTHER], t)
    gap = distance - thick + SLACK
    inside = np.flatnonzero((gap < 0) & (distance > 1e-6))
    normal = apart[inside] / distance[inside, None]
    slopes = _slopes(jacobian, _ONE[inside], s[inside]) - _slopes(jacobian, _OTHER[inside], t[inside])
    return Evidence(gap[inside] / spread, np.einsum("pi,pin->pn", normal, slopes) / spread)


def overlaps(points: np.ndarray, radius: np.ndarray, hand: Skeleton, finger: int) -> np.ndarray:
    """How deep points of a finger's flesh are in the other fingers [m], shape [S, P].

    Args:
        points: in several postures [m], shape [S, P, 3].
        radius: of the flesh around them [m], shape [P].
        hand: the others.
        finger: whose points these are.
    """
    others = (FLESH.finger >= 0) & (FLESH.finger != finger)
    first, last = FLESH.ends(hand.joints())
    thick = FLESH.radius[others] * np.exp(hand.size)
    along, away = offsets_from_lines(points, first[others], last[others])
    distance = np.sqrt(np.einsum("spci,spci->spc", away, away))
    gap = distance - thick[:, 0] - along * (thick[:, 1] - thick[:, 0]) - radius[:, None] + SLACK
    return np.maximum(-gap.min(axis=-1), 0.0)


def _between(ends: np.ndarray, part: np.ndarray) -> np.ndarray:
    return ends[:, 0] + part * (ends[:, 1] - ends[:, 0])


def _slopes(jacobian: np.ndarray, capsules: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Derivatives of points on the lines of capsules, shape [N, 3, n]."""
    part = (part * FLESH.end[capsules])[:, None, None]
    return (1 - part) * jacobian[FLESH.near[capsules]] + part * jacobian[FLESH.far[capsules]]

"""A hand's flesh as tapered capsules about its bones, and what measured points of its skin say about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.perception.hand.evidence import Evidence
from fungrasp.perception.hand.skeleton import RADII, Skeleton

TIP_END = 0.7
"""The tip joint is on the skin: the last link's capsule ends at this part of it."""

FAR_SIDE = 0.3
"""A camera sees no skin that faces away from it: cosine to the viewing ray from which a point is not taken
for a capsule's."""

FAR_SIDE_PENALTY = 0.02
"""By which such a point counts as farther away [m]."""


PALM = 0.0165
"""Half the thickness of the palm with its balls [m]; ``PALM_RADIUS`` is its least."""

ARM_LENGTH, ARM_RADIUS = 0.25, np.array([0.018, 0.028])
"""Of the forearm as far as it is looked at, and half its thickness at the wrist and there [m]."""

EXPLAINED = 0.012
"""Measured points so near to the skin [m] are explained by the hand."""

ARM_NEAR = 0.05
"""Points nearer to the wrist than this [m] don't say where the arm goes."""


@dataclass(frozen=True, eq=False)
class Capsules:
    """Lines between joints with flesh about them."""

    near: np.ndarray
    """Joint at one end, shape [C]."""
    far: np.ndarray
    """Joint at the other end, shape [C]."""
    end: np.ndarray
    """Where on the way to the far joint the line ends, shape [C]."""
    radius: np.ndarray
    """Flesh about both ends, for a hand of mean size [m], shape [C, 2]."""
    finger: np.ndarray
    """Which finger each belongs to, -1 for the palm, shape [C]."""

    def ends(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both ends of every line. joints: shape [..., 21, 3]; returns two of shape [..., C, 3]."""
        first, last = joints[..., self.near, :], joints[..., self.far, :]
        return first, first + self.end[:, None] * (last - first)


def _capsules() -> Capsules:
    rows = []
    for finger in range(5):
        base = 1 + 4 * finger
        if finger < 4:
            rows.append((0, base, 1.0, PALM, PALM - 0.002, -1))
        for link in range(3):
            end = TIP_END if link == 2 else 1.0
            rows.append((base + link, base + link + 1, end, *RADII[finger, link : link + 2], finger))
    near, far, end, first, last, finger = (np.array(column) for column in zip(*rows, strict=True))
    return Capsules(near, far, end, np.stack([first, last], axis=1), finger)


FLESH = _capsules()
"""Four in the palm, three in each finger; the thumb's first is its ball."""


def offsets_from_lines(
    points: np.ndarray, first: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where on lines the points nearest to some others are, and the way from there to them.

    Args:
        points: shape [..., P, d].
        first, last: ends of the lines, shape [..., C, d].

    Returns:
        0 to 1, shape [..., P, C]; shape [..., P, C, d].
    """
    line = last - first
    square = np.maximum(np.sum(line**2, axis=-1), 1e-12)[..., None, :]
    offset = points[..., :, None, :] - first[..., None, :, :]
    along = np.clip(np.einsum("...pci,...ci->...pc", offset, line) / square, 0.0, 1.0)
    return along, offset - along[..., None] * line[..., None, :, :]


def capsule_distances(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed distance of points of the skin from capsules' surfaces, as a camera at the origin sees them.

    Args:
        points: [m], shape [P, 3], camera frame.
        first, last: ends of the capsules [m], shape [..., C, 3].
        radius: at both ends [m], shape [C, 2].

    Returns:
        Distance [m], shape [..., P, C], raised by ``FAR_SIDE_PENALTY`` where the skin there faces away from
        the camera; where on the line the nearest point is, 0 to 1, same shape; the outward normal, shape
        [..., P, C, 3].
    """
    along, offset = offsets_from_lines(points, first, last)
    length = np.sqrt(np.einsum("...i,...i->...", offset, offset))
    normal = offset / np.maximum(length, 1e-9)[..., None]
    away = np.einsum("...pci,pi->...pc", normal, points / np.linalg.norm(points, axis=1)[:, None])
    distance = length - (radius[:, 0] + along * (radius[:, 1] - radius[:, 0]))
    return distance + FAR_SIDE_PENALTY * (away > FAR_SIDE), along, normal


def flesh_evidence(
    hand: Skeleton,
    joints: np.ndarray,
    jacobian: np.ndarray,
    points: np.ndarray,
    spread: tuple[float, ...],
    outlier: float,
) -> Evidence:
    """Every point that shows the hand or its arm lies on the skin.

    Args:
        hand, joints, jacobian: the skeleton, its joints and their derivatives.
        points: [m], shape [P, 3].
        spread: standard deviation of a point's distance from the skin [m]: at fingers, palm and arm.
        outlier: a point farther from the skin [m] shows something else.
    """
    first, last = FLESH.ends(joints)
    elbow = joints[0] + ARM_LENGTH * arm_direction(points, joints)
    first, last = np.vstack([first, joints[0]]), np.vstack([last, elbow])
    radius = np.vstack([FLESH.radius, ARM_RADIUS]) * np.exp(hand.size)
    distance, along, normal = capsule_distances(points, first, last, radius)
    nearest = np.abs(distance).argmin(axis=1)
    row = np.arange(len(points))
    distance, along, normal = distance[row, nearest], along[row, nearest], normal[row, nearest]
    kind = _KIND[nearest]
    part = np.where(kind == 2, 0.0, along * _END[nearest])[:, None]
    by_step = np.einsum("pi,pin->pn", normal, jacobian[_NEAR[nearest]]) * (1 - part)
    by_step += np.einsum("pi,pin->pn", normal, jacobian[_FAR[nearest]]) * part
    width = np.asarray(spread)[kind]
    return Evidence(distance / width, -by_step / width[:, None], outlier / width)


def explained_part(hand: Skeleton, points: np.ndarray) -> float:
    """Part of the measured points, those of the arm apart, that lie on the skin, 0 to 1; 0 if there is none.

    points: [m], shape [P, 3].
    """
    joints = hand.joints()
    distance, _, _ = capsule_distances(points, *FLESH.ends(joints), FLESH.radius * np.exp(hand.size))
    distance = np.abs(distance).min(axis=1)
    back = joints[0] - joints[9]
    arm = (distance > EXPLAINED) & ((points - joints[0]) @ (back / np.linalg.norm(back)) > -0.01)
    return float((distance[~arm] < EXPLAINED).mean()) if not arm.all() else 0.0


_KIND = np.append(np.where(FLESH.finger < 0, 1, 0), 2)
"""Of every capsule and the arm: finger, palm, arm."""

_NEAR, _FAR, _END = np.append(FLESH.near, 0), np.append(FLESH.far, 0), np.append(FLESH.end, 1.0)


def arm_direction(points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Where the forearm goes from the wrist: unit vector, shape [3].

    That is where most of the points behind the wrist are, or straight on from the palm.

    Args:
        points: of hand and arm [m], shape [P, 3].
        joints: [m], shape [21, 3].
    """
    back = joints[0] - joints[[1, 5, 9, 13]].mean(axis=0)
    back /= max(float(np.linalg.norm(back)), 1e-9)
    offset = points - joints[0]
    length = np.linalg.norm(offset, axis=1)
    behind = (length > ARM_NEAR) & (offset @ back > 0.35 * length)
    if behind.sum() < 5:
        return back
    mean = (offset[behind] / length[behind, None]).mean(axis=0)
    return mean / np.linalg.norm(mean)

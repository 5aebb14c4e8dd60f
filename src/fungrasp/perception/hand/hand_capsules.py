"""Shape of the hand: tapered capsules about its bones, and surface samples that are compared with images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.grasps.human_hand import (
    BONES,
    FINGER_RADII,
    LINK_RADII,
    PALM_BALL_RADIUS,
    PALM_RADIUS,
    WRIST_RADIUS,
)
from fungrasp.perception.hand.skeleton import Skeleton

TIP_END = 0.7  # End of the last link's capsule, as a fraction of the link: the tip joint is on the skin.
# Cosine between the skin's normal and the viewing ray beyond which the skin faces away from the camera.
FAR_SIDE = 0.3
FAR_SIDE_PENALTY = 0.02  # Distance added for points on such skin [m].
ARM_LENGTH = 0.25  # Length of the modeled forearm [m].
EXPLAINED = 0.012  # Distance from the skin within which the hand explains a measured point [m].
ARM_NEAR = 0.05  # Distance from the wrist within which points say nothing about the arm's direction [m].


@dataclass(frozen=True, eq=False)
class HandCapsules:
    """Tapered capsules about C lines between joints."""

    near: np.ndarray
    """Joint at one end, shape [C] int."""
    far: np.ndarray
    """Joint at the other end, shape [C] int."""
    end: np.ndarray
    """End of the line, as a fraction of the distance from the near to the far joint, shape [C]."""
    radius: np.ndarray
    """Radius at both ends, for a hand of mean size [m], shape [C, 2]."""
    finger: np.ndarray
    """Finger of each capsule, -1 for the palm, shape [C] int."""

    def ends(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return both ends of every line, shape [..., C, 3] each. joints: shape [..., 21, 3]."""
        first, last = joints[..., self.near, :], joints[..., self.far, :]
        return first, first + self.end[:, None] * (last - first)


def _capsules() -> HandCapsules:
    rows = []
    for finger in range(5):
        base = 1 + 4 * finger
        if finger < 4:
            rows.append((0, base, 1.0, PALM_BALL_RADIUS, PALM_BALL_RADIUS - 0.002, -1))
        for link in range(3):
            end = TIP_END if link == 2 else 1.0
            rows.append((base + link, base + link + 1, end, *FINGER_RADII[finger, link : link + 2], finger))
    near, far, end, first, last, finger = (np.array(column) for column in zip(*rows, strict=True))
    return HandCapsules(near, far, end, np.stack([first, last], axis=1), finger)


def _sure_skin() -> HandCapsules:
    palm_lines = ((1, 5), (5, 9), (9, 13), (13, 17), (17, 1))
    near, far = np.transpose((*BONES, *palm_lines))
    metacarpals = [[PALM_RADIUS]] * 4 + [[FINGER_RADII[4, 0]]]
    radius = np.append(
        np.hstack([metacarpals, LINK_RADII[1:].reshape(5, 3)]).ravel(), np.full(len(palm_lines), PALM_RADIUS)
    )
    finger = np.append(np.repeat(np.arange(5), 4), np.full(len(palm_lines), -1))
    return HandCapsules(near, far, np.ones(len(near)), np.column_stack([radius, radius]), finger)


HAND_CAPSULES = _capsules()  # Four in the palm, three in each finger; the thumb's first is its ball.
# Capsules that certainly show skin, with the web between thumb and index finger. They are thinner, because
# pixels beside them may show the object: with the capsules of the fit, one of two real images was no longer
# accepted; with those made 15 % thinner, two of four.
SURE_SKIN = _sure_skin()


def capsule_distances(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Return distances from the nearest capsule [m], negative inside, shape [P]; infinite for NaN points.

    Args:
        points: [m], shape [P, 3].
        first, last: ends of the capsules [m], shape [C, 3].
        radius: radius at both ends [m], shape [C, 2].
    """
    # Importing Numba takes half a second.
    from fungrasp.geometry.compiling import plain
    from fungrasp.perception import compiled_loops

    distance = np.empty(len(points))
    compiled_loops.capsule_distances(plain(points), plain(first), plain(last), plain(radius), distance)
    return distance


def nearest_capsules(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the capsule whose surface is nearest to each measured point of the skin.

    Args:
        points: [m], shape [P, 3], frame of a camera at the origin.
        first, last: ends of the capsules [m], shape [..., C, 3].
        radius: radius at both ends [m], shape [C, 2].

    Returns:
        Index of the capsule, shape [..., P]; signed distance from its surface [m], same shape, raised by
        ``FAR_SIDE_PENALTY`` where the skin faces away from the camera; nearest point of its line, 0 to 1,
        same shape; outward normal, shape [..., P, 3].
    """
    # Importing Numba takes half a second.
    from fungrasp.geometry.compiling import plain
    from fungrasp.perception import compiled_loops

    hands = first.shape[:-2]
    shape = (int(np.prod(hands)), len(points))
    which = np.empty(shape, np.int64)
    distance, along, normal = np.empty(shape), np.empty(shape), np.empty((*shape, 3))
    ends = (plain(end.reshape(-1, *end.shape[-2:])) for end in (first, last))
    compiled_loops.nearest_capsules(
        plain(points), *ends, plain(radius), FAR_SIDE, FAR_SIDE_PENALTY, which, distance, along, normal
    )
    whole = (*hands, len(points))
    return which.reshape(whole), distance.reshape(whole), along.reshape(whole), normal.reshape(*whole, 3)


def explained_part(hand: Skeleton, points: np.ndarray) -> float:
    """Return the fraction of measured points, without those of the arm, that lie on the skin, 0 to 1; 0
    without points. points: [m], shape [P, 3]."""
    joints = hand.joints()
    _, distance, _, _ = nearest_capsules(
        points, *HAND_CAPSULES.ends(joints), HAND_CAPSULES.radius * np.exp(hand.size)
    )
    distance = np.abs(distance)
    back = joints[0] - joints[9]
    arm = (distance > EXPLAINED) & ((points - joints[0]) @ (back / np.linalg.norm(back)) > -0.01)
    return float((distance[~arm] < EXPLAINED).mean()) if not arm.all() else 0.0


def arm_direction(points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the direction of the forearm from the wrist: toward most points behind the wrist, or straight on
    from the palm. Unit vector, shape [3].

    Args:
        points: points of hand and arm [m], shape [P, 3].
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


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """P points on lines between joints, each with the distance to the skin around it."""

    near: np.ndarray
    """Joint at one end, shape [P] int."""
    far: np.ndarray
    """Joint at the other end, shape [P] int."""
    part: np.ndarray
    """Position between them, 0 to 1, shape [P]."""
    radius: np.ndarray
    """Distance of the skin from the line, for a hand of mean size [m], shape [P]."""

    def place(self, joints: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points [m], shape [P, 3], and their derivatives, shape [P, 3, n]. jacobian: of the
        joints, shape [21, 3, n]."""
        a = self.part[:, None]
        points = (1 - a) * joints[self.near] + a * joints[self.far]
        a = a[..., None]
        return points, (1 - a) * jacobian[self.near] + a * jacobian[self.far]


def _surface_samples() -> SurfaceSamples:
    rows = [(0, 0, 0.0, WRIST_RADIUS)]
    for finger in range(5):
        base = 1 + 4 * finger
        if finger < 4:
            rows += [(0, base, part, PALM_RADIUS) for part in (0.35, 0.65, 0.9)]
        for link in range(3):
            first, last = FINGER_RADII[finger, link], FINGER_RADII[finger, link + 1]
            # The tip joint is on the skin, so samples of the last link end before it.
            parts = (0.05, 0.35, 0.65, 0.8) if link == 2 else (0.05, 0.35, 0.65, 0.95)
            rows += [(base + link, base + link + 1, x, first + x * (last - first)) for x in parts]
    near, far, part, radius = zip(*rows, strict=True)
    return SurfaceSamples(np.array(near), np.array(far), np.array(part), np.array(radius))


# One at the wrist, three along each bone of the palm, four along each link of the fingers.
SURFACE_SAMPLES = _surface_samples()
# Samples on each finger's last link.
FINGERTIP_SAMPLES = [np.flatnonzero(SURFACE_SAMPLES.near == 3 + 4 * finger) for finger in range(5)]


def in_front(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return which samples are not hidden behind others, bool, shape [P].

    Args:
        points: [m], shape [P, 3], camera frame.
        radius: distance to the skin [m], shape [P].
    """
    slopes = points[:, :2] / points[:, 2:]
    aside = np.linalg.norm(slopes[:, None] - slopes, axis=-1) * points[:, 2]
    skin = points[:, 2] - radius
    return ~((aside < 0.9 * radius) & (skin < skin[:, None] - 0.5 * radius[:, None])).any(axis=1)

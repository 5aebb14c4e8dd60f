"""The hand's shape: tapered capsules about its bones, and samples of them that are compared with an image."""

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

TIP_END = 0.7  # The tip joint is on the skin: the last link's capsule ends at this part of it.
# A camera sees no skin that faces away from it: cosine to the viewing ray from which a point is not taken for
# a capsule's.
FAR_SIDE = 0.3
FAR_SIDE_PENALTY = 0.02  # Distance that is added for such a point [m].
ARM_LENGTH = 0.25  # Length of the forearm that is looked at [m].
EXPLAINED = 0.012  # Measured points so near to the skin [m] are explained by the hand.
ARM_NEAR = 0.05  # Points nearer to the wrist than this [m] don't say where the arm goes.


@dataclass(frozen=True, eq=False)
class HandCapsules:
    """Tapered capsules about lines between joints."""

    near: np.ndarray
    """Joint at one end, shape [C]."""
    far: np.ndarray
    """Joint at the other end, shape [C]."""
    end: np.ndarray
    """Where the line ends, as a part of the distance from the near to the far joint, shape [C]."""
    radius: np.ndarray
    """Radius at both ends, for a hand of mean size [m], shape [C, 2]."""
    finger: np.ndarray
    """Which finger each belongs to, -1 for the palm, shape [C]."""

    def ends(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both ends of every line. joints: shape [..., 21, 3]; returns two of shape [..., C, 3]."""
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
# What surely is skin, with the web between thumb and index finger: thinner, as the pixels next to it may show
# the object. With the capsules of the fit, one of two real images was no longer accepted; with the fit's made
# 15 % thinner, two of four.
SURE_SKIN = _sure_skin()


def capsule_distances(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Distance of points from the nearest of some capsules [m], negative inside, shape [P]; infinite for
    points that are NaN.

    Args:
        points: [m], shape [P, 3].
        first, last: ends of the capsules [m], shape [C, 3].
        radius: at both ends [m], shape [C, 2].
    """
    # Importing Numba takes half a second: not before it is needed.
    from fungrasp.geometry.compiling import plain
    from fungrasp.perception import compiled_loops

    distance = np.empty(len(points))
    compiled_loops.capsule_distances(plain(points), plain(first), plain(last), plain(radius), distance)
    return distance


def nearest_capsules(
    points: np.ndarray, first: np.ndarray, last: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The capsule whose surface is nearest to each of some points of the skin, as a camera at the origin sees
    them.

    Args:
        points: [m], shape [P, 3], camera frame.
        first, last: ends of the capsules [m], shape [..., C, 3].
        radius: at both ends [m], shape [C, 2].

    Returns:
        Its index, shape [..., P]; signed distance from its surface [m], same shape, raised by
        ``FAR_SIDE_PENALTY`` where the skin there faces away from the camera; where on its line the nearest
        point is, 0 to 1, same shape; the outward normal, shape [..., P, 3].
    """
    # Importing Numba takes half a second: not before it is needed.
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
    """Part of the measured points, those of the arm apart, that lie on the skin, 0 to 1; 0 if there is none.

    points: [m], shape [P, 3].
    """
    joints = hand.joints()
    _, distance, _, _ = nearest_capsules(
        points, *HAND_CAPSULES.ends(joints), HAND_CAPSULES.radius * np.exp(hand.size)
    )
    distance = np.abs(distance)
    back = joints[0] - joints[9]
    arm = (distance > EXPLAINED) & ((points - joints[0]) @ (back / np.linalg.norm(back)) > -0.01)
    return float((distance[~arm] < EXPLAINED).mean()) if not arm.all() else 0.0


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


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on the lines between joints, each with the distance to the skin around it."""

    near: np.ndarray
    """Joint at one end, shape [P]."""
    far: np.ndarray
    """Joint at the other end, shape [P]."""
    part: np.ndarray
    """Where between them, 0 to 1, shape [P]."""
    radius: np.ndarray
    """Distance of the skin from the line there, for a hand of mean size [m], shape [P]."""

    def place(self, joints: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points [m], shape [P, 3], and their derivatives, [P, 3, n]."""
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
            # The tip joint is on the skin: the last link's samples end before it.
            parts = (0.05, 0.35, 0.65, 0.8) if link == 2 else (0.05, 0.35, 0.65, 0.95)
            rows += [(base + link, base + link + 1, x, first + x * (last - first)) for x in parts]
    near, far, part, radius = zip(*rows, strict=True)
    return SurfaceSamples(np.array(near), np.array(far), np.array(part), np.array(radius))


# One at the wrist, three along each bone of the palm, four along each link of the fingers.
SURFACE_SAMPLES = _surface_samples()
# Those on each finger's last link.
FINGERTIP_SAMPLES = [np.flatnonzero(SURFACE_SAMPLES.near == 3 + 4 * finger) for finger in range(5)]


def in_front(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Which samples are not hidden behind others, bool, shape [P].

    Args:
        points: [m], shape [P, 3], camera frame.
        radius: distance to the skin [m], shape [P].
    """
    slopes = points[:, :2] / points[:, 2:]
    aside = np.linalg.norm(slopes[:, None] - slopes, axis=-1) * points[:, 2]
    skin = points[:, 2] - radius
    return ~((aside < 0.9 * radius) & (skin < skin[:, None] - 0.5 * radius[:, None])).any(axis=1)

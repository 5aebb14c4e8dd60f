"""Search of finger postures on an approximate palm, by random samples.

Least squares finds local minima only: a thumb guessed on the wrong side of an object never gets around it.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fungrasp.grasps.human_hand import FINGER_RADII
from fungrasp.perception.hand.hand_capsules import HAND_CAPSULES, nearest_capsules
from fungrasp.perception.hand.hand_measurements import HandView
from fungrasp.perception.hand.skeleton import (
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_MEAN,
    ANGLE_SPREAD,
    LENGTHS,
    Skeleton,
)

TRIES = 256  # Sampled postures per finger.
ORDER = (4, 0, 1, 2, 3)  # Order in which fingers are searched: the thumb first.
MOST_POINTS = 80  # About the largest number of measured points that a finger is compared with.
WIDE = 1.3  # Factor on the usual spread of postures.
SAMPLED_PARTS = np.array([0.15, 0.5, 0.85])  # Positions of samples along each link.


# Costs of a posture: standard deviations, and bounds beyond which a cost does not grow.
LANDMARK_PART = 0.06  # Standard deviation of a landmark, as a fraction of the hand's extent in the image.
# Bound for landmarks [standard deviations]: those of hidden fingers are guesses.
LANDMARK_WORST = 3.0
POINT_SPREAD = 0.006  # Standard deviation of a measured point's distance from the skin [m].
POINT_WORST = 0.02  # Bound of this distance [m].
POINTS_WEIGHT = 60.0  # Number of independent measurements that all measured points together count as.
FRONT_SPREAD = 0.006  # Standard deviation of the skin's distance in front of the measured depth [m].
FRONT_WORST = 0.04  # Bound of this distance [m].
INSIDE_SPREAD = 0.004  # Standard deviation of the finger's penetration of object or table [m].
TOUCH_SPREAD = 0.008  # Standard deviation of the gap between the last link and the object [m].
TOUCH_WORST = 0.02  # Bound of this gap [m].


def postures(finger: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Sample angles of one finger [rad], shape [count, 3, 3]."""
    angles = ANGLE_MEAN[finger] + WIDE * ANGLE_SPREAD[finger] * rng.normal(size=(count, 3, 3))
    # Only the first joints deviate, and only the thumb's twists.
    angles[:, 1:, ::2] = 0.0
    if finger < 4:
        angles[:, 0, 2] = 0.0
    return angles


def search_fingers(
    hand: Skeleton, view: HandView, landmarks: np.ndarray, spread: float | None, rng: np.random.Generator
) -> Skeleton:
    """Return the hand with every finger in the best sampled posture, or in its own if that is best.

    Args:
        landmarks: [pixels], shape [21, 2].
        spread: standard deviation of a landmark [pixels]; None if unknown.
    """
    if spread is None:
        spread = LANDMARK_PART * float(np.linalg.norm(np.ptp(landmarks, axis=0)))
    for finger in ORDER:
        tried = np.concatenate([hand.angles[None, finger], postures(finger, TRIES, rng)])
        cost = finger_cost(hand, finger, tried, view, landmarks, spread)
        angles = hand.angles.copy()
        angles[finger] = tried[cost.argmin()]
        hand = dataclasses.replace(hand, angles=angles)
    return hand


def finger_cost(
    hand: Skeleton,
    finger: int,
    tried: np.ndarray,
    view: HandView,
    landmarks: np.ndarray,
    spread: float,
) -> np.ndarray:
    """Return the cost of each posture of a finger, shape [S]. tried: angles [rad], shape [S, 3, 3]."""
    joints = hand.finger_joints(finger, tried)
    scale = np.exp(hand.size)
    own = slice(1 + 4 * finger, 5 + 4 * finger)
    off = np.linalg.norm(view.intrinsics.project(joints[:, 1:]) - landmarks[own][1:], axis=-1) / spread
    cost = _limited(off, LANDMARK_WORST).sum(axis=1)
    cost += _points_cost(hand, finger, joints, view)
    # Samples along the links, each with the distance to the skin around it.
    last = np.where(np.arange(3) == 2, 0.8, 1.0)[:, None] * SAMPLED_PARTS
    first, step = joints[:, :-1, None], np.diff(joints, axis=1)[:, :, None]
    samples = (first + last[..., None] * step).reshape(len(joints), -1, 3)
    radius = scale * (FINGER_RADII[finger, :-1, None] + last * np.diff(FINGER_RADII[finger])[:, None]).ravel()
    seen = view.depth_at(view.intrinsics.project(samples))
    front = np.nan_to_num(np.maximum(seen - samples[..., 2] + radius - 0.006, 0.0))
    cost += _limited(front / FRONT_SPREAD, FRONT_WORST / FRONT_SPREAD).sum(axis=1) / 2
    distance, _ = view.surroundings.object_distance(samples.reshape(-1, 3))
    distance = distance.reshape(samples.shape[:2])
    cost += np.square(np.minimum(distance - 0.5 * radius, 0.0) / INSIDE_SPREAD).sum(axis=1)
    gap = np.maximum((distance - 0.8 * radius)[:, -3:].min(axis=1), 0.0)
    cost += _limited(gap / TOUCH_SPREAD, TOUCH_WORST / TOUCH_SPREAD)
    table = view.surroundings.table_distance(samples.reshape(-1, 3))
    if table is not None:
        height = table[0].reshape(samples.shape[:2])
        cost += np.square(np.minimum(height - 0.5 * radius, 0.0) / INSIDE_SPREAD).sum(axis=1)
    usual = (tried[..., 1] - ANGLE_MEAN[finger, :, 1]) / (2.0 * ANGLE_SPREAD[finger, :, 1])
    beyond = np.minimum(tried - ANGLE_LOW[finger], 0) + np.maximum(tried - ANGLE_HIGH[finger], 0)
    cost += (usual**2).sum(axis=1) + np.square(beyond / np.radians(5)).sum(axis=(1, 2))
    return cost


def _points_cost(hand: Skeleton, finger: int, joints: np.ndarray, view: HandView) -> np.ndarray:
    whole = hand.joints()
    scale = np.exp(hand.size)
    others = HAND_CAPSULES.finger != finger
    first, last = HAND_CAPSULES.ends(whole)
    rest = np.abs(
        nearest_capsules(view.points, first[others], last[others], scale * HAND_CAPSULES.radius[others])[1]
    )
    # Only points near this finger that no other part of the hand explains.
    length = scale * LENGTHS[finger].sum() + 0.02
    free = (rest > 0.002) & (np.linalg.norm(view.points - joints[0, 0], axis=1) < length)
    if not free.any():
        return np.zeros(len(joints))
    apart = max(1, int(free.sum()) // MOST_POINTS)
    free = np.flatnonzero(free)[::apart]
    points = view.points[free]
    own = HAND_CAPSULES.finger == finger
    every = np.zeros((len(joints), 21, 3))
    every[:, 1 + 4 * finger : 5 + 4 * finger] = joints
    first, last = HAND_CAPSULES.ends(every)
    distance = np.abs(
        nearest_capsules(points, first[:, own], last[:, own], scale * HAND_CAPSULES.radius[own])[1]
    )
    distance = np.minimum(distance, rest[free])
    weight = POINTS_WEIGHT * apart / max(len(view.points), 1)
    return weight * _limited(distance / POINT_SPREAD, POINT_WORST / POINT_SPREAD).sum(axis=1)


def _limited(residual: np.ndarray, worst: float) -> np.ndarray:
    """Geman-McClure loss, which tends to the square of ``worst``."""
    return worst**2 * residual**2 / (worst**2 + residual**2)

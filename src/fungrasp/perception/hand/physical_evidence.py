"""Residuals of anatomy (size, proportions, angles, overlap) and of contact with object and table."""

from __future__ import annotations

import copy

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points, rotate
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid
from fungrasp.grasps.contacts import link_points
from fungrasp.grasps.human_hand import LINK_RADII
from fungrasp.perception.hand.detected_hand import MIRROR_X
from fungrasp.perception.hand.hand_capsules import FINGERTIP_SAMPLES, HAND_CAPSULES, SURFACE_SAMPLES
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

SIZE_SPREAD = 0.1  # Standard deviation of the logarithm of adults' hand sizes, of both sexes.
# Standard deviation of the logarithm of bone lengths in hands of one size, including different definitions of
# joints by landmark models.
BONE_SPREAD = 0.06
BASE_SPREAD = 0.005  # Standard deviation of the position of a finger's base in the palm [m].
# Standard deviation of joint angles beyond their limits [rad].
LIMIT_SOFTNESS = np.radians(5.0)
# Overlap of soft tissue [m]; nine in ten of the available human grasps have at most this.
OVERLAP_SLACK = 0.0015
OVERLAP_SPREAD = 0.002  # Standard deviation of the overlap of fingers [m].


def anatomy_evidence(hand: Skeleton) -> list[HandEvidence]:
    """Return residuals of size, proportions and angles from those of people."""
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
    """Return the matrix, shape [9, 45], that maps angles minus their means to differences between the flexion
    of neighboring fingers, in standard deviations."""
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
    """Return pairs of capsules that may meet: links of different fingers, or the palm and outer links."""
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
    """Return the nearest points of segments a-b and c-d, 0 to 1, [N] each. a, b, c, d: shape [N, 3]."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = np.sum(u * u, axis=1), np.sum(u * v, axis=1), np.sum(v * v, axis=1)
    uw, vw = np.sum(u * w, axis=1), np.sum(v * w, axis=1)
    uu, vv = np.maximum(uu, 1e-12), np.maximum(vv, 1e-12)
    s = np.clip((uv * vw - vv * uw) / np.maximum(uu * vv - uv**2, 1e-12), 0.0, 1.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    return np.clip((uv * t - uw) / uu, 0.0, 1.0), t


def overlap_evidence(hand: Skeleton, joints: np.ndarray, jacobian: np.ndarray) -> HandEvidence:
    """Return overlaps of fingers. joints, jacobian: joints of ``hand`` and their derivatives."""
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
    by_step = np.einsum("pi,pin->pn", normal, slopes)
    return HandEvidence(gap[inside] / OVERLAP_SPREAD, by_step / OVERLAP_SPREAD)


def _between(ends: np.ndarray, part: np.ndarray) -> np.ndarray:
    return ends[:, 0] + part * (ends[:, 1] - ends[:, 0])


def _slopes(jacobian: np.ndarray, capsules: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return derivatives of points on the lines of capsules, shape [N, 3, n]."""
    part = (part * HAND_CAPSULES.end[capsules])[:, None, None]
    return (1 - part) * jacobian[HAND_CAPSULES.near[capsules]] + part * jacobian[HAND_CAPSULES.far[capsules]]


# Largest gaps between the skin of a touching link and the surface [m]: last links of fingers, all others.
# Fingertips touch in nearly all grasps, and only their estimate is off; other links often pass near the
# object and touch if they are pressed in. Compared with D-Grasp's labels on 30 rendered captures of 16 YCB
# objects, contacts have an F1 of 0.83 for detected hands and 0.87 for hands fitted to the true landmarks with
# noise; with 5 mm for all links, 0.71 and 0.75.
FINGERTIP_TOLERANCE, OTHER_TOLERANCE = 0.010, -0.005
# Largest gap of each of ``HUMAN_LINKS`` [m].
TOLERANCES = np.array([OTHER_TOLERANCE] + [OTHER_TOLERANCE, OTHER_TOLERANCE, FINGERTIP_TOLERANCE] * 5)


CONTACT_SPREAD = 0.004  # Standard deviation of the gap between a touching finger's skin and the surface [m].
CONTACT_REACH = 0.008  # Gap beyond which contact is improbable [m].
PRESSED = 0.6  # Fraction of the hand's radius between bone and surface of a pressed finger.
SOLID = 0.4  # Fraction of the hand's radius that nothing penetrates.
PENETRATION_SPREAD = 0.003  # Standard deviation of the penetration of object or table [m].


class HandSurroundings:
    """Distances of points, camera frame or its mirror image, to a known object and the table."""

    def __init__(
        self, surface: SignedDistanceGrid, pose_camera_object: np.ndarray, table: np.ndarray | None = None
    ):
        """
        Args:
            surface: signed distance grid of the object, object frame.
            pose_camera_object: pose of the object, camera frame, shape [7].
            table: plane ``[nx ny nz d]`` of the table top, unit normal up, camera frame, shape [4].
        """
        self._bank = SignedDistanceBank([surface])
        self._pose, self._table = np.asarray(pose_camera_object, dtype=float), table
        self._flip = np.ones(3)

    def mirrored(self) -> HandSurroundings:
        """Return the same for points whose x is reversed."""
        other = copy.copy(self)
        other._flip = self._flip * MIRROR_X
        return other

    def object_distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return signed distances [m], shape [P], and gradients, shape [P, 3]. points: [m], shape [P, 3]."""
        local = inverse_transform_points(self._pose, points * self._flip)
        distance, gradient = self._bank.query(np.zeros(1, dtype=int), local[None])
        return distance[0], rotate(self._pose[None, 3:], gradient[0]) * self._flip

    def table_distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return heights above the table [m], shape [P], and gradients, [P, 3]; None without a table."""
        if self._table is None:
            return None
        normal = self._table[:3] * self._flip
        return points @ normal + self._table[3], np.broadcast_to(normal, points.shape)


def contact_evidence(
    hand: Skeleton,
    joints: np.ndarray,
    jacobian: np.ndarray,
    surroundings: HandSurroundings,
) -> list[HandEvidence]:
    """Return gaps between the nearest point of each last link and the object, if it is near, and penetrations
    of object and table. joints, jacobian: joints of ``hand`` and their derivatives."""
    points, slopes = SURFACE_SAMPLES.place(joints, jacobian)
    radius = SURFACE_SAMPLES.radius * np.exp(hand.size)
    distance, gradient = surroundings.object_distance(points)
    # Derivatives of signed distances by the n parameters, shape [P, n].
    by_step = np.einsum("pi,pin->pn", gradient, slopes)
    gap = distance - PRESSED * radius
    touching = np.array([samples[gap[samples].argmin()] for samples in FINGERTIP_SAMPLES])
    touching = touching[gap[touching] > 0]
    found = [
        HandEvidence(
            gap[touching] / CONTACT_SPREAD,
            by_step[touching] / CONTACT_SPREAD,
            CONTACT_REACH / CONTACT_SPREAD,
        ),
        _not_inside(distance - SOLID * radius, by_step, PENETRATION_SPREAD),
    ]
    table = surroundings.table_distance(points)
    if table is not None:
        height, normal = table
        by_step = np.einsum("pi,pin->pn", normal, slopes)
        found.append(_not_inside(height - SOLID * radius, by_step, PENETRATION_SPREAD))
    return found


def _not_inside(gap: np.ndarray, by_step: np.ndarray, spread: float) -> HandEvidence:
    inside = gap < 0
    return HandEvidence(gap[inside] / spread, by_step[inside] / spread)


def touching_links(joints: np.ndarray, surface: SignedDistanceGrid, pose: np.ndarray) -> np.ndarray:
    """Return which of ``HUMAN_LINKS`` touch the object, bool, shape [16]. Arguments as in ``link_gaps``."""
    return link_gaps(joints, surface, pose) < TOLERANCES


def link_gaps(joints: np.ndarray, surface: SignedDistanceGrid, pose: np.ndarray) -> np.ndarray:
    """Return the gap between the skin of each of ``HUMAN_LINKS`` and the object, negative inside [m], shape
    [16]. A link is a capsule about its bone, with the thickness of an adult's link.

    Args:
        joints: [m], shape [21, 3], any frame.
        surface: signed distance grid of the object, object frame.
        pose: pose of the object in the frame of the joints, shape [7].
    """
    points = link_points(joints[None])[0]
    local = inverse_transform_points(pose, points.reshape(-1, 3))
    distance = SignedDistanceBank([surface]).query(np.zeros(1, dtype=int), local[None])[0]
    return distance.reshape(points.shape[:2]).min(axis=1) - LINK_RADII

"""What the image and anatomy say about a hand's skeleton: one function per kind of evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.grasps.human_hand import BONES
from fungrasp.perception.hand.silhouette import Silhouettes
from fungrasp.perception.hand.skeleton import (
    ALIKE_SPREAD,
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_MEAN,
    ANGLE_SPREAD,
    PARAMETERS,
    SIZE,
    Skeleton,
)
from fungrasp.perception.hand.surface_samples import in_front
from fungrasp.perception.io.capture import Intrinsics

SIZE_SPREAD = 0.1
"""Standard deviation of the logarithm of adults' hand sizes: both sexes together."""

BONE_SPREAD = 0.06
"""Standard deviation of the logarithm of a bone's length in hands of one size, and what different makers of
landmarks mean by the same joint."""

BASE_SPREAD = 0.005
"""Standard deviation of where a finger's base is in the palm [m]."""

LIMIT_SOFTNESS = np.radians(5.0)
"""A joint bent beyond its limit by this much [rad] is one standard deviation out."""

NEAR_BONES, FAR_BONES = np.transpose(BONES)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Residuals of one kind."""

    residual: np.ndarray
    """In standard deviations, shape [R]."""
    jacobian: np.ndarray
    """Derivatives by the parameters, shape [R, n]; n may be less than the number of parameters."""
    outlier: float | np.ndarray = np.inf
    """Residuals beyond this hardly count: one limit for all, or one per group, shape [R / group]."""
    group: int = 1
    """So many residuals in a row are one measurement and are judged by their norm."""


def pixel_evidence(
    joints: np.ndarray,
    jacobian: np.ndarray,
    intrinsics: Intrinsics,
    pixels: np.ndarray,
    spread: float | np.ndarray,
) -> Evidence:
    """The joints project to the landmarks. spread: standard deviation of a landmark [pixels], shape [21] or
    one for all."""
    projected, slopes = project(joints, jacobian, intrinsics)
    width = np.broadcast_to(spread, 21)[:, None]
    residual = ((projected - pixels) / width).ravel()
    return Evidence(residual, (slopes / width[..., None]).reshape(42, -1), outlier=4.0, group=2)


def project(
    points: np.ndarray, jacobian: np.ndarray, intrinsics: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points, shape [P, 2], and their derivatives, [P, 2, n]."""
    depth = np.maximum(points[:, 2:], 0.05)
    focal = np.array([intrinsics.fx, intrinsics.fy])
    slope = points[:, :2] / depth
    pixels = slope * focal + [intrinsics.cx, intrinsics.cy]
    derivative = jacobian[:, :2] - slope[..., None] * jacobian[:, 2:]
    return pixels, derivative * (focal / depth)[..., None]


def depth_evidence(
    points: np.ndarray,
    jacobian: np.ndarray,
    radius: np.ndarray,
    measured: np.ndarray,
    spread: float,
    outlier: tuple[float, float],
) -> Evidence:
    """The skin seen lies in front of the line between joints by the flesh's thickness.

    Args:
        points, jacobian: of the probes.
        radius: flesh around each of them [m], shape [P].
        measured: depth of what is seen at their pixels [m], shape [P]; 0: none.
        spread: standard deviation of the difference [m].
        outlier: how far in front of the skin something else is seen, and how far behind [m].
    """
    seen = (measured > 0) & in_front(points, radius)
    residual = (points[:, 2] - radius - measured)[seen] / spread
    limit = np.where(residual > 0, outlier[0], outlier[1]) / spread
    return Evidence(residual, jacobian[seen, 2] / spread, limit)


def front_evidence(
    points: np.ndarray,
    jacobian: np.ndarray,
    radius: np.ndarray,
    measured: np.ndarray,
    spread: float,
    outlier: float,
) -> Evidence:
    """No skin is in front of what is seen.

    Args:
        points, jacobian: of the probes.
        radius: flesh around each of them, and slack [m], shape [P].
        measured: depth of what is seen at their pixels [m], shape [P]; 0: none.
        spread: standard deviation of how far skin is in front [m].
        outlier: skin farther in front is likelier a fault of the depth [m].
    """
    ahead = measured - points[:, 2] + radius
    wrong = (measured > 0) & (ahead > 0)
    return Evidence(ahead[wrong] / spread, -jacobian[wrong, 2] / spread, outlier / spread)


def silhouette_evidence(
    silhouettes: Silhouettes,
    pixels: np.ndarray,
    slopes: np.ndarray,
    depth: np.ndarray,
    thickness: np.ndarray,
    spread: float,
    outlier: float,
) -> Evidence:
    """Nothing of the hand is where the background is seen.

    Args:
        silhouettes: where that is.
        pixels, slopes: of the probes and their derivatives, shapes [P, 2] and [P, 2, n].
        depth: of the probes [m], shape [P].
        thickness: least distance of each from the background [pixels], shape [P].
        spread: standard deviation of that distance [pixels].
        outlier: a probe deeper in the background [pixels] is likelier hidden by a hole in the depth.
    """
    distance, gradient = silhouettes.distance(pixels, depth)
    residual = distance + thickness
    out = (residual > 0) & gradient.any(axis=1)
    by_step = np.einsum("pi,pin->pn", gradient[out], slopes[out])
    return Evidence(residual[out] / spread, by_step / spread, outlier / spread)


def shape_evidence(
    joints: np.ndarray, jacobian: np.ndarray, directions: np.ndarray, spread: float
) -> Evidence:
    """The bones point where a model of shape says, up to a turn of the whole hand.

    That turn about the camera's axes is three more parameters, appended to the skeleton's.

    Args:
        joints, jacobian: of the skeleton.
        directions: unit vectors of ``BONES``, turned as believed so far, camera frame, shape [20, 3].
        spread: standard deviation of a direction [rad].
    """
    bones = joints[FAR_BONES] - joints[NEAR_BONES]
    lengths = np.linalg.norm(bones, axis=1)[:, None]
    units = bones / lengths
    slopes = jacobian[FAR_BONES] - jacobian[NEAR_BONES]
    along = np.einsum("bi,bin->bn", units, slopes)
    slopes = (slopes - units[..., None] * along[:, None]) / lengths[..., None]
    by_turn = -np.cross(np.eye(3), directions[:, None]).transpose(0, 2, 1)
    columns = np.concatenate([slopes, by_turn], axis=-1).reshape(60, -1)
    return Evidence(((units - directions) / spread).ravel(), columns / spread, outlier=4.0, group=3)


def anatomy_evidence(hand: Skeleton) -> list[Evidence]:
    """Sizes, proportions and angles are those of people."""
    beyond = np.minimum(hand.angles - ANGLE_LOW, 0.0) + np.maximum(hand.angles - ANGLE_HIGH, 0.0)
    unusual = (hand.angles - ANGLE_MEAN) / ANGLE_SPREAD
    return [
        _prior("size", np.array([hand.size]) / SIZE_SPREAD, 1 / SIZE_SPREAD),
        _prior("bases", hand.bases.ravel() / BASE_SPREAD, 1 / BASE_SPREAD),
        _prior("bones", hand.bones.ravel() / BONE_SPREAD, 1 / BONE_SPREAD),
        _prior("angles", unusual.ravel(), (1 / ANGLE_SPREAD).ravel()),
        Evidence(_ALIKE @ (hand.angles - ANGLE_MEAN).ravel(), _ALIKE_COLUMNS),
        _prior("angles", beyond.ravel() / LIMIT_SOFTNESS, (beyond != 0).ravel() / LIMIT_SOFTNESS),
    ]


def _alike() -> np.ndarray:
    """Differences of what neighbouring fingers' flexion is beyond the usual, over their spread, by angle,
    shape [9, 45]."""
    rows = np.zeros((3, 3, 5, 3, 3))
    for finger in range(3):
        for joint in range(3):
            rows[finger, joint, finger : finger + 2, joint, 1] = np.array([1.0, -1.0]) / ALIKE_SPREAD[joint]
    return rows.reshape(9, 45)


_ALIKE = _alike()

_ALIKE_COLUMNS = np.zeros((9, SIZE))
_ALIKE_COLUMNS[:, PARAMETERS["angles"]] = _ALIKE


def _prior(kind: str, residual: np.ndarray, slope: np.ndarray | float) -> Evidence:
    jacobian = np.zeros((len(residual), SIZE))
    jacobian[:, PARAMETERS[kind]] = np.diag(np.broadcast_to(slope, residual.shape))
    return Evidence(residual, jacobian)

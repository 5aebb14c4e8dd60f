"""Residuals between a hand and an image, one function per kind of evidence: landmarks, depth, silhouette,
measured points, and the landmark model's bone directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from fungrasp.grasps.human_hand import BONES, FOREARM_RADII
from fungrasp.perception.hand.hand_capsules import (
    ARM_LENGTH,
    HAND_CAPSULES,
    arm_direction,
    in_front,
    nearest_capsules,
)
from fungrasp.perception.hand.skeleton import HandEvidence, Skeleton
from fungrasp.perception.io.capture import Intrinsics

NEAR_BONES, FAR_BONES = np.transpose(BONES)

# Standard deviation of depth at a surface sample [m]: camera noise and thickness, with correlated errors.
DEPTH_SPREAD = 0.012
FRONT_SPREAD = 0.016  # Standard deviation of the skin's distance in front of the measured depth [m].
FRONT_OUTLIER = 0.05  # Distance in front beyond which the depth is probably wrong [m].
FRONT_SLACK = 0.004  # Distance in front that is allowed [m].
SILHOUETTE_SPREAD = 3.0  # Standard deviation of the silhouette [pixels].
# Distance into the background beyond which a hole in the depth is more probable [pixels].
SILHOUETTE_OUTLIER = 20.0
SILHOUETTE_INSET = 0.7  # Fraction of the hand's thickness that is certainly inside the silhouette.
# Standard deviation of a measured point's distance from the skin of fingers, palm and arm [m].
POINT_SPREAD = np.array([0.004, 0.008, 0.025])
# Number of independent measurements that all points together count as, because their errors are correlated.
POINTS_WORTH = 85.0
BACKGROUND_BEHIND = 0.02  # Distance behind a part of the hand beyond which depth shows its background [m].
FIELD_STEP = 2  # Resolution of distance fields [pixels]; silhouettes are not known better.
AROUND = 40  # Margin of distance fields around the hand [pixels].
NO_BACKGROUND = -1e3  # Distance to the background at a level without background [pixels].
# Kind of every capsule and of the arm: 0 finger, 1 palm, 2 arm.
_KIND = np.append(np.where(HAND_CAPSULES.finger < 0, 1, 0), 2)

_NEAR, _FAR, _END = (
    np.append(HAND_CAPSULES.near, 0),
    np.append(HAND_CAPSULES.far, 0),
    np.append(HAND_CAPSULES.end, 1.0),
)


def landmark_evidence(
    joints: np.ndarray,
    jacobian: np.ndarray,
    intrinsics: Intrinsics,
    pixels: np.ndarray,
    spread: float | np.ndarray,
) -> HandEvidence:
    """Return residuals of the joints' projections from the landmarks. spread: standard deviation of a
    landmark [pixels], shape [21] or a number."""
    projected, slopes = project(joints, jacobian, intrinsics)
    width = np.broadcast_to(spread, 21)[:, None]
    residual = ((projected - pixels) / width).ravel()
    return HandEvidence(residual, (slopes / width[..., None]).reshape(42, -1), outlier=4.0, group=2)


def project(
    points: np.ndarray, jacobian: np.ndarray, intrinsics: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels of points, shape [P, 2], and their derivatives, shape [P, 2, n]."""
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
    outlier: tuple[float, float],
) -> HandEvidence:
    """Return residuals of the visible skin's depth: the line between joints minus the hand's radius.

    Args:
        points, jacobian: surface samples [m], camera frame, shape [P, 3], and derivatives, shape [P, 3, n].
        radius: distance of the skin from each sample [m], shape [P].
        measured: depth measured at each sample's pixel [m], shape [P]; 0: none.
        outlier: distances in front of and behind the skin beyond which depth shows something else [m].
    """
    seen = (measured > 0) & in_front(points, radius)
    residual = (points[:, 2] - radius - measured)[seen] / DEPTH_SPREAD
    limit = np.where(residual > 0, outlier[0], outlier[1]) / DEPTH_SPREAD
    return HandEvidence(residual, jacobian[seen, 2] / DEPTH_SPREAD, limit)


def front_evidence(
    points: np.ndarray, jacobian: np.ndarray, radius: np.ndarray, measured: np.ndarray
) -> HandEvidence:
    """Return residuals of skin in front of the measured depth. Arguments as in ``depth_evidence``."""
    ahead = measured - points[:, 2] + (radius + FRONT_SLACK)
    wrong = (measured > 0) & (ahead > 0)
    by_step = -jacobian[wrong, 2] / FRONT_SPREAD
    return HandEvidence(ahead[wrong] / FRONT_SPREAD, by_step, FRONT_OUTLIER / FRONT_SPREAD)


def silhouette_evidence(
    silhouettes: Silhouettes,
    pixels: np.ndarray,
    slopes: np.ndarray,
    depth: np.ndarray,
    thickness: np.ndarray,
) -> HandEvidence:
    """Return residuals of parts of the hand in front of visible background.

    Args:
        pixels, slopes: pixels of the surface samples and derivatives, shapes [P, 2] and [P, 2, n].
        depth: depth of the surface samples [m], shape [P].
        thickness: radius of the hand around each [pixels], shape [P].
    """
    distance, gradient = silhouettes.distance(pixels, depth)
    residual = distance + SILHOUETTE_INSET * thickness
    out = (residual > 0) & gradient.any(axis=1)
    # Chain rule: image gradient, shape [P, 2], times derivatives of the pixels, shape [P, 2, n].
    by_step = np.einsum("pi,pin->pn", gradient[out], slopes[out])
    spread = SILHOUETTE_SPREAD
    return HandEvidence(residual[out] / spread, by_step / spread, SILHOUETTE_OUTLIER / spread)


def direction_evidence(
    joints: np.ndarray, jacobian: np.ndarray, directions: np.ndarray, spread: float
) -> HandEvidence:
    """Return residuals of bone directions from those of the landmark model, up to a rotation of the whole
    hand about the camera's axes: three more parameters, appended to the skeleton's.

    Args:
        directions: unit vectors of ``BONES`` at the current rotation, camera frame, shape [20, 3].
        spread: standard deviation of a direction [rad].
    """
    bones = joints[FAR_BONES] - joints[NEAR_BONES]
    lengths = np.linalg.norm(bones, axis=1)[:, None]
    units = bones / lengths
    slopes = jacobian[FAR_BONES] - jacobian[NEAR_BONES]
    # A unit vector changes only across the bone: d(b / |b|) = (I - u u^T) db / |b|, shape [20, 3, n].
    along = np.einsum("bi,bin->bn", units, slopes)
    slopes = (slopes - units[..., None] * along[:, None]) / lengths[..., None]
    by_turn = -np.cross(np.eye(3), directions[:, None]).transpose(0, 2, 1)
    columns = np.concatenate([slopes, by_turn], axis=-1).reshape(60, -1)
    return HandEvidence(((units - directions) / spread).ravel(), columns / spread, outlier=4.0, group=3)


def point_evidence(
    hand: Skeleton,
    joints: np.ndarray,
    jacobian: np.ndarray,
    points: np.ndarray,
    outlier: float,
) -> HandEvidence:
    """Return distances of measured points of hand and arm from the skin.

    Args:
        hand, joints, jacobian: skeleton, its joints and their derivatives.
        points: [m], camera frame, shape [P, 3].
        outlier: distance from the skin beyond which a point shows something else [m].
    """
    first, last = HAND_CAPSULES.ends(joints)
    elbow = joints[0] + ARM_LENGTH * arm_direction(points, joints)
    first, last = np.vstack([first, joints[0]]), np.vstack([last, elbow])
    radius = np.vstack([HAND_CAPSULES.radius, FOREARM_RADII]) * np.exp(hand.size)
    nearest, distance, along, normal = nearest_capsules(points, first, last, radius)
    kind = _KIND[nearest]
    part = np.where(kind == 2, 0.0, along * _END[nearest])[:, None]
    # The nearest point of a bone interpolates its joints; the distance falls as it moves outward.
    by_step = np.einsum("pi,pin->pn", normal, jacobian[_NEAR[nearest]]) * (1 - part)
    by_step += np.einsum("pi,pin->pn", normal, jacobian[_FAR[nearest]]) * part
    width = (POINT_SPREAD / np.sqrt(POINTS_WORTH / max(len(points), 1)))[kind]
    return HandEvidence(distance / width, -by_step / width[:, None], outlier / width)


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Distance fields to the background in the image, for L depth levels of the hand."""

    corner: np.ndarray
    """Top left pixel ``[u v]`` of the fields, shape [2]."""
    depths: np.ndarray
    """Largest depth of parts that belong to each level, ascending [m], shape [L]."""
    fields: np.ndarray
    """Distance into the background at every ``FIELD_STEP``-th pixel, negative outside [pixels], [L, h, w]."""

    @classmethod
    def around(
        cls,
        depth: np.ndarray,
        pixels: np.ndarray,
        parts: np.ndarray,
        levels: int,
    ) -> Silhouettes:
        """Compute the fields around a hand.

        Args:
            depth: depth image [m], shape [H, W]; NaN: not measured, may be the hand.
            pixels: pixels of P parts of the hand, shape [P, 2].
            parts: their depths [m], shape [P].
            levels: L.
        """
        edge = np.array(depth.shape[::-1])
        low = np.clip(np.floor(pixels.min(axis=0)) - AROUND, 0, edge - 2).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)) + AROUND, low + 2, edge).astype(int)
        crop = depth[low[1] : high[1] : FIELD_STEP, low[0] : high[0] : FIELD_STEP]
        depths = np.quantile(parts, np.arange(1, levels + 1) / levels)
        return cls(low, depths, np.stack([_field(crop > limit + BACKGROUND_BEHIND) for limit in depths]))

    def distance(self, pixels: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far each part is in the background, negative outside [pixels], shape [P], and the
        gradient, shape [P, 2]; both are 0 outside the fields.

        Args:
            pixels: shape [P, 2].
            parts: depths of the parts [m], shape [P].
        """
        level = np.minimum(np.searchsorted(self.depths, parts), len(self.depths) - 1)
        local = (pixels - self.corner) / FIELD_STEP
        height, width = self.fields.shape[1:]
        inside = np.all((local >= 0) & (local < [width - 1, height - 1]), axis=1)
        local = np.where(inside[:, None], local, 0.0)
        cell = local.astype(int)
        x, y = (local - cell).T
        near = [self.fields[level, cell[:, 1] + i, cell[:, 0] + j] for i in (0, 1) for j in (0, 1)]
        top, bottom = near[0] + x * (near[1] - near[0]), near[2] + x * (near[3] - near[2])
        across = (1 - y) * (near[1] - near[0]) + y * (near[3] - near[2])
        value = np.where(inside, top + y * (bottom - top), 0.0)
        return value, np.stack([across, bottom - top], axis=1) * inside[:, None] / FIELD_STEP


def _field(background: np.ndarray) -> np.ndarray:
    if not background.any():
        return np.full(background.shape, NO_BACKGROUND)
    inside, outside = (np.asarray(ndimage.distance_transform_edt(part)) for part in (background, ~background))
    return FIELD_STEP * (inside - outside)

"""What the image says about a hand: one function per kind of evidence.

Landmarks, depth, silhouette, measured points, and the shape that the landmark model guesses.
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

# Standard deviation of depth at a surface sample [m]: camera, thickness, and that neighbors err alike.
DEPTH_SPREAD = 0.012
FRONT_SPREAD = 0.016  # Standard deviation of how far skin may be in front of what is seen there [m].
FRONT_OUTLIER = 0.05  # Skin farther in front [m] is likelier a fault of the depth.
FRONT_SLACK = 0.004  # Skin so little in front [m] is not.
SILHOUETTE_SPREAD = 3.0  # Standard deviation of the silhouette [pixels].
# A part farther in the background [pixels] is likelier hidden by a hole in the depth.
SILHOUETTE_OUTLIER = 20.0
SILHOUETTE_INSET = 0.7  # Part of the hand's thickness that is surely inside the silhouette.
# Standard deviation of a measured point's distance from the skin [m]: of fingers, palm and arm.
POINT_SPREAD = np.array([0.004, 0.008, 0.025])
# Number of independent measurements that all measured points together count as: neighbors err alike.
POINTS_WORTH = 85.0
BACKGROUND_BEHIND = 0.02  # What is seen farther behind a part of the hand [m] is background to it.
FIELD_STEP = 2  # Distances are looked at so many pixels apart: silhouettes are not known better.
AROUND = 40  # So much is looked at around the hand's parts [pixels].
NO_BACKGROUND = -1e3  # Distance to the background of a level that has none [pixels].
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
    """The joints project to the landmarks. spread: standard deviation of a landmark [pixels], shape [21] or
    one for all."""
    projected, slopes = project(joints, jacobian, intrinsics)
    width = np.broadcast_to(spread, 21)[:, None]
    residual = ((projected - pixels) / width).ravel()
    return HandEvidence(residual, (slopes / width[..., None]).reshape(42, -1), outlier=4.0, group=2)


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
    outlier: tuple[float, float],
) -> HandEvidence:
    """The skin seen lies in front of the line between joints by half the hand's thickness.

    Args:
        radius: distance of the skin from each [m], shape [P].
        measured: depth of what is seen at their pixels [m], shape [P]; 0: none.
        outlier: how far in front of the skin something else is seen, and how far behind [m].
    """
    seen = (measured > 0) & in_front(points, radius)
    residual = (points[:, 2] - radius - measured)[seen] / DEPTH_SPREAD
    limit = np.where(residual > 0, outlier[0], outlier[1]) / DEPTH_SPREAD
    return HandEvidence(residual, jacobian[seen, 2] / DEPTH_SPREAD, limit)


def front_evidence(
    points: np.ndarray, jacobian: np.ndarray, radius: np.ndarray, measured: np.ndarray
) -> HandEvidence:
    """No skin is in front of what is seen. Arguments as of ``depth_evidence``."""
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
    """Nothing of the hand is where the background is seen.

    Args:
        pixels, slopes: of the surface samples and their derivatives, shapes [P, 2] and [P, 2, n].
        depth: of the surface samples [m], shape [P].
        thickness: of the hand around each [pixels], shape [P].
    """
    distance, gradient = silhouettes.distance(pixels, depth)
    residual = distance + SILHOUETTE_INSET * thickness
    out = (residual > 0) & gradient.any(axis=1)
    # Chain rule: image gradient [P, 2] times derivatives of the pixels by the n parameters [P, 2, n].
    by_step = np.einsum("pi,pin->pn", gradient[out], slopes[out])
    spread = SILHOUETTE_SPREAD
    return HandEvidence(residual[out] / spread, by_step / spread, SILHOUETTE_OUTLIER / spread)


def direction_evidence(
    joints: np.ndarray, jacobian: np.ndarray, directions: np.ndarray, spread: float
) -> HandEvidence:
    """The bones point where a model of shape says, up to a turn of the whole hand.

    That turn about the camera's axes is three more parameters, appended to the skeleton's.

    Args:
        directions: unit vectors of ``BONES``, at the current estimate of the turn, camera frame, shape
        [20, 3].
        spread: standard deviation of a direction [rad].
    """
    bones = joints[FAR_BONES] - joints[NEAR_BONES]
    lengths = np.linalg.norm(bones, axis=1)[:, None]
    units = bones / lengths
    slopes = jacobian[FAR_BONES] - jacobian[NEAR_BONES]
    # A unit vector moves across the bone alone: d(b / |b|) = (I - u u^T) db / |b|, shape [20, 3, n].
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
    """Every point that shows the hand or its arm lies on the skin.

    Args:
        hand, joints, jacobian: the skeleton, its joints and their derivatives.
        points: [m], shape [P, 3].
        outlier: a point farther from the skin [m] shows something else.
    """
    first, last = HAND_CAPSULES.ends(joints)
    elbow = joints[0] + ARM_LENGTH * arm_direction(points, joints)
    first, last = np.vstack([first, joints[0]]), np.vstack([last, elbow])
    radius = np.vstack([HAND_CAPSULES.radius, FOREARM_RADII]) * np.exp(hand.size)
    nearest, distance, along, normal = nearest_capsules(points, first, last, radius)
    kind = _KIND[nearest]
    part = np.where(kind == 2, 0.0, along * _END[nearest])[:, None]
    # The nearest point of the bone is a mixture of its joints; the residual falls as it moves outward.
    by_step = np.einsum("pi,pin->pn", normal, jacobian[_NEAR[nearest]]) * (1 - part)
    by_step += np.einsum("pi,pin->pn", normal, jacobian[_FAR[nearest]]) * part
    width = (POINT_SPREAD / np.sqrt(POINTS_WORTH / max(len(points), 1)))[kind]
    return HandEvidence(distance / width, -by_step / width[:, None], outlier / width)


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Distances in the image to the background of a hand, for parts of it at different depths."""

    corner: np.ndarray
    """Top left pixel ``[u v]`` of the part of the image that was looked at, shape [2]."""
    depths: np.ndarray
    """Parts nearer than this [m] belong to a level, ascending, shape [L]."""
    fields: np.ndarray
    """Distance into the background of each level, negative outside it [pixels], at every
    ``FIELD_STEP``-th pixel, shape [L, h, w]."""

    @classmethod
    def around(
        cls,
        depth: np.ndarray,
        pixels: np.ndarray,
        parts: np.ndarray,
        levels: int,
    ) -> Silhouettes:
        """Look at the image around a hand.

        Args:
            depth: of the image [m], shape [H, W]; NaN: none, taken for anything.
            pixels: of the hand's parts, shape [P, 2].
            parts: their depths [m], shape [P].
            levels: number of depth levels that parts are sorted into.
        """
        edge = np.array(depth.shape[::-1])
        low = np.clip(np.floor(pixels.min(axis=0)) - AROUND, 0, edge - 2).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)) + AROUND, low + 2, edge).astype(int)
        crop = depth[low[1] : high[1] : FIELD_STEP, low[0] : high[0] : FIELD_STEP]
        depths = np.quantile(parts, np.arange(1, levels + 1) / levels)
        return cls(low, depths, np.stack([_field(crop > limit + BACKGROUND_BEHIND) for limit in depths]))

    def distance(self, pixels: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How deep each part is in the background.

        Args:
            pixels: shape [P, 2].
            parts: depths of the parts [m], shape [P].

        Returns:
            [pixels], shape [P], negative where it is not; its slope, shape [P, 2]; both 0 for parts beyond
            what was looked at.
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

"""What the image and anatomy say about a hand's skeleton: one function per kind of evidence.

Every function returns residuals in units of their standard deviation, their derivatives by the parameters of
``Skeleton``, and the residual beyond which an answer is likelier an outlier.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.grasps.human_hand import BONES
from fungrasp.perception.capture import Intrinsics
from fungrasp.perception.hand_skeleton import (
    ANGLE_HIGH,
    ANGLE_LOW,
    ANGLE_MEAN,
    ANGLE_SPREAD,
    PALM_RADIUS,
    PARAMETERS,
    RADII,
    SIZE,
    WRIST_RADIUS,
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

FAR_BONES = np.array([far for _, far in BONES])
NEAR_BONES = np.array([near for near, _ in BONES])


@dataclass(frozen=True, eq=False)
class Evidence:
    """Residuals of one kind."""

    residual: np.ndarray
    """In standard deviations, shape [R]."""
    jacobian: np.ndarray
    """Derivatives by the parameters, shape [R, n]."""
    outlier: float | np.ndarray = np.inf
    """Residuals (or groups of ``group`` of them, by their norm) beyond this hardly count; one for all, or each
    its own, shape [R]."""
    group: int = 1


@dataclass(frozen=True, eq=False)
class Probes:
    """Points of the flesh, on the lines between joints."""

    near: np.ndarray
    """Joint at one end, shape [P]."""
    far: np.ndarray
    """Joint at the other end, shape [P]."""
    part: np.ndarray
    """Where between them, 0 to 1, shape [P]."""
    radius: np.ndarray
    """Flesh around the line there, for a hand of mean size [m], shape [P]."""

    def place(self, joints: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points [m], shape [P, 3], and their derivatives, [P, 3, n]."""
        a = self.part[:, None]
        points = (1 - a) * joints[self.near] + a * joints[self.far]
        a = a[..., None]
        return points, (1 - a) * jacobian[self.near] + a * jacobian[self.far]


def _probes() -> Probes:
    rows = [(0, 0, 0.0, WRIST_RADIUS)]
    for finger in range(5):
        base = 1 + 4 * finger
        if finger < 4:
            rows += [(0, base, part, PALM_RADIUS) for part in (0.35, 0.65, 0.9)]
        for link in range(3):
            first, last = RADII[finger, link], RADII[finger, link + 1]
            parts = (0.05, 0.35, 0.65, 0.8) if link == 2 else (0.05, 0.35, 0.65, 0.95)
            rows += [(base + link, base + link + 1, x, first + x * (last - first)) for x in parts]
    near, far, part, radius = zip(*rows, strict=True)
    return Probes(np.array(near), np.array(far), np.array(part), np.array(radius))


PROBES = _probes()
"""Where depth is compared: along the palm's bones and the fingers."""


def pixel_evidence(
    joints: np.ndarray, jacobian: np.ndarray, intrinsics: Intrinsics, pixels: np.ndarray, spread: float
) -> Evidence:
    """The joints project to the landmarks. spread: standard deviation of a landmark [pixels]."""
    residual, slopes = project(joints, jacobian, intrinsics)
    return Evidence(
        ((residual - pixels) / spread).ravel(), slopes.reshape(42, -1) / spread, outlier=4.0, group=2
    )


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
    residual = (points[:, 2] - radius - measured) / spread
    limit = np.where(residual > 0, outlier[0], outlier[1]) / spread
    return Evidence(residual[seen], jacobian[seen, 2] / spread, limit[seen])


def in_front(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Which points of the flesh are not hidden behind others, bool, shape [P].

    Args:
        points: [m], shape [P, 3], camera frame.
        radius: of the flesh around them [m], shape [P].
    """
    slopes = points[:, :2] / points[:, 2:]
    aside = np.linalg.norm(slopes[:, None] - slopes, axis=-1) * points[:, 2]
    skin = points[:, 2] - radius
    return ~((aside < 0.9 * radius) & (skin < skin[:, None] - 0.5 * radius[:, None])).any(axis=1)


def shape_evidence(
    joints: np.ndarray, jacobian: np.ndarray, directions: np.ndarray, spread: float
) -> Evidence:
    """The bones point where a model of shape says, up to a turn of the whole hand.

    That turn is three parameters more, appended to the others.

    Args:
        directions: unit vectors of ``BONES`` in the camera frame, shape [20, 3].
        spread: standard deviation of a direction [rad].
    """
    bones = joints[FAR_BONES] - joints[NEAR_BONES]
    lengths = np.linalg.norm(bones, axis=1)[:, None]
    units = bones / lengths
    slopes = jacobian[FAR_BONES] - jacobian[NEAR_BONES]
    slopes = (slopes - units[..., None] * np.einsum("bi,bin->bn", units, slopes)[:, None]) / lengths[
        ..., None
    ]
    residual = (units - directions) / spread
    return Evidence(residual.ravel(), (slopes / spread).reshape(60, -1), outlier=4.0, group=3)


def turn_derivatives(directions: np.ndarray, spread: float) -> np.ndarray:
    """Derivatives of ``shape_evidence`` by a turn of the given directions, shape [60, 3]."""
    axes = np.eye(3)
    return -np.cross(axes[None], directions[:, None]).transpose(0, 2, 1).reshape(60, 3) / spread


def anatomy_evidence(hand: Skeleton) -> list[Evidence]:
    """Sizes, proportions and angles are those of people."""
    limits_low = np.minimum(hand.angles - ANGLE_LOW, 0.0)
    limits_high = np.maximum(hand.angles - ANGLE_HIGH, 0.0)
    beyond = (limits_low + limits_high).ravel()
    return [
        _prior("size", np.array([hand.size]) / SIZE_SPREAD, 1 / SIZE_SPREAD),
        _prior("bases", hand.bases.ravel() / BASE_SPREAD, 1 / BASE_SPREAD),
        _prior("bones", hand.bones.ravel() / BONE_SPREAD, 1 / BONE_SPREAD),
        _prior("angles", ((hand.angles - ANGLE_MEAN) / ANGLE_SPREAD).ravel(), (1 / ANGLE_SPREAD).ravel()),
        _prior("angles", beyond / LIMIT_SOFTNESS, (beyond != 0) / LIMIT_SOFTNESS),
    ]


def _prior(kind: str, residual: np.ndarray, slope: np.ndarray | float) -> Evidence:
    jacobian = np.zeros((len(residual), SIZE))
    jacobian[:, PARAMETERS[kind]] = np.diag(np.broadcast_to(slope, residual.shape))
    return Evidence(residual, jacobian)

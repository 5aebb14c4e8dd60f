"""Fitting a known surface to measured points from many starts at once.

Point-to-plane ICP without correspondences: the signed-distance grid gives each point's distance from the
surface and the surface's direction there (Fitzgibbon, 2003). Samples of the surface must also stay out of the
space that the camera saw to be free, which is what fixes an object whose visible side is flat or round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotation_matrix,
)
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.perception.io.capture import Intrinsics

BEHIND = 0.01
"""A pixel shows something behind the object if it is deeper by this [m] than the object's nearest pixel."""

NOWHERE = 0.2
"""Pixels whose color is the background's forbid the object so far behind what is seen of it [m]."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """What the depth image and the table forbid to the object. ``free_space`` makes it."""

    intrinsics: Intrinsics
    """Intrinsics of the whole image."""
    depth: np.ndarray
    """Depth behind which a surface may be [m], shape [H, W]; 0: anywhere."""
    refuge: np.ndarray
    """Nearest pixel (row, column) that does not show something behind the object, shape [2, H, W]."""
    table: np.ndarray | None
    """Plane ``[nx ny nz d]`` with ``n . x + d`` the height above it [m], camera frame, shape [4]."""
    corner: tuple[int, int] = (0, 0)
    """Column and row of the whole image at which ``depth``, a part of it, begins."""

    @property
    def lens(self) -> np.ndarray:
        """Focal lengths, and the center in ``depth`` [pixels], shape [4]."""
        k = self.intrinsics
        return np.array([k.fx, k.fy, k.cx - self.corner[0], k.cy - self.corner[1]])

    @property
    def lowest(self) -> np.ndarray:
        """The table's plane, or one that nothing is below, shape [4]."""
        nowhere = np.array([0.0, 0.0, 0.0, np.inf])
        return nowhere if self.table is None else np.asarray(self.table, dtype=float)


@dataclass(frozen=True, eq=False)
class KnownSurface:
    """The known object, ready to be fitted; object frame."""

    distance: SignedDistanceBank
    """Signed distance grid of the mesh, the only one of the bank."""
    samples: np.ndarray
    """Points of the surface, each far from those before it [m], shape [M, 3]: any leading part is evenly
    spread too."""

    def median_distance(self, points: np.ndarray, pose: np.ndarray) -> float:
        """Median distance of points [m], camera frame, shape [P, 3], from the surface at a pose [7]."""
        local = inverse_transform_points(pose, points)
        return float(np.median(np.abs(self.distance.query(np.zeros(1, dtype=int), local[None])[0])))


@dataclass(frozen=True, eq=False)
class ObjectEvidence:
    """What the object must agree with; camera frame."""

    points: np.ndarray
    """Points measured on the object, in random order [m], shape [P, 3]."""
    free: FreeSpace
    """Space that is known to be free of the object."""
    spread: np.ndarray | None = None
    """Standard deviation of each point's depth, in that of the sensor's noise, shape [P]; None: 1."""


@dataclass(frozen=True)
class IcpSettings:
    """One round of the coarse-to-fine fit."""

    iterations: int
    """Gauss-Newton steps."""
    points: int
    """Number of measured points that are used."""
    samples: int
    """Number of surface samples that are used."""
    scale: float
    """Distance [m] at which a point's pull has fallen to a quarter."""
    free_weight: float = 1.0
    """Weight of a surface sample in free space, in that of a measured point."""
    free_scale: float = 0.02
    """Intrusion of a surface sample into free space [m] at which its pull has fallen to a quarter."""


def fit_poses(
    surface: KnownSurface, evidence: ObjectEvidence, poses: np.ndarray, settings: IcpSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Move each pose to a nearby minimum of
    ``mean rho(distance(points)) + free_weight * mean rho(intrusion(samples))`` by Gauss-Newton steps,
    ``rho(r) = r^2 / (1 + (r / scale)^2)``, means over the points or samples used.

    Args:
        surface: the object.
        evidence: the image.
        poses: starts, object in the camera frame, shape [H, 7].
        settings: of this round.

    Returns:
        poses, shape [H, 7]; the sum before the last step [m^2], shape [H].
    """
    points = evidence.points[: settings.points]
    # Points near smoothed steps in depth count less and reach farther.
    wide = np.ones(len(points)) if evidence.spread is None else evidence.spread[: settings.points]
    weight = wide**-1.0 / np.mean(wide**-1.0)
    samples = surface.samples[: settings.samples]
    cost = np.zeros(len(poses))
    # Importing Numba takes half a second: not before something is fitted.
    from fungrasp.perception.object_pose.icp_loops import fit_terms

    free, count = evidence.free, len(poses)
    lens, table = free.lens, free.lowest
    matrix, vector = np.empty((count, 6, 6)), np.empty((count, 6))
    for _ in range(settings.iterations):
        fit_terms(
            surface.distance.arrays,
            points,
            weight,
            settings.scale * np.sqrt(wide),
            samples,
            settings.free_weight,
            settings.free_scale,
            free.depth,
            free.refuge,
            lens,
            table,
            rotation_matrix(poses[:, 3:]),
            np.ascontiguousarray(poses[:, :3]),
            matrix,
            vector,
            cost,
        )
        damping = np.diag([3e-7] * 3 + [1e-3] * 3) + 1e-3 * matrix * np.eye(6)
        step = np.linalg.solve(matrix + damping, -vector[..., None])[..., 0]
        poses = _moved(poses, step)
    return poses, cost


def _moved(poses: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Poses after a turn and a shift, shape [H, 7]; a turn of at most 0.3 rad, a shift of at most 3 cm."""
    turn, shift = step[:, :3], step[:, 3:]
    turn = turn * np.minimum(1.0, 0.3 / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-9))
    shift = shift * np.minimum(1.0, 0.03 / np.maximum(np.linalg.norm(shift, axis=1, keepdims=True), 1e-9))
    quaternion = quaternion_multiply(quaternion_from_rotation_vector(turn), poses[:, 3:])
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return np.concatenate([poses[:, :3] + shift, quaternion], axis=1)


def free_space(
    depth: np.ndarray,
    intrinsics: Intrinsics,
    shown: np.ndarray,
    table: np.ndarray | None = None,
    tolerance: float = 0.006,
    *,
    uncertain: np.ndarray | None = None,
    background: np.ndarray | None = None,
    corner: tuple[int, int] = (0, 0),
) -> FreeSpace:
    """What a depth image forbids to an object.

    Args:
        depth: [m], shape [H, W]; 0: not measured.
        intrinsics: of the depth image.
        shown: which pixels show the object, bool, shape [H, W].
        table: its plane, see ``FreeSpace``.
        tolerance: how far a surface may be in front of the measurement, or below the table [m].
        uncertain: by how much more at each pixel, where the depth is smoothed [m], shape [H, W].
        background: pixels that show no object whatever their depth is, bool, shape [H, W].
        corner: column and row of the whole image at which a part of it begins; all arrays are of that part.
    """
    measured = depth > 0
    seen = shown & measured
    transformed: Any = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    level = depth[tuple(transformed)]
    open_space = measured & ~shown & (depth > level + BEHIND)
    allowed = np.where(measured, depth - tolerance - (0.0 if uncertain is None else uncertain), 0.0)
    if background is not None:
        open_space |= background & ~shown
        # Nothing is there but far behind: the way out is sideways.
        allowed = np.where(background & ~shown, np.maximum(allowed, level + NOWHERE), allowed)
    refuge: Any = ndimage.distance_transform_edt(open_space, return_distances=False, return_indices=True)
    lowered = None if table is None else np.append(table[:3], table[3] + tolerance)
    return FreeSpace(intrinsics, allowed, refuge, lowered, corner)

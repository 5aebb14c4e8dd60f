"""Search for the pose of a known object: many starts, fitted to measured points and scored, coarse to fine.

The fit is point-to-plane ICP without correspondences: the signed distance grid gives each point's distance
from the surface and its gradient (Fitzgibbon, 2003). Surface samples must also stay out of space that the
camera saw to be free, which determines the pose of objects whose visible side is flat or round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.geometry.poses import (
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    rotation_matrix,
    transform_points,
)
from fungrasp.perception.io.capture import Intrinsics
from fungrasp.perception.object_pose.object_template import (
    KnownSurface,
    ObjectTemplate,
    even_rotations,
    starting_poses,
)
from fungrasp.perception.object_pose.scoring import PoseScorer

BEHIND = 0.01  # Distance beyond the object's nearest pixel from which a pixel shows things behind it [m].
# Distance behind the object's nearest pixel up to which pixels of background color forbid the object [m].
NOWHERE = 0.2
# Intrusion of a surface sample into free space at which its pull has fallen to a quarter [m].
FREE_SCALE = 0.02


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Space that depth image and table forbid to the object, made by ``free_space``."""

    lens: np.ndarray
    """Focal lengths and center of ``depth`` [pixels], shape [4]."""
    depth: np.ndarray
    """Smallest allowed depth of a surface [m], shape [H, W]; 0: any."""
    refuge: np.ndarray
    """Nearest pixel (row, column) that does not show something behind the object, shape [2, H, W]."""
    table: np.ndarray
    """Plane ``[nx ny nz d]``: ``n . x + d`` is the height above it [m], camera frame, shape [4]; far below
    everything without a table."""


@dataclass(frozen=True, eq=False)
class ObjectEvidence:
    """Evidence for a pose; camera frame."""

    points: np.ndarray
    """Measured points of the object, in random order [m], shape [P, 3]."""
    free: FreeSpace
    """Space that the object cannot occupy."""
    spread: np.ndarray | None = None
    """Standard deviation of each point's depth, as a factor of the sensor's noise, shape [P]; 1 if None."""


@dataclass(frozen=True)
class IcpSettings:
    """Settings of one round of the fit."""

    iterations: int
    """Gauss-Newton steps."""
    points: int
    """Number of measured points."""
    samples: int
    """Number of surface samples."""
    scale: float
    """Distance at which a point's pull has fallen to a quarter [m]."""


def fit_poses(
    surface: KnownSurface, evidence: ObjectEvidence, poses: np.ndarray, settings: IcpSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Fit poses to the evidence by Gauss-Newton steps.

    The cost is ``mean rho(distance(points)) + mean rho(intrusion(samples))`` with
    ``rho(r) = r^2 / (1 + (r / scale)^2)`` over the points and samples used; the scale of intrusions is
    ``FREE_SCALE``.

    Args:
        poses: starts, object in the camera frame, shape [H, 7].

    Returns:
        poses, shape [H, 7]; cost before the last step [m^2], shape [H].
    """
    points = evidence.points[: settings.points]
    # Points near smoothed steps in depth have a smaller weight and a larger scale.
    wide = np.ones(len(points)) if evidence.spread is None else evidence.spread[: settings.points]
    weight = wide**-1.0 / np.mean(wide**-1.0)
    samples = surface.samples[: settings.samples]
    cost = np.zeros(len(poses))
    # Importing Numba takes half a second.
    from fungrasp.perception.compiled_loops import fit_terms

    free, count = evidence.free, len(poses)
    matrix, vector = np.empty((count, 6, 6)), np.empty((count, 6))
    for _ in range(settings.iterations):
        fit_terms(
            surface.distance.arrays,
            points,
            weight,
            settings.scale * np.sqrt(wide),
            samples,
            FREE_SCALE,
            free.depth,
            free.refuge,
            free.lens,
            free.table,
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
    """Rotate and shift poses, shape [H, 7], by at most 0.3 rad and 3 cm. step: shape [H, 6]."""
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
    """Return the space that a depth image forbids to an object.

    Args:
        depth: [m], shape [H, W]; 0: not measured.
        shown: pixels that show the object, bool, shape [H, W].
        table: plane, see ``FreeSpace``, or None.
        tolerance: allowed distance of a surface in front of the measurement, or below the table [m].
        uncertain: additional tolerance of each pixel, where the depth is smoothed [m], shape [H, W].
        background: pixels that show no object whatever their depth is, bool, shape [H, W].
        corner: column and row in the whole image at which the arrays, parts of it, begin.
    """
    measured = depth > 0
    seen = shown & measured
    transformed: Any = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    level = depth[tuple(transformed)]
    open_space = measured & ~shown & (depth > level + BEHIND)
    allowed = np.where(measured, depth - tolerance - (0.0 if uncertain is None else uncertain), 0.0)
    if background is not None:
        open_space |= background & ~shown
        # Only depths far behind are allowed there, so the way out is sideways.
        allowed = np.where(background & ~shown, np.maximum(allowed, level + NOWHERE), allowed)
    refuge: Any = ndimage.distance_transform_edt(open_space, return_distances=False, return_indices=True)
    lowered = np.array([0.0, 0.0, 0.0, np.inf] if table is None else [*table[:3], table[3] + tolerance])
    k = intrinsics
    lens = np.array([k.fx, k.fy, k.cx - corner[0], k.cy - corner[1]])
    return FreeSpace(lens, allowed, refuge, lowered)


ROTATIONS = 128  # Starting rotations for the first mask; half as many for the others.
# Rounds from coarse to fine; the scale of the first three grows with the object, from ``TYPICAL_SIZE``.
COARSE = (IcpSettings(4, 40, 40, 0.045), IcpSettings(6, 60, 60, 0.045), IcpSettings(7, 120, 120, 0.012))
FINE = (IcpSettings(8, 300, 300, 0.006), IcpSettings(8, 1000, 800, 0.004))
# Number of poses kept: first for the first mask (others: half as many), in the last two for all together.
KEPT = (256, 80, 20, 6)
TYPICAL_SIZE = 0.25  # Diagonal of the object's box for which the settings are made [m].
# Standard deviations of random moves of a polished pose: shift [m] and rotation [degrees].
POLISH_STEPS = ((0.006, 12.0), (0.005, 8.0), (0.003, 6.0), (0.002, 4.0), (0.0012, 2.5))
POLISH_TRIES = 40  # Random moves of each pose in each round.


@dataclass(frozen=True, eq=False)
class PoseHypotheses:
    """H candidate poses."""

    poses: np.ndarray
    """Object in the camera frame, not sorted, shape [H, 7]."""
    owner: np.ndarray
    """Index of the evidence that each pose is fitted to, shape [H] int."""

    def joined(self, other: PoseHypotheses) -> PoseHypotheses:
        """Return these and other poses."""
        return PoseHypotheses(
            np.concatenate([self.poses, other.poses]), np.concatenate([self.owner, other.owner])
        )


def search_poses(
    known: ObjectTemplate,
    evidence: Sequence[ObjectEvidence],
    scorers: tuple[PoseScorer, PoseScorer],
    rng: np.random.Generator,
) -> PoseHypotheses:
    """Return poses that explain the image. scorers: one with few rays, one with many."""
    growth = float(np.clip(known.size / TYPICAL_SIZE, 0.5, 1.4))
    coarse = [replace(r, scale=growth * r.scale) for r in COARSE]
    pool, owners = [], []
    for index, seen in enumerate(evidence):
        share = 1 if index == 0 else 2
        quaternions = even_rotations(ROTATIONS // share, rng)
        poses = starting_poses(known, seen.points[:500], quaternions)
        for step, count in zip(coarse[:2], KEPT[:2], strict=True):
            poses, cost = fit_poses(known.surface, seen, poses, step)
            poses = poses[np.argsort(cost)[: count // share]]
        poses = fit_poses(known.surface, seen, poses, coarse[2])[0]
        poses = poses[_distinct(poses, known, 0.006)]
        pool.append(poses)
        owners.append(np.full(len(poses), index))
    found = PoseHypotheses(np.concatenate(pool), np.concatenate(owners))
    for step, scorer, count in zip(FINE, scorers, KEPT[2:], strict=True):
        found = refine_poses(known, evidence, best_poses(found, known, scorer, count), step)
    return found


def refine_poses(
    known: ObjectTemplate, evidence: Sequence[ObjectEvidence], found: PoseHypotheses, step: IcpSettings
) -> PoseHypotheses:
    """Fit each pose once more to its own evidence."""
    poses = found.poses.copy()
    for index in np.unique(found.owner):
        mine = found.owner == index
        poses[mine] = fit_poses(known.surface, evidence[index], poses[mine], step)[0]
    return PoseHypotheses(poses, found.owner)


def polish_poses(
    found: PoseHypotheses, known: ObjectTemplate, scorer: PoseScorer, rng: np.random.Generator
) -> PoseHypotheses:
    """Move each pose at random to higher quality, in decreasing steps.

    Where depth is smoothed, the outline in the image says more than the fit to points can use.
    """
    poses, owner = found.poses.copy(), found.owner
    quality = scorer(poses, owner).quality
    for shift, turn in POLISH_STEPS:
        moves = rng.normal(size=(len(poses), POLISH_TRIES, 6))
        steps = quaternion_from_rotation_vector(np.radians(turn) * moves[..., 3:])
        turned = quaternion_multiply(steps, poses[:, None, 3:])
        middles = transform_points(poses, np.broadcast_to(known.middle, (len(poses), 1, 3)))
        # The rotation is about the object's center, wherever its frame is.
        arm = poses[:, None, :3] - middles
        moved = middles + rotate(steps, np.broadcast_to(arm, (*steps.shape[:2], 3))) + shift * moves[..., :3]
        tried = np.concatenate([moved, turned], axis=-1)
        scores = scorer(tried.reshape(-1, 7), np.repeat(owner, POLISH_TRIES)).quality
        scores = scores.reshape(len(poses), POLISH_TRIES)
        best = scores.argmax(axis=1)
        row = np.arange(len(poses))
        better = scores[row, best] > quality
        poses[better], quality[better] = tried[row, best][better], scores[row, best][better]
    return PoseHypotheses(poses, owner)


def best_poses(
    found: PoseHypotheses, known: ObjectTemplate, scorer: PoseScorer, count: int
) -> PoseHypotheses:
    """Return at most ``count`` different poses of highest quality."""
    order = np.argsort(-scorer(found.poses, found.owner).quality)
    best = order[_distinct(found.poses[order], known, 0.004)[:count]]
    return PoseHypotheses(found.poses[best], found.owner[best])


def _distinct(poses: np.ndarray, known: ObjectTemplate, apart: float) -> list[int]:
    """Return indices of poses whose surfaces differ from all chosen before by more than ``apart`` [m]."""
    corners = transform_points(poses, known.surface.samples[:20])
    chosen: list[int] = []
    for i in range(len(poses)):
        if np.linalg.norm(corners[chosen] - corners[i], axis=-1).mean(axis=-1).min(initial=np.inf) > apart:
            chosen.append(i)
    return chosen


def with_symmetries(found: PoseHypotheses, known: ObjectTemplate) -> PoseHypotheses:
    """Return the poses and their near-symmetric variants."""
    turned = quaternion_multiply(found.poses[:, None, 3:], known.symmetries[:, 3:])
    moved = transform_points(found.poses, known.symmetries[:, :3])
    variants = np.concatenate([moved, turned], axis=-1).reshape(-1, 7)
    return found.joined(PoseHypotheses(variants, np.repeat(found.owner, len(known.symmetries))))

"""Searching the pose of a known object: many starts, fitted to measured points and scored, coarse to fine.

The fit is point-to-plane ICP without correspondences: the signed-distance grid gives each point's distance
from the surface and the surface's direction there (Fitzgibbon, 2003). Samples of the surface must also stay
out of the space that the camera saw to be free, which is what fixes an object whose visible side is flat or
round.
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

# A pixel shows something behind the object if it is deeper by this [m] than the object's nearest pixel.
BEHIND = 0.01
# Pixels whose color is the background's forbid the object so far behind what is seen of it [m].
NOWHERE = 0.2
# Intrusion of a surface sample into free space [m] at which its pull has fallen to a quarter.
FREE_SCALE = 0.02


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """What the depth image and the table forbid to the object. ``free_space`` makes it."""

    lens: np.ndarray
    """Focal lengths, and the center in ``depth`` [pixels], shape [4]."""
    depth: np.ndarray
    """Depth behind which a surface may be [m], shape [H, W]; 0: anywhere."""
    refuge: np.ndarray
    """Nearest pixel (row, column) that does not show something behind the object, shape [2, H, W]."""
    table: np.ndarray
    """Plane ``[nx ny nz d]`` with ``n . x + d`` the height above it [m], camera frame, shape [4]; without a
    table one that nothing is below."""


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


def fit_poses(
    surface: KnownSurface, evidence: ObjectEvidence, poses: np.ndarray, settings: IcpSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Move each pose to a nearby minimum of
    ``mean rho(distance(points)) + mean rho(intrusion(samples))`` by Gauss-Newton steps,
    ``rho(r) = r^2 / (1 + (r / scale)^2)``, means over the points or samples used; the scale of intrusions is
    ``FREE_SCALE``.

    Args:
        poses: starts, object in the camera frame, shape [H, 7].

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
        shown: which pixels show the object, bool, shape [H, W].
        table: its plane, see ``FreeSpace``, or None.
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
    lowered = np.array([0.0, 0.0, 0.0, np.inf] if table is None else [*table[:3], table[3] + tolerance])
    k = intrinsics
    lens = np.array([k.fx, k.fy, k.cx - corner[0], k.cy - corner[1]])
    return FreeSpace(lens, allowed, refuge, lowered)


ROTATIONS = 128  # Starting rotations for the first mask; the others have half as many.
# Rounds from coarse to fine; the first three are for an object of ``TYPICAL_SIZE`` and grow with it.
COARSE = (IcpSettings(4, 40, 40, 0.045), IcpSettings(6, 60, 60, 0.045), IcpSettings(7, 120, 120, 0.012))
FINE = (IcpSettings(8, 300, 300, 0.006), IcpSettings(8, 1000, 800, 0.004))
# Poses that go on from each round but the last; of the first mask in the first two, the others have half as
# many, and of all masks together in the other two.
KEPT = (256, 80, 20, 6)
TYPICAL_SIZE = 0.25  # Diagonal of the box round the object for which the settings are made [m].
# Standard deviations of the random moves of a polished pose: shift [m] and turn [degrees].
POLISH_STEPS = ((0.006, 12.0), (0.005, 8.0), (0.003, 6.0), (0.002, 4.0), (0.0012, 2.5))
POLISH_TRIES = 40  # Random moves of each pose in each round.


@dataclass(frozen=True, eq=False)
class PoseHypotheses:
    """Poses that are still considered."""

    poses: np.ndarray
    """Object in the camera frame, not sorted, shape [H, 7]."""
    owner: np.ndarray
    """Row of the evidence that each pose was fitted to, shape [H] int."""

    def joined(self, other: PoseHypotheses) -> PoseHypotheses:
        """These and others."""
        return PoseHypotheses(
            np.concatenate([self.poses, other.poses]), np.concatenate([self.owner, other.owner])
        )


def search_poses(
    known: ObjectTemplate,
    evidence: Sequence[ObjectEvidence],
    scorers: tuple[PoseScorer, PoseScorer],
    rng: np.random.Generator,
) -> PoseHypotheses:
    """Poses that explain the image. scorers: one with few rays, one with many."""
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
    """Each pose fitted once more to its own evidence."""
    poses = found.poses.copy()
    for index in np.unique(found.owner):
        mine = found.owner == index
        poses[mine] = fit_poses(known.surface, evidence[index], poses[mine], step)[0]
    return PoseHypotheses(poses, found.owner)


def polish_poses(
    found: PoseHypotheses, known: ObjectTemplate, scorer: PoseScorer, rng: np.random.Generator
) -> PoseHypotheses:
    """Each pose moved at random to where its quality is highest, in ever smaller steps.

    Where depth is smoothed, the outline in the image says more than the fit to points can use.
    """
    poses, owner = found.poses.copy(), found.owner
    quality = scorer(poses, owner).quality
    for shift, turn in POLISH_STEPS:
        moves = rng.normal(size=(len(poses), POLISH_TRIES, 6))
        steps = quaternion_from_rotation_vector(np.radians(turn) * moves[..., 3:])
        turned = quaternion_multiply(steps, poses[:, None, 3:])
        middles = transform_points(poses, np.broadcast_to(known.middle, (len(poses), 1, 3)))
        # Turned about the object's middle, wherever its frame is.
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
    """The poses of highest quality, at most ``count``, no two of them nearly the same."""
    order = np.argsort(-scorer(found.poses, found.owner).quality)
    best = order[_distinct(found.poses[order], known, 0.004)[:count]]
    return PoseHypotheses(found.poses[best], found.owner[best])


def _distinct(poses: np.ndarray, known: ObjectTemplate, apart: float) -> list[int]:
    """Poses that differ from all chosen before them by more than ``apart`` [m] at the surface."""
    corners = transform_points(poses, known.surface.samples[:20])
    chosen: list[int] = []
    for i in range(len(poses)):
        if np.linalg.norm(corners[chosen] - corners[i], axis=-1).mean(axis=-1).min(initial=np.inf) > apart:
            chosen.append(i)
    return chosen


def with_symmetries(found: PoseHypotheses, known: ObjectTemplate) -> PoseHypotheses:
    """The poses, and those that the object's near-symmetries make of them."""
    turned = quaternion_multiply(found.poses[:, None, 3:], known.symmetries[:, 3:])
    moved = transform_points(found.poses, known.symmetries[:, :3])
    variants = np.concatenate([moved, turned], axis=-1).reshape(-1, 7)
    return found.joined(PoseHypotheses(variants, np.repeat(found.owner, len(known.symmetries))))

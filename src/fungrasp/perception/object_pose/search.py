"""Searching the pose of a known object: many starts, fitted and scored coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.poses import (
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.perception.object_pose.icp import IcpSettings, ObjectEvidence, fit_poses
from fungrasp.perception.object_pose.known_object import KnownObject, even_rotations, starting_poses
from fungrasp.perception.object_pose.scoring import PoseScorer


@dataclass(frozen=True)
class PoseSearchSettings:
    """How much is tried."""

    rotations: int = 128
    """Starting rotations for the first mask; the others have half as many."""
    rounds: tuple[IcpSettings, IcpSettings, IcpSettings, IcpSettings, IcpSettings] = (
        IcpSettings(4, 40, 40, 0.045),
        IcpSettings(6, 60, 60, 0.045),
        IcpSettings(7, 120, 120, 0.012),
        IcpSettings(8, 300, 300, 0.006),
        IcpSettings(8, 1000, 800, 0.004),
    )
    """Settings of the rounds from coarse to fine; the first three are for an object of ``TYPICAL_SIZE`` and
    grow with it."""
    kept: tuple[int, int, int, int] = (256, 80, 20, 6)
    """Poses that go on from each round but the last; of the first mask in the first two, the others have half
    as many, and of all masks together in the other two."""


TYPICAL_SIZE = 0.25
"""Diagonal of the box round the object for which the settings are made [m]."""

POLISH_STEPS = ((0.006, 12.0), (0.005, 8.0), (0.003, 6.0), (0.002, 4.0), (0.0012, 2.5))
"""Standard deviations of the random moves of a polished pose: shift [m] and turn [degrees]."""

POLISH_TRIES = 40
"""Random moves of each pose in each round."""


@dataclass(frozen=True, eq=False)
class PoseHypotheses:
    """Poses that are still considered."""

    poses: np.ndarray
    """Object in the camera frame, not sorted, shape [H, 7]."""
    owner: np.ndarray
    """Row of the evidence that each pose was fitted to, shape [H] int."""


def search_poses(
    known: KnownObject,
    evidence: Sequence[ObjectEvidence],
    scorers: tuple[PoseScorer, PoseScorer],
    rng: np.random.Generator,
    settings: PoseSearchSettings,
) -> PoseHypotheses:
    """Poses that explain the image.

    Args:
        known: the object.
        evidence: of each mask.
        scorers: one with few rays, one with many.
        rng: turns the grid of rotations.
        settings: how much to try.
    """
    growth = float(np.clip(known.size / TYPICAL_SIZE, 0.5, 1.4))
    coarse = [replace(r, scale=growth * r.scale) for r in settings.rounds[:3]]
    pool, owners = [], []
    for index, seen in enumerate(evidence):
        share = 1 if index == 0 else 2
        quaternions = even_rotations(settings.rotations // share, rng)
        poses = starting_poses(known, seen.points[:500], quaternions)
        for step, count in zip(coarse[:2], settings.kept[:2], strict=True):
            poses, cost = fit_poses(known.surface, seen, poses, step)
            poses = poses[np.argsort(cost)[: count // share]]
        poses = fit_poses(known.surface, seen, poses, coarse[2])[0]
        poses = poses[_distinct(poses, known, 0.006)]
        pool.append(poses)
        owners.append(np.full(len(poses), index))
    found = PoseHypotheses(np.concatenate(pool), np.concatenate(owners))
    for step, scorer, count in zip(settings.rounds[3:], scorers, settings.kept[2:], strict=True):
        found = refine_poses(known, evidence, best_poses(found, known, scorer, count), step)
    return found


def refine_poses(
    known: KnownObject, evidence: Sequence[ObjectEvidence], found: PoseHypotheses, step: IcpSettings
) -> PoseHypotheses:
    """Each pose fitted once more to its own evidence."""
    poses = found.poses.copy()
    for index in np.unique(found.owner):
        mine = found.owner == index
        poses[mine] = fit_poses(known.surface, evidence[index], poses[mine], step)[0]
    return PoseHypotheses(poses, found.owner)


def polish_poses(
    found: PoseHypotheses, known: KnownObject, scorer: PoseScorer, rng: np.random.Generator
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


def best_poses(found: PoseHypotheses, known: KnownObject, scorer: PoseScorer, count: int) -> PoseHypotheses:
    """The poses of highest quality, at most ``count``, no two of them nearly the same."""
    order = np.argsort(-scorer(found.poses, found.owner).quality)
    best = order[_distinct(found.poses[order], known, 0.004)[:count]]
    return PoseHypotheses(found.poses[best], found.owner[best])


def _distinct(poses: np.ndarray, known: KnownObject, apart: float) -> list[int]:
    """Poses that differ from all chosen before them by more than ``apart`` [m] at the surface."""
    corners = transform_points(poses, known.surface.samples[:20])
    chosen: list[int] = []
    for i in range(len(poses)):
        if np.linalg.norm(corners[chosen] - corners[i], axis=-1).mean(axis=-1).min(initial=np.inf) > apart:
            chosen.append(i)
    return chosen


def with_symmetries(found: PoseHypotheses, known: KnownObject) -> PoseHypotheses:
    """The poses, and those that the object's near-symmetries make of them."""
    turned = quaternion_multiply(found.poses[:, None, 3:], known.symmetries[:, 3:])
    moved = transform_points(found.poses, known.symmetries[:, :3])
    variants = np.concatenate([moved, turned], axis=-1).reshape(-1, 7)
    owner = np.repeat(found.owner, len(known.symmetries))
    return PoseHypotheses(np.concatenate([found.poses, variants]), np.concatenate([found.owner, owner]))

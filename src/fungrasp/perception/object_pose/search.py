"""Searching the pose of a known object: many starts, fitted and judged coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.geometry.poses import quaternion_multiply, transform_points
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.object_pose.free_space import free_space
from fungrasp.perception.object_pose.icp import Evidence, Round, fit
from fungrasp.perception.object_pose.known_object import KnownObject, even_rotations, starting_poses
from fungrasp.perception.object_pose.scoring import Judge, noise_at


@dataclass(frozen=True)
class SearchSettings:
    """How much is tried."""

    rotations: int = 128
    """Starts for the first mask; the others have half as many."""
    rounds: tuple[Round, Round, Round, Round, Round] = (
        Round(4, 40, 40, 0.045),
        Round(6, 60, 60, 0.045),
        Round(7, 120, 120, 0.012),
        Round(8, 300, 300, 0.006),
        Round(8, 1000, 800, 0.004),
    )
    """From coarse to fine; the first three are for an object of ``TYPICAL_SIZE`` and grow with it."""
    kept: tuple[int, int, int, int] = (256, 80, 20, 6)
    """Poses that go on from each round but the last; of the first mask in the first two, the others have half
    as many, and of all masks together in the other two."""


TYPICAL_SIZE = 0.25
"""Diagonal of the box round the object for which the settings are made [m]."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found."""

    poses: np.ndarray
    """Object in the camera frame, not sorted, shape [H, 7]."""
    owner: np.ndarray
    """Which evidence each was fitted to, shape [H] int."""


def gather(
    capture: Capture, mask: np.ndarray, table: np.ndarray | None, rng: np.random.Generator
) -> Evidence:
    """What a mask says about the object.

    Args:
        capture: the image.
        mask: pixels that show the object, shape [H, W] bool.
        table: plane ``[nx ny nz d]``, camera frame, or None.
        rng: shuffles the points.
    """
    shown = mask & capture.measured
    rows, columns = np.nonzero(shown)
    some = rng.permutation(len(rows))[:3000]
    pixels = np.stack([columns[some], rows[some]], axis=-1)
    points = capture.intrinsics.deproject(pixels, capture.depth[rows[some], columns[some]])
    return Evidence(points, free_space(capture.depth, capture.intrinsics, mask, table))


def search(
    known: KnownObject,
    evidence: Sequence[Evidence],
    judges: tuple[Judge, Judge],
    rng: np.random.Generator,
    settings: SearchSettings,
) -> Found:
    """Poses that explain the image.

    Args:
        known: the object.
        evidence: of each mask.
        judges: one with few rays, one with many.
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
            poses, cost = fit(known.surface, seen, poses, step)
            poses = poses[np.argsort(cost)[: count // share]]
        poses = fit(known.surface, seen, poses, coarse[2])[0]
        poses = poses[_distinct(poses, known, 0.006)]
        pool.append(poses)
        owners.append(np.full(len(poses), index))
    found = Found(np.concatenate(pool), np.concatenate(owners))
    for step, judge, count in zip(settings.rounds[3:], judges, settings.kept[2:], strict=True):
        found = refine(known, evidence, best_of(found, known, judge, count), step)
    return found


def refine(known: KnownObject, evidence: Sequence[Evidence], found: Found, step: Round) -> Found:
    """Each pose fitted once more to its own evidence."""
    poses = found.poses.copy()
    for index in np.unique(found.owner):
        mine = found.owner == index
        poses[mine] = fit(known.surface, evidence[index], poses[mine], step)[0]
    return Found(poses, found.owner)


def best_of(found: Found, known: KnownObject, judge: Judge, count: int) -> Found:
    """The poses of highest quality, at most ``count``, no two of them nearly the same."""
    order = np.argsort(-judge(found.poses, found.owner).quality)
    best = order[_distinct(found.poses[order], known, 0.004)[:count]]
    return Found(found.poses[best], found.owner[best])


def _distinct(poses: np.ndarray, known: KnownObject, apart: float) -> list[int]:
    """Poses that differ from all chosen before them by more than ``apart`` [m] at the surface."""
    corners = transform_points(poses, known.surface.samples[:20])
    chosen: list[int] = []
    for i in range(len(poses)):
        if np.linalg.norm(corners[chosen] - corners[i], axis=-1).mean(axis=-1).min(initial=np.inf) > apart:
            chosen.append(i)
    return chosen


def symmetric(found: Found, known: KnownObject) -> Found:
    """The poses, and those that the object's near-symmetries make of them."""
    turned = quaternion_multiply(found.poses[:, None, 3:], known.symmetries[:, 3:])
    moved = transform_points(found.poses, known.symmetries[:, :3])
    variants = np.concatenate([moved, turned], axis=-1).reshape(-1, 7)
    owner = np.repeat(found.owner, len(known.symmetries))
    return Found(np.concatenate([found.poses, variants]), np.concatenate([found.owner, owner]))


def explained_mask(known: KnownObject, capture: Capture, pose: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Pixels whose depth is that of the mesh, shape [H, W] bool.

    Args:
        known: the object.
        capture: the image.
        pose: object in the camera frame, shape [7].
        allowed: pixels that may belong to the object, shape [H, W] bool.
    """
    k = capture.intrinsics
    result = np.zeros(allowed.shape, dtype=bool)
    corners = transform_points(pose, known.surface.samples)
    pixels = k.project(corners[corners[:, 2] > 0.05])
    if not len(pixels):
        return result
    low = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, [k.width - 1, k.height - 1]).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 2, 1, [k.width, k.height]).astype(int)
    if np.any(high <= low):
        return result
    step = max(1, int(np.sqrt(float(np.prod(high - low)) / 15000)))
    u, v = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    flat = np.stack([u.ravel(), v.ravel()], axis=-1)
    seen = known.rays.cast(pose[None], k.deproject(flat, np.ones(len(flat))))[0].reshape(u.shape)
    depth = capture.depth[v, u]
    agrees = (np.abs(seen - depth) < 3 * noise_at(depth)) & (depth > 0)
    grown = agrees.repeat(step, axis=0).repeat(step, axis=1)
    part = result[low[1] :, low[0] :]
    rows, columns = min(len(grown), part.shape[0]), min(len(grown[0]), part.shape[1])
    part[:rows, :columns] = grown[:rows, :columns]
    return result & allowed

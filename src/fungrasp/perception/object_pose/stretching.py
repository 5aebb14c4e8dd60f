"""Whether another size of the mesh fits the image as well: then it need not be the mesh of what is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.perception.object_pose.scoring import PoseScorer

WHOLE, SIDES = (0.67, 0.82, 1.22, 1.5), (0.75, 1.33)
"""Sizes that are tried of the whole mesh, and of each side alone."""

SETTLED = ((8, 0.004, 4.0), (5, 0.002, 2.0), (5, 0.001, 1.0))
"""Poses that are tried of each size, one after the other; standard deviations of their shift [m] and turn
[degrees]."""


@dataclass(frozen=True)
class OtherSizes:
    """How well other sizes of the mesh explain the image: logarithms of their quality over the mesh's own,
    below 0 where they are worse. Near 0 the image does not say which size it is."""

    whole: float
    """Of the best other size of all of it."""
    side: float
    """Of the best other length of any side."""


def other_sizes(
    scorer: PoseScorer, pose: np.ndarray, owner: int, anchor: np.ndarray, rng: np.random.Generator
) -> OtherSizes:
    """Try other sizes. Each is moved in the same ways about the same pose, so that none gains by chance. The
    whole mesh grows about what is seen of it, a side also about either of its ends: a mesh that is too short
    mostly lies at one end of the thing.

    Args:
        scorer: scores poses.
        pose: object in the camera frame, shape [7].
        owner: the mask that it was fitted to.
        anchor: middle of what is seen of the object [m], camera frame, shape [3].
        rng: of the moves.
    """
    samples = scorer.known.surface.samples
    low, high = samples.min(axis=0), samples.max(axis=0)
    seen = np.clip(inverse_transform_points(pose, anchor[None])[0], low, high)
    sizes = [(np.ones(3), seen), *((np.full(3, size), seen) for size in WHOLE)]
    for axis in range(3):
        mine = np.arange(3) == axis
        for still in (low, seen, high):
            for size in SIDES:
                sizes.append((np.where(mine, size, 1.0), np.where(mine, still, seen)))
    stretch, still = (np.array(part) for part in zip(*sizes, strict=True))
    places, turns = transform_points(pose, still), np.repeat(pose[None, 3:], len(stretch), axis=0)
    quality, rows = np.zeros(len(stretch)), np.arange(len(stretch))
    for count, shift, turn in SETTLED:
        moves = rng.normal(size=(count, 6))
        moves[0] = 0.0
        near = places[:, None] + shift * moves[:, :3]
        steps = quaternion_from_rotation_vector(np.radians(turn) * moves[:, 3:])
        turned = quaternion_multiply(steps, turns[:, None])
        turned = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
        factors, middle = np.repeat(stretch, count, axis=0), np.repeat(still, count, axis=0)
        around = turned.reshape(-1, 4)
        poses = np.concatenate([near.reshape(-1, 3) - rotate(around, factors * middle), around], axis=1)
        tried = scorer(poses, np.full(len(poses), owner), factors).quality.reshape(near.shape[:2])
        best = tried.argmax(axis=1)
        places, turns, quality = near[rows, best], turned[rows, best], tried[rows, best]
    worth = np.log(np.maximum(quality, 1e-4) / max(quality[0], 1e-4))
    first = 1 + len(WHOLE)
    return OtherSizes(float(worth[1:first].max()), float(worth[first:].max()))

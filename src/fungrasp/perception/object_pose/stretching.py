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

KEPT, TRIES = 3, 12
"""So many of the best sizes go on with free factors, and so many moves of each are tried in each round."""

ROUNDS = ((0.12, 0.003, 4.0), (0.06, 0.002, 2.5), (0.03, 0.001, 1.5))
"""Standard deviations of these moves: logarithm of the factors, shift [m], turn [degrees]."""

WIDEST = 0.7
"""Logarithm of the largest factor: beyond half and twice the size nothing more is learned."""


@dataclass(frozen=True)
class OtherSizes:
    """How well other sizes of the mesh explain the image: logarithms of their quality over the mesh's own,
    below 0 where they are worse. Near 0 the image does not say which size it is."""

    whole: float
    """Of the best other size of all of it."""
    longest: float
    """Of the best other length of its longest side."""
    side: float
    """Of the best other length of any side."""
    stretch: float
    """By how much the best stretched mesh of all is stretched: largest logarithm of a factor, whatever its
    sign; 0 where none is better."""


def other_sizes(
    scorer: PoseScorer, pose: np.ndarray, owner: int, anchor: np.ndarray, rng: np.random.Generator
) -> OtherSizes:
    """Try other sizes. Each is moved in the same ways about the same pose, so that none gains by chance.

    Args:
        scorer: scores poses.
        pose: object in the camera frame, shape [7].
        owner: the mask that it was fitted to.
        anchor: middle of what is seen of the object [m], camera frame, shape [3]: it stays in its place.
        rng: of the moves.
    """
    samples = scorer.known.surface.samples
    low, high = samples.min(axis=0), samples.max(axis=0)
    local = np.clip(inverse_transform_points(pose, anchor[None])[0], low, high)
    axes = np.argsort(low - high)
    one_side = [np.where(np.arange(3) == axis, size, 1.0) for axis in axes for size in SIDES]
    stretch = np.log([np.ones(3), *(np.full(3, size) for size in WHOLE), *one_side])
    places = np.repeat(transform_points(pose, local[None]), len(stretch), axis=0)
    turns = np.repeat(pose[None, 3:], len(stretch), axis=0)
    quality = np.zeros(len(stretch))
    for count, shift, turn in SETTLED:
        moves = rng.normal(size=(count, 6))
        moves[0] = 0.0
        near = places[:, None] + shift * moves[:, :3]
        turned = _turned(turns[:, None], turn, moves[:, 3:])
        tried = _quality(scorer, near, turned, np.repeat(stretch[:, None], count, axis=1), local, owner)
        best, rows = tried.argmax(axis=1), np.arange(len(stretch))
        places, turns, quality = near[rows, best], turned[rows, best], tried[rows, best]
    worth = np.log(np.maximum(quality, 1e-4) / max(quality[0], 1e-4))
    for sigma, shift, turn in ROUNDS:
        rows = np.argsort(-quality)[:KEPT]
        moves = rng.normal(size=(KEPT, TRIES, 9))
        near = places[rows, None] + shift * moves[..., :3]
        turned = _turned(turns[rows, None], turn, moves[..., 3:6])
        wider = np.clip(stretch[rows, None] + sigma * moves[..., 6:], -WIDEST, WIDEST)
        tried = _quality(scorer, near, turned, wider, local, owner)
        places, turns = (
            np.concatenate([places, near.reshape(-1, 3)]),
            np.concatenate([turns, turned.reshape(-1, 4)]),
        )
        stretch, quality = (
            np.concatenate([stretch, wider.reshape(-1, 3)]),
            np.concatenate([quality, tried.ravel()]),
        )
    first = 1 + len(WHOLE)
    return OtherSizes(
        float(worth[1:first].max()),
        float(worth[first : first + len(SIDES)].max()),
        float(worth[first:].max()),
        float(np.abs(stretch[quality.argmax()]).max()),
    )


def _turned(quaternions: np.ndarray, degrees: float, moves: np.ndarray) -> np.ndarray:
    turned = quaternion_multiply(quaternion_from_rotation_vector(np.radians(degrees) * moves), quaternions)
    return turned / np.linalg.norm(turned, axis=-1, keepdims=True)


def _quality(
    scorer: PoseScorer,
    places: np.ndarray,
    turns: np.ndarray,
    stretch: np.ndarray,
    local: np.ndarray,
    owner: int,
) -> np.ndarray:
    """Quality of stretched meshes whose point ``local`` is at the places, shape [S, T]."""
    factors, turns = np.exp(stretch).reshape(-1, 3), turns.reshape(-1, 4)
    poses = np.concatenate([places.reshape(-1, 3) - rotate(turns, factors * local), turns], axis=1)
    return scorer(poses, np.full(len(poses), owner), factors).quality.reshape(places.shape[:2])

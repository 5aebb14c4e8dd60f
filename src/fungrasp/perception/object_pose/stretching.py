"""Whether another size of the mesh would fit the image better: then it is not the mesh of what is seen."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import (
    inverse_transform_points,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.perception.object_pose.scoring import PoseScorer

STARTS = 48
"""Sizes that are tried first, and poses at the given size."""

KEPT, TRIES = 3, 16
"""So many of the best go on, and so many moves of each are tried in each round."""

ROUNDS = ((0.12, 0.003, 4.0), (0.06, 0.002, 2.5), (0.03, 0.001, 1.5))
"""Standard deviations of the moves in each round: logarithm of the size, shift [m], turn [degrees]."""

WIDEST = 0.7
"""Logarithm of the largest factor: beyond half and twice the size nothing more is learned."""


def stretch_gain(
    scorer: PoseScorer, pose: np.ndarray, owner: int, anchor: np.ndarray, rng: np.random.Generator
) -> tuple[float, np.ndarray]:
    """How much better a stretched mesh explains the image than the mesh itself.

    Both are moved at random from the same pose, by as many tries: the gain is not that of a better pose.

    Args:
        scorer: scores poses.
        pose: object in the camera frame, shape [7].
        owner: the mask that it was fitted to.
        anchor: middle of what is seen of the object [m], camera frame, shape [3]: it stays in its place.
        rng: of the moves.

    Returns:
        logarithm of the ratio of the two qualities; factors along the mesh's axes of the better one, shape
        [3].
    """
    plain, _ = _best(scorer, pose, owner, anchor, 0.0, rng)
    stretched, factors = _best(scorer, pose, owner, anchor, 1.0, rng)
    return float(np.log(max(stretched, 1e-6) / max(plain, 1e-6))), factors


def _best(
    scorer: PoseScorer,
    pose: np.ndarray,
    owner: int,
    anchor: np.ndarray,
    wide: float,
    rng: np.random.Generator,
) -> tuple[float, np.ndarray]:
    """The best quality that is found and its factors; ``wide``: 1 to stretch, 0 to move only."""
    first = rng.uniform(-WIDEST, WIDEST, (STARTS, 1))
    # One third each: all over, along one axis, across one axis.
    axis, kind = rng.integers(3, size=(STARTS, 1)), rng.integers(3, size=(STARTS, 1))
    along = np.arange(3) == axis
    stretch = wide * first * np.where(kind == 0, True, np.where(kind == 1, along, ~along))
    stretch[0] = 0.0
    samples = scorer.known.surface.samples
    local = inverse_transform_points(pose, anchor[None])[0]
    local = np.clip(local, samples.min(axis=0), samples.max(axis=0))
    places = np.repeat(transform_points(pose, local[None]), STARTS, axis=0)
    turns = np.repeat(pose[None, 3:], STARTS, axis=0)
    moves = rng.normal(size=(STARTS, 6)) * np.where(np.arange(STARTS) == 0, 0.0, 1.0)[:, None]
    places, turns = places + 0.002 * moves[:, :3], _turned(turns, 3.0, moves[:, 3:])
    quality = _quality(scorer, places, turns, stretch, local, owner)
    for sigma, shift, turn in ROUNDS:
        rows = np.argsort(-quality)[:KEPT]
        places, turns, stretch, quality = places[rows], turns[rows], stretch[rows], quality[rows]
        moves = rng.normal(size=(KEPT * TRIES, 9))
        near = np.repeat(places, TRIES, axis=0) + shift * moves[:, :3]
        turned = _turned(np.repeat(turns, TRIES, axis=0), turn, moves[:, 3:6])
        wider = np.repeat(stretch, TRIES, axis=0) + sigma * wide * moves[:, 6:]
        wider = np.clip(wider, -WIDEST, WIDEST)
        scored = _quality(scorer, near, turned, wider, local, owner)
        places, turns = np.concatenate([places, near]), np.concatenate([turns, turned])
        stretch, quality = np.concatenate([stretch, wider]), np.concatenate([quality, scored])
    row = int(quality.argmax())
    return float(quality[row]), np.exp(stretch[row])


def _turned(quaternions: np.ndarray, degrees: float, moves: np.ndarray) -> np.ndarray:
    turned = quaternion_multiply(quaternion_from_rotation_vector(np.radians(degrees) * moves), quaternions)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _quality(
    scorer: PoseScorer,
    places: np.ndarray,
    turns: np.ndarray,
    stretch: np.ndarray,
    local: np.ndarray,
    owner: int,
) -> np.ndarray:
    """Quality of stretched meshes whose point ``local`` is at the places, shape [H]."""
    factors = np.exp(stretch)
    poses = np.concatenate([places - rotate(turns, factors * local), turns], axis=1)
    return scorer(poses, np.full(len(poses), owner), factors).quality

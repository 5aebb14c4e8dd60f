"""Where the optimiser of human grasps starts: the hand comes as wished and closes until it touches."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply
from fungrasp.grasps import HUMAN_LINKS
from fungrasp.optimization.hand_problem import State, Surroundings
from fungrasp.synthesis.human_hand_terms import HumanPoints
from fungrasp.synthesis.specification import KINDS, GraspWish

TOLERANCE = 0.001
"""How deep the closing hand may go [m]: the optimiser does the rest."""

FARTHEST, DEEPEST, STEP = 0.15, 0.05, 0.002
"""The hand comes from this far in front of the held place, at most this far beyond it, in such steps [m]."""


def random_offsets(
    wishes: Sequence[GraspWish], seed: int, starts: int, shift: float, turn: float
) -> np.ndarray:
    """Shift [m] and turn [rad] of the wrist at each start, zero for the first of a wish.

    Args:
        wishes: each is tried ``starts`` times, its tries in a row.
        seed: with the wish itself, all that the numbers depend on.
        starts: tries per wish.
        shift, turn: standard deviations [m], [rad].

    Returns:
        shape [N, 6], N = len(wishes) * starts.
    """
    result = []
    for wish in wishes:
        random = np.random.default_rng([seed, zlib.crc32(repr(wish).encode())])
        shaken = random.normal(size=(starts, 6)) * np.repeat([shift, turn], 3)
        shaken[0] = 0.0
        result.append(shaken)
    return np.concatenate(result)


def wished_pose(wishes: Sequence[GraspWish], shaken: np.ndarray) -> np.ndarray:
    """Wrist with the kind's center at the wish's place, object frame, shape [N, 7]."""
    x = np.array([wish.palm for wish in wishes], dtype=float)
    z = np.array([wish.fingers for wish in wishes], dtype=float)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z -= np.sum(z * x, axis=1, keepdims=True) * x
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    matrix = np.stack([x, np.cross(z, x), z], axis=-1)
    center = np.array([KINDS[wish.kind].center for wish in wishes])
    place = np.array([wish.at for wish in wishes], dtype=float)
    rotation = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    rotation = quaternion_multiply(quaternion_from_rotation_vector(shaken[:, 3:]), rotation)
    turned = Rotation.from_quat(rotation, scalar_first=True).apply(center)
    return np.concatenate([place + shaken[:, :3] - turned, rotation], axis=1)


def approached(
    points: HumanPoints, around: Surroundings, wishes: Sequence[GraspWish], pose: np.ndarray
) -> np.ndarray:
    """The wrist moved in along the palm's direction until the palm touches.

    For kinds that don't use the palm, only until the held place is between the fingers.
    """
    into = Rotation.from_quat(pose[:, 3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    deepest = np.array([DEEPEST if KINDS[wish.kind].palm else 0.0 for wish in wishes])
    base = np.isin(
        points.balls.link, [0, *(i for i, name in enumerate(HUMAN_LINKS) if name.endswith("proximal"))]
    )
    opened = np.array([KINDS[wish.kind].open for wish in wishes])
    depth, free = np.full(len(pose), -FARTHEST), np.ones(len(pose), dtype=bool)
    for step in np.arange(-FARTHEST, DEEPEST + STEP / 2, STEP):
        moved = pose.copy()
        moved[:, :3] += step * into
        state = State(points, around, moved, opened)
        clear = np.minimum(state.clearance, state.heights)[:, base].min(axis=1)
        free &= (clear > -TOLERANCE) & (step <= deepest + 1e-9)
        depth[free] = step
    result = pose.copy()
    result[:, :3] += depth[:, None] * into
    return result


def closed_hand(
    points: HumanPoints, around: Surroundings, wishes: Sequence[GraspWish], pose: np.ndarray
) -> np.ndarray:
    """Joints with each finger closed until it touches object or table, shape [N, 21]."""
    opened = np.array([KINDS[wish.kind].open for wish in wishes])
    closed = np.array([KINDS[wish.kind].closed for wish in wishes])
    finger_of_joint = np.repeat(np.arange(5), [4, 4, 4, 4, 5])
    finger_of_ball = np.where(points.balls.link > 0, (points.balls.link - 1) // 3, -1)
    share, free = np.zeros((len(wishes), 5)), np.ones((len(wishes), 5), dtype=bool)
    for step in np.linspace(0.0, 1.0, 21):
        state = State(points, around, pose, opened + step * (closed - opened))
        clear = np.minimum(state.clearance, state.heights)
        for finger in range(5):
            free[:, finger] &= clear[:, finger_of_ball == finger].min(axis=1) > -TOLERANCE
        share[free] = step
    return opened + share[:, finger_of_joint] * (closed - opened)

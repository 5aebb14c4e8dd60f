"""Where the solver of human grasps starts: the hand comes from the specified direction and closes until
contact."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply
from fungrasp.grasps import HUMAN_LINKS
from fungrasp.optimization.hand_state import HandState
from fungrasp.optimization.problem import CollisionScene
from fungrasp.synthesis.grasp_specification import GRASP_KINDS, GraspSpecification
from fungrasp.synthesis.human_hand_terms import HumanPoints

CONTACT_TOLERANCE = 0.001
"""Penetration at which the closing hand stops [m]; the solver removes it."""

FARTHEST, DEEPEST, STEP = 0.15, 0.05, 0.002
"""The hand comes from ``FARTHEST`` in front of the held place to at most ``DEEPEST`` beyond it, in steps of
``STEP`` [m]."""


def random_offsets(
    specs: Sequence[GraspSpecification], seed: int, starts: int, shift: float, turn: float
) -> np.ndarray:
    """Shift [m] and turn [rad] of the wrist at each start, zero for the first of a specification.

    Args:
        specs: each gets ``starts`` candidates, in consecutive rows.
        seed: with the specification itself, all that the offsets depend on.
        starts: candidates per specification.
        shift, turn: standard deviations [m], [rad].

    Returns:
        shape [N, 6], N = len(specs) * starts.
    """
    result = []
    for spec in specs:
        # The class's former name: the built-in grasps were made from these random numbers.
        text = repr(spec).replace(type(spec).__name__, "GraspWish", 1)
        random = np.random.default_rng([seed, zlib.crc32(text.encode())])
        offsets = random.normal(size=(starts, 6)) * np.repeat([shift, turn], 3)
        offsets[0] = 0.0
        result.append(offsets)
    return np.concatenate(result)


def specified_wrist_pose(specs: Sequence[GraspSpecification], offsets: np.ndarray) -> np.ndarray:
    """Wrist pose that puts the center of the grasp kind at the specified place, object frame, shape [N, 7].

    Args:
        specs: one per candidate, length N.
        offsets: as ``random_offsets`` returns them, shape [N, 6].
    """
    x = np.array([spec.palm for spec in specs], dtype=float)
    z = np.array([spec.fingers for spec in specs], dtype=float)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    z -= np.sum(z * x, axis=1, keepdims=True) * x
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    # Columns are the palm's axes in the object's frame: out of the palm, to the thumb's side, to the fingers.
    matrix = np.stack([x, np.cross(z, x), z], axis=-1)
    center = np.array([GRASP_KINDS[spec.kind].center for spec in specs])
    place = np.array([spec.at for spec in specs], dtype=float)
    rotation = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    rotation = quaternion_multiply(quaternion_from_rotation_vector(offsets[:, 3:]), rotation)
    turned = Rotation.from_quat(rotation, scalar_first=True).apply(center)
    return np.concatenate([place + offsets[:, :3] - turned, rotation], axis=1)


def approach_until_contact(
    points: HumanPoints, scene: CollisionScene, specs: Sequence[GraspSpecification], pose: np.ndarray
) -> np.ndarray:
    """Wrist poses moved along the palm's direction until the palm touches, shape [N, 7].

    For kinds that do not use the palm, only until the held place is between the fingers.
    """
    into = Rotation.from_quat(pose[:, 3:], scalar_first=True).apply([1.0, 0.0, 0.0])
    deepest = np.array([DEEPEST if GRASP_KINDS[spec.kind].palm else 0.0 for spec in specs])
    base = np.isin(
        points.spheres.link, [0, *(i for i, name in enumerate(HUMAN_LINKS) if name.endswith("proximal"))]
    )
    opened = np.array([GRASP_KINDS[spec.kind].open for spec in specs])
    depth, free = np.full(len(pose), -FARTHEST), np.ones(len(pose), dtype=bool)
    for step in np.arange(-FARTHEST, DEEPEST + STEP / 2, STEP):
        moved = pose.copy()
        moved[:, :3] += step * into
        state = HandState(points, scene, moved, opened)
        clear = np.minimum(state.clearance, state.heights)[:, base].min(axis=1)
        free &= (clear > -CONTACT_TOLERANCE) & (step <= deepest + 1e-9)
        depth[free] = step
    result = pose.copy()
    result[:, :3] += depth[:, None] * into
    return result


def close_until_contact(
    points: HumanPoints, scene: CollisionScene, specs: Sequence[GraspSpecification], pose: np.ndarray
) -> np.ndarray:
    """Joints with each finger closed until it touches object or table [rad], shape [N, 21]."""
    opened = np.array([GRASP_KINDS[spec.kind].open for spec in specs])
    closed = np.array([GRASP_KINDS[spec.kind].closed for spec in specs])
    finger_of_joint = np.repeat(np.arange(5), [4, 4, 4, 4, 5])
    finger_of_sphere = np.where(points.spheres.link > 0, (points.spheres.link - 1) // 3, -1)
    share, free = np.zeros((len(specs), 5)), np.ones((len(specs), 5), dtype=bool)
    for step in np.linspace(0.0, 1.0, 21):
        state = HandState(points, scene, pose, opened + step * (closed - opened))
        clear = np.minimum(state.clearance, state.heights)
        for finger in range(5):
            free[:, finger] &= clear[:, finger_of_sphere == finger].min(axis=1) > -CONTACT_TOLERANCE
        share[free] = step
    return opened + share[:, finger_of_joint] * (closed - opened)

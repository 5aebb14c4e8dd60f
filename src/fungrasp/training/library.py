"""The references to train on: planned once, with many perturbed copies of each grasp against memorising."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.reference import planned
from fungrasp.policies.references import References
from fungrasp.simulation import Worlds, build_scene
from fungrasp.task import LiftTask

CHUNK = 256
"""Grasps planned together."""


@dataclass(frozen=True)
class Variety:
    """How perturbed copies of a grasp differ from it, one standard deviation."""

    copies: int = 8
    """Of each grasp, the unchanged one included."""
    position: float = 0.006
    """Of the wrist along each axis [m]."""
    rotation: float = 0.07
    """Of the wrist about each axis [rad]."""
    joints: float = 0.05
    """Of each joint [rad]."""

    def __post_init__(self) -> None:
        if self.copies < 1:
            raise FungraspError(f"training needs at least one copy of each grasp, not {self.copies}")


@dataclass(frozen=True, eq=False)
class Library:
    """References to train on."""

    references: References
    group: np.ndarray
    """Which grasp each reference is a copy of, shape [N] int."""


def build_library(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    variety: Variety,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
) -> Library:
    """Plan the motions of perturbed copies of grasps.

    Args:
        grasps: of ``hand``.
        objects: by name.
        hand: the robot hand.
        variety: of the copies.
        seed: of the perturbations.
        threads: 0 means all processors.
        progress: called with the number of references that are planned.

    Raises:
        FungraspError: no grasp of the set has a finite plan.
    """
    group = np.repeat(np.arange(len(grasps)), variety.copies)
    copies = _varied(
        grasps.select(group), hand, variety, seed, np.tile(np.arange(variety.copies), len(grasps))
    )
    scene = build_scene(hand, objects)
    parts = []
    for start in range(0, len(copies), CHUNK):
        part = copies.select(np.arange(start, min(start + CHUNK, len(copies))))
        index = scene.indices(part.object_name.tolist())
        task = LiftTask(scene, part, Worlds(scene, index, part.object_mass, threads=threads))
        task.reset()
        parts.append(References.of(planned(task, objects), part, task.settled_pose, hand))
        progress(start + len(part))
    references = References.join(parts)
    usable = _usable(references)
    if not usable.any():
        raise FungraspError("none of the grasps can be trained on: no object settles, or no plan is finite")
    rows = np.flatnonzero(usable)
    return Library(references.select(rows), group[rows])


def _usable(references: References) -> np.ndarray:
    """Finite, and the object is on the table."""
    motion = references.motion
    finite = np.isfinite(motion.wrist_goal).all(axis=(1, 2)) & np.isfinite(motion.finger_targets).all(
        axis=(1, 2)
    )
    settled = references.settled_pose
    return finite & np.isfinite(settled).all(axis=1) & (np.abs(settled[:, 2]) < 0.5)


def _varied(
    grasps: RobotGraspSet, hand: Hand, variety: Variety, seed: int, copy: np.ndarray
) -> RobotGraspSet:
    """Grasps with wrist and joints perturbed, but for the first copy of each."""
    matrix, offset = hand.coupling
    rng = np.random.default_rng(seed)
    independent = (grasps.joint_positions - offset) @ np.linalg.pinv(matrix).T
    noise = rng.normal(size=(len(grasps), 6 + independent.shape[1])) * (copy > 0)[:, None]
    turn = quaternion_from_rotation_vector(variety.rotation * noise[:, 3:6])
    shift = np.concatenate([variety.position * noise[:, :3], turn], axis=1)
    joints = (independent + variety.joints * noise[:, 6:]) @ matrix.T + offset
    limits = hand.joint_limits
    return replace(
        grasps,
        wrist_pose=compose(grasps.wrist_pose, shift),
        joint_positions=np.clip(joints, limits[:, 0], limits[:, 1]),
    )

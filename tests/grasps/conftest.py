"""Hands and grasps made for the tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from bent_hand import bent_hand

from fungrasp.grasps import HumanGraspSet, RobotGraspSet


@pytest.fixture
def hand() -> Callable[..., np.ndarray]:
    return bent_hand


@pytest.fixture
def human_grasps() -> Callable[..., HumanGraspSet]:
    """Make N different human grasps."""

    def make(count: int = 3, seed: int = 0, **changes: object) -> HumanGraspSet:
        random = np.random.default_rng(seed)
        quaternion = random.normal(size=(2, count, 4))
        quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
        position = random.uniform((-0.2, -0.2, 0.1), (0.2, 0.2, 0.5), size=(2, count, 3))
        fields = {
            "object_name": np.array([f"object {i % 2}" for i in range(count)]),
            "object_mass": random.uniform(0.01, 1, size=count),
            "object_pose": np.concatenate([position[0], quaternion[0]], axis=1),
            "object_rest_pose": np.concatenate([position[1], quaternion[1]], axis=1),
            "hand_joints": bent_hand() + position[0][:, None],
            "link_contacts": random.random((count, 16)) < 0.5,
            "task": np.array([f"task {i}" for i in range(count)]),
            "hand_qpos": random.normal(size=(count, 51)),
        }
        return HumanGraspSet(**(fields | changes))  # type: ignore[arg-type]

    return make


@pytest.fixture
def robot_grasps(human_grasps: Callable[..., HumanGraspSet]) -> Callable[..., RobotGraspSet]:
    """Make N different robot grasps."""

    def make(count: int = 3, seed: int = 0, **changes: object) -> RobotGraspSet:
        human = human_grasps(count, seed)
        random = np.random.default_rng(seed)
        fields = {
            "hand": "claw",
            "object_name": human.object_name,
            "object_mass": human.object_mass,
            "object_pose": human.object_pose,
            "object_rest_pose": human.object_rest_pose,
            "wrist_pose": human.object_pose,
            "joint_names": ("one", "two"),
            "joint_positions": random.normal(size=(count, 2)),
            "keypoints": random.normal(size=(count, 5, 3)),
            "link_contacts": random.random((count, 4)) < 0.5,
            "extra": {"quality": random.normal(size=count), "count": np.arange(count)},
        }
        return RobotGraspSet(**(fields | changes))  # type: ignore[arg-type]

    return make

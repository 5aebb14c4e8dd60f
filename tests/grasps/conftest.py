"""Hands and grasps made for the tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fungrasp.grasps import HumanGraspSet, RobotGraspSet

SPREAD = {"index": 0.025, "middle": 0.005, "ring": -0.015, "pinky": -0.033}
LENGTHS = {
    "index": (0.088, 0.038, 0.022, 0.021),
    "middle": (0.090, 0.042, 0.025, 0.022),
    "ring": (0.082, 0.038, 0.025, 0.022),
    "pinky": (0.075, 0.031, 0.018, 0.020),
}


def bent_hand(bends: tuple[float, float, float] = (0.3, 0.5, 0.3)) -> np.ndarray:
    """A right hand, wrist at the origin, fingers along x, thumb on the side of +y, palm down.
    bends: MCP, PIP, DIP [rad]. Returns [m], shape [21, 3]."""
    joints = [np.zeros(3)]
    for finger, side in SPREAD.items():
        metacarpal, *links = LENGTHS[finger]
        point = np.array([np.sqrt(metacarpal**2 - side**2), side, 0.0])
        joints.append(point)
        before = point / np.linalg.norm(point)
        angle = 0.0
        for bend, link in zip(bends, links, strict=True):
            angle += bend
            point = point + link * (np.cos(angle) * before + np.sin(angle) * np.array([0.0, 0.0, -1.0]))
            joints.append(point)
    thumb = np.array(
        [[0.025, 0.025, -0.012], [0.055, 0.05, -0.022], [0.08, 0.06, -0.035], [0.1, 0.062, -0.055]]
    )
    return np.concatenate([np.array(joints), thumb])


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
        position = random.uniform(-0.2, 0.2, size=(2, count, 3))
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

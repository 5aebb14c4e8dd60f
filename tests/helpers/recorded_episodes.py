"""Episodes of random numbers, as they are recorded."""

from __future__ import annotations

import numpy as np

from fungrasp.evaluation import Trajectory
from fungrasp.hands import load_hand

HAND = load_hand("inspire")


def episode(index: int = 3, name: str = "mug", size: int = 7) -> Trajectory:
    rng = np.random.default_rng(index)

    def numbers(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    joints, servos = len(HAND.joint_names), len(HAND.actuators)
    return Trajectory(
        hand="inspire",
        object_name=name,
        object_mass=0.35,
        index=index,
        success=index % 2 == 1,
        reason="" if index % 2 else "dropped during the hold",
        times=np.arange(size, dtype=np.float32) * np.float32(0.02),
        qpos=numbers(size, 20),
        wrist_reference=numbers(7),
        object_pose=numbers(size, 7),
        palm_pose=numbers(size, 7),
        joint_positions=numbers(size, joints),
        link_contacts=rng.random((size, len(HAND.links))) > 0.5,
        phase=np.array([0] * 3 + [1] * (size - 3), dtype=np.int8),
        controls=numbers(size, 6 + servos),
        differs="mass friction",
    )

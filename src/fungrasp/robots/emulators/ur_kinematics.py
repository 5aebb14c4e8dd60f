"""Forward kinematics of UR arms by the DH parameters that Universal Robots publishes, as their controllers
compute it; our arm models are written otherwise (``fungrasp/hands/arms``)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, rotation_vector

TWISTS = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
"""alpha of every UR arm [rad]."""


@dataclass(frozen=True)
class URLengths:
    """DH parameters that are not zero [m]."""

    d1: float
    """Height of the shoulder's axis."""
    a2: float
    """Length of the upper arm."""
    a3: float
    """Length of the forearm."""
    d4: float
    """Offset of the first wrist joint along its axis."""
    d5: float
    """Offset of the second wrist joint along its axis."""
    d6: float
    """Offset of the flange along the third wrist joint's axis."""


UR5 = URLengths(0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823)
"""Of a CB3 controller."""
UR5E = URLengths(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996)
"""Of an e-Series controller."""


def tool_pose(lengths: URLengths, joints: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """What a controller calls its TCP pose: position [m] and rotation vector [rad] in its Base, shape [6].

    Args:
        lengths: of the arm.
        joints: [rad], shape [6].
        tool: the tool center point on the flange, position and rotation vector, shape [6].
    """
    frame = np.eye(4)
    offsets = (lengths.d1, 0.0, 0.0, lengths.d4, lengths.d5, lengths.d6)
    lengthwise = (0.0, lengths.a2, lengths.a3, 0.0, 0.0, 0.0)
    for angle, d, a, twist in zip(joints.tolist(), offsets, lengthwise, TWISTS, strict=True):
        c, s, ct, st = math.cos(angle), math.sin(angle), math.cos(twist), math.sin(twist)
        step = [
            [c, -s * ct, s * st, a * c],
            [s, c * ct, -c * st, a * s],
            [0.0, st, ct, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
        frame = frame @ np.array(step)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, frame[:3, :3].ravel())
    on_flange = np.concatenate([tool[:3], quaternion_from_rotation_vector(tool[3:])])
    pose = compose(np.concatenate([frame[:3, 3], quaternion]), on_flange)
    return np.concatenate([pose[:3], rotation_vector(pose[3:])])

"""Forward kinematics of UR arms by the DH parameters that Universal Robots publishes, as their controllers
compute it; our arm models are written otherwise (``fungrasp/hands/arms``)."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, rotation_vector
from fungrasp.robots.kinematics.dh_parameters import DHParameters

TWISTS = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
"""alpha of every UR arm [rad]."""

UR5 = DHParameters(
    np.zeros(6),
    np.array([0.0, -0.425, -0.39225, 0.0, 0.0, 0.0]),
    np.array([0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823]),
    TWISTS,
)
"""Of a CB3 controller."""

UR5E = DHParameters(
    np.zeros(6),
    np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]),
    np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]),
    TWISTS,
)
"""Of an e-Series controller."""


def tool_pose(parameters: DHParameters, joints: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """What a controller calls its TCP pose: position [m] and rotation vector [rad] in its Base, shape [6].

    Args:
        parameters: of the arm.
        joints: [rad], shape [6].
        tool: the tool center point on the flange, position and rotation vector, shape [6].
    """
    on_flange = np.concatenate([tool[:3], quaternion_from_rotation_vector(tool[3:])])
    pose = compose(parameters.frames(joints)[-1], on_flange)
    return np.concatenate([pose[:3], rotation_vector(pose[3:])])

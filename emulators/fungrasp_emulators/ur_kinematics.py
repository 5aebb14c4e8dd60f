"""Forward kinematics of UR arms by the DH parameters that Universal Robots publishes, as their controllers
compute it; our arm models are written otherwise (``fungrasp/hands/arms``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, eq=False)
class DHParameters:
    """Of an arm with M joints: joint i turns about the z axis of frame i, and the next frame is
    Rz(angle) Tz(d_i) Tx(a_i) Rx(alpha_i) from it. The last one is the flange's."""

    a: np.ndarray
    """Distances along x [m], shape [M]."""
    d: np.ndarray
    """Distances along z [m], shape [M]."""
    alpha: np.ndarray
    """Twists about x [rad], shape [M]."""


TWISTS = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
"""alpha of every UR arm [rad]."""

UR5 = DHParameters(
    np.array([0.0, -0.425, -0.39225, 0.0, 0.0, 0.0]),
    np.array([0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823]),
    TWISTS,
)
"""Of a CB3 controller."""

UR5E = DHParameters(
    np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]),
    np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]),
    TWISTS,
)
"""Of an e-Series controller."""


def tool_pose(parameters: DHParameters, joints: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """What a controller calls its TCP pose: position [m] and rotation vector [rad] in its Base, shape [6].

    Args:
        joints: [rad], shape [6].
        tool: the tool center point on the flange, position and rotation vector, shape [6].
    """
    place, turn = np.zeros(3), Rotation.identity()
    for angle, a, d, alpha in zip(joints, parameters.a, parameters.d, parameters.alpha, strict=True):
        turn = turn * Rotation.from_rotvec([0.0, 0.0, angle])
        place = place + turn.apply([a, 0.0, d])
        turn = turn * Rotation.from_rotvec([alpha, 0.0, 0.0])
    return np.concatenate([place + turn.apply(tool[:3]), (turn * Rotation.from_rotvec(tool[3:])).as_rotvec()])

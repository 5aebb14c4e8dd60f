"""Gravity compensation of a hand at any palm rotation (section IV.C.4 of the paper).

Simulated hands are weightless. Without compensation, the position servos of a real hand sag by
``g(q) / stiffness``, where

    g(q, R) = - sum_b m_b J_b(q)^T R^T (0, 0, -9.81 m/s^2)

are the torques that balance the weight. R rotates from the palm frame to the world frame, m_b is the mass of
body b, and J_b is the Jacobian of its center of mass in the palm frame. The torques are added to those of the
servos; servos that accept only positions get a setpoint offset ``g / stiffness`` instead.
"""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.objects.object_model import GRAVITY


class GravityCompensation:
    """Gravity compensation of one hand. A call takes a few microseconds and allocates no buffers."""

    def __init__(self, hand: Hand):
        """hand: a hand with body masses; the palm's mass does not matter."""
        self._model = hand.spec().compile()
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._data = mujoco.MjData(self._model)
        self._matrix, self._offset = hand.coupling
        self._bias = np.zeros(self._model.nv)
        # Rotation of the palm in the world frame of the model.
        mujoco.mj_kinematics(self._model, self._data)
        self._palm = self._data.xquat[self._model.body(hand.palm).id].copy()
        self._down = np.zeros(3)
        self._turn = np.zeros(4)

    def torques(self, palm_rotation: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Return the torques on the independent joints that balance the hand's weight [N m], shape [U].

        Args:
            palm_rotation: rotation of the palm, world frame, wxyz, shape [4].
            joints: independent joints [rad], shape [U].
        """
        m, d = self._model, self._data
        # Rotate gravity to the palm frame, then to the world frame of the model.
        mujoco.mju_negQuat(self._turn, palm_rotation)
        mujoco.mju_rotVecQuat(self._down, _DOWN, self._turn)
        mujoco.mju_rotVecQuat(m.opt.gravity, self._down, self._palm)
        d.qpos[:] = self._matrix @ joints + self._offset
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_rne(m, d, 0, self._bias)
        # Map torques of coupled joints to their independent joints.
        return self._matrix.T @ self._bias


_DOWN = np.array([0.0, 0.0, -GRAVITY])


def setpoint_offset(torques: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the setpoint offset of position servos that produces torques [rad].

    Args:
        torques: [N m], shape [..., U].
        stiffness: identified servo stiffness [N m/rad], shape [U].
    """
    return torques / stiffness

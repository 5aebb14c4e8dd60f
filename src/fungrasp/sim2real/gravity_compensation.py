"""Torques that carry a hand's own weight, in whatever pose the arm holds it (section IV.C.4 of the paper).

Simulated hands are weightless; a real one's servos, which know nothing of gravity, let it sag by
``g(q) / stiffness``. With ``y`` the positions of the bodies' centers of mass and ``m`` their masses,

    g(q, R) = - sum_b m_b J_b(q)^T R^T (0, 0, -9.81 m/s^2)

holds it up: R turns the palm's frame into the world's, J_b is the Jacobian of body b's center of mass in the
palm's frame. It is added to what the servos make of errors of position; servos that take positions only get a
shift of their targets instead, ``g / stiffness``.
"""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.objects.object_model import GRAVITY


class GravityCompensation:
    """For one hand. A call takes a few microseconds and no memory of its own."""

    def __init__(self, hand: Hand):
        """hand: with the masses of its bodies; those of the palm don't matter."""
        self._model = hand.spec().compile()
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._data = mujoco.MjData(self._model)
        self._matrix, self._offset = hand.coupling
        self._bias = np.zeros(self._model.nv)
        # The palm stands in the model as it does in the world of the model: its rotation there.
        mujoco.mj_kinematics(self._model, self._data)
        self._palm = self._data.xquat[self._model.body(hand.palm).id].copy()
        self._down = np.zeros(3)
        self._turn = np.zeros(4)

    def torques(self, palm_rotation: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Torques on the independent joints that balance the hand's weight [N m], shape [U].

        Args:
            palm_rotation: of the palm in the world, wxyz, shape [4].
            joints: independent joints [rad], shape [U].
        """
        m, d = self._model, self._data
        # Gravity in the world of the model: back through the palm's rotation in the world.
        mujoco.mju_negQuat(self._turn, palm_rotation)
        mujoco.mju_rotVecQuat(self._down, _DOWN, self._turn)
        mujoco.mju_rotVecQuat(m.opt.gravity, self._down, self._palm)
        d.qpos[:] = self._matrix @ joints + self._offset
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_rne(m, d, 0, self._bias)
        # Coupled joints hand their torques on to those that drive them.
        return self._matrix.T @ self._bias


_DOWN = np.array([0.0, 0.0, -GRAVITY])


def setpoint_offset(torques: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Shift of the targets of position servos that makes them hold torques [rad].

    Args:
        torques: [N m], shape [..., U].
        stiffness: of the servos, identified [N m/rad], shape [U].
    """
    return torques / stiffness

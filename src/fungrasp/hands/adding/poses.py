"""Poses of a foreign model's bodies and joints, in the frame of its palm."""

from __future__ import annotations

import mujoco
import numpy as np

from fungrasp.hands.adding.couplings import Coupling, coupling_matrix


class Poses:
    """Poses of a model's bodies and joints at any joint positions, in the palm body's frame."""

    def __init__(self, model: mujoco.MjModel, couplings: list[Coupling], palm: int):
        self.model, self.palm = model, palm
        self.matrix, self.offset = coupling_matrix(model.njnt, couplings)
        self.data = mujoco.MjData(model)
        self.low, self.high = independent_limits(model, self.matrix, self.offset)

    def set(self, independent: np.ndarray) -> np.ndarray:
        """Move to independent joint positions [rad]; returns those of all joints."""
        joints = self.matrix @ independent + self.offset
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        self._place, self._turn = self.data.xpos[self.palm], self.data.xmat[self.palm].reshape(3, 3)
        return joints

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points of the world's frame in the palm's [m], shape [..., 3]."""
        return (points - self._place) @ self._turn

    def anchor(self, body: int) -> np.ndarray:
        """Where the first joint of a moving body lies [m], shape [3]."""
        return self.points(self.data.xanchor[self.model.body_jntadr[body]])

    def of_body(self, body: int, point: np.ndarray) -> np.ndarray:
        """A point of a body's frame in the palm's [m], shape [3]."""
        return self.points(self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ point)

    def moved(self, points: np.ndarray, source: int, target: int) -> np.ndarray:
        """Points of the frame of body ``source`` in that of body ``target`` [m], shape [..., 3]."""
        data = self.data
        world = data.xpos[source] + points @ data.xmat[source].reshape(3, 3).T
        return (world - data.xpos[target]) @ data.xmat[target].reshape(3, 3)

    def axis(self, joint: int) -> np.ndarray:
        """Unit vector along a joint's axis, shape [3]."""
        return self.data.xaxis[joint] @ self._turn


def independent_limits(
    model: mujoco.MjModel, matrix: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the independent joints [rad], shape [U] each, such that driven joints keep theirs, where
    that leaves anything."""
    low, high = np.full(matrix.shape[1], -np.inf), np.full(matrix.shape[1], np.inf)
    for u in range(matrix.shape[1]):
        rows = np.flatnonzero(matrix[:, u])
        own = model.jnt_range[rows[np.argmax(matrix[rows, u] == 1.0)]]
        ends = (model.jnt_range[rows] - offset[rows, None]) / matrix[rows, u][:, None]
        ends.sort(axis=1)
        low[u], high[u] = max(own[0], ends[:, 0].max()), min(own[1], ends[:, 1].min())
        if high[u] - low[u] < 0.5 * np.ptp(own):
            low[u], high[u] = own
    return low, high

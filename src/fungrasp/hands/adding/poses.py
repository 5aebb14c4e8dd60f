"""Poses of a foreign model's bodies and joints, in the frame of its palm."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from fungrasp.hands.findings import Finding, listed, note, warning
from fungrasp.hands.kinematic_tree import Drive, coupling_matrix, joint_name

NOTICED = 0.1
"""Change of a joint's range that is mentioned [rad]."""


class Poses:
    """Poses of a model's bodies and joints at any joint positions, in the palm body's frame."""

    def __init__(self, model: mujoco.MjModel, couplings: dict[int, Drive], palm: int):
        self.model, self.palm = model, palm
        self.matrix, self.offset = coupling_matrix(model.njnt, couplings)
        self.data = mujoco.MjData(model)
        self.low, self.high = independent_limits(model, self.matrix, self.offset)
        own = np.argmax(self.matrix == 1.0, axis=0)
        self.start = np.clip(model.qpos0[model.jnt_qposadr[own]], self.low, self.high)
        """Independent joints at the file's pose, as near as limits allow [rad], shape [U]."""

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


def narrowed_ranges(model: mujoco.MjModel, couplings: dict[int, Drive]) -> Iterator[Finding]:
    """Joints whose range shrinks because one that they drive would leave its own, or that push it beyond."""
    matrix, offset = coupling_matrix(model.njnt, couplings)
    low, high = independent_limits(model, matrix, offset)
    narrower, beyond = [], []
    for u in range(matrix.shape[1]):
        rows = np.flatnonzero(matrix[:, u])
        driver = int(rows[np.argmax(matrix[rows, u] == 1.0)])
        own, name = model.jnt_range[driver], joint_name(model, driver)
        ends = np.sort(matrix[rows, u, None] * [low[u], high[u]] + offset[rows, None], axis=1)
        outside = (ends - model.jnt_range[rows]) * [-1.0, 1.0]
        beyond += [f"{joint_name(model, j)} by {name}" for j in rows[outside.max(axis=1) > NOTICED]]
        if max(low[u] - own[0], own[1] - high[u]) > NOTICED:
            narrower.append(f"{name} {low[u]:.2f} to {high[u]:.2f}, not {own[0]:.2f} to {own[1]:.2f}")
    remedy = "if a coupling is wrong, give it with --couple JOINT=OFFSET+SLOPE*DRIVER"
    if narrower:
        yield note(
            "joints turn only as far as those that they drive let them [rad]: "
            f"{'; '.join(narrower[:6])}{' and more' if len(narrower) > 6 else ''}; {remedy}"
        )
    if beyond:
        yield warning(
            f"limits that couplings do not keep are taken to be wrong, of {listed(beyond)}; {remedy}"
        )

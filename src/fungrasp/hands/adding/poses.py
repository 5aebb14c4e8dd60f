"""Kinematics of a foreign model in its palm frame."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from fungrasp.hands.findings import Finding, listed, note, warning
from fungrasp.hands.kinematic_tree import Drive, coupling_matrix, independent_limits, joint_name

NOTICED = 0.1
"""Smallest reported change of a joint's range [rad]."""


class Poses:
    """Kinematics of a model in the palm frame. All methods refer to the positions of the last ``set``."""

    def __init__(self, model: mujoco.MjModel, couplings: dict[int, Drive], palm: int):
        self.model, self.palm = model, palm
        self.matrix, self.offset, self.independent = coupling_matrix(model.njnt, couplings)
        self.data = mujoco.MjData(model)
        self.low, self.high = _kept_limits(model, self.matrix, self.offset, self.independent)
        self.start = np.clip(model.qpos0[model.jnt_qposadr[self.independent]], self.low, self.high)
        """Independent joints at the file's pose, clipped to their limits [rad], shape [U]."""

    def set(self, independent: np.ndarray) -> np.ndarray:
        """Set independent joints [rad], shape [U]; return all joints [rad], shape [M]."""
        joints = self.matrix @ independent + self.offset
        self.data.qpos[:] = joints
        mujoco.mj_kinematics(self.model, self.data)
        self._place, self._turn = self.data.xpos[self.palm], self.data.xmat[self.palm].reshape(3, 3)
        return joints

    def points(self, points: np.ndarray) -> np.ndarray:
        """Transform points from the world frame to the palm frame [m], shape [..., 3]."""
        return (points - self._place) @ self._turn

    def anchor(self, body: int) -> np.ndarray:
        """Return the anchor of a moving body's first joint, palm frame [m], shape [3]."""
        return self.points(self.data.xanchor[self.model.body_jntadr[body]])

    def of_body(self, body: int, point: np.ndarray) -> np.ndarray:
        """Transform a point from a body frame to the palm frame [m], shape [3]."""
        return self.points(self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ point)

    def moved(self, points: np.ndarray, source: int, target: int) -> np.ndarray:
        """Transform points from the frame of body ``source`` to that of ``target`` [m], shape [..., 3]."""
        data = self.data
        world = data.xpos[source] + points @ data.xmat[source].reshape(3, 3).T
        return (world - data.xpos[target]) @ data.xmat[target].reshape(3, 3)

    def axis(self, joint: int) -> np.ndarray:
        """Return a joint's axis, unit vector in the palm frame, shape [3]."""
        return self.data.xaxis[joint] @ self._turn


def _kept_limits(
    model: mujoco.MjModel, matrix: np.ndarray, offset: np.ndarray, independent: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``independent_limits`` [rad], shape [U] each; a joint whose range they would halve keeps its
    own."""
    low, high = independent_limits(matrix, offset, model.jnt_range)
    own = model.jnt_range[independent]
    halved = high - low < 0.5 * np.ptp(own, axis=1)
    return np.where(halved, own[:, 0], low), np.where(halved, own[:, 1], high)


def narrowed_ranges(model: mujoco.MjModel, couplings: dict[int, Drive]) -> Iterator[Finding]:
    """Report joints whose range is narrowed by the limits of driven joints, and driven joints that leave
    their limits."""
    matrix, offset, independent = coupling_matrix(model.njnt, couplings)
    low, high = _kept_limits(model, matrix, offset, independent)
    narrower, beyond = [], []
    for u, driver in enumerate(independent):
        rows = np.flatnonzero(matrix[:, u])
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
            f"couplings exceed the limits of {listed(beyond)}: 'fungrasp hands add' ignores these limits; "
            f"{remedy}"
        )

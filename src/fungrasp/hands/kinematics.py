"""Forward kinematics and Jacobians of many copies of a hand at once, by MuJoCo."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.poses import (
    cross,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotation_matrix,
)
from fungrasp.hands.hand import Hand


class BodyPoints(NamedTuple):
    """Points that ride on a hand's bodies."""

    bodies: np.ndarray
    """Body ids, shape [P]."""
    offsets: np.ndarray
    """Position in the frame of its body [m], shape [P, 3]."""

    def __getitem__(self, key):  # type: ignore[override]
        if isinstance(key, slice | np.ndarray | list):
            return BodyPoints(self.bodies[key], self.offsets[key])
        return tuple.__getitem__(self, key)


class HandKinematics:
    """N hands, each with a wrist pose and U independent joint positions, in any one reference frame of the
    caller's.

    Tangent vectors have D = 6 + U numbers: translation of the wrist [m] and its rotation [rad] about the
    wrist's origin, both along the reference frame's axes, then the independent joints [rad].
    """

    def __init__(self, hand: Hand, count: int):
        """
        Args:
            hand: any hand.
            count: N.
        """
        self.hand = hand
        self.model = model = hand.model
        self.matrix, self.offset = hand.coupling
        limits = hand.joint_limits
        self.lower, self.upper = _independent_limits(self.matrix, self.offset, limits)
        self._data = data = mujoco.MjData(model)
        self._position, self._matrix = (
            np.empty((count, *data.xpos.shape)),
            np.empty((count, *data.xmat.shape)),
        )
        self._anchor, self._axis = np.empty((2, count, *data.xanchor.shape))
        self.moves = _moved_bodies(model)
        self._slides = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
        # The palm stands still in the model.
        mujoco.mj_kinematics(model, data)
        palm = model.body(hand.palm).id
        self._palm_place = data.xpos[palm].copy()
        self._to_palm = data.xmat[palm].reshape(1, 3, 3).mT.copy()
        self._in_palm = np.zeros((count, 3)), self._to_palm, -self._to_palm @ self._palm_place
        # Made when first asked for after each update.
        self._joint_frames: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def size(self) -> int:
        """D, the length of a tangent vector."""
        return 6 + self.matrix.shape[1]

    def update(self, wrist_pose: np.ndarray | None, independent: np.ndarray) -> None:
        """Move the hands.

        Args:
            wrist_pose: pose of the palm body in the reference frame, shape [N, 7]; None where the palm itself
                is that frame.
            independent: independent joint positions [rad], shape [N, U].
        """
        model, data = self.model, self._data
        for i, joints in enumerate(independent @ self.matrix.T + self.offset):
            data.qpos[:] = joints
            mujoco.mj_kinematics(model, data)
            self._position[i], self._matrix[i] = data.xpos, data.xmat
            self._anchor[i], self._axis[i] = data.xanchor, data.xaxis
        self._wrist_position, self._rotation, self._translation = self._in_palm
        if wrist_pose is not None:
            self._wrist_position = wrist_pose[:, :3]
            self._rotation = rotation_matrix(wrist_pose[:, 3:]) @ self._to_palm
            self._translation = self._wrist_position - self._rotation @ self._palm_place
        self._joint_frames = None

    def points(self, which: BodyPoints) -> np.ndarray:
        """Positions in the reference frame [m], shape [N, P, 3]."""
        matrices = self._matrix.take(which.bodies, axis=1).reshape(-1, len(which.bodies), 3, 3)
        local = self._position.take(which.bodies, axis=1) + (matrices @ which.offsets[:, :, None])[..., 0]
        return self._map(local)

    def jacobian(self, bodies: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Derivative of positions that ride on bodies with respect to the tangent vector.

        Args:
            bodies: body ids, shape [P] or [N, P].
            positions: current positions, reference frame [m], shape [N, P, 3].

        Returns:
            shape [N, P, 3, D].
        """
        count, number = positions.shape[:2]
        result = np.zeros((count, number, 3, self.size))
        result[..., [0, 1, 2], [0, 1, 2]] = 1.0
        arm = positions - self._wrist_position[:, None]
        result[..., 0, 4], result[..., 0, 5] = arm[..., 2], -arm[..., 1]
        result[..., 1, 3], result[..., 1, 5] = -arm[..., 2], arm[..., 0]
        result[..., 2, 3], result[..., 2, 4] = arm[..., 1], -arm[..., 0]
        if self._joint_frames is None:
            self._joint_frames = self._map(self._anchor), self._axis @ self._rotation.mT
        anchor, axis = self._joint_frames
        lever = positions[:, :, None, :] - anchor[:, None]
        columns = cross(axis[:, None], lever)
        columns[:, :, self._slides] = axis[:, None, self._slides]
        columns *= self.moves[bodies][..., None]
        result[..., 6:] = np.swapaxes(columns, 2, 3) @ self.matrix
        return result

    def _map(self, local: np.ndarray) -> np.ndarray:
        return local @ self._rotation.mT + self._translation[:, None]

    def step(
        self, wrist_pose: np.ndarray, independent: np.ndarray, tangent: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrist poses and independent joints after a step along ``tangent``, joints clipped to their limits.

        Args:
            wrist_pose: shape [N, 7].
            independent: shape [N, U].
            tangent: shape [N, D].
        """
        rotation = quaternion_multiply(quaternion_from_rotation_vector(tangent[:, 3:6]), wrist_pose[:, 3:])
        rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
        pose = np.concatenate([wrist_pose[:, :3] + tangent[:, :3], rotation], axis=1)
        return pose, np.clip(independent + tangent[:, 6:], self.lower, self.upper)

    def body_points(self, names: tuple[str, ...]) -> BodyPoints:
        """Points at body origins or sites, by name."""
        bodies, offsets = [], []
        for name in names:
            site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name)
            body = self.model.site_bodyid[site] if site >= 0 else self.model.body(name).id
            bodies.append(int(body))
            offsets.append(self.model.site_pos[site] if site >= 0 else np.zeros(3))
        return BodyPoints(np.array(bodies), np.array(offsets))

    def keypoints(self, wrist_pose: np.ndarray, joint_positions: np.ndarray) -> np.ndarray:
        """Key points of full joint vectors (coupled joints included). Shape [N, 7], [N, M]; returns [m], [N,
        K, 3]."""
        independent = (joint_positions - self.offset) @ np.linalg.pinv(self.matrix).T
        self.update(wrist_pose, independent)
        return self.points(self.body_points(self.hand.keypoint_names))


def _moved_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Whether a joint moves a body, shape [nbody, njnt]."""
    moves = np.zeros((model.nbody, model.njnt))
    for body in range(1, model.nbody):
        moves[body] = moves[model.body_parentid[body]]
        first = model.body_jntadr[body]
        if first >= 0:
            moves[body, first : first + model.body_jntnum[body]] = 1.0
    return moves


def _independent_limits(
    matrix: np.ndarray, offset: np.ndarray, limits: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the independent joints such that coupled joints keep theirs as well."""
    lower = np.full(matrix.shape[1], -np.inf)
    upper = np.full(matrix.shape[1], np.inf)
    for row, constant, (low, high) in zip(matrix, offset, limits, strict=True):
        for u in np.flatnonzero(row):
            bounds = sorted(((low - constant) / row[u], (high - constant) / row[u]))
            lower[u], upper[u] = max(lower[u], bounds[0]), min(upper[u], bounds[1])
    return lower, upper

"""Batched kinematics of a hand: with Jacobians by MuJoCo, or on a device by an array library."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.arrays import constant
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    compose,
    cross,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
    rotation_matrix,
)
from fungrasp.hands.hand import Hand
from fungrasp.hands.kinematic_tree import independent_limits, place_of

FARTHEST = 0.15
"""Largest distance of a palm's origin from the bases of its fingers [m]; built-in hands have 0.02 to 0.14."""


def palm_offset(model: mujoco.MjModel, palm: str, bases: Sequence[str]) -> np.ndarray:
    """Return the shift of a far palm origin towards the fingers, palm frame [m], shape [3].

    The shifted origin is ``FARTHEST`` from the mean of the bases. The shift is zero if the origin is nearer.

    Args:
        bases: site or body at the base of each finger except the thumb.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    away = (np.mean([place_of(data, name) for name in bases], axis=0) - data.body(palm).xpos) @ data.body(
        palm
    ).xmat.reshape(3, 3)
    distance = float(np.linalg.norm(away))
    return max(0.0, distance - FARTHEST) / max(distance, 1e-9) * away


class BodyPoints(NamedTuple):
    """Points fixed to a hand's bodies."""

    bodies: np.ndarray
    """Body ids, shape [P]."""
    offsets: np.ndarray
    """Positions, body frames [m], shape [P, 3]."""

    def __getitem__(self, key):  # type: ignore[override]
        if isinstance(key, slice | np.ndarray | list):
            return BodyPoints(self.bodies[key], self.offsets[key])
        return tuple.__getitem__(self, key)


class HandKinematics:
    """N copies of a hand, each with a wrist pose in a common reference frame and U independent joints.

    Tangent vectors have D = 6 + U elements: translation [m] and rotation vector [rad] of the wrist, both in
    the reference frame and the latter about the wrist's origin, then the independent joints [rad].
    """

    def __init__(self, hand: Hand, count: int):
        self.hand = hand
        self.model = model = hand.model
        self.matrix, self.offset = hand.coupling
        self.lower, self.upper = independent_limits(self.matrix, self.offset, hand.joint_limits)
        self._data = data = mujoco.MjData(model)
        self._position, self._matrix = (
            np.empty((count, *data.xpos.shape)),
            np.empty((count, *data.xmat.shape)),
        )
        self._anchor, self._axis = np.empty((2, count, *data.xanchor.shape))
        self.moves = _moved_bodies(model)
        self._slides = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
        # The palm is static in the model.
        mujoco.mj_kinematics(model, data)
        palm = model.body(hand.palm).id
        self._palm_place = data.xpos[palm].copy()
        self._to_palm = data.xmat[palm].reshape(1, 3, 3).mT.copy()
        self._in_palm = np.zeros((count, 3)), self._to_palm, -self._to_palm @ self._palm_place
        # Computed on the first use after each update.
        self._joint_frames: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def size(self) -> int:
        """D, the length of a tangent vector."""
        return 6 + self.matrix.shape[1]

    def update(self, wrist_pose: np.ndarray | None, independent: np.ndarray) -> None:
        """Move the hands.

        Args:
            wrist_pose: pose of the palm body, reference frame, shape [N, 7]. None: the identity.
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
        """Return positions, reference frame [m], shape [N, P, 3]."""
        matrices = self._matrix.take(which.bodies, axis=1).reshape(-1, len(which.bodies), 3, 3)
        local = self._position.take(which.bodies, axis=1) + (matrices @ which.offsets[:, :, None])[..., 0]
        return self._map(local)

    def jacobian(self, bodies: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return the derivative of positions fixed to bodies with respect to the tangent vector.

        Args:
            bodies: body ids, shape [P] or [N, P].
            positions: current positions, reference frame [m], shape [N, P, 3].

        Returns:
            Reference frame, shape [N, P, 3, D].
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
        """Return wrist poses and independent joints after a step, the joints clipped to their limits.

        Args:
            wrist_pose: reference frame, shape [N, 7].
            independent: independent joint positions [rad], shape [N, U].
            tangent: tangent vectors, shape [N, D].
        """
        rotation = quaternion_multiply(quaternion_from_rotation_vector(tangent[:, 3:6]), wrist_pose[:, 3:])
        rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
        pose = np.concatenate([wrist_pose[:, :3] + tangent[:, :3], rotation], axis=1)
        return pose, np.clip(independent + tangent[:, 6:], self.lower, self.upper)

    def body_points(self, names: tuple[str, ...]) -> BodyPoints:
        """Return the points at sites or, where there is no such site, body origins."""
        bodies, offsets = [], []
        for name in names:
            site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name)
            body = self.model.site_bodyid[site] if site >= 0 else self.model.body(name).id
            bodies.append(int(body))
            offsets.append(self.model.site_pos[site] if site >= 0 else np.zeros(3))
        return BodyPoints(np.array(bodies), np.array(offsets))

    def keypoints(self, wrist_pose: np.ndarray, joint_positions: np.ndarray) -> np.ndarray:
        """Return the key points, reference frame [m], shape [N, K, 3].

        Args:
            wrist_pose: reference frame, shape [N, 7].
            joint_positions: all joints [rad], shape [N, M].
        """
        self.update(wrist_pose, self.hand.independent(joint_positions))
        return self.points(self.body_points(self.hand.keypoint_names))


def _moved_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Return whether a joint moves a body, as 0 or 1, shape [nbody, njnt]."""
    moves = np.zeros((model.nbody, model.njnt))
    for body in range(1, model.nbody):
        moves[body] = moves[model.body_parentid[body]]
        first = model.body_jntadr[body]
        if first >= 0:
            moves[body, first : first + model.body_jntnum[body]] = 1.0
    return moves


_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class _Segment(NamedTuple):
    """Part of a body with at most one joint."""

    parent: int
    """Index among the segments of the level before."""
    place: np.ndarray
    """Pose in the parent with the joint at zero, shape [7]."""
    column: int
    """Index of the joint among all joints."""
    anchor: np.ndarray
    """Position of the joint [m], shape [3]."""
    turns: np.ndarray
    """Axis of a hinge, shape [3]; zero otherwise."""
    shifts: np.ndarray
    """Axis of a slide, shape [3]; zero otherwise."""


class ArrayKinematics:
    """Positions of points on the bodies of N hands, palm frame. Segments of the same level, their distance
    from the palm in the kinematic tree, are moved by one call: on a device, calls are expensive."""

    def __init__(self, hand: Hand, points: BodyPoints):
        """
        Args:
            hand: any hand with hinges and slides.
        """
        self._hand, self._offsets = hand, points.offsets
        model = hand.model
        # Joints above the palm do not move points in its frame.
        known = {model.body(hand.palm).id: (0, 0), 0: (0, 0)}
        levels: list[list[_Segment]] = [[]]
        for body in points.bodies.tolist():
            _add(model, body, known, levels)
        self._levels = [np.array([s.parent for s in level]) for level in levels[1:]]
        segments = [s for level in levels[1:] for s in level]
        self._parts = [np.array(part) for part in zip(*segments, strict=True)]
        first = np.cumsum([0, 1, *(len(level) for level in levels[1:])])
        self._carrier = np.array([first[known[b][0]] + known[b][1] for b in points.bodies.tolist()])

    def points(self, independent: Array) -> Array:
        """Return the points, palm frame [m], shape [N, P, 3]. independent: joints [rad], shape [N, U]."""
        xp = array_namespace(independent)
        pose = xp.broadcast_to(constant(independent, _IDENTITY), (len(independent), 1, 7))
        poses, begin = [pose], 0
        if self._parts:
            local = self._moved(self._hand.all_joints(independent))
        for parents in self._levels:
            end = begin + len(parents)
            pose = compose(pose[:, constant(independent, parents)], local[:, begin:end])
            poses.append(pose)
            begin = end
        pose = xp.concat(poses, axis=1)[:, constant(independent, self._carrier)]
        return pose[..., :3] + rotate(pose[..., 3:], constant(independent, self._offsets))

    def _moved(self, joints: Array) -> Array:
        """Segments in their parents, shape [N, S, 7]. joints: all [rad], shape [N, M]."""
        _, place, column, anchor, turns, shifts = (constant(joints, part) for part in self._parts)
        position = joints[:, column][..., None]
        turn = quaternion_from_rotation_vector(position * turns)
        shift = anchor - rotate(turn, anchor) + position * shifts
        return compose(place, array_namespace(joints).concat([shift, turn], axis=-1))


def _add(
    model: mujoco.MjModel, body: int, known: dict[int, tuple[int, int]], levels: list[list[_Segment]]
) -> tuple[int, int]:
    """Add the segments of a body and its ancestors. Return level and index of its last segment."""
    if body in known:
        return known[body]
    level, number = _add(model, int(model.body_parentid[body]), known, levels)
    place = np.concatenate([model.body_pos[body], model.body_quat[body]])
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    none = np.zeros(3)
    for joint in range(first, first + count) if count else (None,):
        if joint is None:
            segment = _Segment(number, place, 0, none, none, none)
        else:
            axis, slides = model.jnt_axis[joint].copy(), model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            ways = (none, axis) if slides else (axis, none)
            segment = _Segment(number, place, joint, model.jnt_pos[joint].copy(), *ways)
        level += 1
        if level == len(levels):
            levels.append([])
        number, place = len(levels[level]), _IDENTITY
        levels[level].append(segment)
    known[body] = level, number
    return known[body]


BENT = 1.3
"""A finger that is shorter by this factor at both limits of a joint than between them bends to both sides."""

TOWARD = 0.35
"""Smallest cosine between the motion of a bending finger's tip and the closing direction; for three fingers
around a center it is 0.5."""

NEAR_ZERO = 0.25
"""A thumb is open at the limit whose distance from zero is less than this share of the other's."""

STEP = 1e-3
"""Step of finite differences [rad]."""


def partly_closed(kinematics: HandKinematics, share: float) -> np.ndarray:
    """Return independent joints between open and closed [rad], shape [U].

    A finger's joint closes towards the limit at which its tip is farther out of the palm; a thumb's joint
    closes away from zero. Other joints are assumed to close towards their upper limits. A finger that bends
    to both sides is open where it is straight; such a thumb closes towards the other tips.

    Args:
        kinematics: kinematics of 5 copies of a hand; it is updated.
        share: 0 for open, 1 for closed.
    """
    lower, upper = kinematics.lower, kinematics.upper
    middle = 0.5 * (lower + upper)
    start = np.empty_like(lower)
    # Not on a limit, where fingers may be straight and the derivative small.
    others = np.clip(np.zeros_like(lower), 0.9 * lower + 0.1 * upper, 0.1 * lower + 0.9 * upper)
    for u in range(len(lower)):
        trial = np.repeat(others[None], 5, axis=0)
        trial[:, u] = lower[u], middle[u], upper[u], others[u] - STEP, others[u] + STEP
        length, closing, is_thumb = _moved_finger(kinematics, trial)
        both_ways = length[1] > BENT * max(length[0], length[2])
        # Thumbs also rotate, so only a mostly negative range shows that they close downwards.
        negative = closing < -TOWARD if both_ways or not is_thumb else abs(upper[u]) < NEAR_ZERO * -lower[u]
        opened, closed = (upper[u], lower[u]) if negative else (lower[u], upper[u])
        if both_ways:
            opened = middle[u]
        start[u] = opened + share * (closed - opened)
    return start


def _moved_finger(kinematics: HandKinematics, independent: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Return values of the finger that moves most among the 5 copies: its length [m], shape [5]; the cosine
    between its tip's motion from copy 3 to copy 4 and its closing direction; whether it is the thumb."""
    hand = kinematics.hand
    kinematics.update(None, independent)
    points = kinematics.points(kinematics.body_points(hand.keypoint_names))
    counts = np.array([len(finger.links) for finger in hand.fingers.values()])
    last = np.cumsum(counts + 1)
    bases, tips = points[:, last - counts], points[:, last]
    thumb = list(hand.fingers).index("thumb")
    moved = int(np.linalg.norm(np.ptp(tips, axis=0), axis=1).argmax())
    toward = hand.palm_normal
    if moved == thumb:
        toward = np.delete(tips[3], thumb, axis=0).mean(axis=0) - tips[3, thumb]
    motion = tips[4, moved] - tips[3, moved]
    size = np.linalg.norm(motion) * np.linalg.norm(toward)
    length = np.linalg.norm(tips - bases, axis=-1)[:, moved]
    return length, float(motion @ toward / max(size, 1e-12)), moved == thumb

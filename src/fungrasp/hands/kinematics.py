"""Where the bodies of many copies of a hand are: by MuJoCo with Jacobians, or on devices by array libraries;
which way a hand's joints close."""

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
from fungrasp.hands.kinematic_tree import place_of

FARTHEST = 0.15
"""Distance of a palm's origin from the bases of its fingers that a palm of human size can have [m]; of the
built-in hands, 0.02 to 0.14."""


def palm_offset(model: mujoco.MjModel, palm: str, bases: Sequence[str]) -> np.ndarray:
    """From a palm's origin to the place where it would lie if it were near the hand, palm frame [m], shape
    [3]: on the line to the middle of the fingers' bases, ``FARTHEST`` before it. Zero where it is near.

    Args:
        bases: site or body at the base of each finger but the thumb.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    away = (np.mean([place_of(data, name) for name in bases], axis=0) - data.body(palm).xpos) @ data.body(
        palm
    ).xmat.reshape(3, 3)
    distance = float(np.linalg.norm(away))
    return max(0.0, distance - FARTHEST) / max(distance, 1e-9) * away


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
        """ """
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
    for row, shift, (low, high) in zip(matrix, offset, limits, strict=True):
        for u in np.flatnonzero(row):
            bounds = sorted(((low - shift) / row[u], (high - shift) / row[u]))
            lower[u], upper[u] = max(lower[u], bounds[0]), min(upper[u], bounds[1])
    return lower, upper


_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class _Segment(NamedTuple):
    """What a joint moves, or a body that none moves; a body of several joints is as many segments."""

    parent: int
    """Number among the segments one step nearer to the palm."""
    place: np.ndarray
    """In its parent [m], where the joint is at zero, shape [7]."""
    column: int
    """Of the joint, among all joints."""
    anchor: np.ndarray
    """Of the joint [m], shape [3]."""
    turns: np.ndarray
    """About which axis it turns, shape [3]; zero for none."""
    shifts: np.ndarray
    """Along which axis it shifts, shape [3]; zero for none."""


class ArrayKinematics:
    """Points on the bodies of N hands, in their palms' frames. Bodies that are as many joints away from the
    palm are moved together: on a device the number of calls is what takes time."""

    def __init__(self, hand: Hand, points: BodyPoints):
        """
        Args:
            hand: any hand with hinges and slides.
        """
        self._hand, self._offsets = hand, points.offsets
        model = hand.model
        # What moves the palm itself does not count in its frame.
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
        """Palm frame [m], shape [N, P, 3]. independent: joints [rad], shape [N, U]."""
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
    """Level and number of the last segment of a body, which is added with what carries it."""
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
"""A finger that is shorter by this factor at both limits of a joint bends to both sides."""

TOWARD = 0.35
"""Cosine of the angle to the closing direction within which a tip moves as its finger bends: fingers a third
of a turn apart have 0.5."""

NEAR_ZERO = 0.25
"""A thumb's limit this much nearer to zero than the other is that of the open thumb."""

STEP = 1e-3
"""For derivatives [rad]."""


def partly_closed(kinematics: HandKinematics, share: float) -> np.ndarray:
    """Independent joints that have gone a share of their way from open to closed [rad], shape [U].

    A joint closes towards the limit to which its fingertip moves out of the palm, a thumb's joint away from
    zero; joints that do neither are taken to close towards their upper limits. A finger that bends to both
    sides is open where it is straight, and its thumb closes towards the other tips.

    Args:
        kinematics: of 5 copies of any hand; they are moved.
        share: 0 is open, 1 is closed.
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
        # Thumbs turn as well as bend: only a range on the negative side tells that they close downwards.
        negative = closing < -TOWARD if both_ways or not is_thumb else abs(upper[u]) < NEAR_ZERO * -lower[u]
        opened, closed = (upper[u], lower[u]) if negative else (lower[u], upper[u])
        if both_ways:
            opened = middle[u]
        start[u] = opened + share * (closed - opened)
    return start


def _moved_finger(kinematics: HandKinematics, independent: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Of the finger that a joint moves most: its length [m], shape [5], the cosine of the angle between its
    tip's motion from copy 3 to copy 4, which differ in that joint, and the direction in which it closes, and
    whether it is the thumb."""
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

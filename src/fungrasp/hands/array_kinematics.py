"""Forward kinematics of many copies of a hand on any array-API library: for devices, where
``hands.kinematics``, which asks MuJoCo for one hand after the other, can't go."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.geometry.arrays import constant
from fungrasp.geometry.poses import (
    Array,
    array_namespace,
    compose,
    quaternion_from_rotation_vector,
    rotate,
)
from fungrasp.hands.hand import Hand
from fungrasp.hands.kinematics import BodyPoints, HandKinematics

_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class _Joint:
    """A hinge or a slide of a body."""

    column: int
    """Among all joints."""
    slide: bool
    anchor: np.ndarray
    """Body frame [m], shape [3]."""
    axis: np.ndarray
    """Body frame, shape [3]."""


class ArrayKinematics:
    """Key points of N hands in their palms' frames."""

    def __init__(self, hand: Hand):
        """hand: any hand with hinges and slides."""
        self._hand = hand
        model = hand.model
        self._points: BodyPoints = HandKinematics(hand, 1).body_points(hand.keypoint_names)
        palm = model.body(hand.palm).id
        needed = {palm}
        for body in self._points.bodies.tolist():
            while body not in needed and body > 0:
                needed.add(body)
                body = int(model.body_parentid[body])
        # What moves the palm itself does not count in its frame.
        self._bodies = [
            (b, int(model.body_parentid[b]), np.concatenate([model.body_pos[b], model.body_quat[b]]), joints)
            for b in sorted(needed - {palm})
            for joints in [_joints(model, b)]
        ]
        self._palm = palm

    def keypoints(self, independent: Array) -> Array:
        """Palm frame [m], shape [N, K, 3]. independent: joints [rad], shape [N, U]."""
        xp = array_namespace(independent)
        joints = self._hand.all_joints(independent)
        identity = xp.broadcast_to(constant(independent, _IDENTITY), (len(independent), 7))
        poses: dict[int, Array] = {self._palm: identity}
        for body, parent, place, moving in self._bodies:
            pose = compose(poses.get(parent, identity), constant(independent, place))
            for joint in moving:
                pose = compose(pose, _moved(joint, joints[:, joint.column : joint.column + 1]))
            poses[body] = pose
        offsets = constant(independent, self._points.offsets)
        found = []
        for number, body in enumerate(self._points.bodies.tolist()):
            pose = poses[body]
            found.append(pose[:, :3] + rotate(pose[:, 3:], offsets[number]))
        return xp.stack(found, axis=1)


def _joints(model: mujoco.MjModel, body: int) -> list[_Joint]:
    first = int(model.body_jntadr[body])
    numbers = range(first, first + int(model.body_jntnum[body])) if first >= 0 else ()
    kinds, slide = model.jnt_type, mujoco.mjtJoint.mjJNT_SLIDE
    anchors, axes = model.jnt_pos.copy(), model.jnt_axis.copy()
    return [_Joint(j, bool(kinds[j] == slide), anchors[j], axes[j]) for j in numbers]


def _moved(joint: _Joint, position: Array) -> Array:
    """Motion of a body by a joint, body frame, shape [N, 7]. position: shape [N, 1]."""
    xp, axis = array_namespace(position), constant(position, joint.axis)
    if joint.slide:
        turn = xp.broadcast_to(constant(position, _IDENTITY[3:]), (len(position), 4))
        return xp.concat([position * axis, turn], axis=1)
    turn, anchor = quaternion_from_rotation_vector(position * axis), constant(position, joint.anchor)
    return xp.concat([anchor - rotate(turn, anchor), turn], axis=1)

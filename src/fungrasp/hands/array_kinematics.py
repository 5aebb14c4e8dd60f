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
from fungrasp.hands.kinematics import BodyPoints

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
    """Points on the bodies of N hands, in their palms' frames."""

    def __init__(self, hand: Hand, points: BodyPoints):
        """
        Args:
            hand: any hand with hinges and slides.
            points: P of them.
        """
        self._hand, self._offsets = hand, points.offsets
        self._carriers, self._carrier = np.unique(points.bodies, return_inverse=True)
        model = hand.model
        palm = model.body(hand.palm).id
        needed = {palm}
        for body in self._carriers.tolist():
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

    def points(self, independent: Array) -> Array:
        """Palm frame [m], shape [N, P, 3]. independent: joints [rad], shape [N, U]."""
        xp = array_namespace(independent)
        joints = self._hand.all_joints(independent)
        identity = xp.broadcast_to(constant(independent, _IDENTITY), (len(independent), 7))
        poses: dict[int, Array] = {self._palm: identity}
        for body, parent, place, moving in self._bodies:
            pose = compose(poses.get(parent, identity), constant(independent, place))
            for joint in moving:
                pose = compose(pose, _moved(joint, joints[:, joint.column : joint.column + 1]))
            poses[body] = pose
        carriers = xp.stack([poses.get(body, identity) for body in self._carriers.tolist()], axis=1)
        pose = carriers[:, constant(independent, self._carrier)]
        return pose[..., :3] + rotate(pose[..., 3:], constant(independent, self._offsets))


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

"""Forward kinematics of many copies of a hand on any array-API library: for devices, where
``hands.kinematics``, which asks MuJoCo for one hand after the other, can't go."""

from __future__ import annotations

from typing import NamedTuple

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
            points: P of them.
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

"""Retargeting of human grasps to robot hands, by the method of choice."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps import HumanGraspSet, RobotGraspSet, hand_sides
from fungrasp.hands import Hand, as_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.retargeting_problem import RetargetingProblem
from fungrasp.parallel import in_chunks
from fungrasp.retargeting.angle_copy import retarget_by_angle_copy
from fungrasp.retargeting.contact_optimization import RetargetSettings, retarget_by_contact_optimization
from fungrasp.retargeting.dexgraspnet import retarget_by_dexgraspnet

Solver = Callable[[HandPoints, RetargetingProblem, RetargetSettings], tuple[np.ndarray, np.ndarray]]
METHODS: dict[str, Solver] = {
    "ours": retarget_by_contact_optimization,
    "angle-copy": retarget_by_angle_copy,
    "dexgraspnet": retarget_by_dexgraspnet,
}


def retarget(
    grasps: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand | str,
    method: str = "ours",
    settings: RetargetSettings | None = None,
    threads: int = 0,
    chunk: int = 64,
    progress: Callable[[int], None] = lambda count: None,
) -> RobotGraspSet:
    """Retarget human grasps to a robot hand.

    Args:
        grasps: N human grasps.
        objects: each object of the grasps, by name.
        hand: the robot hand, or its name.
        method: one of ``METHODS``.
        settings: weights and iterations; the defaults if None.
        threads: 0 means all processors. The result does not depend on it.
        chunk: grasps solved together.
        progress: called with the number of grasps that have just been finished.

    Raises:
        FungraspError: no such method, no grasps, a missing object, or a grasp of a left hand for a right one
            or the other way round.
    """
    if method not in METHODS:
        raise UnknownNameError("retargeting method", method, METHODS)
    if not isinstance(grasps, HumanGraspSet):
        raise FungraspError(f"only human grasps can be retargeted, not a {type(grasps).__name__}")
    if not len(grasps):
        raise FungraspError("there are no grasps to retarget: the set is empty")
    hand = as_hand(hand)
    check_objects(grasps.object_name.tolist(), objects)
    other = np.flatnonzero(hand_sides(grasps.hand_joints) != hand.side)
    if len(other):
        raise FungraspError(
            f"'{hand.name}' is a {hand.side} hand, but {len(other)} of {len(grasps)} grasps are of the other "
            f"hand (row {other[0]}, {grasps.object_name[other[0]]}); mirror the grasps and their objects: "
            "--mirror, or fungrasp.grasps.mirrored_grasps"
        )
    settings = settings or RetargetSettings()
    shared = HandPoints(HandKinematics(hand, min(chunk, len(grasps))))
    _ = shared.dense  # once, not in each thread
    problem = RetargetingProblem.from_grasps(grasps, objects, shared.match)

    def run(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        part = problem.rows(rows)
        points = shared.for_hands(len(part))
        kinematics = points.kinematics
        pose, independent = METHODS[method](points, part, settings)
        kinematics.update(pose, independent)
        progress(len(part))
        joints = independent @ kinematics.matrix.T + kinematics.offset
        return pose, joints, kinematics.points(points.keypoints), part.contacts

    parts = in_chunks(run, len(grasps), threads, chunk)
    pose, joints, keypoints, contacts = (np.concatenate(x) for x in zip(*parts, strict=True))
    return RobotGraspSet(
        hand=hand.name,
        object_name=grasps.object_name,
        object_mass=grasps.object_mass,
        object_pose=grasps.object_pose,
        object_rest_pose=grasps.object_rest_pose,
        wrist_pose=compose(grasps.object_pose, pose),
        joint_names=hand.joint_names,
        joint_positions=joints,
        keypoints=transform_points(grasps.object_pose, keypoints),
        link_contacts=contacts,
        task=grasps.task,
    )

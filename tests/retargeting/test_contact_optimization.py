"""Several starts for grasps that are not firm, or far from the human ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from retarget_scenes import held, plain_objects

from fungrasp.geometry.poses import compose, invert
from fungrasp.hands import load_hand
from fungrasp.hands.correspondence import correspond
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.firmness import unresisted_share
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.retargeting_problem import RetargetingProblem
from fungrasp.retargeting import RetargetSettings, retarget
from fungrasp.retargeting.contact_optimization import turned_about_fingertips


def test_turns_leave_the_mean_fingertip_where_it_is():
    points = HandPoints(HandKinematics(load_hand("allegro"), 2))
    kinematics, last = points.kinematics, points.match.far[points.match.is_last]
    pose = np.array([[0.1, -0.2, 0.3, 1, 0, 0, 0], [0, 0.1, 0, 0.5, 0.5, -0.5, 0.5]])
    joints = np.repeat((0.5 * (kinematics.lower + kinematics.upper))[None], 2, axis=0)

    def tip(wrist: np.ndarray) -> np.ndarray:
        kinematics.update(wrist, joints)
        return kinematics.points(points.keypoints)[:, last].mean(axis=1)

    before = tip(pose)
    turned = turned_about_fingertips(points, pose, joints, np.array([[0.35, 0, 0], [0.1, -0.2, 0.3]]))
    np.testing.assert_allclose(tip(turned), before, atol=1e-12)
    angle = 2 * np.arccos(np.abs(compose(invert(pose), turned)[:, 3]))
    np.testing.assert_allclose(angle, [0.35, np.linalg.norm([0.1, -0.2, 0.3])], atol=1e-9)


def test_heavy_objects_are_gripped_more_firmly_than_from_one_start():
    grasps, objects, hand = held(), plain_objects(), load_hand("allegro")
    grasps = replace(grasps, object_mass=np.full(len(grasps), 0.5))
    single = RetargetSettings(start_turns=())
    share = {}
    for name, settings in (("single", single), ("several", RetargetSettings())):
        robot = retarget(grasps, objects, hand, settings=settings, threads=1)
        problem = RetargetingProblem.from_grasps(grasps, objects, correspond(hand))
        points = HandPoints(HandKinematics(hand, len(grasps)))
        wrist = compose(invert(grasps.object_pose), robot.wrist_pose)
        joints = hand.independent(robot.joint_positions)
        share[name] = unresisted_share(points.dense, problem, wrist, joints)
    assert share["several"].mean() < share["single"].mean() - 0.02


def test_light_objects_that_are_held_well_have_one_start():
    grasps, objects, hand = held(), plain_objects(), load_hand("allegro")
    single, several = (
        retarget(grasps, objects, hand, settings=settings, threads=1)
        for settings in (RetargetSettings(start_turns=(), good_enough=1e6), RetargetSettings(good_enough=1e6))
    )
    np.testing.assert_array_equal(single.joint_positions, several.joint_positions)

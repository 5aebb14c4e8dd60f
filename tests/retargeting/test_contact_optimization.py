"""Several starts for grasps that are not firm, or far from the human ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from odd_hands import odd_hand
from retarget_scenes import held, plain_objects

from fungrasp.geometry.poses import compose, invert
from fungrasp.hands import load_hand
from fungrasp.hands.adding.add_hand import Answers, add_hand
from fungrasp.hands.correspondence import correspond
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.terms import contact_error
from fungrasp.optimization.wrench_resistance import unresisted_share
from fungrasp.retargeting import RetargetSettings, retarget
from fungrasp.retargeting.contact_optimization import STARTS, moved_starts, turned_about_fingertips


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


def contact_errors(settings: RetargetSettings | None) -> tuple[np.ndarray, np.ndarray]:
    """Mean contact error [m] and unresisted share of heavy things."""
    grasps, objects, hand = held(), plain_objects(), load_hand("allegro")
    grasps = replace(grasps, object_mass=np.full(len(grasps), 0.5))
    robot = retarget(grasps, objects, hand, settings=settings, threads=1)
    problem = RetargetingProblem.from_grasps(grasps, objects, correspond(hand))
    points = HandPoints(HandKinematics(hand, len(grasps)))
    solution = compose(invert(grasps.object_pose), robot.wrist_pose), hand.independent(robot.joint_positions)
    return (
        contact_error(points, problem, *solution),
        unresisted_share(points.dense, problem, *solution),
    )


def test_starts_and_likeness_decide_between_firm_and_as_shown():
    shown_error, shown_share = contact_errors(RetargetSettings(likeness=np.inf))
    firm_error, firm_share = contact_errors(RetargetSettings(likeness=0.0))
    assert firm_share.mean() < shown_share.mean() - 0.02
    assert shown_error.mean() < firm_error.mean() - 0.002
    single, several = (contact_errors(settings)[1] for settings in (RetargetSettings(starts=()), None))
    assert several.mean() < single.mean() - 0.02, "firmer from several starts than from one"


def test_a_grasp_as_shown_has_one_start():
    shown, one = (
        retarget(held(), plain_objects(), load_hand("allegro"), settings=settings, threads=1)
        for settings in (RetargetSettings(likeness=np.inf), RetargetSettings(starts=()))
    )
    np.testing.assert_array_equal(shown.joint_positions, one.joint_positions)


def test_starts_of_a_left_hand_are_those_of_a_right_one_in_a_mirror(tmp_path: Path):
    found = []
    for side in ("right", "left"):
        path = tmp_path / f"{side}.xml"
        path.write_text(odd_hand(left=side == "left"))
        hand = load_hand(add_hand(path, tmp_path / f"{side}-hand", answers=Answers())[0])
        points = HandPoints(HandKinematics(hand, len(STARTS)))
        joints = np.repeat((0.5 * (points.kinematics.lower + points.kinematics.upper))[None], len(STARTS), 0)
        pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(STARTS), 1))
        found.append(moved_starts(points, pose, joints, STARTS)[0])
    # The hands are each other's mirror images across y = 0.
    np.testing.assert_allclose(found[0], found[1] * [1, -1, 1, 1, -1, 1, -1], atol=1e-6)

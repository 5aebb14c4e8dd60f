"""Several starts for grasps that are not firm or not as shown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from odd_hands import odd_hand
from retarget_scenes import held, plain_objects

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import static_quality
from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import HumanGraspSet, builtin_grasps
from fungrasp.hands import load_hand
from fungrasp.hands.adding.add_hand import Answers, add_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.wrench_resistance import NO_GRIP, torque_limits, unresisted_share
from fungrasp.retargeting import RetargetSettings, retarget
from fungrasp.retargeting.contact_optimization import moved
from fungrasp.retargeting.settings import STARTS, Start


def test_turns_leave_the_mean_fingertip_where_it_is():
    points = HandPoints(HandKinematics(load_hand("allegro"), 2))
    kinematics, last = points.kinematics, points.match.far[points.match.is_last]
    pose = np.array([[0.1, -0.2, 0.3, 1, 0, 0, 0], [0, 0.1, 0, 0.5, 0.5, -0.5, 0.5]])
    joints = np.repeat((0.5 * (kinematics.lower + kinematics.upper))[None], 2, axis=0)

    def tip(wrist: np.ndarray) -> np.ndarray:
        kinematics.update(wrist, joints)
        return kinematics.points(points.keypoints)[:, last].mean(axis=1)

    before = tip(pose)
    turned = moved(points, pose, joints, Start((0.1, -0.2, 0.3), (0.0, 0.0, 0.0)))[0]
    np.testing.assert_allclose(tip(turned), before, atol=1e-12)
    angle = 2 * np.arccos(np.abs(compose(invert(pose), turned)[:, 3]))
    np.testing.assert_allclose(angle, np.linalg.norm([0.1, -0.2, 0.3]), atol=1e-9)


def judged(human: HumanGraspSet, objects: Mapping[str, ObjectModel], starts: tuple[Start, ...]):
    """Distance of the wanted links' places from the person's [m], whether they are on the person's side,
    shape [N, S] each, NaN where a link is not wanted, and the unresisted share of the load, shape [N]."""
    hand = load_hand("allegro")
    robot = retarget(human, objects, hand, settings=RetargetSettings(starts=starts), threads=1)
    points = HandPoints(HandKinematics(hand, len(human)))
    problem = RetargetingProblem.from_grasps(human, objects, points.match)
    palm, joints = (
        compose(invert(human.object_pose), robot.wrist_pose),
        hand.independent(robot.joint_positions),
    )
    found = contacts_of_links(points.dense, problem, palm, joints)
    wanted = problem.contacts[:, 1:]
    off = np.linalg.norm(found.place[:, 1:] - problem.surface, axis=-1)
    facing = (found.inward[:, 1:] * problem.normals).sum(axis=-1) < 0
    share = unresisted_share(found, problem, torque_limits(hand))
    return np.where(wanted, off, np.nan), np.where(wanted, facing, np.nan), share


def test_links_touch_where_the_person_did_and_more_starts_bring_them_nearer():
    human, objects = held(), plain_objects()
    off, facing, share = judged(human, objects, STARTS)
    assert np.nanmean(off) < 0.005 and np.nanmax(off) < 0.02 and np.nanmin(facing) == 1
    assert np.all(share < NO_GRIP)
    assert np.nanmean(off) < np.nanmean(judged(human, objects, STARTS[:1])[0]) - 0.001


def test_what_is_not_as_shown_is_solved_from_further_starts():
    human = builtin_grasps().select(np.array([72, 3, 21]))
    shown = []
    for count in (0, RetargetSettings().further_starts):
        settings = RetargetSettings(further_starts=count)
        robot = retarget(human, None, "leap", settings=settings, threads=1)
        shown.append(static_quality(robot, human, exact=False).held_as_shown)
    np.testing.assert_array_equal(shown, [[0, 1, 0], [1, 1, 1]])
    with pytest.raises(FungraspError, match="negative"):
        RetargetSettings(further_starts=-1)


def test_starts_of_a_left_hand_are_those_of_a_right_one_in_a_mirror(tmp_path: Path):
    found = []
    for side in ("right", "left"):
        path = tmp_path / f"{side}.xml"
        path.write_text(odd_hand(left=side == "left"))
        hand = load_hand(add_hand(path, tmp_path / f"{side}-hand", answers=Answers())[0])
        points = HandPoints(HandKinematics(hand, 1))
        joints = (0.5 * (points.kinematics.lower + points.kinematics.upper))[None]
        pose = np.array([[0.0, 0, 0, 1, 0, 0, 0]])
        found.append(np.concatenate([moved(points, pose, joints, start)[0] for start in STARTS]))
    # The hands are each other's mirror images across y = 0.
    np.testing.assert_allclose(found[0], found[1] * [1, -1, 1, 1, -1, 1, -1], atol=1e-6)

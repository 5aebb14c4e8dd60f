"""Several starts for grasps that are not firm or not as shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from odd_hands import odd_hand

from fungrasp.evaluation import static_quality
from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import builtin_grasps
from fungrasp.hands import load_hand
from fungrasp.hands.adding.add_hand import Answers, add_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.hand_state import HandPoints
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


def test_what_is_not_as_shown_is_solved_from_further_starts():
    human = builtin_grasps().select(np.array([72, 3, 21]))
    shown = []
    for count in (0, RetargetSettings().further_starts):
        settings = RetargetSettings(further_starts=count)
        robot = retarget(human, None, "leap", settings=settings, threads=1)
        shown.append(static_quality(robot, human, exact=False).held_as_shown)
    np.testing.assert_array_equal(shown, [[0, 1, 0], [1, 1, 1]])


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

"""Use tests: what is held firmly stays, what is held loosely does not, and where fingers are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, plan, scene

from fungrasp.geometry.poses import compose, euler_angles, invert, quaternion_from_rotation_vector, relative
from fungrasp.grasps.as_shown import ShownContacts
from fungrasp.hands import Hand
from fungrasp.policies import OpenLoopPolicy
from fungrasp.task import LiftEnvironment, play
from fungrasp.task.use import UseMotion, play_use
from fungrasp.task.use.episode import FingerHold
from fungrasp.task.use.geometry import far_end, turning_frame
from fungrasp.task.use.motion import TriggerPress
from fungrasp.task.use.outcome import functional_contact
from fungrasp.task.use.worlds import UseWorlds


@cache
def _lifted() -> tuple[LiftEnvironment, object, np.ndarray]:
    environment = LiftEnvironment(scene(), 2, threads=1)
    environment.settle(grasps_and_objects()[0])
    outcomes = play(environment, OpenLoopPolicy(), plan())
    return environment, environment.engine.get_state(), outcomes.success


def lifted() -> tuple[LiftEnvironment, np.ndarray]:
    """A can and a ball, held up at the end of their lift tests; where the person touched is not known."""
    environment, state, held = _lifted()
    environment.task.shown = None
    environment.engine.restore(state)
    environment.engine.set_parameters(table_height=np.zeros(2))
    assert held.all()
    return environment, held


def still(duration: float = 0.4, **options) -> UseMotion:
    return UseMotion("still", ("wait",), duration, **options)


def test_what_is_only_held_stays_in_the_palm():
    environment, held = lifted()
    use = play_use(environment, [still()] * 2, held)
    assert use.success.all() and use.motion.tolist() == ["still"] * 2
    assert (use.shift_m < 2e-3).all() and (use.turn_rad < np.deg2rad(3)).all()


def test_a_use_counts_only_as_shown():
    environment, held = lifted()
    shown = ShownContacts.of(grasps_and_objects()[0])
    assert shown is not None
    environment.task.shown = shown
    there = environment.task.as_shown()
    assert there is not None
    touching = environment.task.measurements.middle.touching[:, 1:]
    # At right angles to every side.
    same = replace(shown, places=there.points, wanted=touching, normals=np.zeros_like(shown.normals))
    environment.task.shown = same
    assert play_use(environment, [still()] * 2, held).success.all()
    environment, held = lifted()
    environment.task.shown = replace(same, places=there.points + np.array([0.0, 0.0, 0.05]))
    use = play_use(environment, [still()] * 2, held)
    assert use.reason.tolist() == ["not held as shown"] * 2


def test_a_pull_that_no_hand_withstands_takes_the_object_out():
    environment, held = lifted()
    use = play_use(environment, [still(pull=10.0), still(pull=200.0)], held)
    assert use.shift_m[1] > 0.01 and use.shift_m[1] > use.shift_m[0]
    assert use.reason[1] == "the object slipped in the palm"


def test_a_torque_turns_what_is_held_loosely():
    held = lifted()[1]
    weak, strong = (
        play_use(lifted()[0], [still(torque=torque)] * 2, held).turn_rad for torque in (0.01, 2.0)
    )
    assert (strong > weak).all() and (strong > np.deg2rad(10)).any()


def test_the_palm_turns_as_the_motion_says():
    environment, held = lifted()
    before = environment.engine.palm_pose
    half = UseMotion("tip", ("tip",), 1.0, turn="tilt", segments=((np.deg2rad(60), 1.0, 0.2),))
    poses = []
    play_use(environment, [half] * 2, held, lambda controls: poses.append(environment.engine.palm_pose))
    turned = compose(poses[-1], invert(before))
    angle = 2 * np.arccos(np.clip(np.abs(turned[:, 3]), 0, 1))
    np.testing.assert_allclose(np.rad2deg(angle), 60, atol=4)
    np.testing.assert_allclose(poses[-1][:, :3], before[:, :3], atol=6e-3)


def test_what_is_held_is_not_pushed_ahead_of_a_palm_that_begins_to_turn():
    """With a wrist far lighter than its damping stands for it is, by 1 mm and 1.5 degrees (decision 0093)."""
    environment, held = lifted()
    begun = UseMotion("tip", ("tip",), 0.2, turn="tilt", segments=((np.deg2rad(6), 0.2, 0.02),))
    use = play_use(environment, [begun] * 2, held)
    assert (use.shift_m < 5e-4).all() and (use.turn_rad < np.deg2rad(0.6)).all()


def test_worlds_that_were_not_held_and_tasks_without_motion_are_not_tested():
    environment, _ = lifted()
    use = play_use(environment, [still(), None], np.array([False, True]))
    assert use.motion.tolist() == ["", ""] and not use.success.any()
    assert np.isnan(use.shift_m).all() and np.isnan(use.functional_contact[0])


def test_a_finger_presses_with_the_force_it_is_asked_for():
    environment, held = lifted()
    soft = play_use(environment, [still(1.0, trigger=TriggerPress("index", "", 0.5))] * 2, held)
    environment, held = lifted()
    hard = play_use(environment, [still(1.0, trigger=TriggerPress("index", "", 2.0))] * 2, held)
    assert (hard.trigger_force_n > soft.trigger_force_n).any()
    environment, held = lifted()
    missing = play_use(environment, [still(trigger=TriggerPress("pinky", "", 5.0))] * 2, held)
    assert missing.reason.tolist() == ["the hand has no pinky finger"] * 2


def test_a_finger_that_closes_a_gap_presses_as_hard_and_one_that_is_pushed_back_does_not_yield():
    motion = still(1.0, trigger=TriggerPress("index", "", 5.0))
    start, press = np.array([[0.5, -0.5, 0.2]]), np.array([[0.1, -0.1, 0.0]])
    none, pose = np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    worlds = UseWorlds([motion], pose, none, none, np.zeros(1), press, squeeze=none)
    for moved in (0.0, 0.3, -0.3):
        joints = start + moved * np.sign(press)
        targets = worlds.fingers_at(1.0, joints, start, np.full((1, 3), 7.0), np.zeros(3))
        expected = start + press + max(moved, 0.0) * np.sign(press)
        np.testing.assert_allclose(targets[:, :2], expected[:, :2])
        assert targets[0, 2] == 7.0, "a finger that does not press holds on"


def test_what_is_lost_is_not_followed():
    """Its world stands still: nothing pulls at it through the room."""
    environment, held = lifted()
    use = play_use(environment, [still(2.0, pull=500.0)] * 2, held)
    assert not use.success.any() and (use.shift_m > 0.1).all()
    assert (np.linalg.norm(environment.engine.object_pose[:, :2], axis=1) < 3.0).all()


def test_what_was_let_go_and_taken_away_is_not_followed():
    """Its far end is pulled at no longer, which would spin it ever faster."""
    environment, held = lifted()
    use = play_use(environment, [still(0.2, pull=10.0)] * 2, held)
    engine = environment.engine
    away = np.linalg.norm(engine.object_pose[:, :3] - engine.palm_pose[:, :3], axis=1)
    assert (use.shift_m < 0.05).all() and not engine.link_contacts.any(), "gone while the hand opened"
    assert (away < 0.4).all() and not engine.diverged.any()


def test_functional_contact_counts_the_fingers_on_the_part_that_the_person_held():
    environment, _ = lifted()
    share, parts = functional_contact(environment)
    touching = environment.engine.link_contacts & environment.task.target_contacts
    np.testing.assert_allclose(share, touching.sum(1) / environment.task.target_contacts.sum(1))
    assert set(parts[0]) == {"body"}, "a can has one part"


def test_hinges_stay_away_from_where_two_coincide():
    rng = np.random.default_rng(0)
    for _ in range(200):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        pose = np.array([0, 0, 0, *rng.normal(size=4)])
        pose[3:] /= np.linalg.norm(pose[3:])
        frame = turning_frame(axis, pose)
        angles = []
        for angle in np.linspace(-np.deg2rad(100), np.deg2rad(100), 41):
            turned = compose(np.array([0, 0, 0, *quaternion_from_rotation_vector(angle * axis)]), pose)
            angles.append(euler_angles(relative(frame, turned)[3:]))
        angles = np.array(angles)
        assert np.abs(angles[:, 1]).max() < np.deg2rad(46)
        assert np.abs(np.diff(angles, axis=0)).max() < 0.5, "none of them jumps"


def test_the_far_end_is_the_farthest_point_of_the_surface():
    objects = grasps_and_objects()[1]
    can = objects["can"]
    identity = np.array([0, 0, 0, 1.0, 0, 0, 0])
    above = np.array([0, 0, 1.0, 1.0, 0, 0, 0])
    assert far_end(can, identity, above)[2] == pytest.approx(can.vertices[:, 2].min())


# Fingers that hold on: joints stay where they were, as far as torques reach.

KP, LIMIT, CONTACT = 4.0, 0.7, 20.0
"""Of the servos [N m/rad] and [N m]; stiffness of what the joints press against [N m/rad]."""


def two_joints() -> Hand:
    servo = SimpleNamespace(kp=KP, force_limit=LIMIT)
    return cast(Any, SimpleNamespace(actuators={"a": servo, "b": servo}))


@pytest.mark.parametrize("load", [0.3, 0.9])
def test_joints_return_to_where_they_were_as_far_as_the_torque_reaches(load):
    """Two joints at rest in a contact, and a load on one of them: 0.9 N m is more than its servo's limit."""
    place = np.array([[0.5, 0.5]])
    joints = place.copy()
    hold = FingerHold(two_joints(), joints, joints)
    pull = np.array([[load, 0.0]])
    moved = []
    for _ in range(60):
        setpoints = hold.keep(joints)
        free = (KP * setpoints + CONTACT * place - pull) / (KP + CONTACT)
        torque = np.clip(KP * (setpoints - free), -LIMIT, LIMIT)
        joints = place + (torque - pull) / CONTACT
        moved.append(joints - place)
    assert abs(moved[-1][0, 1]) < 1e-9
    left = max(load - LIMIT, 0.0) / CONTACT
    assert moved[-1][0, 0] == pytest.approx(-left, abs=1e-3)
    assert abs(moved[0][0, 0]) > left + 0.005, "it gave way at first"


def test_a_setpoint_is_never_farther_from_its_joint_than_the_torque_limit():
    joints = np.array([[0.5, 0.5]])
    hold = FingerHold(two_joints(), joints, joints)
    for _ in range(100):
        setpoints = hold.keep(joints - 0.2)
    np.testing.assert_allclose(setpoints, joints - 0.2 + LIMIT / KP)
    for _ in range(2):
        setpoints = hold.keep(joints + 0.3)
    assert (setpoints < joints + 0.3).all(), "it comes back without delay"

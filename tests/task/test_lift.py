"""The lift test: when things happen."""

from __future__ import annotations

import numpy as np
import pytest
from planned_grasps import grasps_and_objects, scene, start
from task_scenes import hand, plain, ready, run, stay

from fungrasp.geometry.poses import compose
from fungrasp.simulation import MujocoCpuEngine, SceneSettings, build_scene
from fungrasp.task import Action, LiftProtocol, LiftTask

STICK = plain("stick", (0.4, 0.05, 0.05))
CUBE = plain("cube", (0.06, 0.06, 0.06))
CONTROL = LiftProtocol().control_period


def test_objects_settle_before_the_hand_starts_30_cm_away():
    task = ready([STICK, CUBE])
    np.testing.assert_allclose(task.settled_pose[:, 2], [0.025, 0.03], atol=1e-3)
    np.testing.assert_allclose(task.measurements.settled_height, [0.025, 0.03], atol=1e-3)
    palm = task.engine.palm_pose
    away = np.linalg.norm(palm[:, :3] - task.settled_pose[:, :3], axis=1)
    np.testing.assert_allclose(away, LiftProtocol().start_distance, atol=1e-3)
    np.testing.assert_array_equal(task.engine.object_velocity, 0.0)
    # Nothing moves if nothing is asked for.
    engine = task.engine
    controls = engine.controls(palm, np.zeros((2, 3)), task.setpoints.fingers)
    engine.step(controls, 1)
    assert engine.object_on_table.all()
    np.testing.assert_allclose(engine.palm_pose, palm, atol=1e-6)


def test_fingers_start_half_closed():
    grasps, _ = grasps_and_objects()
    task = start().task
    limits = hand().joint_limits
    expected = np.clip(0.5 * grasps.joint_positions, limits[:, 0], limits[:, 1])
    np.testing.assert_allclose(task.engine.joint_positions, expected, atol=0.02)
    wanted = compose(task.settled_pose, grasps.wrist_pose_object)
    np.testing.assert_allclose(task.engine.wrist_frame, wanted, atol=1e-12)


def test_the_lift_begins_at_6_s_at_the_latest_and_the_hold_lasts_3_s():
    task = ready([CUBE])
    run(task)
    p = task.protocol
    assert task.lift_time[0] == pytest.approx(6.0)
    assert 1.2 < task.hold_time[0] - task.lift_time[0] < 1.7
    assert -1e-9 <= task.time[0] - (task.hold_time[0] + p.hold_time) < CONTROL
    lifted = task.setpoints.wrist.pose[0, 2] - task.engine.wrist_frame[0, 2]
    assert lifted == pytest.approx(p.lift_height, abs=2e-3)


def test_a_hand_whose_goal_never_rests_is_judged_all_the_same():
    # The goal runs ahead of the wrist, as one does that is carried by an object that rolls.
    task = ready([CUBE])
    for _ in range(round((task.protocol.rise_time + task.protocol.hold_time) / CONTROL)):
        assert not task.done[0]
        ahead = task.setpoints.wrist.pose + np.array([0.2, 0, 0, 0, 0, 0, 0])
        task.step(Action(ahead, task.setpoints.fingers.copy(), np.array([True])))
    assert task.hold_time[0] - task.lift_time[0] == pytest.approx(task.protocol.rise_time, abs=CONTROL)
    assert task.done[0] and not task.outcomes().success[0]


def test_a_lift_begins_when_asked_for_and_cannot_be_taken_back():
    task = ready([CUBE, CUBE])
    task.step(stay(task, np.array([True, False])))
    for _ in range(30):
        task.step(stay(task, np.array([False, False])))
    assert task.lift_time[0] == 0.0 and np.isinf(task.lift_time[1])
    raised = task.setpoints.wrist.pose[:, 2] - task.engine.wrist_frame[:, 2]
    np.testing.assert_allclose(raised, [0.15, 0.0], atol=2e-3)


def test_worlds_that_are_done_wait_for_the_others():
    task = ready([CUBE, CUBE])
    frozen = None
    while not task.done.all():
        task.step(stay(task, np.array([True, False])))
        if task.done[0] and frozen is None:
            frozen = task.engine.positions[0], task.time[0]
    assert frozen is not None
    np.testing.assert_array_equal(task.engine.positions[0], frozen[0])
    assert task.time[0] == frozen[1]


def test_episodes_that_begin_anew_leave_the_others_alone():
    alone, disturbed = ready([CUBE] * 3), ready([CUBE] * 3)
    for task in (alone, disturbed):
        for _ in range(4):
            task.step(stay(task, np.array([True, True, False])))
    world = np.array([1])
    pose = disturbed.settled_pose[world] + [0.1, 0, 0, 0, 0, 0, 0]
    wrist = disturbed.engine.wrist_frame[world] + [0.1, 0, 0, 0, 0, 0, 0]
    links = np.zeros((1, len(hand().links)), dtype=bool)
    closed = np.full((1, disturbed.setpoints.fingers.shape[1]), 0.3)
    disturbed.begin(world, pose, wrist, wrist, closed, links)
    for _ in range(4):
        for task in (alone, disturbed):
            task.step(stay(task))
    others = [0, 2]
    np.testing.assert_array_equal(disturbed.engine.positions[others], alone.engine.positions[others])
    for name in ("time", "lift_time", "settled_pose", "target_contacts"):
        np.testing.assert_array_equal(getattr(disturbed, name)[others], getattr(alone, name)[others])
    for a, b in (
        (disturbed.setpoints.fingers, alone.setpoints.fingers),
        (disturbed.setpoints.wrist.pose, alone.setpoints.wrist.pose),
        (disturbed.measurements.height, alone.measurements.height),
    ):
        np.testing.assert_array_equal(a[others], b[others])
    np.testing.assert_allclose(disturbed.time, [0.8, 0.4, 0.8])
    assert disturbed.lift_time.tolist() == [0.0, np.inf, np.inf]
    np.testing.assert_allclose(disturbed.engine.object_pose[1, :3], pose[0, :3], atol=1e-4)
    np.testing.assert_allclose(disturbed.engine.palm_pose[1, :3], wrist[0, :3], atol=2e-3)
    np.testing.assert_allclose(disturbed.engine.joint_positions[1], 0.3, atol=0.02)


def test_an_episode_may_begin_on_its_way():
    """With the wrist under way and the clock running."""
    task = ready([CUBE])
    velocity = np.array([[0.1, 0.0, 0.05]])
    target, fingers = task.engine.wrist_frame, task.setpoints.fingers.copy()
    begin = target - [0.2, 0, 0.1, 0, 0, 0, 0]
    settled, contacts = task.settled_pose.copy(), task.target_contacts.copy()
    task.begin(np.zeros(1, int), settled, target, begin, fingers, contacts, velocity, np.array([4.5]))
    assert task.time[0] == 4.5
    before = task.engine.palm_pose
    task.step(Action(begin + 10 * np.pad(velocity, ((0, 0), (0, 4))), fingers, np.zeros(1, bool)))
    moved = (task.engine.palm_pose - before)[0, :3]
    np.testing.assert_allclose(moved, 0.1 * velocity[0], atol=3e-3)
    run(task)
    assert task.lift_time[0] == pytest.approx(6.0)


def test_objects_are_lost_when_they_stay_down_a_while_after_the_lift_began():
    task = ready([CUBE, CUBE])
    p, lost = task.protocol, []
    for _ in range(15):
        task.step(stay(task, np.array([True, False])))
        lost.append(task.lost)
    first = int(np.argmax([world[0] for world in lost]))
    assert p.lost_after < task.time[0] - CONTROL * (14 - first) <= p.lost_after + CONTROL + 1e-9
    assert not np.array(lost)[:, 1].any(), "its lift has not begun"
    raised = task.settled_pose.copy()
    raised[:, 2] += p.lost_height + 0.01
    task.engine.set_state(object_pose=raised)
    assert not task.lost.any()


def test_the_clock_does_not_depend_on_the_physics_step(timestep=0.01):
    grasps, objects = grasps_and_objects()
    other = build_scene(hand(), objects, SceneSettings(timestep=timestep))
    assert other.objects == scene().objects
    engine = MujocoCpuEngine(other, 2, 1)
    engine.set_parameters(object_index=other.indices(grasps.object_name.tolist()))
    task, calls = LiftTask(engine), []
    task.settle(grasps)
    task.step(stay(task), after=lambda: calls.append(task.time[0]))
    np.testing.assert_allclose(calls, [0.02, 0.04, 0.06, 0.08, 0.1])

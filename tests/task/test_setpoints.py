"""Setpoints: within the servos' ranges, and as late as actions are."""

from __future__ import annotations

import numpy as np
import pytest
from task_scenes import hand, plain, ready, run

from fungrasp.task import Action

CUBE = plain("cube", (0.06, 0.06, 0.06))


def test_servo_targets_are_clipped_to_their_ranges():
    task = ready([CUBE])
    wild = np.full_like(task.setpoints.fingers, 10.0)
    target = task.engine.wrist_frame
    for _ in range(8):
        task.step(Action(target, wild, np.zeros(1, bool)))
    low, high = task.scene.servo_limits.T
    assert (task.setpoints.fingers <= high).all()
    assert (task.engine.joint_positions[0] < hand().joint_limits[:, 1] + 0.1).all()
    for _ in range(8):
        task.step(Action(target, -wild, np.zeros(1, bool)))
    assert (task.setpoints.fingers >= low).all()


def test_actions_take_effect_after_the_delay():
    task = ready([CUBE] * 5)
    setpoints = task.setpoints
    setpoints.delay[:] = [0.0, 0.02, 0.04, 0.05, 0.1]
    start, before = setpoints.wrist.pose[0, 2], setpoints.fingers.copy()
    goal, fingers = task.engine.wrist_frame, before + 0.2
    goal[:, 2] += 0.05
    heights, angles = [], []

    def watch() -> None:
        heights.append(setpoints.wrist.pose[:, 2] - start)
        angles.append((setpoints.fingers - before)[:, 5])

    for _ in range(3):
        task.step(Action(goal, fingers, np.zeros(5, bool)), after=watch)
    late = np.array([0, 1, 2, 3, 5])
    for values in (np.array(heights), np.array(angles)):
        np.testing.assert_array_equal(np.argmax(values > 1e-9, axis=0), late)
        for world, steps in enumerate(late):
            np.testing.assert_allclose(values[steps:, world], values[: 15 - steps, 0], atol=1e-12)
    np.testing.assert_allclose(angles[4][0], 0.2, atol=1e-12)
    np.testing.assert_allclose(angles[-1], 0.2, atol=1e-12)


def test_a_delay_delays_the_hold_and_no_more():
    task = ready([CUBE, CUBE])
    task.setpoints.delay[:] = [0.0, 0.1]
    run(task, lift_from=0.2)
    np.testing.assert_allclose(task.lift_time, 0.2)
    assert task.hold_time[0] > 1.4
    assert task.hold_time[1] - task.hold_time[0] == pytest.approx(0.1)


def test_a_world_that_begins_anew_forgets_what_it_was_asked_for():
    task = ready([CUBE, CUBE])
    setpoints = task.setpoints
    setpoints.delay[:] = 0.1
    goal = task.engine.wrist_frame + np.array([0.0, 0.0, 0.1, 0, 0, 0, 0])
    task.step(Action(goal, setpoints.fingers + 0.3, np.zeros(2, bool)))
    pose, fingers = setpoints.wrist.pose[1:].copy(), setpoints.fingers[1:].copy()
    setpoints.begin(np.array([1]), pose, np.zeros((1, 3)), fingers)
    sequence = setpoints.advance(goal, setpoints.fingers)
    np.testing.assert_allclose(sequence.palm[:, 1], np.repeat(pose, 5, axis=0), atol=1e-12)
    np.testing.assert_allclose(sequence.fingers[:, 1], np.repeat(fingers, 5, axis=0), atol=1e-12)
    assert np.abs(sequence.palm[:, 0] - sequence.palm[0, 0]).max() > 1e-3

"""Attempts: the lift is tested, and where the object stays behind the plan is taken back once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fungrasp.policies.grasp_attempts import AttemptSettings, GraspAttempts
from fungrasp.task import Observation

CLOSING, LIFT = np.full(2, 16), np.full(2, 30)
S = AttemptSettings()


def seen(clock: int, object_height=(0.0, 0.0), palm_height=(0.0, 0.0), age: float = 0.1) -> Observation:
    pose = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    thing, palm = pose.copy(), pose.copy()
    thing[:, 2], palm[:, 2] = object_height, palm_height
    joints = np.zeros((2, 3))
    return Observation(
        time=np.full(2, 0.1 * clock),
        time_since_lift=np.full(2, -1.0),
        joint_positions=joints,
        joint_setpoints=joints,
        palm_pose=palm,
        palm_setpoint=palm,
        object_pose=thing,
        object_pose_age=np.full(2, age),
    )


def played(until: int, held=(True, False), age: float = 0.1, touching=None, late: int = 0) -> GraspAttempts:
    """Attempts up to a control step of the clock; held objects rise with the palm from step 30 on."""
    attempts = GraspAttempts(2)
    attempts.begin(np.arange(2), np.zeros(2, dtype=int))
    for clock in range(until + 1):
        height = S.rise * np.clip((clock - 30 - late) / S.test_steps, 0, 1)
        observation = seen(clock, height * np.array(held), np.full(2, height), age)
        attempts.update(observation, np.full(2, clock), CLOSING + late, LIFT + late, touching)
    return attempts


def test_the_palm_rises_for_the_test_and_lifts_what_has_risen_with_it():
    before, during, after = played(29), played(31), played(30 + S.test_steps)
    np.testing.assert_array_equal(before.raised, 0)
    np.testing.assert_array_equal(during.raised, S.rise)
    assert not before.lifting.any() and not during.lifting.any()
    np.testing.assert_array_equal(after.lifting, [True, False])
    np.testing.assert_array_equal(after.failed, [False, True])
    np.testing.assert_array_equal(after.raised, 0)


def test_a_plan_that_has_missed_goes_back_opens_closes_and_lifts_without_another_test():
    missed = 30 + S.test_steps
    steps = [int(played(clock).step[1]) for clock in range(missed, missed + S.open_steps + S.back + 15)]
    start = 16 - S.back
    assert steps[: S.open_steps + 1] == [start] * (S.open_steps + 1)
    assert steps[S.open_steps :] == list(range(start, start + len(steps) - S.open_steps))
    again = missed + S.open_steps + S.back + 14
    assert not played(again - 1).lifting[1]
    assert played(again).lifting[1] and played(again).raised[1] == 0


def test_an_object_that_is_not_seen_is_held_where_links_touch_it():
    end = 30 + S.test_steps
    blind = played(end, held=(False, False), age=1.0)
    np.testing.assert_array_equal(blind.lifting, [True, True])
    felt = played(end, held=(False, False), age=1.0, touching=np.array([1, 0]))
    np.testing.assert_array_equal(felt.lifting, [True, False])
    np.testing.assert_array_equal(felt.failed, [False, True])


@pytest.mark.parametrize("late", [0, 6])
def test_without_time_for_another_attempt_there_is_no_test(late):
    attempts = played(30 + late, late=late)
    assert attempts.lifting.all() == (late > 0)


def test_a_jittering_tracker_is_believed_in_the_mean():
    random = np.random.default_rng(0)
    wrong = 0
    for _ in range(200):
        attempts = GraspAttempts(2)
        attempts.begin(np.arange(2), np.zeros(2, dtype=int))
        for clock in range(31 + S.test_steps):
            height = S.rise * np.clip((clock - 30) / S.test_steps, 0, 1)
            thing = height * np.array([1.0, 0.0]) + random.normal(0, 0.002, 2)
            attempts.update(seen(clock, thing, np.full(2, height)), np.full(2, clock), CLOSING, LIFT)
        wrong += int(attempts.failed[0]) + int(not attempts.failed[1])
    assert wrong < 4


def test_new_episodes_know_nothing_of_those_before():
    attempts = played(30 + S.test_steps)
    attempts.begin(np.array([1]), np.array([0, 5]))
    assert attempts.step[1] == 5 and not attempts.failed[1] and attempts.lifting[0]
    attempts.update(seen(6), np.array([38, 6]), CLOSING, LIFT)
    assert attempts.step[1] == 6


def test_a_lift_that_has_begun_ends_the_test():
    attempts = played(32)
    begun = replace(seen(33), time_since_lift=np.full(2, 0.1))
    attempts.update(begun, np.full(2, 33), CLOSING, LIFT)
    assert attempts.lifting.all() and not attempts.raised.any()

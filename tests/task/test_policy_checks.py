"""A policy of one's own that is wrong says so before its first step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose
from fungrasp.policies import OpenLoopPolicy


@pytest.fixture(scope="module")
def robot():
    return fungrasp.retarget(fungrasp.builtin_grasps()[50])


class NoReset:
    def act(self, observation):
        raise AssertionError


class NoAct:
    def reset(self, plan, observation):
        raise AssertionError


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (NoReset(), r"NoReset lacks the method reset\(plan, observation\)"),
        (NoAct(), r"NoAct lacks the method act\(observation\)"),
        (3.0, "lacks the method reset.* and act"),
        (OpenLoopPolicy, r"pass an instance, OpenLoopPolicy\(\)"),
    ],
)
def test_missing_methods_are_named(robot, policy, words):
    with pytest.raises(FungraspError, match=words):
        fungrasp.evaluate(robot, policy=policy)


CHANGES = {
    r"return a fungrasp.Action, not a tuple": lambda a, plan: (a.palm_goal_world, a.finger_targets, a.lift),
    r"palm_goal_world has shape \(7,\), expected \(1, 7\)": lambda a, plan: replace(
        a, palm_goal_world=a.palm_goal_world[0]
    ),
    r"finger_targets has shape \(1, 15\), expected \(1, 16\)": lambda a, plan: replace(
        a, finger_targets=a.finger_targets[:, 1:]
    ),
    r"lift holds int64, expected bool": lambda a, plan: replace(a, lift=a.lift.astype(int)),
    r"quaternion of length 1": lambda a, plan: replace(a, palm_goal_world=0 * a.palm_goal_world),
    r"is in the object's frame: give .*compose": lambda a, plan: replace(
        a, palm_goal_world=plan.palm_goal_object[:, 0]
    ),
}


@pytest.mark.parametrize("words", CHANGES)
def test_a_wrong_action_is_named_before_the_first_step(robot, words):
    class Wrong(OpenLoopPolicy):
        def reset(self, plan, observation):
            super().reset(plan, observation)
            self.followed, self.steps = plan, 0

        def act(self, observation):
            self.steps += 1
            assert self.steps == 1
            return CHANGES[words](super().act(observation), self.followed)

    with pytest.raises(FungraspError, match=words):
        fungrasp.evaluate(robot, policy=Wrong())


@pytest.mark.parametrize("at", [0, 3])
def test_an_action_that_is_not_finite_is_no_diverged_simulation(robot, at):
    class Broken(OpenLoopPolicy):
        def act(self, observation):
            action = super().act(observation)
            step = round(float(observation.time[0] / 0.1))
            return replace(action, finger_targets=np.where(step < at, 1.0, np.nan) * action.finger_targets)

    words = f"policy Broken returned finger_targets that is not finite at control step {at} of world 0"
    with pytest.raises(FungraspError, match=words):
        fungrasp.evaluate(robot, policy=Broken())


def test_a_plan_in_the_world_is_no_mistake(robot):
    class Template:
        def reset(self, plan, observation):
            self.plan = plan

        def act(self, observation):
            step = (observation.time / self.plan.control_period + 0.5).astype(int)
            goal, fingers = self.plan.at(step)
            return fungrasp.Action(compose(self.plan.object_pose, goal), fingers, step >= self.plan.lift_step)

    assert fungrasp.evaluate(robot, policy=Template()).success.tolist() == [True]

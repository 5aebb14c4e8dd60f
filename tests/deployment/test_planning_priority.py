"""Control runs ahead of other work, planning does not: not for a second attempt either."""

from __future__ import annotations

import os
import threading
from typing import Any

import numpy as np
import pytest
from ideal_twin import IDEAL
from robot_cells import cell_and_hand, grasp_and_object, near_cell, placed

from fungrasp.deployment import wired_deployment
from fungrasp.deployment.deployment_result import DeploymentSettings
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.wired_deployment import DeploymentTask, deploy_on_robot
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.process_priority import NICENESS, at_priority, present_priority, raise_priority
from fungrasp.robots.robot import Robot
from fungrasp.robots.twin.devices import TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.parameters import draw_twin
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import Action, Belief, GraspPlan, Observation

pytest.importorskip("mink")


def niceness() -> int:
    return os.getpriority(os.PRIO_PROCESS, 0)


@pytest.fixture(autouse=True)
def allowed() -> Any:
    usual = present_priority()
    with at_priority(usual):
        if not raise_priority():
            pytest.skip("this user may not raise priorities")
    assert niceness() == usual.niceness != NICENESS
    return usual


class Planner(MotionPlanner):
    """Notes at which priority it, and a thread that it starts, works."""

    seen: tuple[list[int], list[int]] = ([], [])

    def plan(self, grasp: Any, belief: Belief, seed: int = 0) -> GraspPlan:
        self.seen[0].append(niceness())
        thread = threading.Thread(target=lambda: self.seen[1].append(niceness()))
        thread.start()
        thread.join()
        return super().plan(grasp, belief, seed)


class LowAtFirst(OpenLoopPolicy):
    """Lifts too low the first time, and notes at which priority it acts."""

    def __init__(self) -> None:
        self.attempts, self.seen = 0, set()

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        super().reset(plan, observation)
        self.attempts += 1

    def act(self, observation: Observation) -> Action:
        self.seen.add(niceness())
        action = super().act(observation)
        if self.attempts == 1 and action.lift[0]:
            action.palm_goal[:, 2] -= 0.12
        return action


def test_every_plan_is_made_at_the_usual_priority_and_control_runs_ahead(monkeypatch: Any) -> None:
    hand, cell = cell_and_hand()[1], near_cell()
    grasp, thing = grasp_and_object()
    truth = draw_twin(0, len(hand.joint_names), len(hand.actuators), IDEAL)

    def on_twin(*arguments: Any, **options: Any) -> Robot:
        world = TwinWorld(cell, hand, thing, truth)
        world.settle(placed())
        devices = TwinArm(world, cell), TwinHand(world, cell, hand), TwinTracker(world)
        return Robot(cell, hand, *devices, TwinClock(world))

    monkeypatch.setattr(wired_deployment, "wired_robot", on_twin)
    usual, policy, planner = niceness(), LowAtFirst(), Planner(hand, {thing.name: thing})
    task = DeploymentTask(cell, hand, thing, grasp, policy, planner)
    settings = DeploymentSettings(look_time=0.3, until=Phase.HOLD, attempts=2)
    result = deploy_on_robot(task, settings=settings, hold=lambda robot: None)
    assert result.attempts == 2 and not result.fault
    own, started = planner.seen
    assert len(own) >= 2 and set(own) == set(started) == {usual}
    assert policy.seen == {NICENESS}
    assert niceness() == usual, "the next grasp is perceived and planned at it, too"


def test_a_raised_thread_gets_its_priority_back_after_an_error(allowed: Any) -> None:
    with at_priority(allowed):
        raise_priority()
        raised = present_priority()
        with pytest.raises(ValueError, match="made up"), at_priority(allowed):
            assert present_priority() == allowed
            raise ValueError("made up")
        assert present_priority() == raised != allowed
    assert present_priority() == allowed and np.isfinite(niceness())

"""Several attempts on a twin: what is seen not to be held is let go of, and tried again by another plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_cells import Told, deploy

from fungrasp.deployment.log import McapLog, read_log, replay_log
from fungrasp.deployment.phases import Phase
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.twin.twin_model import OBJECT
from fungrasp.task import Action, GraspPlan, Observation

pytest.importorskip("mink")


class Low(OpenLoopPolicy):
    """Lifts by 3 cm only, the first few times."""

    def __init__(self, times: int):
        self._times, self.plans = times, []

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        super().reset(plan, observation)
        self.plans.append(plan)

    def act(self, observation: Observation) -> Action:
        action = super().act(observation)
        if len(self.plans) <= self._times and action.lift[0]:
            action.palm_goal[:, 2] -= 0.12
        return action


def phases(path: Path) -> list[str]:
    return [e["text"] for e in read_log(path).messages["/event"] if e["what"] == "phase"]


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path, Low]:
    pytest.importorskip("mcap")
    path, policy = tmp_path_factory.mktemp("log") / "log.mcap", Low(1)
    with McapLog(path) as log:
        # Let go of from so low, the glass of other grasps topples, and is not found where it stood.
        return deploy(log, policy=policy, until="home", attempts=2, row=9), path, policy


def test_what_is_held_too_low_is_put_down_and_lifted_by_another_attempt(twice: tuple[Any, Path, Low]) -> None:
    outcome, path, policy = twice
    assert outcome.fault == ""
    assert outcome.success and outcome.height > 0.1
    assert outcome.attempts == 2 and not outcome.missed
    once = [Phase.MOVE_TO_START, Phase.GRASP, Phase.LIFT, Phase.HOLD]
    assert phases(path) == [*once, Phase.WITHDRAW, *once, Phase.PUT_DOWN, Phase.HOME, Phase.DONE]
    # The object was put down about where it stood, and looked at again.
    first, second = policy.plans
    assert np.linalg.norm(first.object_pose[0, :3] - second.object_pose[0, :3]) < 0.02
    assert not np.array_equal(first.object_pose, second.object_pose)


def test_the_log_of_two_attempts_replays_to_the_same_actions(twice: tuple[Any, Path, Low]) -> None:
    log = read_log(twice[1])
    assert len(log.further_plans) == 1
    result = replay_log(log, Low(1))
    assert (result.different, result.largest) == (0, 0.0)
    assert result.steps > 100


def test_the_last_attempt_that_fails_ends_at_home_with_an_open_hand(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    with McapLog(tmp_path / "log.mcap") as log:
        outcome = deploy(log, policy=Low(2), until="home", attempts=2)
    assert outcome.fault == "" and outcome.phase is Phase.DONE
    assert outcome.missed and outcome.attempts == 2 and not outcome.success
    assert phases(tmp_path / "log.mcap")[-3:] == [Phase.WITHDRAW, Phase.HOME, Phase.DONE]


def test_one_attempt_is_not_judged() -> None:
    outcome = deploy(policy=Low(1), attempts=1)
    assert outcome.phase is Phase.DONE
    assert not outcome.missed and not outcome.success


def test_an_object_that_is_taken_away_is_not_looked_for_elsewhere() -> None:
    """While it is lifted, or seems to be, it is moved out of the arm's reach."""
    seen = {}

    def remember(world: Any) -> None:
        seen["world"] = world

    def take(phase: Phase) -> None:
        if phase is Phase.HOLD:
            world = seen["world"]
            joint = world.model.body(OBJECT).jntadr[0]
            address = world.model.jnt_qposadr[joint]
            world.data.qpos[address] += 0.6

    outcome = deploy(Told(take), policy=Low(1), attempts=2, spoil=remember)
    assert outcome.attempts == 1 and outcome.missed
    assert outcome.fault == "" and outcome.phase is Phase.DONE

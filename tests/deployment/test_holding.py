"""Whatever ends a run leaves the arm braked and the hand holding until a person says open."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from ideal_twin import IDEAL
from robot_cells import cell_and_hand, grasp_and_object, near_cell, placed

from fungrasp.deployment import holding, wired_deployment
from fungrasp.deployment.deployment_result import DeploymentSettings
from fungrasp.deployment.log import DeploymentLog
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.wired_deployment import DeploymentTask, deploy_on_robot
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.device import DeviceStatus
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.parameters import draw_twin
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import Action, Observation

pytest.importorskip("mink")

ENDINGS = {
    "fault": lambda action: action.palm_goal.__setitem__((0, 0), np.nan),
    "Ctrl-C": lambda action: signal.raise_signal(signal.SIGINT),
    "kill": lambda action: os.kill(os.getpid(), signal.SIGTERM),
    "a terminal that is closed": lambda action: os.kill(os.getpid(), signal.SIGHUP),
    "a mistake of ours": lambda action: [][0],
    "full disk": None,
    "stay": None,
}
REASONS = {
    "fault": "not finite",
    "Ctrl-C": "interrupted (Ctrl-C)",
    "kill": "interrupted (SIGTERM)",
    "a terminal that is closed": "interrupted (SIGHUP)",
    "full disk": "the log can't be written: No space left on device",
    "stay": "",
}


class Ending(OpenLoopPolicy):
    """Ends the run once the object is lifted."""

    def __init__(self, end: Any):
        self._end = end

    def act(self, observation: Observation) -> Action:
        action = super().act(observation)
        if self._end is not None and float(observation.time_since_lift[0]) > 0.5:
            self._end(action)
        return action


class Full(DeploymentLog):
    steps = 0

    def step(self, *given: Any) -> None:
        self.steps += 1
        if self.steps > 45:
            raise OSError(28, "No space left on device")


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> TwinWorld:
    cell, hand = near_cell(), cell_and_hand()[1]
    truth = draw_twin(0, len(hand.joint_names), len(hand.actuators), IDEAL)
    world = TwinWorld(cell, hand, grasp_and_object()[1], truth)
    world.settle(placed())

    def on_twin(*arguments: Any, **options: Any) -> Robot:
        devices = TwinArm(world, cell), TwinHand(world, cell, hand), TwinTracker(world)
        return Robot(cell, hand, *devices, TwinClock(world), switch=options["switch"])

    monkeypatch.setattr(wired_deployment, "wired_robot", on_twin)
    monkeypatch.setattr(wired_deployment, "raise_priority", lambda: None)
    return world


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Programs that a shell starts in the background are deaf to Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("name", ENDINGS)
@pytest.mark.usefixtures("interruptible")
def test_the_object_stays_held_until_a_person_says_otherwise(name: str, world: TwinWorld) -> None:
    hand = cell_and_hand()[1]
    grasp, thing = grasp_and_object()
    planner = MotionPlanner(hand, {thing.name: thing})
    task = DeploymentTask(near_cell(), hand, thing, grasp, Ending(ENDINGS[name]), planner)
    heights = []

    def hold(robot: Robot) -> None:
        assert robot.state().arm.status is robot.state().hand.status is DeviceStatus.STOPPED
        for _ in range(2):
            world.advance(world.time + 1.0)
            heights.append(float(world.center_of_mass()[2]))
            assert np.abs(world.arm_state()[1]).max() < 0.02

    rest = float(world.center_of_mass()[2])
    settings = DeploymentSettings(look_time=0.3, until=Phase.HOLD if name == "stay" else Phase.HOME)
    log = Full() if name == "full disk" else None
    try:
        result = deploy_on_robot(task, settings=settings, hold=hold, log=log)
        assert result.phase is (Phase.DONE if name == "stay" else Phase.FAULT)
        assert REASONS[name] in result.fault
    except IndexError:
        assert name == "a mistake of ours"
    assert len(heights) == 2, "nobody was asked"
    assert min(heights) > rest + 0.02 and abs(heights[1] - heights[0]) < 0.005


def test_an_empty_hand_at_home_needs_nobody(world: TwinWorld) -> None:
    hand = cell_and_hand()[1]
    grasp, thing = grasp_and_object()
    planner = MotionPlanner(hand, {thing.name: thing})
    task = DeploymentTask(near_cell(), hand, thing, grasp, OpenLoopPolicy(), planner)
    settings, asked = DeploymentSettings(look_time=0.3), []
    assert deploy_on_robot(task, settings=settings, hold=asked.append).phase is Phase.DONE
    assert not asked and not world.powered


def test_the_hand_opens_at_the_word_and_at_no_other(
    world: TwinWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(holding, "OPENING", 0.0)
    switch, answers, opened = StopSwitch(), ["", "no", "open"], []
    monkeypatch.setattr(switch, "ask", lambda question: answers.pop(0))
    robot = wired_deployment.wired_robot(switch=switch)
    monkeypatch.setattr(robot.hand_driver, "stop", opened.append)
    holding.hold_until_told(robot)
    assert opened == ["open"] and not answers


def test_ctrl_c_twice_does_not_drop_what_is_held(
    world: TwinWorld, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    switch, robot, clock = StopSwitch(), wired_deployment.wired_robot(switch=None), iter([0.0, 0.3, 5.0, 9.0])
    monkeypatch.setattr(holding, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    robot.switch, asked = switch, []

    def interrupted(question: str) -> str:
        asked.append(question)
        raise KeyboardInterrupt

    monkeypatch.setattr(switch, "ask", interrupted)
    monkeypatch.setattr(robot.hand_driver, "lets_go", "when this program ends")
    with pytest.raises(KeyboardInterrupt):
        holding.hold_until_told(robot)
    # The one that comes at once is of the press that stopped the arm; the next one warns; the third ends it.
    assert len(asked) == 3 and "lets go when this program ends: Ctrl-C once more" in caplog.text


@pytest.mark.usefixtures("interruptible")
def test_a_second_ctrl_c_while_the_first_is_dealt_with_still_stops(world: TwinWorld) -> None:
    hand = cell_and_hand()[1]
    grasp, thing = grasp_and_object()
    end = Ending(lambda action: signal.raise_signal(signal.SIGINT))
    task = DeploymentTask(near_cell(), hand, thing, grasp, end, MotionPlanner(hand, {thing.name: thing}))
    statuses = []

    def again(robot: Robot) -> None:
        stop = robot.stop

        def interrupted(*kind: Any) -> None:
            robot.stop = stop
            signal.raise_signal(signal.SIGINT)

        robot.stop = interrupted

    def hold(robot: Robot) -> None:
        statuses.extend((robot.state().arm.status, robot.state().hand.status))

    with pytest.raises(KeyboardInterrupt):
        deploy_on_robot(
            task, settings=DeploymentSettings(look_time=0.3, until=Phase.HOME), on_connect=again, hold=hold
        )
    assert statuses == [DeviceStatus.STOPPED] * 2

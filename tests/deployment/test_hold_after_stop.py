"""Whatever ends a run leaves the arm braked and the hand holding until a person says open."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from robot_cells import Told, cell_and_hand, grasp_and_object, ideal, near_cell, placed, task

from fungrasp.deployment import deploy, hold_after_stop
from fungrasp.deployment.deploy import deploy_on_robot
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.spec import Phase
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.device import DeviceStatus, JointState, StopKind
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import Action, Observation

pytest.importorskip("mink")

ENDINGS = {
    "fault": lambda action: action.palm_goal_world.__setitem__((0, 0), np.nan),
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


class Full(DeploymentObserver):
    steps = 0

    def step(self, *given: Any) -> None:
        self.steps += 1
        if self.steps > 45:
            raise OSError(28, "No space left on device")


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> TwinWorld:
    cell, hand = near_cell(), cell_and_hand()[1]
    world = TwinWorld(cell, hand, grasp_and_object()[1], ideal())
    world.settle(placed())

    def on_twin(*arguments: Any, **options: Any) -> Robot:
        devices = TwinArm(world, cell), TwinHand(world, cell, hand), TwinTracker(world)
        return Robot(cell, hand, *devices, TwinClock(world), switch=options["switch"])

    monkeypatch.setattr(deploy, "wired_robot", on_twin)
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
    what = task(policy=Ending(ENDINGS[name]), until="lift" if name == "stay" else "home")
    heights = []

    def hold(robot: Robot) -> None:
        assert robot.state().arm.status is robot.state().hand.status is DeviceStatus.STOPPED
        for _ in range(2):
            world.advance(world.time + 1.0)
            heights.append(float(world.center_of_mass()[2]))
            assert np.abs(world.arm_state()[1]).max() < 0.02

    rest = float(world.center_of_mass()[2])
    log = Full() if name == "full disk" else DeploymentObserver()
    try:
        result = deploy_on_robot(what, [log, Told(hold=hold)])
        assert result.phase is (Phase.DONE if name == "stay" else Phase.FAULT)
        assert REASONS[name] in result.fault
    except IndexError:
        assert name == "a mistake of ours"
    assert len(heights) == 2, "nobody was asked"
    assert min(heights) > rest + 0.02 and abs(heights[1] - heights[0]) < 0.005


def test_an_empty_hand_at_home_needs_nobody(world: TwinWorld) -> None:
    asked = []
    assert deploy_on_robot(task(), [Told(hold=asked.append)]).phase is Phase.DONE
    assert not asked and not world.powered


def answering(robot: Robot, answers: list[str], monkeypatch: pytest.MonkeyPatch, looks: int = 3) -> None:
    """Somebody at the keyboard says one answer after the other, after some looks at the robot each."""

    def ask(question: str, meanwhile: Callable[[], None]) -> str:
        for _ in range(looks):
            meanwhile()
        return answers.pop(0)

    monkeypatch.setattr(robot.switch, "ask", ask)


def test_the_hand_opens_at_the_word_and_at_no_other(
    world: TwinWorld, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, answers, said = deploy.wired_robot(switch=StopSwitch()), ["", "no", "open"], []
    with robot:
        robot.stop()
        answering(robot, answers, monkeypatch)
        hold_after_stop.hold_until_told(robot, said.append)
    assert not answers and said[0] == "The arm has braked. The hand holds."
    assert said[-1] == "The hand is open." and said[-1] in capsys.readouterr().err


@pytest.mark.parametrize("what", ["hot", "lost", "slips"])
def test_what_the_hand_says_while_it_holds_is_said_at_once(
    what: str, world: TwinWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, said, looks = deploy.wired_robot(switch=StopSwitch()), [], []
    hand = robot.hand_driver
    read = hand.read

    def spoiled() -> JointState:
        state = read()
        if len(looks) < 5:
            return state
        if what == "slips":
            return replace(state, positions=state.positions + 0.2)
        status = DeviceStatus.FAULT if what == "hot" else DeviceStatus.DISCONNECTED
        return replace(state, status=status, message="too hot" if what == "hot" else "silent")

    with robot:
        robot.stop()
        monkeypatch.setattr(hand, "read", spoiled)
        watch = hold_after_stop.HoldWatch(robot, said.append)
        for _ in range(10):
            watch.look()
            looks.append(len(said))
    assert looks == [1] * 5 + [2] * 5
    assert said[0].endswith("The hand holds.") and "hand holds" not in said[1]
    words = {"hot": "reports: too hot", "lost": "state is unknown: silent", "slips": "has moved by"}
    assert words[what] in said[1]


def test_a_hand_that_does_not_open_is_said_and_asked_about_again(
    world: TwinWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, answers, said = deploy.wired_robot(switch=StopSwitch()), ["open", "open"], []
    with robot:
        world.command_hand(robot.hand.open_joints + 0.6)
        world.advance(world.time + 1.0)
        robot.stop()
        stop, stops = robot.hand_driver.stop, []

        def deaf(kind: StopKind = StopKind.HOLD) -> None:
            stops.append(kind)
            if len(stops) > 1:
                stop(kind)

        monkeypatch.setattr(robot.hand_driver, "stop", deaf)
        answering(robot, answers, monkeypatch)
        hold_after_stop.hold_until_told(robot, said.append)
    assert not answers
    opened = [words for words in said if "open" in words]
    assert opened[0].startswith("The hand has not opened") and opened[-1] == "The hand is open."


def test_a_driver_that_raises_at_a_stop_leaves_the_hold(world: TwinWorld) -> None:
    held = []

    def break_arm(robot: Robot) -> None:
        def stop(kind: StopKind = StopKind.HOLD) -> None:
            raise ValueError("made up")

        robot.arm.stop = stop

    policy = Ending(ENDINGS["fault"])
    told = Told(connected=break_arm, hold=lambda robot: held.append(robot.hand_driver.read().status))
    # Closing, it raises again: that is the plug-in's own.
    with pytest.raises(ValueError, match="made up"):
        deploy_on_robot(task(policy=policy), [told])
    assert held == [DeviceStatus.STOPPED]


def test_ctrl_c_twice_does_not_drop_what_is_held(
    world: TwinWorld, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    switch, robot, clock = StopSwitch(), deploy.wired_robot(switch=None), iter([0.0, 0.3, 5.0, 9.0])
    monkeypatch.setattr(hold_after_stop, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    robot.switch, asked = switch, []

    def interrupted(question: str, meanwhile: Callable[[], None]) -> str:
        asked.append(question)
        raise KeyboardInterrupt

    monkeypatch.setattr(switch, "ask", interrupted)
    monkeypatch.setattr(robot.hand_driver, "lets_go", "when this program ends")
    with pytest.raises(KeyboardInterrupt):
        hold_after_stop.hold_until_told(robot)
    # The one that comes at once is of the press that stopped the arm; the next one warns; the third ends it.
    assert len(asked) == 3 and "lets go when this program ends: Ctrl-C once more" in caplog.text


@pytest.mark.usefixtures("interruptible")
def test_a_second_ctrl_c_while_the_first_is_dealt_with_still_stops(world: TwinWorld) -> None:
    end = Ending(lambda action: signal.raise_signal(signal.SIGINT))
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
        deploy_on_robot(task(policy=end), [Told(connected=again, hold=hold)])
    assert statuses == [DeviceStatus.STOPPED] * 2

"""Deployments on a twin: phases, faults and their reactions, the log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_cells import Told, cell_and_hand, deploy, grasp_and_object, near_cell, placed

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.log import McapLog, read_log
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import GraspPreparer, UnreachableError
from fungrasp.deployment.spec import Phase
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.cell import plan_speed
from fungrasp.robots.device import RobotCommand, RobotState
from fungrasp.robots.kinematics.joint_path import FreePath
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import TwinArm, TwinHand
from fungrasp.robots.twin.twin_model import OBJECT
from fungrasp.task import Action, GraspPlan, Observation

pytest.importorskip("mink")


class Spoiled(OpenLoopPolicy):
    """A policy that does something else at a step."""

    def __init__(self, step: int, change: Any):
        self._step, self._change = step, change

    def act(self, observation: Observation) -> Action:
        action = super().act(observation)
        if round(float(observation.time[0]) / 0.1) >= self._step:
            self._change(action)
        return action


@pytest.fixture(scope="module")
def lifted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    pytest.importorskip("mcap")
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    with McapLog(path, {"policy": "reference"}) as log:
        return deploy(log, until="home"), path


def test_a_grasp_is_lifted_put_down_and_the_arm_goes_home(lifted: tuple[Any, Path]) -> None:
    outcome, path = lifted
    assert outcome.fault == ""
    assert outcome.phase is Phase.DONE
    assert outcome.success and outcome.height > 0.1
    phases = [e["text"] for e in read_log(path).messages["/event"] if e["what"] == "phase"]
    assert phases == [p.value for p in Phase if p not in (Phase.IDLE, Phase.FAULT, Phase.WITHDRAW)]
    # Without a wall clock no tick is late.
    assert max(outcome.ticks.lateness) < 0.003


def test_every_setpoint_keeps_the_limits(lifted: tuple[Any, Path]) -> None:
    cell, _ = cell_and_hand()
    setpoints = read_log(lifted[1]).messages["/setpoint"]
    times = np.array([s["time"] for s in setpoints])
    palm = np.array([s["sent"]["palm"][:3] for s in setpoints])
    arm = np.array([s["sent"]["arm"] for s in setpoints])
    together = np.abs(np.diff(times) - 0.02) < 0.003
    assert together.mean() > 0.95
    speed = np.linalg.norm(np.diff(palm, axis=0), axis=1)[together] / 0.02
    assert speed.max() <= 1.02 * cell.limits.palm_speed
    assert (np.abs(np.diff(arm, axis=0))[together] / 0.02).max() <= 1.02 * cell.limits.arm_speed


def test_the_log_holds_all_that_the_policy_saw(lifted: tuple[Any, Path]) -> None:
    """Shown the logged observations, it answers with the logged actions, to the last bit."""
    log, policy = read_log(lifted[1]), OpenLoopPolicy()
    assert log.complete and log.about["policy"] == "reference"
    steps = log.messages["/step"]
    assert log.plan is not None and len(steps) > 50
    for number, step in enumerate(steps):
        seen = {name: np.array(value)[None] for name, value in step["observation"].items()}
        observation = Observation.from_arrays(seen)
        if number == 0:
            policy.reset(log.plan, observation)
        for name, value in policy.act(observation).arrays().items():
            np.testing.assert_array_equal(value[0], step["action"][name])


def test_a_log_that_breaks_off_is_read_up_to_there(lifted: tuple[Any, Path], tmp_path: Path) -> None:
    whole = lifted[1].read_bytes()
    steps = len(read_log(lifted[1]).messages["/step"])
    for share in (0.999, 0.5, 0.1):
        torn = tmp_path / "torn.mcap"
        torn.write_bytes(whole[: int(share * len(whole))])
        log = read_log(torn)
        assert not log.complete
        assert len(log.messages["/setpoint"]) > 0
        assert len(log.messages["/step"]) <= steps
    for cut in range(1, 60):
        # Also within the length of a record.
        (tmp_path / "torn.mcap").write_bytes(whole[: len(whole) // 3 - cut])
        assert not read_log(tmp_path / "torn.mcap").complete
    (tmp_path / "no.mcap").write_bytes(b"nothing")
    with pytest.raises(FungraspError, match="is not an MCAP file"):
        read_log(tmp_path / "no.mcap")


def test_a_log_is_not_overwritten(lifted: tuple[Any, Path]) -> None:
    with pytest.raises(FungraspError, match="already exists"):
        McapLog(lifted[1])


def test_the_same_twin_does_the_same_again() -> None:
    one, two = deploy(), deploy()
    assert one.height == two.height
    assert one.times == two.times


def spoil_tracker(world: Any) -> None:
    """The tracker stops delivering after the object was found."""
    original = world._track

    def track() -> None:
        if world.time < 0.5:
            original()

    world._track = track


def jump_tracker(world: Any) -> None:
    original = world._track

    def track() -> None:
        original()
        if world.time > 0.6 and world._frames:
            world._frames[-1].pose_world_object[0] += 0.1

    world._track = track


def flip_tracker(world: Any) -> None:
    """Every other pose is turned about the vertical by half a turn, from the beginning."""
    original = world._track

    def track() -> None:
        before = len(world._frames)
        original()
        if len(world._frames) > before and int(world.time / 0.05) % 2:
            pose = world._frames[-1].pose_world_object
            pose[3:] = [-pose[6], -pose[5], pose[4], pose[3]]

    world._track = track


def test_a_tracker_that_flips_is_refused_before_anything_is_planned() -> None:
    result = deploy(spoil=flip_tracker)
    assert result.phase is Phase.FAULT and result.prepared is None
    assert "turned by" in result.fault and "check the tracker" in result.fault


@pytest.mark.parametrize(
    ("spoil", "said"),
    [(spoil_tracker, "the tracked pose is"), (jump_tracker, "the tracked object has jumped")],
)
def test_a_tracker_that_fails_before_the_hand_closes_stops_the_arm(spoil: Any, said: str) -> None:
    result = deploy(spoil=spoil)
    assert result.phase is Phase.FAULT
    assert said in result.fault
    assert "lift" not in result.times


def test_an_object_that_is_moved_while_the_arm_goes_to_the_start_stops_it() -> None:
    def carry_away(world: Any) -> None:
        original = world._track

        def track() -> None:
            original()
            if world.time > 2.0 and world._frames:
                world._frames[-1].pose_world_object[0] += 0.1

        world._track = track

    result = deploy(cell=cell_and_hand()[0], spoil=carry_away)
    assert "the tracked object has jumped" in result.fault
    assert result.times["fault"] < 2.5 and "grasp" not in result.times


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a.palm_goal_world.__setitem__((0, 0), np.nan), "not finite"),
        (lambda a: a.finger_targets.__setitem__((0, 2), np.inf), "not finite"),
        (lambda a: a.palm_goal_world.__setitem__((0, 1), 3.0), "palm would move"),
        (lambda a: a.palm_goal_world.__isub__([[0, 0, 0.2, 0, 0, 0, 0]]), "table"),
    ],
)
def test_a_policy_gone_wrong_stops_the_robot(change: Any, said: str) -> None:
    result = deploy(policy=Spoiled(5, change))
    assert result.phase is Phase.FAULT
    assert said in result.fault


@pytest.mark.parametrize(("device", "said"), [(TwinArm, "the arm"), (TwinHand, "the hand")])
@pytest.mark.parametrize("how", ["fault", "frozen"])
def test_a_device_that_fails_stops_the_robot(
    monkeypatch: pytest.MonkeyPatch, device: Any, said: str, how: str
) -> None:
    read = device.read

    def failing(self: Any) -> Any:
        if self.world.time > 1.5 and self.name.startswith("twin"):
            setattr(self, how, "motor hot" if how == "fault" else True)
        return read(self)

    monkeypatch.setattr(device, "read", failing)
    result = deploy()
    assert result.phase is Phase.FAULT
    assert said in result.fault
    assert ("silent" if how == "frozen" else "motor hot") in result.fault
    watchdog = cell_and_hand()[0].watchdog
    limit = 0.02 if how == "fault" else 0.02 + max(watchdog.arm_silence, watchdog.hand_silence)
    assert result.times["fault"] - 1.5 <= limit + 0.021


def test_the_stop_file_stops_the_arm_and_it_comes_to_rest(tmp_path: Path) -> None:
    file = tmp_path / "stop"
    switch = StopSwitch(file)
    seen = {}

    def keep(world: Any) -> None:
        seen["world"] = world

    def phase(now: Phase) -> None:
        if now is Phase.LIFT:
            file.touch()

    result = deploy(Told(phase), switch=switch, spoil=keep)
    assert result.phase is Phase.FAULT
    assert "stop file" in result.fault
    world = seen["world"]
    world.advance(world.time + 0.3)
    assert np.abs(world.arm_state()[1]).max() < 0.02


def test_a_full_disk_stops_the_robot() -> None:
    class Full(DeploymentObserver):
        count = 0

        def step(self, *given: Any) -> None:
            self.count += 1
            if self.count > 10:
                raise OSError(28, "No space left on device")

    result = deploy(Full())
    assert result.phase is Phase.FAULT
    assert "No space left" in result.fault


def test_a_disk_that_is_full_at_the_end_hides_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with McapLog(tmp_path / "a.mcap") as log:
        log.phase(0.0, Phase.DONE)

        def full() -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(log._writer, "finish", full)
    assert "a.mcap breaks off: No space left on device" in caplog.text
    assert not read_log(tmp_path / "a.mcap").complete


def test_where_one_plan_has_no_free_way_the_next_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, hand = cell_and_hand()
    (grasp, obj), where = grasp_and_object(), placed()
    seeds: list[int] = []
    find, plan = FreePath.find, MotionPlanner.plan

    def planned(self: Any, grasps: Any, belief: Any, seed: int = 0, *rest: Any) -> Any:
        seeds.append(seed)
        return plan(self, grasps, belief, seed, *rest)

    monkeypatch.setattr(MotionPlanner, "plan", planned)
    monkeypatch.setattr(FreePath, "find", lambda self, *a: find(self, *a) if len(seeds) > 1 else None)
    preparer = GraspPreparer(cell, hand, obj, MotionPlanner(hand, {obj.name: obj}))
    home = np.array(cell.arm.home)
    prepared = preparer.prepare(grasp, where, home)
    assert seeds == [0, 1] and len(prepared.corners)
    monkeypatch.setattr(FreePath, "find", lambda self, *a: None)
    with pytest.raises(UnreachableError, match="no collision-free path"):
        preparer.prepare(grasp, where, home)
    assert seeds == [0, 1, 0, 1, 2]


def test_the_hand_opens_only_where_the_arm_is_seen_to_be_low(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = near_cell()
    cell = replace(cell, watchdog=replace(cell.watchdog, arm_silence=1.5))
    seen: dict[str, Any] = {}
    command, read = TwinArm.command, TwinArm.read

    def lost(self: Any) -> bool:
        return self.world.time > seen.get("put down", np.inf) + 0.8

    def silent(self: Any) -> Any:
        self.frozen = lost(self)
        return read(self)

    monkeypatch.setattr(TwinArm, "command", lambda self, q: q if lost(self) else command(self, q))
    monkeypatch.setattr(TwinArm, "read", silent)

    def phase(now: Phase) -> None:
        if now is Phase.PUT_DOWN:
            seen["put down"] = seen["world"].time

    result = deploy(Told(phase), cell=cell, until="home", spoil=lambda world: seen.update(world=world))
    assert "the arm has been silent" in result.fault
    world = seen["world"]
    high = float(world.center_of_mass()[2])
    world.advance(world.time + 1.0)
    assert world.look().in_hand and not world.look().on_table
    assert float(world.center_of_mass()[2]) == pytest.approx(high, abs=0.005)


def test_a_grasp_out_of_reach_is_said_before_anything_moves() -> None:
    cell, hand = cell_and_hand()
    grasp, obj = grasp_and_object()
    preparer = GraspPreparer(cell, hand, obj, MotionPlanner(hand, {obj.name: obj}))
    far = placed().copy()
    far[0] += 1.5
    with pytest.raises(UnreachableError) as error:
        preparer.prepare(grasp, far, np.array(near_cell().arm.home))
    assert "not reachable" in str(error.value) and "\n" not in str(error.value)
    aside = placed().copy()
    aside[0] += 0.45
    with pytest.raises(
        UnreachableError, match=r"it would be reachable with the object moved by|no placement nearby"
    ):
        preparer.prepare(grasp, aside, np.array(near_cell().arm.home))


def test_a_palm_too_low_for_the_wrist_is_out_of_reach() -> None:
    cell, hand = cell_and_hand()
    grasp, obj = grasp_and_object()
    preparer = GraspPreparer(cell, hand, obj, MotionPlanner(hand, {obj.name: obj}))
    home = np.array(cell.arm.home)
    # As the grasp was shown, so that heights are those of its own scene.
    pose = placed().copy()
    pose[3:] = grasp.object_pose[0, 3:]
    for height, low in ((0.01, True), (0.25, False)):
        wrist = grasp.wrist_pose.copy()
        wrist[:, 2] = height + grasp.object_pose[:, 2] - pose[2]
        assert bool(preparer.obstacle(replace(grasp, wrist_pose=wrist), pose, home)) is low


# Several attempts: what is seen not to be held is let go of, and tried again by another plan.


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
            action.palm_goal_world[:, 2] -= 0.12
        return action


def phases(path: Path) -> list[str]:
    return [e["text"] for e in read_log(path).messages["/event"] if e["what"] == "phase"]


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path, Low]:
    pytest.importorskip("mcap")
    path, policy = tmp_path_factory.mktemp("log") / "log.mcap", Low(1)
    with McapLog(path) as log:
        # Let go of from so low, the objects of other grasps topple, and are not found where they stood.
        return deploy(log, policy=policy, until="home", attempts=2, row=36), path, policy


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


def test_the_last_attempt_that_fails_ends_at_home_with_an_open_hand(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    with McapLog(tmp_path / "log.mcap") as log:
        outcome = deploy(log, policy=Low(2), until="home", attempts=2, row=36)
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


@pytest.mark.parametrize(("pause", "stopped"), [(0.1, False), (0.2, False), (0.45, True)])
@pytest.mark.parametrize("phase", [Phase.MOVE_TO_START, Phase.LIFT])
def test_a_pause_is_not_caught_up(pause: float, stopped: bool, phase: Phase) -> None:
    """However long the computer is held up, the palm goes no faster than its limit afterwards."""
    cell = replace(cell_and_hand()[0], limits=replace(cell_and_hand()[0].limits, palm_speed=0.1))
    palms: list[tuple[float, np.ndarray]] = []
    robots: list[Robot] = []

    class Paused(DeploymentObserver):
        left = 60

        def connected(self, robot: Robot) -> None:
            robots.append(robot)

        def setpoint(self, now: Phase, state: RobotState, command: RobotCommand) -> None:
            palms.append((state.time, command.palm[:3]))
            self.left -= now is phase
            if self.left == 0:
                robots[0].clock.sleep_until(robots[0].clock.now() + pause)

    result = deploy(Paused(), cell=cell, until="lift")
    assert ("overrun" in result.fault) is stopped
    # A slow cell carries the same motion out, in slow motion.
    assert stopped or result.success
    times = np.array([time for time, _ in palms])
    places = np.array([place for _, place in palms])
    # Over windows of 100 ms and longer, as an arm that follows them moves.
    for i in range(len(times)):
        later = np.searchsorted(times, times[i] + 0.1)
        if later < len(times):
            speed = np.linalg.norm(places[later] - places[i]) / (times[later] - times[i])
            assert speed <= 0.1 * 1.05, (times[i], speed)


SLOW = {
    "palm_speed": 0.05,
    "palm_acceleration": 0.1,
    "palm_rotation_speed": 0.3,
    "arm_speed": 0.3,
    "arm_acceleration": 0.5,
    "hand_speed": 1.0,
}


@pytest.mark.parametrize("names", [tuple(SLOW), ("arm_speed",), ("palm_speed",)])
def test_a_slow_cell_has_the_plans_of_a_fast_one(names: tuple[str, ...]) -> None:
    """With the limits of a cell that 'robots new' writes, and with each alone."""
    cell, hand = cell_and_hand()
    slow = replace(cell, limits=replace(cell.limits, **{name: SLOW[name] for name in names}))
    grasp, obj = grasp_and_object()
    preparer = GraspPreparer(slow, hand, obj, MotionPlanner(hand, {obj.name: obj}))
    assert preparer.prepare(grasp, placed(), np.array(cell.arm.home)).reach.obstacle == ""
    assert plan_speed(slow.limits) == pytest.approx(
        min(0.2 if names[0] == "palm_speed" else 0.15, 0.2), abs=0.06
    )


def test_no_plan_names_the_limit_that_forbids_it() -> None:
    cell, hand = cell_and_hand()
    grasp, obj = grasp_and_object(36)
    home = np.array(cell.arm.home)
    for change, said in (
        (
            {"upper": (0.5, 0.5, 0.5)},
            r"with the arm in its current posture, .*z = 0\.67 m, and workspace\.upper has 0\.5",
        ),
        ({"hand_depth": -0.12}, r"workspace\.hand_depth = -0\.12"),
    ):
        small = replace(cell, workspace=replace(cell.workspace, **change))
        preparer = GraspPreparer(small, hand, obj, MotionPlanner(hand, {obj.name: obj}), advise=False)
        with pytest.raises(UnreachableError, match=said):
            preparer.prepare(grasp, placed(36), home, plans=1)

"""Whoever makes a robot or a device of a cell gets its guard, its stop switch and its limits."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lerobot_adapter import LeRobotRobot
from robot_cells import cell_and_hand
from twin_robots import twin_robot

from fungrasp.cli.main import main
from fungrasp.hands import load_hand
from fungrasp.robots import single_devices
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import Obstacle, RobotCell, load_cell
from fungrasp.robots.device import DeviceStatus, RobotError, SafetyStop
from fungrasp.robots.kinematics.arm_model import MARGIN, ArmKinematics, ClearanceModel
from fungrasp.robots.robot import Robot
from fungrasp.robots.single_devices import GuardedDriver, guarded_driver
from fungrasp.robots.twin.devices import TwinHand
from fungrasp.robots.twin.world import TwinWorld
from fungrasp_emulators.inspire import InspireEmulator
from fungrasp_emulators.plants import ServoPlant

pytest.importorskip("mink")


def sink(robot: Robot, world: TwinWorld) -> None:
    """As LeRobot's loop does, ask again and again for a palm that is a little lower."""
    adapter = LeRobotRobot(robot)
    adapter.connect()
    world.advance(world.time + 0.2)
    seen = adapter.get_observation()
    action = {name: seen.get(name, 0.0) for name in adapter.action_features}
    while action["palm.z"] > -0.2:
        action["palm.z"] -= 0.02
        adapter.send_action(action)
        world.advance(world.time + 0.02)


def test_lerobots_actions_pass_the_guard() -> None:
    robot, world = twin_robot(cell_and_hand()[0])
    with pytest.raises(SafetyStop, match=r"table|touch the arm|workspace"):
        sink(robot, world)
    assert robot.state().arm.status is robot.state().hand.status is DeviceStatus.STOPPED
    with pytest.raises(RobotError):
        sink(robot, world)


def test_lerobots_goals_may_not_be_far() -> None:
    robot, world = twin_robot(cell_and_hand()[0])
    adapter = LeRobotRobot(robot)
    adapter.connect()
    world.advance(world.time + 0.2)
    seen = adapter.get_observation()
    action = {name: seen.get(name, 0.0) for name in adapter.action_features}
    action["palm.x"] += 0.5
    with pytest.raises(SafetyStop, match=r"0\.50 m at once"):
        adapter.send_action(action)
    assert robot.state().arm.status is DeviceStatus.STOPPED


def test_the_stop_file_of_the_cell_stops_lerobot(tmp_path: Path) -> None:
    robot, world = twin_robot(replace(cell_and_hand()[0], stop_file=str(tmp_path / "stop")))
    (tmp_path / "stop").touch()
    with pytest.raises(SafetyStop, match="stop file"):
        sink(robot, world)
    assert robot.state().arm.status is DeviceStatus.STOPPED


def test_a_wired_robot_has_the_cells_guard_and_switch(tmp_path: Path) -> None:
    cell = replace(load_cell("ur5e-inspire-emulated"), stop_file=str(tmp_path / "stop"))
    hand = load_hand(cell.hand)
    for made in (wired_robot(cell, hand), guarded_driver("hand", cell, hand)):
        assert made.switch.reason == ""
    (tmp_path / "stop").touch()
    for made in (wired_robot(cell, hand), guarded_driver("hand", cell, hand)):
        assert "stop file" in made.switch.reason


def hand_alone(cell: RobotCell | None = None) -> tuple[GuardedDriver, TwinHand, TwinWorld]:
    cell = cell or cell_and_hand()[0]
    robot, world = twin_robot(cell)
    assert isinstance(robot.hand_driver, TwinHand)
    guarded = GuardedDriver(robot.hand_driver, cell, "hand", clock=robot.clock)
    guarded.connect()
    return guarded, robot.hand_driver, world


def test_a_device_alone_keeps_the_limits_of_speed() -> None:
    guarded, driver, world = hand_alone()
    goal = np.minimum(driver.limits.upper, driver.read().positions + 2.0)
    before = guarded.command(driver.read().positions)
    most = cell_and_hand()[0].limits.hand_speed
    for _ in range(5):
        world.advance(world.time + 0.02)
        sent = guarded.command(goal)
        assert np.abs(sent - before).max() <= 1.03 * 0.02 * most
        before = sent


@pytest.mark.parametrize("what", ["fault", "frozen", "torque"])
def test_a_device_alone_stops_for_what_is_wrong(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    guarded, driver, world = hand_alone()
    rest = guarded.command(driver.read().positions)
    if what == "torque":
        read = driver.read
        torques = np.full(16, 9.0)
        monkeypatch.setattr(driver, "read", lambda: replace(read(), torques=torques))
    else:
        setattr(driver, what, "hot" if what == "fault" else True)
    with pytest.raises(RobotError, match={"fault": "hot", "frozen": "silent", "torque": "torque"}[what]):
        for _ in range(10):
            world.advance(world.time + 0.02)
            guarded.command(rest)
    assert driver._status is DeviceStatus.STOPPED


def test_boxes_of_the_cell_are_kept_clear_of() -> None:
    cell, hand = cell_and_hand()
    home = np.array(cell.arm.home)
    palm = ArmKinematics(cell, hand).palm_pose(home)[:3]
    fingers = hand.open_joints
    pedestal = Obstacle((-0.5, 0.0, 0.14), (0.25, 0.25, 0.28))
    ahead = Obstacle(tuple(palm - [0.0, 0.0, 0.3]), (0.1, 0.1, 0.2))
    boxed = replace(cell, obstacles=(pedestal, ahead))
    assert ClearanceModel(cell, hand).measure(home, fingers).obstacle == MARGIN
    free = ClearanceModel(boxed, hand).measure(home, fingers)
    assert free.obstacle == MARGIN and free.table == MARGIN
    robot, world = twin_robot(boxed)
    with pytest.raises(SafetyStop, match="would touch an obstacle"):
        sink(robot, world)


def test_an_arm_alone_keeps_off_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, hand = cell_and_hand()
    robot, world = twin_robot(cell)
    monkeypatch.setattr(single_devices, "arm_driver", lambda cell: robot.arm)
    guarded = guarded_driver("arm", cell, hand, clock=robot.clock)
    guarded.connect()
    goal = robot.arm.read().positions.copy()
    with pytest.raises(SafetyStop, match=r"table|workspace"):
        for _ in range(200):
            goal[1] += 0.02
            guarded.command(goal)
            world.advance(world.time + 0.02)
    assert robot.arm.read().status is DeviceStatus.STOPPED


@pytest.mark.parametrize("real", [False, True])
def test_identification_stops_for_the_stop_file_and_asks_at_a_real_robot(
    real: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pymodbus")
    arm = "[arm]\ndriver = 'ur-rtde'\naddress = '192.168.0.10'\n" if real else ""
    mount = "[mount]\npose_flange_hand = [0, 0, 0.1, 1, 0, 0, 0]\n" if real else ""
    plant = ServoPlant(np.full(6, 0.3), time_constant=0.02, velocity=10.0)
    with InspireEmulator(plant, port=0) as emulator:
        cell = tmp_path / "cell.toml"
        cell.write_text(
            # Beside the cell's file, wherever the command was given.
            f'hand = "inspire"\nstop_file = "stop"\n{arm}{mount}[hand_device]\ndriver = "inspire"\n'
            f'address = "{emulator.address}"\noptions = {{ port = {emulator.port}, stale_after = 1.0 }}\n'
        )
        (tmp_path / "stop").touch()
        before = plant.state(time.monotonic()).positions
        words = ["identify", "collect", str(tmp_path / "log.npz"), str(cell), "--excitation.seconds", "4"]
        assert main(words) != 0
        said = capsys.readouterr().err
        assert "moves a robot and asks first" in said if real else f"stop file {tmp_path}" in said
        assert np.abs(plant.state(time.monotonic()).positions - before).max() < 0.01
    assert not (tmp_path / "log.npz").exists()

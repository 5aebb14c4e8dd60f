"""Drivers, poses and services over ROS 2 itself, where rclpy is installed: a node on the same machine stands
for ur_robot_driver and its controller. No robot and no simulation of one."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driver_contract import DeviceUnderTest, DriverContract, reach, wait_for
from loop_thread import LoopThread
from robot_cells import Told

from fungrasp.deployment.deploy import deploy_on_robot, deployment_task
from fungrasp.deployment.preparation import reachable_placements
from fungrasp.deployment.spec import DeploymentSpec, GraspChoice, Phase
from fungrasp.hands import load_hand
from fungrasp.robots import assembly
from fungrasp.robots.cell import load_cell
from fungrasp.robots.control_loop.loop_driver import LoopDriver, worker_environment
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, RobotError
from fungrasp_emulators.plants import ServoPlant

rclpy = pytest.importorskip("rclpy")
# Before the first context: nobody else's topics.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from geometry_msgs.msg import PoseStamped  # noqa: E402
from ros_joints import JOINTS, MODEL, RosJoints  # noqa: E402
from sensor_msgs.msg import JointState as JointStateMessage  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from fungrasp_ros2.grasp_node import GraspNode  # noqa: E402
from fungrasp_ros2.joint_loop import JointTopicLoop, TopicSettings, make_arm, make_hand  # noqa: E402
from fungrasp_ros2.pose_source import RosPoseSource, make_pose_source  # noqa: E402
from fungrasp_ros2.ros_side import RosSide  # noqa: E402

HOME = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
# ur_dashboard_msgs is no package of pip: its topic is watched in the tests of ArmWatch only.
WATCHED = {"safety_mode": ""}


@contextlib.contextmanager
def emulated(**settings: Any) -> Iterator[DeviceUnderTest]:
    plant = ServoPlant(HOME, time_constant=0.02)
    emulator = RosJoints(plant)
    emulator.start()
    options = {"stale_after": 1.0, "timeout": 5.0} | WATCHED | settings
    limits = JointLimits(*MODEL.jnt_range.T.copy(), np.full(6, 1.0), np.full(6, np.inf))
    loop = JointTopicLoop("fungrasp_arm", TopicSettings(**options), JOINTS, limits)
    driver = LoopDriver(loop, LoopThread)
    try:
        yield DeviceUnderTest(driver, emulator, plant, HOME + 0.1, 0.005)
    finally:
        driver.close()
        emulator.close()


class TestArm(DriverContract):
    def running(self):
        return emulated()


def test_setpoints_keep_the_limits() -> None:
    with emulated(velocity=0.5, acceleration=2.0) as device:
        device.driver.connect()
        assert not device.emulator.heard
        reach(device, HOME + 0.3)
        sent = np.array([data for _, data in device.emulator.heard])
    speeds = np.diff(sent, axis=0) / 0.008
    assert np.abs(speeds).max() < 0.51 and np.abs(np.diff(speeds, axis=0)).max() / 0.008 < 2.1


def test_an_arm_that_is_slowed_is_refused_and_one_that_becomes_slow_stops() -> None:
    with emulated(timeout=1.0) as device:
        device.emulator.scaling = 50.0
        device.driver.connect()
        time.sleep(0.1)
        with pytest.raises(RobotError, match=r"50 % of its speed: set the slider to 100 %"):
            device.driver.take_control()
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.scaling = 30.0
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert "30 %" in device.driver.read().message


def test_a_program_that_ends_is_a_fault() -> None:
    with emulated() as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.stop_program()
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.FAULT)
        assert "External Control" in device.driver.read().message


def test_a_controller_that_is_not_active_is_named() -> None:
    with emulated(commands="/other/commands", timeout=1.0) as device:
        device.driver.connect()
        with pytest.raises(RobotError, match="nobody listens on /other/commands"):
            device.driver.take_control()


def test_joint_states_that_end_are_a_lost_arm() -> None:
    with emulated(stale_after=0.3) as device:
        device.driver.connect()
        reach(device, device.near)
        device.emulator.close()
        assert wait_for(lambda: device.driver.read().status is DeviceStatus.DISCONNECTED)


@pytest.mark.slow
def test_an_arm_and_a_hand_of_a_cell_run_in_processes() -> None:
    cell = load_cell("ur5e-inspire-emulated")
    arm = replace(
        cell.arm, driver="ros2", address="", options={"timeout": 10.0, "stale_after": 2.0} | WATCHED
    )
    options = {"commands": "/hand/commands", "timeout": 10.0, "stale_after": 2.0}
    hand = replace(cell.hand_device, driver="ros2", address="", options=options)
    cell = replace(cell, arm=arm, hand_device=hand)
    drivers = make_arm(cell), make_hand(cell)
    names = tuple(drivers[1]._loop.joints)
    plants = (
        ServoPlant(HOME, time_constant=0.02),
        ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0),
    )
    sides = RosJoints(plants[0]), RosJoints(plants[1], names, "/hand/commands")
    try:
        for side, driver, plant, goal in zip(
            sides, drivers, plants, (HOME + 0.1, np.full(6, 0.4)), strict=True
        ):
            side.start()
            driver.connect()
            reach(DeviceUnderTest(driver, side, plant, goal, 0.01), goal)
            assert driver.process_id is not None
    finally:
        for one in (*drivers, *sides):
            one.close()


@pytest.mark.slow
def test_a_bowl_is_grasped_on_a_twin_with_everything_over_ros(tmp_path: Path) -> None:
    patient = {"timeout": 20.0, "stale_after": 1.0}
    cell = load_cell("ur5e-inspire-emulated")
    options = {"velocity": 2.0, "acceleration": 20.0, "jerk": 1000.0, **patient, **WATCHED}
    dog = replace(cell.watchdog, arm_silence=0.5, hand_silence=0.5, overrun=1.0, pose_stale=2.0)
    fingers = {"commands": "/hand/commands", **patient}
    cell = replace(
        cell,
        arm=replace(cell.arm, driver="ros2", address="", options=options),
        hand_device=replace(cell.hand_device, driver="ros2", address="fungrasp_hand", options=fingers),
        tracker=replace(cell.tracker, driver="ros2", address="/object_pose", options={"timeout": 20.0}),
        watchdog=dog,
    )
    hand = load_hand(cell.hand)
    grasp, objects = GraspChoice("bowl").robot(hand)
    obj = objects["bowl"]
    task = deployment_task(grasp, objects, DeploymentSpec("ur5e-inspire-emulated"))
    task = replace(task, cell=cell)
    # Of the package's own drivers, by name; these two are not installed here.
    arm, side, poses = make_arm(cell), make_hand(cell), make_pose_source(cell)
    said = tmp_path / "task"
    said.write_bytes(pickle.dumps((cell, obj, next(reachable_placements(cell, hand, obj, grasp)))))
    worker = Path(__file__).with_name("twin_over_ros.py")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, worker, said], env=worker_environment(), **pipes) as twin:
        assert twin.stdout is not None and twin.stdin is not None
        assert twin.stdout.readline() == "ready\n"
        with pytest.MonkeyPatch.context() as patched:
            for name, device in (("arm_driver", arm), ("hand_driver", side), ("pose_source", poses)):
                patched.setattr(assembly, name, lambda *arguments, device=device: device)
            result = deploy_on_robot(task, [Told(hold=lambda robot: None)])
        twin.stdin.close()
        held = float(twin.stdout.readline())
    assert result.phase is Phase.DONE, result
    assert held >= 2.0


@contextlib.contextmanager
def publishing(frame: str, stamp: Callable[[Any], Any], topic: str) -> Iterator[None]:
    ros, ended = RosSide("tracker"), threading.Event()
    publisher = ros.node.create_publisher(PoseStamped, topic, 1)

    def run() -> None:
        while not ended.wait(0.02):
            message = PoseStamped()
            message.header.frame_id = frame
            message.header.stamp = stamp(ros.node.get_clock().now())
            message.pose.position.z = 0.5
            message.pose.orientation.w = 1.0
            publisher.publish(message)

    thread = threading.Thread(target=run)
    thread.start()
    yield
    ended.set()
    thread.join()
    ros.close()


def test_poses_come_with_the_age_of_their_capture() -> None:
    ago = rclpy.duration.Duration(seconds=0.25)
    with publishing("world", lambda now: (now - ago).to_msg(), "/pose_a"), RosPoseSource("/pose_a") as source:
        first = source.read()
        assert first is not None and first.pose_world_object.tolist() == [0, 0, 0.5, 1, 0, 0, 0]
        assert 0.25 <= time.monotonic() - first.captured < 5.0
        assert wait_for(lambda: source.read().captured > first.captured)


def test_poses_of_the_camera_go_by_the_cells_calibration() -> None:
    cell = load_cell("ur5e-inspire-emulated")
    tracker = replace(
        cell.tracker,
        driver="ros2",
        address="/pose_b",
        options={"camera_frame": "optical"},
        pose_world_camera=(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0),
        calibration_residual=0.001,
    )
    with publishing("optical", lambda now: now.to_msg(), "/pose_b"):
        with make_pose_source(replace(cell, tracker=tracker)) as source:
            assert source.read().pose_world_object[:3].tolist() == pytest.approx([0.0, 0.0, 0.5])
        with pytest.raises(RobotError, match="in the frame 'optical', not 'world'"):
            RosPoseSource("/pose_b", timeout=1.0).connect()


def test_poses_without_a_stamp_are_refused() -> None:
    from builtin_interfaces.msg import Time

    with publishing("world", lambda now: Time(), "/pose_c"), pytest.raises(RobotError, match="no time stamp"):
        RosPoseSource("/pose_c", timeout=1.0).connect()


class StandInAction:
    """In the place of rclpy's server: the action's type needs a build."""

    def __init__(
        self, node: Any, kind: Any, name: str, execute: Any, callback_group: Any, cancel_callback: Any
    ):
        self.name = name


def test_the_node_says_its_states_and_stops_when_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = SimpleNamespace(Result=SimpleNamespace, Feedback=SimpleNamespace)
    for name, members in (("fungrasp_msgs", {}), ("fungrasp_msgs.action", {"Grasp": kind})):
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    state = JointState(np.full(6, 0.1), np.zeros(6), None, 0.0, 0.0, DeviceStatus.READY)
    told: list[str] = []
    job: Any = SimpleNamespace(
        cell=load_cell("ur5e-inspire-emulated"),
        hand=SimpleNamespace(actuators=dict.fromkeys("abcdef")),
        states={"arm": state, "hand": state},
        now="grasp",
        wrong="",
        stop=lambda: (told.append("stop") is None, "stopping"),
        release=lambda: (False, "the hand does not hold"),
    )
    server, client = RosSide("fungrasp"), RosSide("client")
    GraspNode(server.node, job, StandInAction)
    from diagnostic_msgs.msg import DiagnosticArray

    heard: dict[str, Any] = {}
    client.newest(JointStateMessage, "/fungrasp/joint_states", lambda m: heard.update({m.name[0]: m}))
    client.newest(DiagnosticArray, "/diagnostics", lambda m: heard.update(diagnostics=m))
    answers = {n: client.node.create_client(Trigger, f"/fungrasp/{n}") for n in ("stop", "release")}
    server.spin_in_thread()
    client.spin_in_thread()
    assert all(answer.wait_for_service(10.0) for answer in answers.values())
    futures = {name: answer.call_async(Trigger.Request()) for name, answer in answers.items()}
    assert wait_for(lambda: all(f.done() for f in futures.values()))
    assert futures["stop"].result().success and futures["stop"].result().message == "stopping"
    assert not futures["release"].result().success and told == ["stop"]
    assert wait_for(lambda: {JOINTS[0], "a", "diagnostics"} <= set(heard))
    assert heard["a"].position.tolist() == [0.1] * 6
    assert [s.name for s in heard["diagnostics"].status] == [
        f"fungrasp: {n}" for n in ("arm", "hand", "grasp")
    ]
    for side in (server, client):
        side.close()


def test_the_entry_points_of_the_package_lead_somewhere() -> None:
    text = (Path(__file__).parents[2] / "ros2" / "fungrasp_ros2" / "setup.py").read_text()
    for name in ("joint_loop:make_arm", "joint_loop:make_hand", "pose_source:make_pose_source"):
        module, function = name.split(":")
        assert name in text and hasattr(__import__(f"fungrasp_ros2.{module}", fromlist=[function]), function)

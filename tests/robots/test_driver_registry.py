"""Drivers that other packages bring: found, guarded, and refused in words."""

from __future__ import annotations

import re
import socket
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loop_thread import LoopThread

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.robots.assembly import ARM_DRIVERS, TRACKERS, arm_driver, hand_driver, pose_source, wired_robot
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.device import DeviceStatus, SafetyStop
from fungrasp.robots.single_devices import guarded_driver
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp_emulators.emulator import PlantCommand
from fungrasp_emulators.plants import ServoPlant

EXAMPLE = Path(__file__).parents[2] / "examples" / "fungrasp_gateway"

LAB = """
import time
import numpy as np
from fungrasp.robots.device import DeviceStatus, JointLimits, JointState, TrackedPose, TrackingStatus
from fungrasp.robots.hands import hand_joint_limits


class Arm:
    name, takes_feedforward, lets_go = "arm of a lab", False, ""
    limits = JointLimits(np.full(6, -6.0), np.full(6, 6.0), np.full(6, 3.0), np.full(6, 150.0))

    def __init__(self, cell):
        self.positions, self.sent, self.stopped = np.array(cell.arm.home), [], False

    def connect(self): pass
    def take_control(self): pass
    def close(self): pass
    def __enter__(self): return self
    def __exit__(self, *error): pass
    def stop(self, kind=None): self.stopped = True

    def read(self):
        now = time.monotonic()
        status = DeviceStatus.STOPPED if self.stopped else DeviceStatus.READY
        return JointState(self.positions, np.zeros(6), None, now, now, status)

    def command(self, positions, feedforward=None):
        self.positions = positions
        self.sent.append(positions)
        return positions


class Hand(Arm):
    name = "hand of a lab"

    def __init__(self, cell):
        self.positions, self.sent, self.stopped = np.full(6, 0.2), [], False
        self.limits = JointLimits(*hand_joint_limits(cell.hand, 6), np.full(6, 3.0), np.full(6, 3.0))


class Poses:
    name = "tracker of a lab"

    def __init__(self, cell): pass
    def connect(self): pass
    def close(self): pass
    def __enter__(self): return self
    def __exit__(self, *error): pass

    def read(self):
        pose = np.array([0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0])
        return TrackedPose(pose, time.monotonic(), 1.0, TrackingStatus.TRACKING)


def five_joints(cell):
    arm = Arm(cell)
    arm.limits = JointLimits(*(np.ones(5),) * 4)
    return arm


def half(cell):
    arm = Arm(cell)
    return type("Half", (), {"name": "half", "limits": arm.limits, "connect": arm.connect})()


def broken(cell):
    return 1 / 0
"""


def install(folder: Path, name: str, module: str, source: str, points: str) -> None:
    """What pip leaves of a package."""
    folder.mkdir(exist_ok=True)
    (folder / f"{module}.py").write_text(source)
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    monkeypatch.syspath_prepend(str(tmp_path / "site"))

    def installed(points: str, name: str = "lab-robots", module: str = "lab_robots", source: str = LAB):
        install(tmp_path / "site", name, module, source, points)

    yield installed
    for module in ("lab_robots", "fungrasp_gateway"):
        monkeypatch.delitem(__import__("sys").modules, module, raising=False)


def lab_cell(**arm: str) -> RobotCell:
    cell = load_cell("ur5e-inspire-emulated")
    device = replace(cell.arm, driver=arm.get("driver", "lab"), address="lab", options={})
    return replace(cell, arm=device, tracker=replace(cell.tracker, driver="lab"))


ARM = "[fungrasp.arm_drivers]\nlab = lab_robots:Arm\n"
HAND = "[fungrasp.hand_drivers]\nlab = lab_robots:Hand\n"
POSES = "[fungrasp.pose_sources]\nlab = lab_robots:Poses\n"


def test_a_robot_of_others_is_guarded_and_stopped(lab, tmp_path: Path) -> None:
    lab(ARM + HAND + POSES)
    cell = lab_cell()
    cell = replace(cell, hand_device=replace(cell.hand_device, driver="lab"))
    hand = load_hand(cell.hand)
    assert pose_source(cell).name == "tracker of a lab"
    stop = tmp_path / "stop"
    robot = wired_robot(cell, hand, switch=StopSwitch(str(stop)))
    home = np.array(cell.arm.home)
    robot.place_setpoints(home, np.full(6, 0.2))
    robot.send(home, np.full(6, 0.2))
    sent = len(robot.arm.sent)
    with pytest.raises(SafetyStop, match="far from where the arm is"):
        # A setpoint's time later.
        robot.clock.sleep_until(robot.clock.now() + robot.setpoints.period)
        robot.send(home + 0.6, np.full(6, 0.2))
    assert len(robot.arm.sent) == sent and robot.arm.stopped and robot.hand_driver.stopped
    stop.touch()
    with pytest.raises(SafetyStop, match="stop file"):
        robot.send(home, np.full(6, 0.2))
    assert len(robot.arm.sent) == sent


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ("lab = lab_robots:five_joints", "moves 5 joints, and 'arm.home' has 6"),
        ("lab = lab_robots:half", "lab-robots 1.0 is no JointDriver: it has no 'takes_feedforward'"),
        ("lab = lab_robots:broken", "lab-robots 1.0 can't be made from cell .*ZeroDivisionError"),
        ("lab = lab_robots:missing", "lab-robots 1.0 can't be loaded: AttributeError"),
        ("lab = no_such_module:Arm", "lab-robots 1.0 can't be loaded: ModuleNotFoundError: .*no_such_module"),
        ("other = lab_robots:Arm", "'arm.driver': unknown driver 'lab'.*Known: other, twin, ur-rtde"),
    ],
)
def test_drivers_that_do_not_fit_are_refused_by_name(lab, points: str, words: str) -> None:
    lab(f"[fungrasp.arm_drivers]\n{points}\n")
    with pytest.raises(FungraspError, match=words) as caught:
        arm_driver(lab_cell())
    assert "\n" not in str(caught.value)


def test_names_that_clash_are_refused(lab, capsys: pytest.CaptureFixture[str]) -> None:
    lab("[fungrasp.arm_drivers]\nur-rtde = lab_robots:Arm\nlab = lab_robots:Arm\n")
    lab("[fungrasp.arm_drivers]\nlab = other_lab:Arm\n", "other-lab", "other_lab")
    both = "provided by several packages, (lab-robots 1.0, other-lab|other-lab 1.0, lab-robots) 1.0"
    for name, words in (("ur-rtde", "fungrasp, lab-robots 1.0"), ("lab", both)):
        with pytest.raises(FungraspError, match=words):
            arm_driver(lab_cell(driver=name))
    assert main(["robots", "list"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"ur-rtde +arm +fungrasp, lab-robots 1.0", text)
    assert re.search(r"realsense +tracker +fungrasp", text)


def test_own_drivers_need_no_entry_point() -> None:
    assert ARM_DRIVERS.known() == {"twin": "fungrasp", "ur-rtde": "fungrasp"}
    assert set(TRACKERS.known()) == {"pose-stream", "realsense", "twin"}


def test_the_package_of_the_examples_drives_a_hand(lab, monkeypatch: pytest.MonkeyPatch) -> None:
    source = (EXAMPLE / "fungrasp_gateway.py").read_text()
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    ((group, points),) = project["entry-points"].items()
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    lab(f"[{group}]\n{lines}", project["name"], "fungrasp_gateway", source)
    plant = ServoPlant(np.full(6, 0.2), time_constant=0.02, velocity=10.0)
    server = socket.create_server(("127.0.0.1", 0))

    def gateway() -> None:
        connection, _ = server.accept()
        with connection:
            for line in connection.makefile("r"):
                now = time.monotonic()
                if line.startswith("set"):
                    plant.apply(PlantCommand(positions=np.array(line.split()[1:], dtype=float)), now)
                elif line.startswith("get"):
                    joints = " ".join(str(q) for q in plant.state(now).positions)
                    connection.sendall(f"{joints}\n".encode())

    threading.Thread(target=gateway, daemon=True).start()
    cell = load_cell("ur5e-inspire-emulated")
    options = {"port": server.getsockname()[1]}
    device = replace(cell.hand_device, driver="gateway", address="127.0.0.1", options=options)
    cell = replace(cell, hand_device=device)
    driver = hand_driver(cell, load_hand(cell.hand))
    # In this process: the package is on its path alone.
    monkeypatch.setattr(driver, "_make_host", LoopThread)
    monkeypatch.setattr("fungrasp.robots.single_devices.hand_driver", lambda cell, hand: driver)
    with guarded_driver("hand", cell, load_hand(cell.hand)) as hand:
        assert hand.read().status is DeviceStatus.READY
        deadline = time.monotonic() + 10.0
        while np.abs(hand.read().positions - 0.3).max() > 0.01 and time.monotonic() < deadline:
            hand.command(np.full(6, 0.3))
            time.sleep(0.01)
        assert np.abs(plant.state(time.monotonic()).positions - 0.3).max() < 0.01
    server.close()

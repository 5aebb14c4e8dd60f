"""A real cell with a mistake in its file is refused before anything is connected, in one line that names the
key and what to write."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fungrasp.cli.main import main
from fungrasp.robots.cell import RobotCell, cell_faults

CELL = """
name = "lab"
hand = "inspire"
stop_file = "stop"

[arm]
model = "ur5e"
driver = "ur-rtde"
address = "192.168.0.10"
options = { velocity = 0.3, acceleration = 1.0, jerk = 20.0, payload = 1.2 }
pose_world_base = [-0.5, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]
home = [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0]

[mount]
pose_flange_hand = [0.0, 0.0, 0.156, 0.7071068, 0.0, 0.0, 0.7071068]
adapter_radius = 0.04
adapter_length = 0.15

[hand_device]
driver = "inspire"
address = "192.168.11.210"
options = { speed = 100, force = 100 }

[tracker]
driver = "pose-stream"
address = "tcp://127.0.0.1:5556"
options = { frame = "camera", object_name = "mug" }
pose_world_camera = [0.8, 0.0, 0.6, 0.0, 0.7071068, 0.7071068, 0.0]
calibration_residual = 0.002

[[obstacles]]
center = [-0.5, 0.0, 0.14]
size = [0.25, 0.25, 0.28]

[workspace]
lower = [-0.3, -0.3, 0.0]
upper = [0.35, 0.3, 0.8]
"""

MISTAKES = {
    "joints in degrees": (
        "home = [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0]",
        "home = [0, -109, 109, -90, -90, 0]",
        ["'arm.home' is in rad and may be at most 6.283, not 109"],
    ),
    "millimeters": (
        "0.156, 0.7071068",
        "156.0, 0.7071068",
        ["'mount.pose_flange_hand' is in m and may be at most 0.5, not 156"],
    ),
    "an adapter in millimeters": (
        "adapter_radius = 0.04",
        "adapter_radius = 40",
        ["'mount.adapter_radius' is in m and may be at most 0.3, not 40"],
    ),
    "payload in grams": (
        "payload = 1.2",
        "payload = 1200.0",
        ["'arm.options.payload' is in kg and may be at most 20, not 1200"],
    ),
    "unknown key": (
        "stop_file =",
        "stopfile =",
        ["no field 'stopfile'", "did you mean 'stop_file'"],
    ),
    "unknown option": (
        "speed = 100",
        "sped = 100",
        ["[hand_device]", "options of the driver inspire: there is no field 'sped'; did you mean 'speed'"],
    ),
    "missing mount": (
        "pose_flange_hand = [0.0, 0.0, 0.156, 0.7071068, 0.0, 0.0, 0.7071068]",
        "",
        ["'mount.pose_flange_hand' is missing", "3 meters and a unit quaternion wxyz"],
    ),
    "residual too large": (
        "calibration_residual = 0.002",
        "calibration_residual = 0.0061",
        ["'tracker.calibration_residual' is 6.1 mm", "calibrate the camera again"],
    ),
    "left hand, right model": (
        'hand = "inspire"',
        'hand = "allegro"',
        ["[hand_device]", 'side = "left"', "hand 'allegro' is a model of a right hand"],
    ),
    "another hand's driver": (
        'hand = "inspire"',
        'hand = "leap"',
        ["[hand_device]", "hand 'leap' has 16 independent joints, the device 6"],
    ),
    "camera frame without the camera's pose": (
        "calibration_residual = 0.002",
        "",
        ["no calibration of the camera", "fungrasp robots calibrate", "'calibration' under [tracker]"],
    ),
    "unknown frame": ('frame = "camera"', 'frame = "base"', ["[tracker]", '"world" or "camera"', "'base'"]),
    "home outside the limits": (
        "home = [0.0, -1.9, 1.9,",
        "home = [0.0, -1.9, 3.5,",
        ["'arm.home' is beyond the joint limits"],
    ),
    "home outside the workspace": (
        "upper = [0.35, 0.3, 0.8]",
        "upper = [0.35, 0.3, 0.5]",
        ["at 'arm.home' the palm would leave the workspace box", "the palm is at ("],
    ),
    "too few joints": (", -1.5708, 0.0]", ", -1.5708]", ["'arm.home' must have 6 joints, not 5"]),
    "obstacle through the base": (
        "center = [-0.5, 0.0, 0.14]",
        "center = [-0.5, 0.0, 0.28]",
        ["at 'arm.home' the arm or the hand would touch an obstacle"],
    ),
    "unknown driver": (
        'driver = "ur-rtde"',
        'driver = "ur-rdte"',
        ["'arm.driver'", "unknown driver 'ur-rdte'. Did you mean 'ur-rtde'"],
    ),
    "serial port without protocol": (
        'address = "192.168.11.210"',
        'address = "/dev/ttyUSB0"',
        ["[hand_device] 'protocol' is missing", '"serial" (frames EB 90) or "rtu" (Modbus)'],
    ),
    "a number as a text": (
        "speed = 100",
        'speed = "slow"',
        ["[hand_device]", "inspire: speed: expected a whole number, not 'slow'"],
    ),
    "no address": (
        'address = "192.168.0.10"',
        "",
        ["'arm.address' is missing", "where the arm's controller is"],
    ),
    "a quaternion that is none": (
        "0.3, 1.0, 0.0, 0.0, 0.0]",
        "0.3, 0.0, 0.0, 180.0]",
        ["'arm.pose_world_base' must be 3 meters and a unit quaternion wxyz"],
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_refused_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right, wrong, words = MISTAKES[name]
    assert right in CELL
    text = CELL.replace(right, wrong, 1)
    if "left" in name:
        text = text.replace('driver = "inspire"', 'driver = "allegro-can"').replace("192.168.11.210", "can0")
        text = text.replace("speed = 100, force = 100", 'side = "left"')
    path = tmp_path / "cell.toml"
    path.write_text(text)
    assert main(["robots", "check", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("fungrasp: error: ") and error.count("\n") == 1
    for word in words:
        assert word in error, error


def test_the_cell_without_a_mistake_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    assert main(["robots", "check", str(path)]) == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    ("section", "name", "value", "unit"),
    [
        ("watchdog", "arm_silence", 40.0, "s"),
        ("watchdog", "hand_silence", 100.0, "s"),
        ("watchdog", "pose_stale", 500.0, "s"),
        ("watchdog", "overrun", 250.0, "s"),
        ("watchdog", "pose_jump", 50.0, "m"),
        ("watchdog", "pose_turn", 30.0, "rad"),
        ("limits", "goal_distance", 300.0, "m"),
        ("limits", "hand_speed", 90.0, "rad/s"),
        ("workspace", "hand_depth", 12.0, "m"),
    ],
)
def test_a_wrong_unit_does_not_switch_a_check_off(section: str, name: str, value: float, unit: str) -> None:
    cell = RobotCell("allegro")
    wrong = replace(cell, **{section: replace(getattr(cell, section), **{name: value})})
    faults = cell_faults(wrong)
    assert any(f"'{section}.{name}'" in fault and f"is in {unit} and" in fault for fault in faults), faults

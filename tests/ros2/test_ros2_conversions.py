"""Messages of ROS: what is read from them, what is written, and, where rosbags is installed, that its
definitions of the messages take every field."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fungrasp.robots.device import DeviceStatus, JointState, RobotError
from fungrasp_ros2.arm_watch import ArmWatch
from fungrasp_ros2.conversions import (
    captured_time,
    command_fields,
    diagnostic_fields,
    fill,
    joint_state_fields,
    joints_of,
    pose_of,
)

NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
STATE = JointState(np.array([0.1, -0.2]), np.array([0.0, 0.5]), None, 5.0, 6.0, DeviceStatus.READY)


def message(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**fields)


def pose(x: float = 0.1, w: float = 1.0) -> SimpleNamespace:
    return message(position=message(x=x, y=0.2, z=0.3), orientation=message(x=0.0, y=0.0, z=0.0, w=w))


def test_only_the_age_goes_from_one_clock_to_another() -> None:
    stamp = message(sec=1_700_000_000, nanosec=250_000_000)
    ros_now = 1_700_000_000_300_000_000
    assert captured_time(stamp, ros_now, 12.0) == pytest.approx(11.95)
    # A stamp a little ahead is now, not the future.
    assert captured_time(message(sec=1_700_000_000, nanosec=310_000_000), ros_now, 12.0) == 12.0


@pytest.mark.parametrize(
    ("stamp", "words"),
    [
        ((0, 0), "no time stamp"),
        ((1_700_000_001, 0), "0.700 s ahead: synchronize the clocks"),
        ((1_699_999_980, 0), "20 s old.*use_sim_time"),
    ],
)
def test_stamps_that_can_not_be_are_refused(stamp: tuple[int, int], words: str) -> None:
    with pytest.raises(RobotError, match=words):
        captured_time(message(sec=stamp[0], nanosec=stamp[1]), 1_700_000_000_300_000_000, 12.0)


def test_quaternions_change_their_order() -> None:
    turned = message(position=message(x=1.0, y=2.0, z=3.0), orientation=message(x=0.0, y=0.0, z=0.6, w=0.8))
    assert pose_of(turned).tolist() == [1.0, 2.0, 3.0, 0.8, 0.0, 0.0, 0.6]
    transform = message(translation=turned.position, rotation=turned.orientation)
    assert pose_of(transform).tolist() == pose_of(turned).tolist()


@pytest.mark.parametrize(
    ("wrong", "words"), [(pose(x=np.nan), "not finite"), (pose(w=0.0), "unit quaternion")]
)
def test_poses_that_are_none_are_refused(wrong: SimpleNamespace, words: str) -> None:
    with pytest.raises(RobotError, match=words):
        pose_of(wrong)


def test_joints_come_in_the_order_of_the_model() -> None:
    # As joint_state_broadcaster of a UR orders them, beside a joint of another device.
    heard = message(
        name=["elbow_joint", "gripper", "shoulder_lift_joint", "shoulder_pan_joint"],
        position=[3.0, 9.0, 2.0, 1.0],
        velocity=[0.3, 0.9, 0.2, 0.1],
    )
    positions, velocities = joints_of(heard, NAMES)
    assert positions.tolist() == [1.0, 2.0, 3.0] and velocities.tolist() == [0.1, 0.2, 0.3]
    heard.velocity = []
    assert np.isnan(joints_of(heard, NAMES)[1]).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": ["a", "b", "c"]}, "no 'shoulder_pan_joint', but a, b, c"),
        ({"position": [1.0]}, "3 names have 1 positions"),
        ({"position": [1.0, np.nan, 2.0]}, "not finite"),
    ],
)
def test_joint_states_that_are_none_are_refused(change: dict[str, Any], words: str) -> None:
    fields = {"name": list(NAMES), "position": [1.0, 2.0, 3.0], "velocity": []} | change
    with pytest.raises(RobotError, match=words):
        joints_of(message(**fields), NAMES)


def test_diagnostics_say_what_every_device_says() -> None:
    stopped = JointState(
        STATE.positions, STATE.velocities, None, 0.0, 0.0, DeviceStatus.PROTECTIVE_STOP, "acknowledge it"
    )
    fields = diagnostic_fields({"arm": stopped, "hand": STATE}, "grasp", "", 7)
    levels = [(one["name"], one["level"], one["message"]) for one in fields["status"]]
    assert levels == [
        ("fungrasp: arm", b"\x02", "acknowledge it"),
        ("fungrasp: hand", b"\x00", "ready"),
        ("fungrasp: grasp", b"\x00", "grasp"),
    ]
    fault = diagnostic_fields({}, "fault", "the object jumped", 7)["status"][-1]
    assert fault["level"] == b"\x02" and fault["message"] == "the object jumped"


SAID = {
    "sensor_msgs/msg/JointState": joint_state_fields(("a", "b"), STATE, 1_700_000_000_300_000_000),
    "std_msgs/msg/Float64MultiArray": command_fields(np.array([0.1, 0.2, 0.3])),
    "diagnostic_msgs/msg/DiagnosticArray": diagnostic_fields(
        {"arm": STATE}, "hold", "", 1_700_000_000_000_000_001
    ),
}


@pytest.mark.parametrize("store", ["ROS2_HUMBLE", "ROS2_JAZZY", "ROS2_LYRICAL"])
@pytest.mark.parametrize("name", SAID)
def test_messages_are_serialized_by_the_definitions_of_rosbags(name: str, store: str) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    known = typesys.get_typestore(typesys.Stores[store])
    made = typed(known, name, SAID[name])
    back = known.deserialize_cdr(known.serialize_cdr(made, name), name)
    compare(SAID[name], back)


def typed(store: Any, name: str, fields: dict[str, Any]) -> Any:
    """A message of rosbags: classes that take all fields at once, numbers as arrays."""
    _, definitions = store.fielddefs[name]
    assert {field for field, _ in definitions} == set(fields), "a field is missing, or is not of the message"
    values = {}
    for field, (kind, detail) in definitions:
        value = fields[field]
        if isinstance(value, dict):
            value = typed(store, detail, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            value = [typed(store, detail[0][1], one) for one in value]
        elif isinstance(value, list) and kind.name == "SEQUENCE" and detail[0][1][0] == "float64":
            value = np.array(value, dtype=np.float64)
        elif isinstance(value, bytes):
            value = value[0]
        values[field] = value
    return store.types[name](**values)


def compare(fields: dict[str, Any], back: Any) -> None:
    for name, value in fields.items():
        got = getattr(back, name)
        if isinstance(value, dict):
            compare(value, got)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            assert len(value) == len(got)
            for one, other in zip(value, got, strict=True):
                compare(one, other)
        elif isinstance(value, bytes):
            assert got == value[0]
        else:
            assert list(got) == value if isinstance(value, list) else got == value


def test_filling_makes_messages_within_messages() -> None:
    class Value:
        key = value = ""

    class Status:
        level, name, message, hardware_id, values = b"", "", "", "", ()

    array = message(header=message(stamp=message(sec=0, nanosec=0), frame_id=""), status=())
    fill(array, SAID["diagnostic_msgs/msg/DiagnosticArray"], {"status": Status, "values": Value})
    assert array.header.stamp.nanosec == 1
    assert [one.name for one in array.status] == ["fungrasp: arm", "fungrasp: grasp"]
    assert array.status[0].values[0].value == "ready"


def heard(**more: Any) -> ArmWatch:
    watch = ArmWatch(2, stale_after=0.1)
    watch.hear_joints(np.zeros(2), np.zeros(2), 1.0, 100.0)
    for name, value in ({"safety_mode": 1, "program_running": True, "speed_scaling": 100.0} | more).items():
        setattr(watch, name, value)
    return watch


@pytest.mark.parametrize(
    ("more", "status", "words"),
    [
        ({}, DeviceStatus.READY, ""),
        ({"safety_mode": 2}, DeviceStatus.READY, ""),
        ({"safety_mode": 3}, DeviceStatus.PROTECTIVE_STOP, "acknowledge it on the pendant"),
        ({"safety_mode": 5}, DeviceStatus.FAULT, "safeguard stop"),
        ({"safety_mode": 7}, DeviceStatus.EMERGENCY_STOP, "release it, then connect again"),
        ({"safety_mode": 99}, DeviceStatus.FAULT, "safety mode 99"),
        ({"program_running": False}, DeviceStatus.FAULT, "start External Control"),
        ({"speed_scaling": 50.0}, DeviceStatus.FAULT, "50 % of its speed: set the slider to 100 %"),
        ({"safety_mode": None}, DeviceStatus.FAULT, "nothing has come on the topic of safety_mode"),
    ],
)
def test_an_arm_that_is_led_is_watched(more: dict[str, Any], status: DeviceStatus, words: str) -> None:
    state = heard(**more).state(100.05, taken=True)
    assert state.status is status and words in state.message


def test_an_arm_that_is_looked_at_may_be_slow() -> None:
    assert heard(speed_scaling=10.0, program_running=False).state(100.0, False).status is DeviceStatus.READY
    assert heard(safety_mode=3).state(100.0, False).status is DeviceStatus.PROTECTIVE_STOP


def test_stamps_that_stand_still_grow_old() -> None:
    watch = heard()
    watch.hear_joints(np.ones(2), np.zeros(2), 1.0, 100.2)
    state = watch.state(100.2, False)
    assert state.status is DeviceStatus.DISCONNECTED and "200 ms" in state.message
    assert ArmWatch(2, 0.1).state(5.0, False).message == "no joint states yet"


def test_velocities_that_are_not_said_are_differences() -> None:
    watch = heard()
    watch.hear_joints(np.array([0.1, 0.0]), np.full(2, np.nan), 1.5, 100.5)
    assert watch.velocities.tolist() == pytest.approx([0.2, 0.0])

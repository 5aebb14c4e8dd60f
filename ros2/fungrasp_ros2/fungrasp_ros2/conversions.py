"""What messages of ROS say in the terms of fungrasp, and back. Needs no ROS: messages are taken by their
fields, and made as nested dicts of fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fungrasp.robots.device import DeviceStatus, JointState, RobotError

FUTURE = 0.02
"""A stamp this far ahead of our clock [s] is of a machine whose clock differs."""
OLDEST = 10.0
"""A stamp older than this [s] is of another clock, or of a recording."""
OK, WARN, ERROR, STALE = b"\x00", b"\x01", b"\x02", b"\x03"
"""Levels of diagnostic_msgs/DiagnosticStatus."""
LEVELS = {DeviceStatus.READY: OK, DeviceStatus.STOPPED: WARN, DeviceStatus.DISCONNECTED: STALE}


def captured_time(stamp: Any, ros_now: int, now: float) -> float:
    """When something was captured, by ``time.monotonic`` [s].

    Only its age goes from one clock to the other, so that clocks of any origin will do. Machines must keep
    the same time (NTP, PTP): an age is as wrong as their clocks differ.

    Args:
        stamp: of a message's header, with ``sec`` and ``nanosec``.
        ros_now: of the node's clock when the message came [ns].
        now: ``time.monotonic`` at that time [s].

    Raises:
        RobotError: no stamp, or one that can't be.
    """
    nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
    if nanoseconds == 0:
        raise RobotError("a message has no time stamp: the age of what it says is not known")
    age = (ros_now - nanoseconds) * 1e-9
    if age < -FUTURE:
        raise RobotError(
            f"a message's time stamp is {-age:.3f} s ahead: synchronize the clocks of the two machines"
        )
    if age > OLDEST:
        raise RobotError(
            f"a message's time stamp is {age:.0f} s old: is its clock another one (use_sim_time)?"
        )
    return now - max(age, 0.0)


def stamp_fields(nanoseconds: int) -> dict[str, int]:
    """Fields of a stamp. nanoseconds: of the node's clock."""
    return {"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000}


def pose_of(message: Any) -> np.ndarray:
    """A pose, shape [7], of geometry_msgs/Pose, whose quaternion is xyzw, or of a Transform.

    Raises:
        RobotError: values that are not finite, or no unit quaternion.
    """
    if hasattr(message, "translation"):
        place, turn = message.translation, message.rotation
    else:
        place, turn = message.position, message.orientation
    pose = np.array([place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z], dtype=float)
    if not np.isfinite(pose).all():
        raise RobotError("a pose holds values that are not finite")
    norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1.0) > 1e-2:
        raise RobotError("the orientation of a pose is no unit quaternion")
    pose[3:] /= norm
    return pose


def joints_of(message: Any, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Positions [rad] and velocities [rad/s] of joints in our order, shape [U] each, of
    sensor_msgs/JointState, whose order is its own. A message without velocities gives NaN.

    Raises:
        RobotError: a joint is missing, or the message's lists differ in length.
    """
    listed = {name: i for i, name in enumerate(message.name)}
    missing = [name for name in names if name not in listed]
    if missing:
        raise RobotError(
            f"the joint states hold no '{missing[0]}', but {', '.join(message.name) or 'nothing'}"
        )
    if len(message.position) != len(message.name):
        raise RobotError(f"joint states of {len(message.name)} names have {len(message.position)} positions")
    rows = [listed[name] for name in names]
    positions = np.array(message.position, dtype=float)[rows]
    velocities = np.full(len(rows), np.nan)
    if len(message.velocity) == len(message.name):
        velocities = np.array(message.velocity, dtype=float)[rows]
    if not np.isfinite(positions).all():
        raise RobotError("joint states hold positions that are not finite")
    return positions, velocities


def joint_state_fields(names: Sequence[str], state: JointState, nanoseconds: int) -> dict[str, Any]:
    """Fields of sensor_msgs/JointState.

    Args:
        names: of the joints.
        state: as a driver says it.
        nanoseconds: of the node's clock when it was received.
    """
    torques = [] if state.torques is None else state.torques.tolist()
    return {
        "header": {"stamp": stamp_fields(nanoseconds), "frame_id": ""},
        "name": list(names),
        "position": state.positions.tolist(),
        "velocity": state.velocities.tolist(),
        "effort": torques,
    }


def command_fields(positions: np.ndarray) -> dict[str, Any]:
    """Fields of std_msgs/Float64MultiArray, as forward_command_controller takes them. positions: [rad]."""
    return {"layout": {"dim": [], "data_offset": 0}, "data": positions.tolist()}


def diagnostic_fields(
    states: Mapping[str, JointState], phase: str, fault: str, nanoseconds: int
) -> dict[str, Any]:
    """Fields of diagnostic_msgs/DiagnosticArray: one status of each device, and one of the grasp.

    Args:
        states: of the devices by name.
        phase: of the deployment; "" for none.
        fault: why it was stopped; "" if it was not.
        nanoseconds: of the node's clock.
    """
    statuses = [
        {
            "level": LEVELS.get(state.status, ERROR),
            "name": f"fungrasp: {name}",
            "message": state.message or state.status.value,
            "hardware_id": name,
            "values": [{"key": "status", "value": state.status.value}],
        }
        for name, state in states.items()
    ]
    grasp = {
        "level": ERROR if fault else OK,
        "name": "fungrasp: grasp",
        "message": fault or phase or "idle",
        "hardware_id": "",
        "values": [{"key": "phase", "value": phase}],
    }
    return {"header": {"stamp": stamp_fields(nanoseconds), "frame_id": ""}, "status": [*statuses, grasp]}


def fill(message: Any, fields: Mapping[str, Any], kinds: Mapping[str, type] | None = None) -> Any:
    """A message with these fields.

    Args:
        message: to be filled.
        fields: nested.
        kinds: class of the members of each list of messages, by the list's name.
    """
    for name, value in fields.items():
        if isinstance(value, Mapping):
            fill(getattr(message, name), value, kinds)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            setattr(message, name, [fill((kinds or {})[name](), one, kinds) for one in value])
        else:
            setattr(message, name, value)
    return message

"""Goals and states as records of fixed size, for mailboxes."""

from __future__ import annotations

from typing import Any

import numpy as np

from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointState

STATUSES = tuple(DeviceStatus)
MESSAGE_BYTES = 240

STARTING, RUNNING, ENDED = range(3)
"""Phases of a loop."""


def goal_kind(count: int) -> np.dtype:
    """Record of what a driver tells its loop; count: number of joints U."""
    joints = ("<f8", (count,))
    return np.dtype(
        [("mode", "u1"), ("order", "<i8"), ("sent", "<f8"), ("positions", *joints), ("feedforward", *joints)]
    )


def state_kind(count: int) -> np.dtype:
    """Record of what a loop tells its driver; count: number of joints U."""
    joints = ("<f8", (count,))
    return np.dtype(
        [
            ("phase", "u1"),
            ("order", "<i8"),
            ("status", "u1"),
            ("has_torques", "u1"),
            ("device_time", "<f8"),
            ("received", "<f8"),
            ("busy", "<f8"),
            ("steps", "<i8"),
            ("positions", *joints),
            ("velocities", *joints),
            ("torques", *joints),
            ("message", f"S{MESSAGE_BYTES}"),
        ]
    )


def loop_goal(record: Any) -> LoopGoal:
    """The goal in a record of ``goal_kind``."""
    return LoopGoal(LoopMode(int(record["mode"])), record["positions"], record["feedforward"])


def put_state(record: np.ndarray, state: JointState) -> None:
    """Write a state into a record of ``state_kind``, shape []."""
    record["status"] = STATUSES.index(state.status)
    record["has_torques"] = state.torques is not None
    record["device_time"], record["received"] = state.device_time, state.received
    record["positions"], record["velocities"] = state.positions, state.velocities
    if state.torques is not None:
        record["torques"] = state.torques
    record["message"] = state.message.encode()[:MESSAGE_BYTES]


def joint_state(record: Any) -> JointState:
    """The state in a record of ``state_kind``."""
    return JointState(
        positions=record["positions"],
        velocities=record["velocities"],
        torques=record["torques"] if record["has_torques"] else None,
        device_time=float(record["device_time"]),
        received=float(record["received"]),
        status=STATUSES[int(record["status"])],
        message=record_message(record),
    )


def record_message(record: Any) -> str:
    """The message in a record of ``state_kind``."""
    return bytes(record["message"]).decode(errors="replace")

"""The newest record of a fixed size, passed between two processes, and the records of a device's loop: goals
and states. Nobody waits."""

from __future__ import annotations

import mmap
import os
import tempfile
import zlib
from typing import Any

import numpy as np

from fungrasp.robots.control_loop.device_loop import LoopGoal, LoopMode
from fungrasp.robots.device import DeviceStatus, JointState

CHECKSUM = np.dtype("<u4")


class Mailbox:
    """One writes, the others read the newest record.

    A record that is read while it is being written fails its checksum and is read again; where the writer
    has died half way, readers keep the record before.
    """

    def __init__(self, buffer: memoryview, kind: np.dtype):
        """buffer: memory that both sides see, ``mailbox_size(kind)`` bytes."""
        self._kind = kind
        self._record = np.frombuffer(buffer, dtype=np.uint8, count=kind.itemsize, offset=CHECKSUM.itemsize)
        self._checksum = np.frombuffer(buffer, dtype=CHECKSUM, count=1)
        self._last: np.ndarray | None = None
        self._seen: int | None = None

    def write(self, record: np.ndarray) -> None:
        """Replace the record; record: of the mailbox's kind, shape []."""
        data = record.tobytes()
        self._checksum[0] = zlib.crc32(data) ^ 0xFFFFFFFF
        self._record[:] = np.frombuffer(data, dtype=np.uint8)

    def read(self) -> np.ndarray | None:
        """The newest record, shape []; None before the first. Where there is no newer one, the same object
        again."""
        for _ in range(8):
            checksum = int(self._checksum[0])
            if checksum == self._seen:
                break
            data = self._record.tobytes()
            if checksum == zlib.crc32(data) ^ 0xFFFFFFFF:
                self._last, self._seen = np.frombuffer(data, dtype=self._kind)[0], checksum
                break
        return self._last


def mailbox_size(kind: np.dtype) -> int:
    """Bytes of memory that a mailbox of records of a ``kind`` takes."""
    return CHECKSUM.itemsize + kind.itemsize


def shared_memory(size: int) -> tuple[int, mmap.mmap]:
    """Memory without a name, which a child process inherits and which goes with the last of its users.

    Args:
        size: [bytes].

    Returns:
        File descriptor to pass on, which the caller closes, and the memory as this process sees it.
    """
    folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryFile(dir=folder) as file:
        file.truncate(size)
        return os.dup(file.fileno()), mmap.mmap(file.fileno(), size)


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
            ("beat", "<f8"),
            ("status", "u1"),
            ("has_torques", "u1"),
            ("device_time", "<f8"),
            ("received", "<f8"),
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

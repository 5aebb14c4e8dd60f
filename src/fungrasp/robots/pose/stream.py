"""Object poses from another process over ZeroMQ; only the newest is kept. Each message is a MessagePack map
with the entries "schema" ("fungrasp.pose"), "version" (1), and the fields of ``PoseMessage``."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import record_from_json
from fungrasp.geometry.poses import compose
from fungrasp.robots.device import PoseSource, RobotError, TrackedPose, TrackingStatus, import_client

SCHEMA, VERSION = "fungrasp.pose", 1


@dataclass(frozen=True)
class PoseMessage:
    """Entries of a message, without schema and version."""

    sequence: int
    """Number of the message."""
    clock: str
    """Name of the sender's clock; equal names on both sides mean the same clock."""
    captured: float
    """Time of the image, by the sender's clock [s]."""
    sent: float
    """Time of sending, by the sender's clock [s]."""
    object: str
    """Name of the object."""
    frame: str
    """Frame of the pose: "world" or "camera"."""
    position: tuple[float, float, float]
    """Position of the object in this frame [m]."""
    rotation: tuple[float, float, float, float]
    """Rotation of the object in this frame, wxyz."""
    score: float
    """Confidence, 0 to 1."""
    status: Literal["tracking", "lost", "initializing"]
    """State of the tracker (``TrackingStatus``)."""
    wall: float | None = None
    """Time of sending, by the time of day [s since 1970]; may be missing."""

    def entries(self) -> dict[str, Any]:
        """Return the whole map."""
        return {"schema": SCHEMA, "version": VERSION, **vars(self)}


def read_message(entries: Any) -> PoseMessage:
    """Read the message of a map; other entries are ignored. Raises: RobotError: no pose message, another
    version, or invalid values."""
    if not isinstance(entries, dict) or entries.get("schema") != SCHEMA:
        raise RobotError(f"a message of another kind came instead of '{SCHEMA}'")
    if entries.get("version") != VERSION:
        raise RobotError(f"the tracker sends version {entries.get('version')} of '{SCHEMA}', not {VERSION}")
    own = {f.name: entries[f.name] for f in fields(PoseMessage) if f.name in entries}
    try:
        message = record_from_json(PoseMessage, own, "a pose message")
    except FungraspError as error:
        raise RobotError(str(error)) from error
    if abs(math.hypot(*message.rotation) - 1.0) > 1e-3:
        raise RobotError("the rotation of a pose message is no unit quaternion")
    return message


FUTURE = 0.005
"""Time of a capture ahead of our clock beyond which the sender's clock has jumped [s]."""
LONGEST_DELAY = 10.0
"""Delay from capture to sending beyond which the sender's clock has jumped [s]."""
SKEW = 0.02
"""Largest difference of the time of day between two synchronized machines [s]."""


class PoseStream(PoseSource):
    """Receives poses from a publisher. Messages with invalid time stamps, or that are not newer than the
    previous one, are ignored: the last pose then grows old, and only its age tells whether it is usable.

    If the tracker runs on another machine, the age follows from the time of day of both machines, which NTP
    must keep equal. Without time of day, the message with the fastest transmission counts as delivered in no
    time, and the delays of others are relative to it.
    """

    def __init__(
        self,
        address: str,
        object_name: str = "",
        frame: str = "world",
        timeout: float = 2.0,
        pose_world_camera: np.ndarray | None = None,
    ):
        """
        Args:
            address: address of the publisher, such as "tcp://127.0.0.1:5556".
            object_name: expected name of the object. Empty: any.
            frame: expected frame of the poses: "world", or "camera" (OpenCV: x right, y down, z forward).
            timeout: longest wait for the first message [s].
            pose_world_camera: calibrated pose of the camera, world frame, shape [7]; for the frame "camera".

        Raises:
            RobotError: an unknown frame, or the frame "camera" without the camera's pose.
        """
        if frame not in ("world", "camera"):
            raise RobotError(f'a pose stream is in the frame "world" or "camera", not \'{frame}\'')
        if frame == "camera" and pose_world_camera is None:
            raise RobotError("a pose stream in the camera's frame needs the pose of the camera in the world")
        self._camera = np.asarray(pose_world_camera) if frame == "camera" else None
        self.name = f"pose stream {address}"
        self.ignored = 0
        """Number of ignored messages."""
        self._address, self._object, self._frame, self._timeout = address, object_name, frame, timeout
        self._clock = clock_name()
        self._sender, self._sent, self._offset = "", -np.inf, np.inf
        self._socket: Any = None
        self._zmq: Any = None
        self._msgpack: Any = None
        self._last: TrackedPose | None = None

    def connect(self) -> None:
        self._zmq = import_client("zmq", "pose", "a pose stream")
        self._msgpack = import_client("msgpack", "pose", "a pose stream")
        self.close()
        self._sender = ""
        self._socket = self._zmq.Context.instance().socket(self._zmq.SUB)
        # Keep only the newest message; this has no effect after connecting.
        self._socket.setsockopt(self._zmq.CONFLATE, 1)
        self._socket.setsockopt(self._zmq.LINGER, 0)
        self._socket.setsockopt(self._zmq.SUBSCRIBE, b"")
        try:
            self._socket.connect(self._address)
        except self._zmq.ZMQError as error:
            self.close()
            raise RobotError(f"{self.name}: {error}; an address is like tcp://127.0.0.1:5556") from error
        if not self._socket.poll(1000 * self._timeout):
            self.close()
            raise RobotError(f"{self.name}: nothing came within {self._timeout} s; is the tracker running?")
        self._take(strict=True)

    def read(self) -> TrackedPose | None:
        if self._socket is not None:
            self._take()
        return self._last

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _take(self, strict: bool = False) -> None:
        try:
            data = self._socket.recv(self._zmq.NOBLOCK)
        except self._zmq.Again:
            return
        now = time.monotonic()
        try:
            self._last = self._pose(data, now)
        except RobotError as error:
            self.ignored += 1
            if strict:
                self.close()
                raise RobotError(f"{self.name}: {error}") from error

    def _pose(self, data: bytes, now: float) -> TrackedPose:
        try:
            entries = self._msgpack.unpackb(data)
        except Exception as error:
            # Invalid bytes raise errors of many kinds.
            raise RobotError(f"a message is no MessagePack ({type(error).__name__})") from error
        message = read_message(entries)
        if self._object and message.object != self._object:
            raise RobotError(f"the tracker follows '{message.object}', not '{self._object}'")
        if message.frame != self._frame:
            raise RobotError(f"the tracker's poses are in the frame '{message.frame}', not '{self._frame}'")
        delay = message.sent - message.captured
        if not 0 <= delay <= LONGEST_DELAY:
            raise RobotError("the tracker's clock has jumped")
        if message.clock != self._sender:
            self._sender, self._sent, self._offset = message.clock, -np.inf, np.inf
        if message.sent <= self._sent:
            raise RobotError("a message is not newer than the previous one")
        captured = self._captured(message, now, time.time())
        if captured > now + FUTURE:
            raise RobotError("the tracker's clock is ahead of ours")
        self._sent = message.sent
        pose = np.array(message.position + message.rotation)
        if self._camera is not None:
            pose = compose(self._camera, pose)
        return TrackedPose(pose, captured, message.score, TrackingStatus(message.status))

    def _captured(self, message: PoseMessage, now: float, wall: float) -> float:
        """Return the time of the image on our clock [s]. now, wall: our clock and the time of day [s]."""
        if message.clock == self._clock:
            return message.captured
        delay = message.sent - message.captured
        if message.wall is not None:
            travel = wall - message.wall
            if travel < -SKEW:
                raise RobotError(
                    f"the time of day on the tracker's machine is {-travel:.2f} s ahead of ours: let both "
                    "keep the same (NTP)"
                )
            return now - max(travel, 0.0) - delay
        self._offset = min(self._offset, now - message.sent)
        return message.captured + self._offset


class PosePublisher:
    """Publishes the poses of a tracker."""

    def __init__(self, address: str, object_name: str, frame: str = "world"):
        """address: such as "tcp://127.0.0.1:5556". Raises: RobotError: the address is in use or invalid."""
        zmq = import_client("zmq", "pose", "a pose publisher")
        self._msgpack = import_client("msgpack", "pose", "a pose publisher")
        self._object, self._frame, self._sequence = object_name, frame, 0
        self._clock = clock_name()
        self._socket = zmq.Context.instance().socket(zmq.PUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as error:
            self._socket.close()
            raise RobotError(f"cannot publish poses on {address}: {error}") from error

    def publish(
        self,
        pose: np.ndarray,
        captured: float,
        score: float = 1.0,
        status: TrackingStatus = TrackingStatus.TRACKING,
    ) -> None:
        """Send a pose.

        Args:
            pose: pose of the object in the frame, shape [7].
            captured: time of the image, ``time.monotonic`` [s].
            score: confidence, 0 to 1.
            status: state of the tracker.
        """
        x, y, z, *turn = pose.tolist()
        message = PoseMessage(
            self._sequence,
            self._clock,
            captured,
            time.monotonic(),
            self._object,
            self._frame,
            (x, y, z),
            tuple(turn),
            score,
            status.value,
            time.time(),
        )
        self._sequence += 1
        self.send_bytes(self._msgpack.packb(message.entries()))

    def send_bytes(self, data: bytes) -> None:
        """Send a packed message."""
        self._socket.send(data)

    def close(self) -> None:
        """Stop publishing."""
        self._socket.close()


def clock_name() -> str:
    """Return a name for ``time.monotonic`` of this machine since it was started."""
    boot = Path("/proc/sys/kernel/random/boot_id")
    try:
        return f"monotonic:{boot.read_text().strip()}"
    except OSError:
        import uuid

        # Without Linux, the address of the network card, which does not change with a restart.
        return f"monotonic:{uuid.getnode():x}"

"""Object poses from another process, over ZeroMQ, the newest only: one MessagePack map per pose, with the
entries "schema", which is "fungrasp.pose", "version", which is 1, and the fields of ``PoseMessage``."""

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
    """What a tracker says: the entries of its map, but for schema and version."""

    sequence: int
    """Count of the tracker's answers."""
    clock: str
    """Identifies the sender's clock; the same text on both sides: the same clock."""
    captured: float
    """When the image was taken, by the sender's clock [s]."""
    sent: float
    """When the message was sent, by the sender's clock [s]."""
    object: str
    """Name of the object."""
    frame: str
    """Frame of the pose: "world" or "camera"."""
    position: tuple[float, float, float]
    """Position of the object in the frame [m]."""
    rotation: tuple[float, float, float, float]
    """Its rotation, wxyz."""
    score: float
    """Confidence, 0 to 1."""
    status: Literal["tracking", "lost", "initializing"]
    """Whether the pose may be used (``TrackingStatus``)."""
    wall: float | None = None
    """When the message was sent, by the time of day [s since 1970]; may be missing."""

    def entries(self) -> dict[str, Any]:
        """The map."""
        return {"schema": SCHEMA, "version": VERSION, **vars(self)}


def read_message(entries: Any) -> PoseMessage:
    """The message of a map; entries that are not its own are left alone. Raises: RobotError: it is none, of
    another version, or impossible."""
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
"""A capture this far ahead of our clock [s] was stamped by a clock that has jumped."""
LONGEST_DELAY = 10.0
"""A tracker that says it took longer [s] has a clock that has jumped."""
SKEW = 0.02
"""Two machines that keep the same time of day are apart by less [s]."""


class PoseStream(PoseSource):
    """Of a publisher. A message whose time stamps can't be is ignored, and so is one that is
    no newer than the one before, so that the pose before it grows old: only the age of the capture says
    whether a pose may be used.

    Of a tracker on another machine, whose clock has another origin, the age is told by the time of day, which
    both machines keep (NTP). Where its messages don't say that, the one that came soonest after it was sent
    counts as having taken no time: what is later than that one, or waits to be read, is as much older.
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
            address: of the publisher, "tcp://127.0.0.1:5556".
            object_name: of the object; another one is refused. Empty: any.
            frame: that poses must be in: "world", or "camera" (OpenCV: x right, y down, z forward).
            timeout: to wait for the first message on connecting [s].
            pose_world_camera: where the camera stands, from calibration, shape [7]; of the frame "camera".

        Raises:
            RobotError: another frame, or the camera's without its pose.
        """
        if frame not in ("world", "camera"):
            raise RobotError(f'a pose stream is in the frame "world" or "camera", not \'{frame}\'')
        if frame == "camera" and pose_world_camera is None:
            raise RobotError("a pose stream in the camera's frame needs the pose of the camera in the world")
        self._camera = np.asarray(pose_world_camera) if frame == "camera" else None
        self.name = f"pose stream {address}"
        self.ignored = 0
        """Messages that could not be used."""
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
        # Before connecting, or it has no effect: only the newest message is kept.
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
            # The library raises errors of many kinds for bytes that are no MessagePack.
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
            raise RobotError("a message came again")
        captured = self._captured(message, now, time.time())
        if captured > now + FUTURE:
            raise RobotError("the tracker's clock is ahead of ours")
        self._sent = message.sent
        pose = np.array(message.position + message.rotation)
        if self._camera is not None:
            pose = compose(self._camera, pose)
        return TrackedPose(pose, captured, message.score, TrackingStatus(message.status))

    def _captured(self, message: PoseMessage, now: float, wall: float) -> float:
        """When the image was taken, by our clock [s]. now, wall: our clock and the time of day [s]."""
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
    """The other end: what a tracker's process calls for each of its answers."""

    def __init__(self, address: str, object_name: str, frame: str = "world"):
        """address: to publish on, "tcp://127.0.0.1:5556". Raises: RobotError: the address is in use or is
        none."""
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
            pose: of the object, shape [7].
            captured: when the image was taken, ``time.monotonic`` [s].
            score: confidence, 0 to 1.
            status: whether the pose may be used.
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
        """Send a message that is packed already."""
        self._socket.send(data)

    def close(self) -> None:
        """Stop publishing."""
        self._socket.close()


def clock_name() -> str:
    """Names the clock ``time.monotonic`` of this machine since it was started."""
    boot = Path("/proc/sys/kernel/random/boot_id")
    try:
        return f"monotonic:{boot.read_text().strip()}"
    except OSError:
        import uuid

        # Elsewhere: of this machine's network card; it does not change when the machine is restarted.
        return f"monotonic:{uuid.getnode():x}"

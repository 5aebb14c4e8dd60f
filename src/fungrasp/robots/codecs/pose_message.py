"""Message of an object tracker: one MessagePack map per pose.

| key | value |
| --- | --- |
| schema, version | "fungrasp.pose", 1 |
| sequence | counts the tracker's answers |
| clock | identifies the clock of the two times; the same text on both sides: the same clock |
| captured, sent | when the image was taken, and when the message was sent, by that clock [s] |
| object, frame | names |
| position, rotation | [m], and unit quaternion wxyz: object in frame |
| score, status | 0 to 1; "tracking", "lost" or "initializing" |
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from fungrasp.robots.device import RobotError, TrackingStatus

SCHEMA, VERSION = "fungrasp.pose", 1


@dataclass(frozen=True)
class PoseMessage:
    """What a tracker says."""

    sequence: int
    """Count of the tracker's answers."""
    clock: str
    """Identifies the sender's clock."""
    captured: float
    """When the image was taken, sender's clock [s]."""
    sent: float
    """When the message was sent, sender's clock [s]."""
    object_name: str
    """Name of the object."""
    frame: str
    """Frame that the pose is in: "world", "camera"."""
    pose: tuple[float, ...]
    """Pose of the object in the frame, length 7."""
    score: float
    """Confidence, 0 to 1."""
    status: TrackingStatus
    """Whether the pose may be used."""


def message_entries(message: PoseMessage) -> dict[str, Any]:
    """What is packed."""
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "sequence": message.sequence,
        "clock": message.clock,
        "captured": message.captured,
        "sent": message.sent,
        "object": message.object_name,
        "frame": message.frame,
        "position": list(message.pose[:3]),
        "rotation": list(message.pose[3:]),
        "score": message.score,
        "status": message.status.value,
    }


def read_message(entries: Any) -> PoseMessage:
    """The message that was packed.

    Raises:
        RobotError: it is none, of another version, or holds impossible values.
    """
    if not isinstance(entries, dict) or entries.get("schema") != SCHEMA:
        raise RobotError(f"a message of another kind came instead of '{SCHEMA}'")
    if entries.get("version") != VERSION:
        raise RobotError(f"the tracker sends version {entries.get('version')} of '{SCHEMA}', not {VERSION}")
    try:
        pose = tuple(float(v) for v in (*entries["position"], *entries["rotation"]))
        message = PoseMessage(
            int(entries["sequence"]),
            str(entries["clock"]),
            float(entries["captured"]),
            float(entries["sent"]),
            str(entries["object"]),
            str(entries["frame"]),
            pose,
            float(entries["score"]),
            TrackingStatus(entries["status"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise RobotError(f"a pose message is incomplete or wrong: {error!r}") from error
    numbers = (*pose, message.captured, message.sent, message.score)
    if len(pose) != 7 or not all(math.isfinite(v) for v in numbers):
        raise RobotError("a pose message holds values that are not finite, or not seven of them")
    if abs(math.hypot(*pose[3:]) - 1.0) > 1e-3:
        raise RobotError("the rotation of a pose message is no unit quaternion")
    return message

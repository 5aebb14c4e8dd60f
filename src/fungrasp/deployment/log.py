"""The log of a deployment: an MCAP file, which Foxglove and Rerun open.

Records are not compressed and are flushed at every control step: if the writer is killed, the file is
readable up to the last step. Numbers are JSON with all digits: given the logged observations again, a policy
must return the logged actions to the last bit.

| topic | message |
| --- | --- |
| ``/setpoint`` | every 20 ms: time, phase, state of arm and hand, object pose, command as sent |
| ``/step`` | every control step: observation, action of the policy, action as sent, lateness |
| ``/event`` | phases, faults, notes |

Each plan is an attachment, "plan.npz"; the names of cell and policy are metadata, "about".
"""

from __future__ import annotations

import io
import json
import logging
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.spec import Phase
from fungrasp.robots.device import JointState, RobotCommand, RobotState
from fungrasp.task import Action, GraspPlan, Observation

if TYPE_CHECKING:
    from fungrasp.deployment.preparation import PreparedGrasp
    from fungrasp.robots.robot import Robot

_log = logging.getLogger(__name__)

TOPICS = ("/setpoint", "/step", "/event")
"""Topics of a log."""

_MISSING = 'logs are MCAP files: pip install ".[deploy]" in the clone'


class McapLog(DeploymentObserver):
    """Writes a log file; a context manager. An existing file is not changed."""

    def __init__(self, path: str | Path, about: Mapping[str, str] | None = None):
        """about: metadata besides the name of the cell. Raises: FungraspError: mcap is not installed, the
        file exists, or it can't be written."""
        try:
            from mcap.writer import Writer
        except ImportError as error:
            raise FungraspError(_MISSING) from error
        self.path, self._about = Path(path), about or {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self.path.open("xb")
        except FileExistsError as error:
            raise FungraspError(f"the log {path} already exists: give another name") from error
        except OSError as error:
            raise FungraspError(f"cannot write {path}: {error.strerror or error}") from error
        self._writer = Writer(self._stream, use_chunking=False)
        self._writer.start(profile="", library="fungrasp")
        schema = self._writer.register_schema("object", "jsonschema", b'{"type": "object"}')
        self._channels = {t: self._writer.register_channel(t, "json", schema) for t in TOPICS}
        self._number = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Finish the file; an unfinished file is readable as well. A full disk only causes a warning, so that
        the result of the deployment is still reported."""
        if self._stream.closed:
            return
        try:
            self._writer.finish()
            self._stream.close()
        except OSError as error:
            _log.warning("the log %s breaks off: %s", self.path, error.strerror or error)
            with suppress(OSError):
                self._stream.close()

    def planned(self, robot: Robot, prepared: PreparedGrasp) -> None:
        stream = io.BytesIO()
        np.savez_compressed(stream, **prepared.plan.arrays())  # pyright: ignore[reportArgumentType]
        self._writer.add_attachment(0, 0, "plan.npz", "application/octet-stream", stream.getvalue())
        self._writer.add_metadata("about", {"cell": robot.cell.name, **self._about})
        self._stream.flush()

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        tracked = state.tracked
        self._write(
            "/setpoint",
            state.time,
            {
                "phase": phase,
                "arm": _joints(state.arm),
                "hand": _joints(state.hand),
                "object": None if tracked is None else tracked.pose_world_object.tolist(),
                "object_captured": None if tracked is None else tracked.captured,
                "sent": {name: value.tolist() for name, value in vars(command).items()},
            },
        )

    def step(
        self, time: float, phase: Phase, observation: Observation, action: Action, sent: Action, late: float
    ) -> None:
        records = {"observation": observation, "action": action, "sent": sent}
        message = {name: {k: v[0].tolist() for k, v in r.arrays().items()} for name, r in records.items()}
        self._write("/step", time, {"phase": phase, "late": late, **message})
        self._stream.flush()

    def phase(self, time: float, phase: Phase) -> None:
        self._event(time, "phase", phase)

    def fault(self, time: float, reason: str) -> None:
        self._event(time, "fault", reason)

    def note(self, time: float, text: str) -> None:
        self._event(time, "note", text)

    def _event(self, time: float, what: str, text: str) -> None:
        self._write("/event", time, {"what": what, "text": text})
        self._stream.flush()

    def _write(self, topic: str, time: float, message: Mapping[str, Any]) -> None:
        data = json.dumps({"time": time, **message}, separators=(",", ":")).encode()
        stamp = round(time * 1e9)
        self._writer.add_message(self._channels[topic], stamp, data, stamp, self._number)
        self._number += 1


@dataclass(frozen=True, eq=False)
class RecordedDeployment:
    """Content of a log."""

    plan: GraspPlan | None
    """The first plan; None if the log ends before it."""
    about: Mapping[str, str]
    """Metadata."""
    messages: Mapping[str, list[dict[str, Any]]]
    """Messages by topic, in order of time."""
    complete: bool
    """Whether the log was closed; False if its writer died."""


def read_log(path: str | Path) -> RecordedDeployment:
    """Read a log, complete or not. Raises: FungraspError: mcap is not installed, or the file is missing or no
    log."""
    try:
        from mcap.records import Attachment, Channel, DataEnd, Message, Metadata
    except ImportError as error:
        raise FungraspError(_MISSING) from error
    topics: dict[int, str] = {}
    messages: dict[str, list[dict[str, Any]]] = {topic: [] for topic in TOPICS}
    plan: GraspPlan | None = None
    about, complete = {}, False
    for record in _records(Path(path)):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and topics.get(record.channel_id) in messages:
            messages[topics[record.channel_id]].append(json.loads(record.data))
        elif isinstance(record, Attachment) and record.name == "plan.npz" and plan is None:
            with np.load(io.BytesIO(record.data), allow_pickle=False) as data:
                plan = GraspPlan.from_arrays(dict(data))
        elif isinstance(record, Metadata) and record.name == "about":
            about = record.metadata
        elif isinstance(record, DataEnd):
            complete = True
    return RecordedDeployment(plan, about, messages, complete)


def _records(path: Path) -> Iterator[Any]:
    """Yield the records of a file, up to the first incomplete one."""
    from mcap.exceptions import McapError
    from mcap.stream_reader import StreamReader

    try:
        with path.open("rb") as stream:
            if stream.read(8) != b"\x89MCAP0\r\n":
                raise FungraspError(f"{path} is not an MCAP file")
            stream.seek(0)
            # If its writer was killed, the file may end within a record.
            try:
                yield from StreamReader(stream, record_size_limit=64_000_000).records
            except (McapError, EOFError, struct.error, ValueError, OSError):
                return
    except OSError as error:
        raise FungraspError(f"cannot read {path}: {error.strerror or error}") from error


def _joints(state: JointState) -> dict[str, Any]:
    return {
        "positions": state.positions.tolist(),
        "velocities": state.velocities.tolist(),
        "torques": None if state.torques is None else state.torques.tolist(),
        "device_time": state.device_time,
        "status": str(state.status),
    }

"""Messages between a driver and the loop of its device, in shared memory and without waiting. Only the newest
message of each is kept."""

from __future__ import annotations

import mmap
import os
import pickle
import struct
import tempfile
import zlib
from dataclasses import dataclass
from typing import Generic, TypeVar

from fungrasp.robots.control_loop.device_loop import LoopGoal
from fungrasp.robots.device import JointState

SIZE = 1 << 14
"""Size of a mailbox [bytes], several times that of a goal or a report."""

MESSAGE = 400
"""Largest number of characters in the message of a reported state."""

HEADER = struct.Struct("<II")
"""Checksum and length of the pickled message, which follows."""


@dataclass(frozen=True, eq=False)
class GoalMessage:
    """Message from a driver to its loop."""

    goal: LoopGoal
    """Newest goal."""
    order: int
    """Number of the goal."""
    sent: float
    """Time at which the driver was last used, ``time.monotonic`` [s]."""


@dataclass(frozen=True, eq=False)
class LoopReport:
    """Message from a loop to its driver."""

    state: JointState
    """State of the device."""
    order: int
    """Number of the newest goal that the loop has read."""
    beat: float
    """Time of this message, ``time.monotonic`` [s]."""
    ended: bool = False
    """Whether the loop has ended; the message of the state gives the reason."""


Message = TypeVar("Message", GoalMessage, LoopReport)


class Mailbox(Generic[Message]):
    """Holds the newest message of a single writer.

    A message that is read while it is written fails its checksum and is read again; if its writer died half
    way, readers keep the previous message.
    """

    def __init__(self, memory: memoryview):
        """memory: shared memory, ``SIZE`` bytes, initially zero."""
        self._memory, self._last, self._seen = memory, None, None

    def write(self, message: Message) -> None:
        """Replace the message."""
        data = pickle.dumps(message)
        HEADER.pack_into(self._memory, 0, ~zlib.crc32(data) & 0xFFFFFFFF, len(data))
        self._memory[HEADER.size : HEADER.size + len(data)] = data

    def read(self) -> Message | None:
        """Return the newest message, as the same object if it is not new; None before the first."""
        for _ in range(8):
            header = HEADER.unpack_from(self._memory)
            if header == self._seen:
                break
            data = bytes(self._memory[HEADER.size : HEADER.size + header[1]])
            if header[0] == ~zlib.crc32(data) & 0xFFFFFFFF:
                # Safe to unpickle: written by the parent or the child process.
                self._last, self._seen = pickle.loads(data), header
                break
        return self._last


def mailboxes(memory: memoryview) -> tuple[Mailbox[GoalMessage], Mailbox[LoopReport]]:
    """Return the mailboxes of goals and reports in shared memory of twice ``SIZE``."""
    return Mailbox(memory[:SIZE]), Mailbox(memory[SIZE:])


def shared_memory() -> tuple[int, memoryview]:
    """Make anonymous shared memory for ``mailboxes``, which is freed after its last user. Returns: a file
    descriptor for the child process, to be closed by the caller, and the memory in this process."""
    folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryFile(dir=folder) as file:
        file.truncate(2 * SIZE)
        return os.dup(file.fileno()), memoryview(mmap.mmap(file.fileno(), 2 * SIZE))

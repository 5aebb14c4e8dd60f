"""What a driver and its device's loop tell each other: the newest only, in memory that both processes see.
Nobody waits."""

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
"""Bytes of a mailbox: several times those of a goal or a report."""

MESSAGE = 400
"""Characters of a report's message at most."""

HEADER = struct.Struct("<II")
"""Checksum and length of the pickled message, which follows."""


@dataclass(frozen=True, eq=False)
class GoalMessage:
    """What a driver tells its loop."""

    goal: LoopGoal
    """The newest goal."""
    order: int
    """Count of the goals."""
    sent: float
    """When the driver was last asked for anything, ``time.monotonic`` [s]."""


@dataclass(frozen=True, eq=False)
class LoopReport:
    """What a loop tells its driver."""

    state: JointState
    """The device."""
    order: int
    """Of the newest goal that was seen."""
    beat: float
    """When this was written, ``time.monotonic`` [s]."""
    ended: bool = False
    """Whether the loop has ended; why is in the state's message."""


Message = TypeVar("Message", GoalMessage, LoopReport)


class Mailbox(Generic[Message]):
    """One writes, the others read the newest message.

    A message that is read while it is being written fails its checksum and is read again; where the writer
    has died half way, readers keep the message before.
    """

    def __init__(self, memory: memoryview):
        """memory: that both sides see, zeros at first, ``SIZE`` bytes."""
        self._memory, self._last, self._seen = memory, None, None

    def write(self, message: Message) -> None:
        """Replace the message."""
        data = pickle.dumps(message)
        HEADER.pack_into(self._memory, 0, ~zlib.crc32(data) & 0xFFFFFFFF, len(data))
        self._memory[HEADER.size : HEADER.size + len(data)] = data

    def read(self) -> Message | None:
        """The newest message; None before the first. Where there is no newer one, the same object again."""
        for _ in range(8):
            header = HEADER.unpack_from(self._memory)
            if header == self._seen:
                break
            data = bytes(self._memory[HEADER.size : HEADER.size + header[1]])
            if header[0] == ~zlib.crc32(data) & 0xFFFFFFFF:
                # Of the other process, which one of the two has started.
                self._last, self._seen = pickle.loads(data), header
                break
        return self._last


def mailboxes(memory: memoryview) -> tuple[Mailbox[GoalMessage], Mailbox[LoopReport]]:
    """Those of a driver and its loop, in memory of twice ``SIZE``."""
    return Mailbox(memory[:SIZE]), Mailbox(memory[SIZE:])


def shared_memory() -> tuple[int, memoryview]:
    """Memory for ``mailboxes`` without a name, which a child process inherits and which goes with the last of
    its users. Returns: a file descriptor to pass on, which the caller closes, and the memory as this process
    sees it."""
    folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryFile(dir=folder) as file:
        file.truncate(2 * SIZE)
        return os.dup(file.fileno()), memoryview(mmap.mmap(file.fileno(), 2 * SIZE))

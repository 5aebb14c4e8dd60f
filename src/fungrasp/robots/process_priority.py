"""Priority of what must keep its time."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

NICENESS = -5
"""Of threads that must keep their time: ahead of planning and of everything else at the usual 0."""

AUTOGROUP = Path("/proc/self/autogroup")
"""Linux gives each session the same share of the processors, whatever the niceness of its threads, and keeps
a niceness of the session beside (sched(7))."""


@dataclass(frozen=True)
class Priority:
    """Of a thread, on other systems than Linux of its process."""

    niceness: int | None
    """Of the thread; None where the system has none."""
    session: int | None
    """Niceness of its session; None where that is not this process's own, or the system has none."""


def raise_priority() -> bool:
    """Put the calling thread ahead of other work (on other systems than Linux: the process), and its session
    where this process has one of its own. Systems allow it to administrators; whether it was done."""
    return _set(Priority(NICENESS, NICENESS))


def present_priority() -> Priority:
    """That of the calling thread."""
    niceness, session = None, None
    with contextlib.suppress(OSError, AttributeError):
        niceness = os.getpriority(os.PRIO_PROCESS, 0)
        if _own_session():
            # "/autogroup-25 nice 0"
            session = int(AUTOGROUP.read_text().split()[-1])
    return Priority(niceness, session)


@contextlib.contextmanager
def at_priority(priority: Priority) -> Iterator[None]:
    """The calling thread has a priority within, and the threads that it starts; afterwards the one before.

    Args:
        priority: as ``present_priority`` gave it.
    """
    before = present_priority()
    _set(priority)
    try:
        yield
    finally:
        _set(before)


def _set(priority: Priority) -> bool:
    if priority.niceness is None:
        return False
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, priority.niceness)
        if priority.session is not None and _own_session():
            AUTOGROUP.write_text(str(priority.session))
        return True
    return False


def _own_session() -> bool:
    """The session of a terminal stays as it is: it outlives this process."""
    return os.getsid(0) == os.getpid() and AUTOGROUP.exists()

"""Priority of what must keep its time."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

NICENESS = -5
"""Of threads that must keep their time: ahead of planning and of everything else at the usual 0."""

AUTOGROUP = Path("/proc/self/autogroup")
"""Linux gives each session the same share of the processors, whatever the niceness of its threads, and keeps
a niceness of the session beside (sched(7))."""


def raise_priority() -> bool:
    """Put the calling thread ahead of other work (on other systems than Linux: the process), and its session
    where this process has one of its own. Systems allow it to administrators; whether it was done."""
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
        # The session of a terminal stays as it is: it outlives this process.
        if os.getsid(0) == os.getpid() and AUTOGROUP.exists():
            AUTOGROUP.write_text(str(NICENESS))
        return True
    return False

"""How late the system may wake a thread that sleeps."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def timer_slack(seconds: float) -> Iterator[None]:
    """Threads that are started within sleep longer, by up to so much; the calling thread does so only
    within. Client libraries that poll with sleeps of a fraction of a millisecond then take less of a
    processor. Linux only (``PR_SET_TIMERSLACK`` of prctl(2), which new threads inherit); on other systems,
    and for threads of real-time scheduling, nothing changes.

    Args:
        seconds: of slack; 50 microseconds are usual [s].
    """
    file = Path(f"/proc/{threading.get_native_id()}/timerslack_ns")
    try:
        before = file.read_text()
        file.write_text(str(int(1e9 * seconds)))
    except OSError:
        before = None
    try:
        yield
    finally:
        if before is not None:
            with contextlib.suppress(OSError):
                file.write_text(before)

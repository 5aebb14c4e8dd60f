"""The process of one device: ``python -m fungrasp.robots.control_loop.loop_worker``.

Standard input carries the pickled loop and stays open: its end means that the driver's process has died,
and the device is halted at once.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import struct
import sys
import threading
from pathlib import Path

from fungrasp.robots.control_loop.loop_runner import run_device_loop
from fungrasp.robots.control_loop.mailbox import Mailbox, mailbox_size, map_shared_memory
from fungrasp.robots.control_loop.records import goal_kind, state_kind

LENGTH = struct.Struct("<I")


def run_worker() -> None:
    """Run the loop that stands on standard input."""
    source = sys.stdin.buffer
    size = LENGTH.unpack(source.read(LENGTH.size))[0]
    # From the process that started this one, through its own pipe.
    loop, path, driver_timeout = pickle.loads(source.read(size))
    orphaned = threading.Event()
    # Ahead of planning and all other work, client libraries' threads as well; systems allow it to
    # administrators. Linux shares the processors by sessions (autogroup of sched(7)), and this is one.
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, -5)
        Path("/proc/self/autogroup").write_text("-5")

    def watch() -> None:
        source.read()
        orphaned.set()

    threading.Thread(target=watch, daemon=True).start()
    # Ctrl-C in a terminal goes to both processes: the driver's decides how to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: orphaned.set())
    memory = memoryview(map_shared_memory(Path(path)))
    count = len(loop.limits.lower)
    first = mailbox_size(goal_kind(count))
    goals = Mailbox(memory[:first], goal_kind(count))
    states = Mailbox(memory[first:], state_kind(count))
    run_device_loop(loop, goals, states, driver_timeout, orphaned.is_set)
    sys.stderr.flush()
    # All is said and written. Some client libraries wait in their destructors for devices that are gone.
    os._exit(0)


if __name__ == "__main__":
    run_worker()

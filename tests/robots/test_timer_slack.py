"""Threads of client libraries that may sleep longer."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from fungrasp.robots.timer_slack import timer_slack


def own_slack() -> int:
    return int(Path(f"/proc/{threading.get_native_id()}/timerslack_ns").read_text())


@pytest.mark.skipif(
    not Path("/proc/self/timerslack_ns").exists(), reason="this system tells nothing of timer slack"
)
def test_threads_that_are_started_within_sleep_longer_and_the_caller_does_not():
    seen: list[int] = []
    before, ended = own_slack(), threading.Event()

    def library() -> None:
        ended.wait(5.0)
        seen.append(own_slack())

    with timer_slack(2e-3):
        thread = threading.Thread(target=library)
        thread.start()
    assert own_slack() == before
    ended.set()
    thread.join()
    assert seen == [2_000_000]

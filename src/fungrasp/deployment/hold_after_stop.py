"""After a run that did not end with an empty hand: arm and hand hold until a person says open."""

from __future__ import annotations

import logging
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from fungrasp.robots.device import StopKind
from fungrasp.robots.robot import Robot

_log = logging.getLogger(__name__)

OPEN = "open"
"""The word that lets the object go."""

OPENING = 4.0
"""Time in which a hand opens [s]."""

ONE_PRESS = 1.0
"""Interrupts that come sooner after the one before are one and the same [s]."""

QUESTION = f"The arm has braked and the hand holds. Put a hand under the object, then type '{OPEN}': "

ENDINGS = ("SIGTERM", "SIGHUP")
"""Signals that end a program as Ctrl-C does: ``kill``, and a terminal that is closed."""


def hold_until_told(robot: Robot) -> None:
    """Hold until a person says open at the keyboard of the robot's switch, then open the hand slowly. Ctrl-C
    ends holding without opening: where the hand would let go then (``lets_go``) only a second one does.

    Args:
        robot: connected and stopped.
    """
    lets_go, since, warned = robot.hand_driver.lets_go, time.monotonic(), False
    while True:
        try:
            _wait_for_the_word(robot)
            break
        except KeyboardInterrupt:
            now, pressed = time.monotonic(), since
            since = now
            if now - pressed < ONE_PRESS:
                # Of somebody who pressed it more than once to stop the arm.
                continue
            if warned or not lets_go:
                raise
            warned = True
            _log.warning("the hand lets go %s: Ctrl-C once more does it", lets_go)
    open_slowly(robot)


def open_slowly(robot: Robot) -> None:
    """Open the hand of a stopped robot, and give it the time."""
    robot.hand_driver.stop(StopKind.OPEN)
    time.sleep(OPENING)


def _wait_for_the_word(robot: Robot) -> None:
    try:
        while robot.switch.ask(QUESTION).lower() != OPEN:
            pass
    except EOFError:
        _log.warning("no terminal to ask: the robot holds until this program is interrupted")
        while True:
            robot.state()
            time.sleep(0.1)


@contextmanager
def endings_as_interrupts() -> Iterator[None]:
    """``kill`` and a closed terminal raise ``KeyboardInterrupt`` meanwhile; only in the main thread."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in ENDINGS if hasattr(signal, name)]
    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

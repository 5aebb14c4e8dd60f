"""The hold after a run that did not end with an empty hand: it is monitored until a person types open."""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

import numpy as np

from fungrasp.robots.device import DeviceStatus, JointState, StopKind
from fungrasp.robots.robot import Robot

_log = logging.getLogger(__name__)

OPEN = "open"
"""Word that opens the hand."""

OPENING = 4.0
"""Time to wait for a hand that opens [s]; twice as long while it has not opened."""

OPENED = 0.25
"""Distance from the model's open position within which a joint counts as open [rad]; or half of its initial
distance, if that is more, because the object may be in the way."""

MOVED = 0.1
"""Change of a joint since the hold began beyond which it has moved [rad]."""

LOOK = 0.05
"""Time between two readings of a robot that holds [s]."""

ONE_PRESS = 1.0
"""Time after an interrupt in which further ones are ignored [s]."""

QUESTION = f"Put a hand under the object, then type '{OPEN}': "

ENDINGS = ("SIGTERM", "SIGHUP")
"""Signals that end a program like Ctrl-C: those of ``kill`` and of a terminal that closes."""


class HoldWatch:
    """Monitors a stopped robot and reports each change of its devices in words."""

    def __init__(self, robot: Robot, say: Callable[[str], None]):
        """robot: connected and stopped; say: receives the reports."""
        self.robot, self._say = robot, say
        self._places: dict[str, np.ndarray] = {}
        self._said = ""
        self.held_up: tuple[str, ...] = ()
        """Names of the joints that ``open`` could not open."""

    def look(self) -> None:
        """Read the devices, report a change, and wait for ``LOOK``."""
        words = self.words()
        if words != self._said:
            self._said = words
            self._say(words)
        self.robot.clock.sleep_until(self.robot.clock.now() + LOOK)

    def words(self) -> str:
        """Return what arm and hand do, according to their readings."""
        state = self.robot.state()
        arm, hand = self._of("arm", state.arm, "has braked"), self._of("hand", state.hand, "holds")
        return f"The arm {arm}. The hand {hand}."

    def open(self) -> bool:
        """Open the hand slowly, report the result, and return whether its readings show it open."""
        robot, target = self.robot, self.robot.hand.open_joints
        begin = np.abs(robot.hand_driver.read().positions - target)
        robot.hand_driver.stop(StopKind.OPEN)
        hand = robot.hand_driver.read()
        begun, opened, names = robot.clock.now(), False, np.array(list(robot.hand.actuators))
        # A hand that counts as open still opens further; a slow hand, or a late reading, gets more time.
        while robot.clock.now() < begun + (OPENING if opened else 2 * OPENING):
            hand = robot.state().hand
            left = np.abs(hand.positions - target)
            self.held_up = tuple(names[left > np.maximum(OPENED, 0.5 * begin)].tolist())
            opened = hand.status is not DeviceStatus.DISCONNECTED and not self.held_up
            robot.clock.sleep_until(robot.clock.now() + LOOK)
        self._places.pop("hand", None)
        said = [hand.message] * (hand.status is not DeviceStatus.STOPPED)
        said += [f"{', '.join(self.held_up)} blocked, or without power"] * bool(self.held_up)
        why = "; ".join(said)
        self._say(
            "The hand is open."
            if opened
            else f"The hand has not opened ({why}). Take the object, or switch the hand's supply off."
        )
        return opened

    def _of(self, part: str, state: JointState, well: str) -> str:
        """Return what a device does, as the rest of a sentence. well: words for one that stands still."""
        if state.status is DeviceStatus.DISCONNECTED:
            return f"does not answer, and its state is unknown: {state.message}"
        place = self._places.setdefault(part, state.positions.copy())
        moved = float(np.abs(state.positions - place).max())
        did = f"has moved by more than {MOVED:g} rad" if moved > MOVED else well
        told = state.status in (DeviceStatus.READY, DeviceStatus.STOPPED)
        return did if told else f"{'stands still' if did == well else did}, and reports: {state.message}"


def hold_until_told(robot: Robot, note: Callable[[str], None] = lambda words: None) -> None:
    """Hold until a person types open at the keyboard of the robot's switch and the hand has opened. Ctrl-C
    ends the hold without opening; if the hand would then let go (``lets_go``), only a second Ctrl-C does.
    robot: connected and stopped; note: receives all messages of the terminal. Raises: KeyboardInterrupt."""

    def say(words: str) -> None:
        note(words)
        sys.stderr.write(f"\n{words} {QUESTION if robot.switch.keyboard else ''}")
        sys.stderr.flush()

    watch = HoldWatch(robot, say)
    lets_go, since, warned = robot.hand_driver.lets_go, time.monotonic(), False
    while True:
        try:
            _wait_for_open(watch)
            if watch.open():
                return
        except KeyboardInterrupt:
            now, pressed = time.monotonic(), since
            since = now
            if now - pressed < ONE_PRESS:
                # A person pressed Ctrl-C more than once to stop the arm.
                continue
            if warned or not lets_go:
                raise
            warned = True
            _log.warning("the hand lets go %s: Ctrl-C once more does it", lets_go)


def _wait_for_open(watch: HoldWatch) -> None:
    try:
        while watch.robot.switch.ask("", watch.look).lower() != OPEN:
            pass
    except EOFError:
        _log.warning("no terminal to ask: the robot holds until this program is interrupted")
        while True:
            watch.look()


@contextmanager
def endings_as_interrupts() -> Iterator[None]:
    """Context in which ``kill`` and a terminal that closes raise ``KeyboardInterrupt``; no effect outside the
    main thread."""

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

"""The person who brings a robot up: asked on a terminal, or, for emulated devices, by a file of answers."""

from __future__ import annotations

import sys
from collections.abc import Callable

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.confirmation import ask_before_phases
from fungrasp.deployment.deployment import Confirm
from fungrasp.robots.cell import RobotCell, is_wired
from fungrasp.robots.stop_switch import StopSwitch

YES, SKIP = "yes", "skip"
"""Words of an answer; after "skip" comes the reason."""


class StepSkipped(Exception):
    """The operator leaves a step out, and says why."""


class BringUpEnded(FungraspError):
    """The operator ends the session."""


class Operator:
    """Answers questions."""

    def __init__(self, switch: StopSwitch, cell: RobotCell, say: Callable[[str], None], always: bool = False):
        """
        Args:
            switch: that listens to the keyboard.
            cell: the robot: at a real one a person answers.
            say: shows a line.
            always: answer yes to everything.

        Raises:
            FungraspError: nobody answers for a real robot.
        """
        self._switch, self._always, self.say = switch, always, say
        """``say`` shows a line."""
        if is_wired(cell) and (always or not switch.keyboard):
            raise FungraspError("a real robot is brought up by a person at a terminal: no --yes, no pipe")

    @property
    def present(self) -> bool:
        """Whether a person answers."""
        return not self._always

    @property
    def confirm(self) -> Confirm | None:
        """Asks before each phase of a grasp; None where nobody is at the keyboard."""
        return ask_before_phases(self._switch) if self._switch.keyboard and self.present else None

    def ask(self, question: str) -> str:
        """The answer to a question.

        Raises:
            BringUpEnded: there is no more answer.
        """
        if self._always:
            return YES
        if self._switch.keyboard:
            try:
                return self._switch.ask(question)
            except EOFError as error:
                raise BringUpEnded("the terminal is gone") from error
        line = sys.stdin.readline()
        if not line:
            raise BringUpEnded("there are no more answers")
        self.say(question + line.strip())
        return line.strip()

    def begin(self, what: str) -> None:
        """Ask whether something may begin.

        Raises:
            StepSkipped: it is left out; the reason is the message.
            BringUpEnded: any other answer than yes.
        """
        answer = self.ask(f"  {what} Type '{YES}' to begin, '{SKIP} WHY' to leave it out: ")
        word, _, why = answer.partition(" ")
        if word.lower() == SKIP:
            raise StepSkipped(why.strip() or "no reason given")
        if answer.lower() != YES:
            raise BringUpEnded("ended by the operator")

    def judges(self, question: str) -> bool:
        """Whether the operator says yes to a question."""
        return self.ask(f"  {question} Type '{YES}' or 'no': ").lower() == YES

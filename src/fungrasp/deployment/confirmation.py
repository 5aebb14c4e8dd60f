"""A person says whether a robot may move: at each phase of a deployment, and before one device does."""

from __future__ import annotations

import sys
from collections.abc import Callable

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Confirm
from fungrasp.deployment.phases import Phase
from fungrasp.robots.device import SafetyStop, StopKind
from fungrasp.robots.stop_switch import StopSwitch

YES = "yes"
"""The word that lets a phase begin."""

MOTIONS = {
    Phase.MOVE_TO_START: "approach: the arm goes to the start of the grasp",
    Phase.GRASP: "grasp: the hand goes to the object and closes",
    Phase.LIFT: "lift: the arm rises and holds the object up",
    Phase.PUT_DOWN: "put down: the object is lowered and let go of, the hand withdraws",
    Phase.HOME: "home: the arm goes back the way it came",
}
"""What moves in each phase, as a phrase."""


def ask_before_phases(switch: StopSwitch) -> Confirm:
    """Ask at the keyboard of a switch before each phase; any other answer than yes stops the robot there.

    Args:
        switch: that listens to the keyboard.
    """

    def confirm(phase: Phase, meanwhile: Callable[[], None]) -> None:
        question = f"next, {MOTIONS[phase]}. Type '{YES}' to go on, anything else stops here: "
        try:
            answer = switch.ask(question, meanwhile)
        except EOFError as error:
            raise SafetyStop("the terminal is gone", StopKind.HOLD) from error
        if answer.lower() != YES:
            raise SafetyStop(f"the phase '{phase}' was not confirmed", StopKind.HOLD)

    return confirm


def ask_before_motion(switch: StopSwitch, what: str) -> None:
    """Ask at the keyboard of a switch before a device moves, and say how to stop it.

    Args:
        switch: that listens to the keyboard.
        what: will be done, as a phrase.

    Raises:
        FungraspError: any other answer than yes, or no terminal.
    """
    question = f"This will {what}. Nobody within reach, a hand on the emergency stop? Type '{YES}': "
    try:
        answer = switch.ask(question)
    except EOFError:
        raise FungraspError("this moves a robot and asks first: it needs a terminal") from None
    if answer.lower() != YES:
        raise FungraspError("not confirmed: nothing has moved")
    sys.stderr.write(f"to stop: {switch.ways}\n")

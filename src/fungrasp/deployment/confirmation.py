"""A person says at each phase of a deployment whether it may begin."""

from __future__ import annotations

from collections.abc import Callable

from fungrasp.deployment.deployment import Confirm
from fungrasp.deployment.phases import Phase
from fungrasp.robots.device import StopKind
from fungrasp.robots.robot_state import SafetyStop
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

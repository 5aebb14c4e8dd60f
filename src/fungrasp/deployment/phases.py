"""The states of a deployment."""

from __future__ import annotations

from enum import StrEnum

from fungrasp.deployment.spec import Until
from fungrasp.robots.device import RobotError


class Phase(StrEnum):
    """What a deployment is doing."""

    IDLE = "idle"
    """Connected; looks for the object and plans. Nothing moves."""
    MOVE_TO_START = "move to start"
    """The arm goes to the start of the plan."""
    GRASP = "grasp"
    """The policy approaches and closes the hand."""
    LIFT = "lift"
    """The palm rises."""
    HOLD = "hold"
    """The object is held."""
    PUT_DOWN = "put down"
    """The object is lowered, let go of, and the palm withdraws."""
    HOME = "home"
    """The arm goes back to where it was."""
    DONE = "done"
    """The end."""
    FAULT = "fault"
    """Stopped; a person has to look, and to start anew."""
    WITHDRAW = "withdraw"
    """The object is not held: the hand opens and withdraws, and looks where the object lies."""


FOLLOWING: dict[Phase, tuple[Phase, ...]] = {
    Phase.IDLE: (Phase.MOVE_TO_START,),
    Phase.MOVE_TO_START: (Phase.GRASP,),
    Phase.GRASP: (Phase.LIFT,),
    Phase.LIFT: (Phase.HOLD,),
    Phase.HOLD: (Phase.PUT_DOWN, Phase.WITHDRAW),
    Phase.PUT_DOWN: (Phase.HOME,),
    Phase.WITHDRAW: (Phase.MOVE_TO_START, Phase.HOME),
    Phase.HOME: (Phase.DONE,),
}
"""The phases that may follow each; FAULT may follow any, and nothing follows FAULT."""


LAST_PHASES: dict[Until, Phase] = {
    "plan": Phase.IDLE,
    "approach": Phase.MOVE_TO_START,
    "grasp": Phase.GRASP,
    "lift": Phase.HOLD,
    "put-down": Phase.PUT_DOWN,
    "home": Phase.HOME,
}
"""The last phase where ``DeploymentSpec.until`` says so; the robot ends where it is then."""


class PhaseMachine:
    """The present phase. FAULT is latched."""

    def __init__(self) -> None:
        self.phase = Phase.IDLE
        """The present phase."""
        self.fault = ""
        """Why it is FAULT, as a phrase."""

    def go(self, phase: Phase) -> None:
        """Go on to a phase.

        Raises:
            RobotError: it does not follow the present one, or that is FAULT.
        """
        if self.phase is Phase.FAULT:
            raise RobotError(
                f"the robot is in the state of fault ({self.fault}): look at it, then start anew"
            )
        if phase not in FOLLOWING.get(self.phase, ()):
            raise RobotError(f"the phase '{phase}' does not follow '{self.phase}'")
        self.phase = phase

    def fail(self, reason: str) -> None:
        """Go to FAULT. reason: a phrase; the first one stays."""
        self.fault = self.fault or reason
        self.phase = Phase.FAULT

"""Observers of deployments: notified of all events, asked before motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from fungrasp.deployment.spec import Phase
from fungrasp.robots.device import RobotCommand, RobotState, SafetyStop, StopKind
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.task import Action, Observation

if TYPE_CHECKING:
    from fungrasp.deployment.preparation import PreparedGrasp
    from fungrasp.robots.robot import Robot

YES = "yes"
"""Word that lets a phase begin."""

MOTIONS = {
    Phase.MOVE_TO_START: "approach: the arm goes to the start of the grasp",
    Phase.GRASP: "grasp: the hand goes to the object and closes",
    Phase.LIFT: "lift: the arm rises and holds the object up",
    Phase.PUT_DOWN: "put down: the object is lowered and let go of, the hand withdraws",
    Phase.HOME: "home: the arm goes back the way it came",
}
"""What moves in each phase, as a phrase."""


class DeploymentObserver:
    """Base of observers; its methods do nothing and agree. They are called in the thread of the deployment,
    and an exception stops the robot."""

    def connected(self, robot: Robot) -> None:
        """The robot is connected. Nothing has moved."""

    def planned(self, robot: Robot, prepared: PreparedGrasp) -> None:
        """A plan was made. Before anything has moved, a ``FungraspError`` rejects it."""

    def confirm(self, phase: Phase, meanwhile: Callable[[], None]) -> None:
        """Called before a phase with motion, which starts when this returns. ``SafetyStop`` prevents it.
        While waiting, call ``meanwhile`` repeatedly: it keeps the robot still and monitored."""

    def phase(self, time: float, phase: Phase) -> None:
        """A phase has begun, on the robot's clock [s]. Not called for IDLE and FAULT, and for DONE only after
        HOME."""

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        """A setpoint was sent."""

    def step(
        self, time: float, phase: Phase, observation: Observation, action: Action, sent: Action, late: float
    ) -> None:
        """A control step was made. late: delay of its start [s]."""

    def fault(self, time: float, reason: str) -> None:
        """The robot was stopped. reason: a phrase."""

    def note(self, time: float, text: str) -> None:
        """A message for a person."""

    def hold(self, robot: Robot) -> bool:
        """The robot has stopped and its hand may hold something. Hold it as long as needed, then return True;
        False leaves the hold to the next observer, and finally to the keyboard."""
        return False


class PhaseQuestions(DeploymentObserver):
    """Asks at the keyboard of a switch before each phase; any answer but yes stops the robot."""

    def __init__(self, switch: StopSwitch):
        self._switch = switch

    def confirm(self, phase: Phase, meanwhile: Callable[[], None]) -> None:
        question = f"next, {MOTIONS[phase]}. Type '{YES}' to go on, anything else stops here: "
        try:
            answer = self._switch.ask(question, meanwhile)
        except EOFError as error:
            raise SafetyStop("the terminal has closed", StopKind.HOLD) from error
        if answer.lower() != YES:
            raise SafetyStop(f"the phase '{phase}' was not confirmed", StopKind.HOLD)

"""Deployments on a robot: devices behind wires, on the clock of the wall."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.deployment_result import DeploymentResult, DeploymentSettings
from fungrasp.deployment.emergency_stop import StopSwitch
from fungrasp.deployment.log import DeploymentLog
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import GraspPreparer, HandDynamics
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import Planner
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.process_priority import raise_priority
from fungrasp.robots.robot import Robot
from fungrasp.task import Policy


@dataclass(frozen=True, eq=False)
class DeploymentTask:
    """What is to be done, and with what."""

    cell: RobotCell
    """The robot."""
    hand: Hand
    """On its arm."""
    thing: ObjectModel
    """The object as it is believed."""
    grasp: RobotGraspSet
    """One."""
    policy: Policy
    """What acts."""
    planner: Planner
    """Of the policy."""
    dynamics: HandDynamics | None = None
    """Identified, of the hand; the model's if None."""
    stiffness: np.ndarray | None = None
    """Identified, of the hand's servos [N m/rad], shape [U]; the model's if None."""
    compensate: bool = True
    """Whether the hand's weight is carried."""
    dry_run: bool = False
    """Read everything, send nothing."""
    seed: int = 0
    """Of the plan."""


def deploy_on_robot(
    task: DeploymentTask,
    *,
    log: DeploymentLog | None = None,
    switch: StopSwitch | None = None,
    settings: DeploymentSettings | None = None,
    about: dict[str, str] | None = None,
    on_phase: Callable[[Phase], None] = lambda phase: None,
    on_connect: Callable[[Robot], None] = lambda robot: None,
) -> DeploymentResult:
    """Connect to a robot and deploy one grasp.

    Args:
        task: what is to be done.
        log: of every tick; none if None.
        switch: stops the robot; none if None.
        settings: times; the defaults if None.
        about: what the log says of it.
        on_phase: called as a phase begins.
        on_connect: called with the connected robot, before anything moves.

    Raises:
        FungraspError: a device is not there, or the grasp can't be planned or reached; nothing has moved.
    """

    def begun(phase: Phase) -> None:
        if phase is Phase.MOVE_TO_START:
            # Not before: planning may take all the processors that it finds.
            raise_priority()
        on_phase(phase)

    robot = wired_robot(
        task.cell, task.hand, stiffness=task.stiffness, compensate=task.compensate, dry_run=task.dry_run
    )
    with ExitStack() as stack:
        stack.enter_context(robot)
        on_connect(robot)
        preparer = GraspPreparer(task.cell, task.hand, task.thing, task.planner, task.dynamics, task.seed)
        deployment = Deployment(
            robot,
            task.policy,
            preparer,
            log=log,
            switch=switch,
            settings=settings,
            about=about,
            on_phase=begun,
        )
        return deployment.run(task.grasp)

"""Deployments on a robot: devices behind wires, on the clock of the wall."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from fungrasp.deployment.deployment import Confirm, Deployment
from fungrasp.deployment.deployment_result import DeploymentResult, DeploymentSettings
from fungrasp.deployment.hand_knowledge import HandDynamics
from fungrasp.deployment.holding import endings_as_interrupts, hold_until_told
from fungrasp.deployment.log import DeploymentLog
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import GraspPreparer, PreparedGrasp, Preparer
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import Planner
from fungrasp.robots.assembly import wired_robot
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import StopKind
from fungrasp.robots.process_priority import (
    Priority,
    at_priority,
    present_priority,
    raise_priority,
)
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.task import Policy

POWERING_OFF = 0.1
"""Time in which an empty hand's driver takes the torque away [s]."""


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
    preparer: Preparer | None = None
    """What has a plan already; None to plan."""


def deploy_on_robot(
    task: DeploymentTask,
    *,
    log: DeploymentLog | None = None,
    switch: StopSwitch | None = None,
    settings: DeploymentSettings | None = None,
    about: dict[str, str] | None = None,
    on_phase: Callable[[Phase], None] = lambda phase: None,
    on_connect: Callable[[Robot], None] = lambda robot: None,
    confirm: Confirm | None = None,
    hold: Callable[[Robot], None] = hold_until_told,
) -> DeploymentResult:
    """Connect to a robot and deploy one grasp. What keeps time runs ahead of other work from the first
    motion on; planning never does, nor what follows this call.

    Whatever ends a motion, but at home with an open hand, leaves the arm braked and the hand holding: a
    fault, Ctrl-C, ``kill``, an error of ours, a full disk, an object that is to stay held. ``hold`` then says
    when the connection may end.

    Args:
        task: what is to be done.
        log: of every tick; none if None.
        switch: stops the robot; that of the cell's stop file if None.
        settings: times; the defaults if None.
        about: what the log says of it.
        on_phase: called as a phase begins.
        on_connect: called with the connected robot, before anything moves.
        confirm: called before each phase in which the robot moves; not if None.
        hold: called with the stopped robot where the hand may hold something; returns when it may let go.

    Raises:
        FungraspError: a device is not there, or the grasp can't be planned or reached; nothing has moved.
    """

    def begun(phase: Phase) -> None:
        if phase is Phase.MOVE_TO_START:
            raise_priority()
        on_phase(phase)

    usual = present_priority()
    robot = wired_robot(
        task.cell,
        task.hand,
        stiffness=task.stiffness,
        compensate=task.compensate,
        dry_run=task.dry_run,
        switch=switch,
    )
    with ExitStack() as stack:
        stack.enter_context(at_priority(usual))
        stack.enter_context(robot)
        on_connect(robot)
        preparer = task.preparer or GraspPreparer(
            task.cell, task.hand, task.thing, task.planner, task.dynamics, task.seed
        )
        deployment = Deployment(
            robot,
            task.policy,
            _PreparerAt(preparer, usual),
            log=log,
            settings=settings,
            about=about,
            on_phase=begun,
            confirm=confirm,
        )
        stack.enter_context(endings_as_interrupts())
        try:
            return deployment.run(task.grasp)
        finally:
            if deployment.machine.phase not in (Phase.DONE, Phase.FAULT):
                # A second Ctrl-C while the first one was being dealt with.
                robot.stop()
            if deployment.may_hold:
                hold(robot)
            else:
                robot.hand_driver.stop(StopKind.POWER_OFF)
                time.sleep(POWERING_OFF)


class _PreparerAt:
    """A preparer that works at a priority: planning takes all the processors that it finds, and the drivers
    of an arm that waits for another attempt must keep their time."""

    def __init__(self, preparer: Preparer, priority: Priority):
        self._preparer, self._priority = preparer, priority
        self.objects: Mapping[str, ObjectModel] = preparer.objects

    def prepare(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0
    ) -> PreparedGrasp:
        """See ``Preparer.prepare``."""
        with at_priority(self._priority):
            return self._preparer.prepare(grasp, object_pose, arm, attempt=attempt)

"""``deploy``: one grasp on a robot or on its twin, whatever the cell is connected to."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.deployment_result import DeploymentResult
from fungrasp.deployment.deployment_task import DeploymentTask, deployment_task
from fungrasp.deployment.hold_after_stop import endings_as_interrupts, hold_until_told
from fungrasp.deployment.log import McapLog
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.spec import DeploymentSpec
from fungrasp.deployment.twin_deployment import deploy_on_twin, reachable_placement
from fungrasp.grasps import HumanGraspSet
from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects, as_grasp_set, resolve_objects
from fungrasp.retargeting.robot_grasps import as_robot_grasps
from fungrasp.robots.assembly import is_twin, wired_robot
from fungrasp.robots.cell import load_cell
from fungrasp.robots.device import StopKind
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.task import GraspPlan

POWERING_OFF = 0.1
"""Time in which an empty hand's driver takes the torque away [s]."""


def deploy(
    grasps: AnyGrasps,
    objects: Objects = None,
    cell: str | None = None,
    policy: str | None = None,
    *,
    plans: GraspPlan | None = None,
    spec: DeploymentSpec | None = None,
    log: str | Path | None = None,
    observer: DeploymentObserver | None = None,
    switch: StopSwitch | None = None,
) -> DeploymentResult:
    """Look, plan, move to the start, grasp, lift, hold, put down and go home.

    A robot that was stopped, or is to stay, holds what it holds until a person says open at the keyboard of
    ``switch`` or interrupts the program (``fungrasp.deployment.hold_after_stop``). On a twin the object is
    put where the arm can reach it; on a robot it stands where the tracker sees it.

    Args:
        grasps: one grasp of the cell's hand, or of a person, which is retargeted to that hand first.
        objects: its object, as for ``retarget``.
        cell: in the place of the one that ``spec`` names.
        policy: in the place of that of ``spec``.
        plans: one plan for the grasp (``fungrasp.plan``), which moves along with the object to where the
            robot sees it; by default the policy's planner makes one.
        spec: what is asked; the defaults if None.
        log: MCAP file to write, which must not exist; no log if None.
        observer: told of everything, and asked before each phase in which the robot moves; nobody if None.
        switch: stops the robot; that of the cell's stop file if None.

    Returns:
        How it went. Faults of the robot are in it; they raise nothing.

    Raises:
        FungraspError: what is asked does not fit together (``deployment_task``), a device that is not there,
            or a grasp that can't be planned or reached; nothing has moved then.
    """
    spec = spec or DeploymentSpec()
    spec = replace(spec, cell=cell or spec.cell, policy=policy or spec.policy)
    found = as_grasp_set(grasps)
    if len(found) != 1:
        raise FungraspError(f"one grasp is deployed at a time, not {len(found)}: select one, as in robot[0]")
    if isinstance(found, HumanGraspSet):
        robot, known, _, _ = as_robot_grasps(found, objects, load_cell(spec.cell).hand, spec.threads)
    else:
        robot, known = found, resolve_objects(found, objects)
    task = deployment_task(robot, known, spec, plans)
    with ExitStack() as stack:
        observers = [] if observer is None else [observer]
        if log is not None:
            about = {"version": __version__, "robot": spec.cell, "policy": spec.policy}
            grasp = {"grasp": spec.about} if spec.about else {}
            observers.insert(0, stack.enter_context(McapLog(Path(log), {**about, **grasp})))
        switch = stack.enter_context(StopSwitch(task.cell.stop_file)) if switch is None else switch
        if not is_twin(task.cell):
            return deploy_on_robot(task, observers, switch)
        given = None if plans is None else task.planner
        placement = reachable_placement(task.cell, task.hand, task.obj, robot, spec.seed, given)
        truth = cell_twin(task.cell, task.hand, spec.twin)
        result = deploy_on_twin(task, placement, truth, observers, switch=switch)
        if spec.until in ("plan", "approach", "grasp"):
            # It was not to be lifted.
            return replace(result, success=None, height=np.nan)
        return result


def deploy_on_robot(
    task: DeploymentTask, observers: Sequence[DeploymentObserver] = (), switch: StopSwitch | None = None
) -> DeploymentResult:
    """Connect to a robot and deploy one grasp.

    Whatever ends a motion, but at home with an open hand, leaves the arm braked and the hand holding: a
    fault, Ctrl-C, ``kill``, an error of ours, a full disk, an object that is to stay held. An observer's
    ``hold``, else a person at the keyboard of the switch, then says when the connection may end.

    Args:
        observers: told of everything in this order.
        switch: stops the robot; that of the cell's stop file if None.

    Raises:
        FungraspError: a device is not there, or the grasp can't be planned or reached; nothing has moved.
    """
    spec = task.spec
    robot = wired_robot(
        task.cell,
        task.hand,
        stiffness=task.stiffness,
        compensate=spec.gravity_compensation,
        dry_run=spec.dry_run,
        switch=switch,
    )
    with ExitStack() as stack:
        stack.enter_context(robot)
        for observer in observers:
            observer.connected(robot)
        deployment = Deployment(robot, task.policy, task.preparer(), spec, observers)
        stack.enter_context(endings_as_interrupts())
        try:
            return deployment.run(task.grasp)
        finally:
            if deployment.machine.phase not in (Phase.DONE, Phase.FAULT):
                # A second Ctrl-C while the first one was being dealt with.
                robot.stop()
            if not deployment.may_hold:
                robot.hand_driver.stop(StopKind.POWER_OFF)
                time.sleep(POWERING_OFF)
            elif not any(observer.hold(robot) for observer in observers):

                def note(words: str) -> None:
                    for observer in observers:
                        # The log may be what has failed.
                        with suppress(Exception):
                            observer.note(robot.clock.now(), words)

                hold_until_told(robot, note)

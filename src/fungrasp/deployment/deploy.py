"""The function ``deploy``: one grasp on a robot or its simulated twin."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.deployment_result import DeploymentResult
from fungrasp.deployment.hold_after_stop import endings_as_interrupts, hold_until_told
from fungrasp.deployment.log import McapLog
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import GraspPreparer, reachable_placements
from fungrasp.deployment.spec import DeploymentSpec, Phase
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects, as_grasp_set, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.planning import Planner, make_planner
from fungrasp.planning.attempts import check_attempts
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.policies import OpenLoopPolicy, make_policy
from fungrasp.retargeting.robot_grasps import as_robot_grasps
from fungrasp.robots.assembly import identified_dynamics, is_twin, wired_robot
from fungrasp.robots.cell import RobotCell, check_calibrated, load_cell, plan_speed, slowest_limit
from fungrasp.robots.device import RobotCommand, RobotState, StopKind, WallClock
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import RealTimeTwin, TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.parameters import TwinParameters, cell_twin
from fungrasp.robots.twin.world import TwinJudge, TwinWorld, held_as_shown
from fungrasp.sim2real.joint_dynamics import HandDynamics
from fungrasp.task import GraspPlan, Policy

POWERING_OFF = 0.1
"""Time in which the driver of an empty hand switches the torque off [s]."""


@dataclass(frozen=True, eq=False)
class DeploymentTask:
    """A deployment, with everything loaded that its specification names."""

    spec: DeploymentSpec
    """Settings."""
    cell: RobotCell
    """Robot cell."""
    hand: Hand
    """Hand of the cell."""
    obj: ObjectModel
    """Believed model of the object."""
    grasp: RobotGraspSet
    """One grasp."""
    policy: Policy
    """Policy that follows the plan."""
    planner: Planner
    """Planner of the policy."""
    dynamics: HandDynamics | None = None
    """Identified dynamics of the hand; those of its model if None."""

    def preparer(self, advise: bool = True) -> GraspPreparer:
        """Make the preparer. advise: whether errors name a placement that the arm can reach."""
        return GraspPreparer(
            self.cell, self.hand, self.obj, self.planner, self.dynamics, self.spec.seed, advise=advise
        )

    @property
    def stiffness(self) -> np.ndarray | None:
        """Identified stiffness of the hand's servos [N m/rad], shape [U]; None if it was not identified."""
        return None if self.dynamics is None else self.dynamics.stiffness(self.hand)


def deployment_task(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    spec: DeploymentSpec,
    plans: GraspPlan | None = None,
) -> DeploymentTask:
    """Load everything that a specification names. robot: one grasp of the cell's hand; plans: one plan for
    it, made by the policy's planner if None. Raises: FungraspError: several grasps, another hand, an unknown
    cell or policy, an uncalibrated cell, several attempts with an open-loop policy, or a slower speed with
    feedback."""
    if len(robot) != 1:
        raise FungraspError(f"one grasp is deployed at a time, not {len(robot)}: select one, as in robot[:1]")
    check_objects(robot.object_name.tolist(), objects)
    obj, cell = objects[str(robot.object_name[0])], load_cell(spec.cell)
    if not is_twin(cell):
        check_calibrated(cell)
    hand = load_hand(cell.hand)
    if robot.hand != hand.name:
        raise FungraspError(
            f"robot cell '{cell.name}' carries the hand '{hand.name}', and the grasp is of '{robot.hand}'"
        )
    limited, dynamics = identified_dynamics(cell, hand, spec.hand_dynamics)
    policy = deployable_policy(spec.policy, hand, {obj.name: obj})
    watches = not isinstance(policy, OpenLoopPolicy)
    check_attempts(spec.attempts, watches)
    allowed = plan_speed(cell.limits)
    if watches and min(spec.speed, allowed) < 1.0:
        why = f"speed = {spec.speed:g}" if spec.speed < allowed else slowest_limit(cell.limits)
        raise FungraspError(
            f"with {why} plans are carried out at {min(spec.speed, allowed):.2g} of their speed, and the "
            f"policy '{spec.policy}' needs feedback at 10 Hz and can't be slowed down; the policies "
            '"plan" and "reference" can'
        )
    # One processor is left to the drivers: a driver that does not run takes its device to be silent.
    spare = 0 if is_twin(cell) else max(1, (os.cpu_count() or 2) - 1)
    planner = (
        robot_planner(spec.policy, limited, {obj.name: obj}, spec.threads or spare)
        if plans is None
        else GivenPlans(plans, robot)
    )
    return DeploymentTask(spec, cell, hand, obj, robot, policy, planner, dynamics)


def robot_planner(name: str, hand: Hand, objects: Mapping[str, ObjectModel], threads: int = 0) -> Planner:
    """Make a policy's planner for a robot. Candidates are tried in worlds of the reality protocol, as a robot
    differs from its model. threads: 0 means all processors. Raises: FungraspError: an unknown policy, or a
    policy for another hand."""
    return make_planner(name, hand, objects, SelectionSettings.for_protocol("reality"), threads=threads)


def deployable_policy(name: str, hand: Hand, objects: Mapping[str, ObjectModel]) -> Policy:
    """Load a policy for a robot. Raises: FungraspError: an unknown policy, or one with privileged
    observations."""
    policy = make_policy(name, hand, objects)
    if not isinstance(policy, Policy):
        raise FungraspError(f"the policy '{name}' needs privileged observations: use a student")
    return policy


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
    """Deploy one grasp: look, plan, move to the start, grasp, lift, hold, put down and go home.

    After a stop, or if ``spec.until`` ends with a closed hand, a robot's hand keeps its grip until a person
    types open at the keyboard of ``switch`` or interrupts the program
    (``fungrasp.deployment.hold_after_stop``). On a twin, the object is placed within reach of the arm; on a
    robot, the tracker finds it.

    Args:
        grasps: one robot grasp of the cell's hand, or one human grasp, which is retargeted first.
        objects: its object, as for ``retarget``.
        cell: replaces ``spec.cell``.
        policy: replaces ``spec.policy``.
        plans: one plan for the grasp (``fungrasp.plan``), which is moved to the observed object. Default:
            made by the policy's planner.
        spec: settings; the defaults if None.
        log: MCAP file to write; must not exist. None: no log.
        observer: notified of all events, and asked before each phase with motion; None for none.
        switch: stop switch; None: one that watches the cell's stop file.

    Returns:
        The result. It includes faults of the robot, which are not raised.

    Raises:
        FungraspError: contradictory settings (``deployment_task``), a missing device, or a grasp that can't
            be planned or reached. Nothing has moved then.
    """
    spec = DeploymentSpec.given(spec)
    spec = replace(spec, cell=cell or spec.cell, policy=policy or spec.policy)
    found = as_grasp_set(grasps)
    if len(found) != 1:
        raise FungraspError(f"one grasp is deployed at a time, not {len(found)}: select one, as in robot[0]")
    if isinstance(found, HumanGraspSet):
        robot, known, _, _ = as_robot_grasps(found, objects, load_cell(spec.cell).hand, spec.threads)
    else:
        robot, known = found, load_objects(found, objects)
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
        placement = next(reachable_placements(task.cell, task.hand, task.obj, robot, spec.seed, given))
        truth = cell_twin(task.cell, task.hand, spec.twin)
        result = deploy_on_twin(task, placement, truth, observers, switch=switch)
        if spec.until in ("plan", "approach", "grasp"):
            # These phases do not lift the object.
            return replace(result, success=None, height=np.nan, as_shown=None)
        return result


def deploy_on_robot(
    task: DeploymentTask, observers: Sequence[DeploymentObserver] = (), switch: StopSwitch | None = None
) -> DeploymentResult:
    """Connect to a robot and deploy one grasp.

    If the hand may hold something at the end, for example after a fault, Ctrl-C, ``kill``, a programming
    error or with a full disk, the arm stays braked and the hand keeps its grip. An observer's ``hold``, or
    else a person at the keyboard of the switch, then ends the connection.

    Args:
        observers: notified of all events, in this order.
        switch: stop switch; None: one that watches the cell's stop file.

    Raises:
        FungraspError: a missing device, or a grasp that can't be planned or reached. Nothing has moved then.
    """
    spec = task.spec
    robot = wired_robot(
        task.cell,
        task.hand,
        stiffness=task.stiffness,
        compensate=spec.gravity_compensation,
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
            if deployment.phase not in (Phase.DONE, Phase.FAULT):
                # A second Ctrl-C interrupted the handling of the first.
                robot.stop()
            if not deployment.may_hold:
                robot.hand_driver.stop(StopKind.POWER_OFF)
                time.sleep(POWERING_OFF)
            elif not any(observer.hold(robot) for observer in observers):

                def note(words: str) -> None:
                    for observer in observers:
                        # The log itself may have failed.
                        with suppress(Exception):
                            observer.note(robot.clock.now(), words)

                hold_until_told(robot, note)


def deploy_on_twin(
    task: DeploymentTask,
    placement: np.ndarray,
    truth: TwinParameters,
    observers: Sequence[DeploymentObserver] = (),
    *,
    switch: StopSwitch | None = None,
    advise: bool = True,
) -> DeploymentResult:
    """Deploy one grasp on a new twin. ``spec.seed`` also seeds the tracker's noise.

    Args:
        placement: pose at which the object is released, world frame, shape [7]; it then settles.
        truth: true parameters of the twin.
        observers: notified of all events, in this order.
        switch: stop switch; None: one that watches the cell's stop file.
        advise: whether errors name a placement that the arm can reach.

    Returns:
        The result, with the true outcome of the last attempt.

    Raises:
        FungraspError: the grasp can't be planned or reached.
    """
    cell, hand, spec = task.cell, task.hand, task.spec
    world = TwinWorld(cell, hand, task.obj, truth, seed=spec.seed)
    world.settle(placement)
    watch = _TwinWatch(world)
    with ExitStack() as stack:
        if spec.real_time:
            stack.enter_context(RealTimeTwin(world))
        robot = Robot(
            cell,
            hand,
            TwinArm(world, cell),
            TwinHand(world, cell, hand),
            TwinTracker(world),
            WallClock() if spec.real_time else TwinClock(world),
            stiffness=task.stiffness,
            compensate=spec.gravity_compensation,
            switch=switch,
        )
        stack.enter_context(robot)
        for observer in observers:
            observer.connected(robot)
        everyone = [watch, *observers]
        result = Deployment(robot, task.policy, task.preparer(advise), spec, everyone).run(task.grasp)
    judge = watch.judge
    return replace(
        result,
        success=judge.success,
        height=float(judge.height),
        as_shown=held_as_shown(judge.samples, hand, task.obj, task.grasp),
    )


class _TwinWatch(DeploymentObserver):
    """Judges the hold of the last attempt."""

    def __init__(self, world: TwinWorld):
        self._world, self.judge = world, TwinJudge(world)

    def phase(self, time: float, phase: Phase) -> None:
        if phase is Phase.GRASP:
            self.judge = TwinJudge(self._world)

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        self.judge.watch(phase is Phase.HOLD)

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
from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects, as_grasp_set, resolve_objects
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
"""Time in which an empty hand's driver takes the torque away [s]."""


@dataclass(frozen=True, eq=False)
class DeploymentTask:
    """What a specification names, loaded."""

    spec: DeploymentSpec
    """What is asked."""
    cell: RobotCell
    """The robot."""
    hand: Hand
    """On its arm."""
    obj: ObjectModel
    """The object as it is believed."""
    grasp: RobotGraspSet
    """One."""
    policy: Policy
    """What acts."""
    planner: Planner
    """Of the policy."""
    dynamics: HandDynamics | None = None
    """Identified, of the hand; the model's if None."""

    def preparer(self, advise: bool = True) -> GraspPreparer:
        """What plans. advise: whether a placement that would do is looked for where the object's does not."""
        return GraspPreparer(
            self.cell, self.hand, self.obj, self.planner, self.dynamics, self.spec.seed, advise=advise
        )

    @property
    def stiffness(self) -> np.ndarray | None:
        """Of the hand's servos, where it was identified [N m/rad], shape [U]; None for the model's."""
        return None if self.dynamics is None else self.dynamics.stiffness(self.hand)


def deployment_task(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    spec: DeploymentSpec,
    plans: GraspPlan | None = None,
) -> DeploymentTask:
    """Load what a specification names. robot: one grasp, of the cell's hand; plans: one plan for it, to be
    followed in the place of one that the policy's planner makes. Raises: FungraspError: several grasps,
    grasps of another hand, no such cell or policy, a cell that is not calibrated, or several attempts or
    another speed with a policy for which these make no sense."""
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
    # Drivers that planning keeps from running take their devices for silent.
    spare = 0 if is_twin(cell) else max(1, (os.cpu_count() or 2) - 1)
    planner = (
        robot_planner(spec.policy, limited, {obj.name: obj}, spec.threads or spare)
        if plans is None
        else GivenPlans(plans, robot)
    )
    return DeploymentTask(spec, cell, hand, obj, robot, policy, planner, dynamics)


def robot_planner(name: str, hand: Hand, objects: Mapping[str, ObjectModel], threads: int = 0) -> Planner:
    """The planner of the policy of a name on a robot: a robot differs from its model, so that candidates are
    tried in the worlds of the reality protocol. threads: 0 means all processors. Raises: FungraspError: no
    such policy, or one for another hand."""
    return make_planner(name, hand, objects, SelectionSettings.for_protocol("reality"), threads=threads)


def deployable_policy(name: str, hand: Hand, objects: Mapping[str, ObjectModel]) -> Policy:
    """The policy of a name, if a robot can run it. Raises: FungraspError: there is none, or it needs what
    only a simulation knows."""
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

    After a stop, or if the robot should stay, the hand keeps its grip until a person types open at the
    keyboard of ``switch`` or interrupts the program (``fungrasp.deployment.hold_after_stop``). On a twin, the
    object is placed within reach of the arm; on a robot, the tracker finds it.

    Args:
        grasps: one robot grasp of the cell's hand, or one human grasp, which is retargeted first.
        objects: its object, as for ``retarget``.
        cell: replaces that of ``spec``.
        policy: replaces that of ``spec``.
        plans: one plan for the grasp (``fungrasp.plan``), which is moved to the observed object. Default:
            made by the policy's planner.
        spec: settings; the defaults if None.
        log: MCAP file to write; must not exist. None: no log.
        observer: notified of all events, and asked before each phase with motion; None for none.
        switch: stops the robot; that of the cell's stop file if None.

    Returns:
        The result. It includes faults of the robot, which are not raised.

    Raises:
        FungraspError: contradicting settings (``deployment_task``), a missing device, or a grasp that can't
            be planned or reached. Nothing has moved then.
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
        placement = next(reachable_placements(task.cell, task.hand, task.obj, robot, spec.seed, given))
        truth = cell_twin(task.cell, task.hand, spec.twin)
        result = deploy_on_twin(task, placement, truth, observers, switch=switch)
        if spec.until in ("plan", "approach", "grasp"):
            # It was not to be lifted.
            return replace(result, success=None, height=np.nan, as_shown=None)
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


def deploy_on_twin(
    task: DeploymentTask,
    placement: np.ndarray,
    truth: TwinParameters,
    observers: Sequence[DeploymentObserver] = (),
    *,
    switch: StopSwitch | None = None,
    advise: bool = True,
) -> DeploymentResult:
    """Deploy one grasp on a fresh twin. Its seed is of the tracker's noise as well.

    Args:
        placement: where the object is put, world frame, shape [7]; it settles.
        truth: what is true of the twin.
        observers: told of everything in this order.
        switch: stops the robot; that of the cell's stop file if None.
        advise: whether a grasp that can't be reached is refused with a placement that would do.

    Returns:
        How it went, with what only a twin knows. Run in real time or as fast as it goes, as the specification
        says.

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

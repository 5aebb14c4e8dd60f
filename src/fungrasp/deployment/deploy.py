"""``deploy``: one grasp on a robot or on its twin, whatever the cell is connected to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from fungrasp.core.errors import FungraspError
from fungrasp.core.version import __version__
from fungrasp.deployment.deployment import Confirm
from fungrasp.deployment.deployment_result import (
    LAST_PHASES,
    DeploymentResult,
    DeploymentSettings,
    DeploymentSpec,
)
from fungrasp.deployment.hand_knowledge import hand_knowledge
from fungrasp.deployment.log import DeploymentLog, McapLog
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.twin_deployment import deploy_on_twin, reachable_placement
from fungrasp.deployment.wired_deployment import DeploymentTask, deploy_on_robot
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.planning import Planner, make_planner
from fungrasp.planning.attempts import check_attempts
from fungrasp.planning.selection import SelectionSettings
from fungrasp.policies import OpenLoopPolicy, make_policy
from fungrasp.robots.assembly import is_twin
from fungrasp.robots.cell import check_calibrated, load_cell
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.task import Policy


def deploy(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    cell: str | None = None,
    policy: str | None = None,
    *,
    spec: DeploymentSpec | None = None,
    log: str | Path | None = None,
    about: Mapping[str, str] | None = None,
    switch: StopSwitch | None = None,
    threads: int = 0,
    on_phase: Callable[[Phase], None] = lambda phase: None,
    on_connect: Callable[[], None] = lambda: None,
    confirm: Confirm | None = None,
) -> DeploymentResult:
    """Look, plan, move to the start, grasp, lift, hold, put down and go home.

    A robot that was stopped, or is to stay, holds what it holds until a person says open at the keyboard of
    ``switch`` or interrupts the program (``fungrasp.deployment.holding``). On a twin the object is put where
    the arm can reach it; on a robot it stands where the tracker sees it.

    Args:
        robot: one grasp, of the cell's hand.
        objects: its object, by name.
        cell: in the place of the one that ``spec`` names.
        policy: in the place of that of ``spec``.
        spec: what is asked; the defaults if None.
        log: MCAP file to write, which must not exist; no log if None.
        about: what else the log says of the deployment.
        switch: stops the robot; that of the cell's stop file if None.
        threads: of the planner; 0 means all processors.
        on_phase: called as a phase begins.
        on_connect: called when the robot is connected, before anything moves.
        confirm: called before each phase in which the robot moves, with what has to be called again and
            again until it returns: then the phase begins. ``SafetyStop`` ends the run. Not if None.

    Returns:
        How it went. Faults of the robot are in it; they raise nothing.

    Raises:
        FungraspError: several grasps, grasps of another hand, no such cell or policy, a cell that is not
            calibrated, a device that is not there, or a grasp that can't be planned or reached; nothing has
            moved then.
    """
    spec = spec or DeploymentSpec()
    spec = replace(spec, cell=cell or spec.cell, policy=policy or spec.policy)
    return run_task(
        deployment_task(robot, objects, spec, threads),
        spec,
        log=log,
        about=about,
        switch=switch,
        on_phase=on_phase,
        on_connect=on_connect,
        confirm=confirm,
    )


def run_task(
    task: DeploymentTask,
    spec: DeploymentSpec,
    *,
    log: str | Path | None = None,
    about: Mapping[str, str] | None = None,
    switch: StopSwitch | None = None,
    on_phase: Callable[[Phase], None] = lambda phase: None,
    on_connect: Callable[[], None] = lambda: None,
    confirm: Confirm | None = None,
) -> DeploymentResult:
    """Carry a task out on the robot, or on the twin, of its cell. Arguments and result: as of ``deploy``.

    Raises:
        FungraspError: several attempts or another speed with a policy for which these make no sense, a
            device that is not there, or a grasp that can't be planned or reached; nothing has moved then.
    """
    cell, hand, watches = task.cell, task.hand, not isinstance(task.policy, OpenLoopPolicy)
    check_attempts(spec.attempts, watches)
    if spec.speed < 1.0 and watches:
        raise FungraspError(
            f"the policy '{spec.policy}' watches what it does and acts at 10 Hz: it can't be slowed down to "
            f'{spec.speed:g}; the policies "plan" and "reference" can'
        )
    last = LAST_PHASES[spec.until]
    settings = DeploymentSettings(until=last, attempts=spec.attempts, speed=spec.speed)
    said = {"version": __version__, "robot": spec.cell, "policy": spec.policy, **(about or {})}
    with ExitStack() as stack:
        written: DeploymentLog | None = None if log is None else stack.enter_context(McapLog(Path(log)))
        switch = stack.enter_context(StopSwitch(cell.stop_file)) if switch is None else switch
        if not is_twin(cell):
            result = deploy_on_robot(
                task,
                log=written,
                switch=switch,
                settings=settings,
                about=said,
                on_phase=on_phase,
                on_connect=lambda connected: on_connect(),
                confirm=confirm,
            )
            return replace(result, spec=spec)
        on_connect()
        outcome = deploy_on_twin(
            cell,
            hand,
            task.thing,
            task.grasp,
            reachable_placement(cell, hand, task.thing, task.grasp, spec.seed),
            task.policy,
            task.planner,
            cell_twin(cell, hand, spec.twin),
            wall_clock=spec.real_time,
            dynamics=task.dynamics,
            compensate=task.compensate,
            dry_run=task.dry_run,
            seed=spec.seed,
            log=written,
            switch=switch,
            settings=settings,
            about=said,
            on_phase=on_phase,
            confirm=confirm,
            preparer=task.preparer,
        )
        if last in (Phase.IDLE, Phase.MOVE_TO_START, Phase.GRASP):
            return replace(outcome.result, spec=spec)
        return replace(outcome.result, spec=spec, success=outcome.success, height=outcome.height)


def deployment_task(
    robot: RobotGraspSet, objects: Mapping[str, ObjectModel], spec: DeploymentSpec, threads: int = 0
) -> DeploymentTask:
    """A grasp with the cell, the policy, its planner, and what is known of the hand.

    Args:
        robot: one grasp, of the cell's hand.
        objects: its object, by name.
        spec: what is asked.
        threads: of the planner; 0 means all processors.

    Raises:
        FungraspError: several grasps, grasps of another hand, no such cell or policy, or a cell that is not
            calibrated.
    """
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
    known = hand_knowledge(cell, hand, spec.hand_dynamics or None)
    return DeploymentTask(
        cell,
        hand,
        obj,
        robot,
        deployable_policy(spec.policy, hand, {obj.name: obj}),
        robot_planner(spec.policy, known.planned, {obj.name: obj}, threads),
        known.dynamics,
        known.stiffness,
        spec.gravity_compensation,
        spec.dry_run,
        spec.seed,
    )


def robot_planner(name: str, hand: Hand, objects: Mapping[str, ObjectModel], threads: int = 0) -> Planner:
    """The planner of a policy on a robot: a robot differs from its model, so that candidates are tried in the
    worlds of the reality protocol.

    Args:
        name: of the policy.
        hand: that it moves.
        objects: by name.
        threads: 0 means all processors.

    Raises:
        FungraspError: no such policy, or one for another hand.
    """
    return make_planner(name, hand, objects, SelectionSettings.for_protocol("reality"), threads=threads)


def deployable_policy(name: str, hand: Hand, objects: Mapping[str, ObjectModel]) -> Policy:
    """The policy of a name, if a robot can run it.

    Raises:
        FungraspError: there is none, or it needs what only a simulation knows.
    """
    policy = make_policy(name, hand, objects)
    if not isinstance(policy, Policy):
        raise FungraspError(f"the policy '{name}' needs what only a simulation knows: take a student")
    return policy

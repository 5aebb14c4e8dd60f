"""``deploy``: one grasp on a robot or on its twin, whatever the cell is connected to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from fungrasp.deployment.deployment_result import DeploymentResult, DeploymentSettings, DeploymentSpec
from fungrasp.deployment.hand_knowledge import hand_knowledge
from fungrasp.deployment.log import DeploymentLog, McapLog
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.twin_deployment import deploy_on_twin, reachable_placement
from fungrasp.deployment.wired_deployment import DeploymentTask, deploy_on_robot
from fungrasp.errors import FungraspError
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.planning import Planner
from fungrasp.planning.selection import SelectionSettings
from fungrasp.policies import OpenLoopPolicy, check_attempts, make_planner, make_policy
from fungrasp.robots.assembly import is_twin
from fungrasp.robots.cell import RobotCell, check_calibrated, load_cell
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.task import Policy
from fungrasp.version import __version__


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

    Returns:
        How it went. Faults of the robot are in it; they raise nothing.

    Raises:
        FungraspError: several grasps, grasps of another hand, no such cell or policy, a cell that is not
            calibrated, a device that is not there, or a grasp that can't be planned or reached; nothing has
            moved then.
    """
    spec = spec or DeploymentSpec()
    spec = replace(spec, cell=cell or spec.cell, policy=policy or spec.policy)
    if len(robot) != 1:
        raise FungraspError(f"one grasp is deployed at a time, not {len(robot)}: select one, as in robot[:1]")
    check_objects(robot.object_name.tolist(), objects)
    obj, loaded = objects[str(robot.object_name[0])], load_cell(spec.cell)
    if not is_twin(loaded):
        check_calibrated(loaded)
    hand = load_hand(loaded.hand)
    if robot.hand != hand.name:
        raise FungraspError(
            f"robot cell '{loaded.name}' carries the hand '{hand.name}', and the grasp is of '{robot.hand}'"
        )
    task = deployment_task(loaded, hand, robot, obj, spec, threads)
    check_attempts(spec.attempts, not isinstance(task.policy, OpenLoopPolicy))
    settings = DeploymentSettings(put_down=spec.put_down, attempts=spec.attempts)
    said = {"version": __version__, "robot": spec.cell, "policy": spec.policy, **(about or {})}
    with ExitStack() as stack:
        written: DeploymentLog | None = None if log is None else stack.enter_context(McapLog(Path(log)))
        switch = stack.enter_context(StopSwitch(loaded.stop_file)) if switch is None else switch
        if not is_twin(loaded):
            result = deploy_on_robot(
                task,
                log=written,
                switch=switch,
                settings=settings,
                about=said,
                on_phase=on_phase,
                on_connect=lambda connected: on_connect(),
            )
            return replace(result, spec=spec)
        outcome = deploy_on_twin(
            loaded,
            hand,
            obj,
            robot,
            reachable_placement(loaded, hand, obj, robot, spec.seed),
            task.policy,
            task.planner,
            cell_twin(loaded, hand, spec.twin),
            wall_clock=spec.real_time,
            dynamics=task.dynamics,
            compensate=task.compensate,
            dry_run=spec.dry_run,
            seed=spec.seed,
            log=written,
            switch=switch,
            settings=settings,
            about=said,
            on_phase=on_phase,
        )
        return replace(outcome.result, spec=spec, success=outcome.success, height=outcome.height)


def deployment_task(
    cell: RobotCell,
    hand: Hand,
    grasp: RobotGraspSet,
    obj: ObjectModel,
    spec: DeploymentSpec,
    threads: int = 0,
) -> DeploymentTask:
    """A grasp with the policy, its planner, and what is known of the hand.

    Args:
        cell: the robot.
        hand: on its arm.
        grasp: one.
        obj: its object.
        spec: what is asked.
        threads: of the planner; 0 means all processors.

    Raises:
        FungraspError: as ``deployable_policy``, ``hand_knowledge`` and ``robot_planner``.
    """
    objects = {obj.name: obj}
    known = hand_knowledge(cell, hand, spec.hand_dynamics or None)
    return DeploymentTask(
        cell,
        hand,
        obj,
        grasp,
        deployable_policy(spec.policy, hand, objects),
        robot_planner(spec.policy, known.planned, objects, threads),
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

"""Planning a deployment ahead, and carrying out what was planned."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deploy import deployment_task, run_task
from fungrasp.deployment.deployment import Confirm
from fungrasp.deployment.deployment_result import DeploymentResult, DeploymentSpec, Until
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.rehearsal import rehearse
from fungrasp.deployment.saved_plan import (
    ObjectSource,
    PlanOrigin,
    SavedPlan,
    SavedPlanPreparer,
    check_unchanged,
    digests,
)
from fungrasp.grasps import RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.robots.stop_switch import StopSwitch


def plan_ahead(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    source: ObjectSource,
    spec: DeploymentSpec | None = None,
    *,
    about: str = "",
    switch: StopSwitch | None = None,
    threads: int = 0,
) -> SavedPlan:
    """Look, choose and plan the whole way there and back, and send nothing. The safety filter has seen all
    of it.

    Args:
        robot: one grasp, of the cell's hand.
        objects: its object, by name.
        source: where that is read from when the plan is carried out.
        spec: what is asked; the defaults if None. Where it ends, attempts and speed
            are said when it is carried out.
        about: which grasp, in words.
        switch: ends it; that of the cell's stop file if None.
        threads: of the planner; 0 means all processors.

    Raises:
        FungraspError: as ``deploy``; or the safety filter would stop the plan, or the object can't be read
            from its source as it is.
    """
    spec = replace(spec or DeploymentSpec(), until="plan", attempts=1, speed=1.0, dry_run=True)
    if Path(spec.cell).suffix == ".toml":
        spec = replace(spec, cell=str(Path(spec.cell).resolve()))
    task = deployment_task(robot, objects, spec, threads)
    dynamics = spec.hand_dynamics or task.cell.hand_dynamics
    made_of = digests(task.cell, task.hand, task.thing, spec.policy, dynamics)
    origin = PlanOrigin(spec, source, about, digests=made_of)
    if digests(task.cell, task.hand, source.load(), spec.policy, dynamics) != made_of:
        raise FungraspError(
            f"the object '{task.thing.name}' is another one when it is read again from its mesh: such a plan "
            "can't be kept"
        )
    result = run_task(task, spec, switch=switch)
    if result.fault or result.prepared is None or result.before is None:
        raise FungraspError(result.fault)
    arm, fingers = result.before.arm.positions, result.before.hand.positions
    motion = rehearse(task.cell, task.hand, robot, result.prepared, arm, fingers)
    return SavedPlan(origin, robot, arm, fingers, result.prepared, motion)


def execute_plan(
    saved: SavedPlan,
    *,
    until: Until = "home",
    speed: float = 1.0,
    real_time: bool = True,
    log: str | Path | None = None,
    switch: StopSwitch | None = None,
    on_phase: Callable[[Phase], None] = lambda phase: None,
    on_connect: Callable[[], None] = lambda: None,
    confirm: Confirm | None = None,
) -> DeploymentResult:
    """Carry out a saved plan, with its policy, if everything is as it was.

    Args:
        saved: the plan.
        until: where to end.
        speed: share of the cell's speed; below 1 only for policies that do not watch.
        real_time: for a twin: run on the clock of the wall.
        log: MCAP file to write, which must not exist; no log if None.
        switch: stops the robot; that of the cell's stop file if None.
        on_phase: called as a phase begins.
        on_connect: called when the robot is connected, before anything moves.
        confirm: as of ``deploy``.

    Raises:
        FungraspError: cell, hand, object, policy or identified dynamics are not those of the plan, the
            object or the arm is somewhere else, or as ``deploy``; nothing has moved then.
    """
    spec = replace(saved.origin.spec, until=until, speed=speed, real_time=real_time, dry_run=False)
    thing = saved.origin.source.load()
    task = deployment_task(saved.grasp, {thing.name: thing}, spec)
    dynamics = spec.hand_dynamics or task.cell.hand_dynamics
    check_unchanged(saved, digests(task.cell, task.hand, thing, spec.policy, dynamics))
    return run_task(
        replace(task, preparer=SavedPlanPreparer(saved, {thing.name: thing})),
        spec,
        log=log,
        about={"grasp": saved.origin.about, "saved plan": saved.digest},
        switch=switch,
        on_phase=on_phase,
        on_connect=on_connect,
        confirm=confirm,
    )

"""Deployments on a twin without a wire: on the clock of the wall, or as fast as they go."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice

import numpy as np

from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.deployment_result import DeploymentResult
from fungrasp.deployment.deployment_task import DeploymentTask
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import GraspPreparer, UnreachableError
from fungrasp.geometry.poses import (
    invert,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    rotate,
)
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import broad_settled_up
from fungrasp.planning import MotionPlanner, Planner
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import RobotCommand, RobotState, WallClock
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import RealTimeTwin, TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.judge import TwinJudge
from fungrasp.robots.twin.parameters import TwinParameters
from fungrasp.robots.twin.twin_model import TwinPhysics
from fungrasp.robots.twin.world import TwinWorld

ROOM = 0.02
"""An object is put so that the palm stays so far within the sides of the workspace [m]: what is seen of it is
up to a centimeter off, and plans differ."""

PLACEMENTS_PLANNED = 12
"""Placements for which a motion is planned: a second or two each."""


def reachable_placement(
    cell: RobotCell,
    hand: Hand,
    obj: ObjectModel,
    grasp: RobotGraspSet,
    seed: int = 0,
    planner: Planner | None = None,
) -> np.ndarray:
    """Where a person would put the object so that the arm can grasp it: the first of
    ``reachable_placements``. Arguments and errors: as there.

    Returns:
        the object, world frame, shape [7].
    """
    return next(reachable_placements(cell, hand, obj, grasp, seed, planner))


def reachable_placements(
    cell: RobotCell,
    hand: Hand,
    obj: ObjectModel,
    grasp: RobotGraspSet,
    seed: int = 0,
    planner: Planner | None = None,
) -> Iterator[np.ndarray]:
    """Where a person would put the object so that the arm can grasp it, and where next if the robot says that
    it can't: near the middle of the workspace, turned as the arm needs it. Where the object stood as the
    grasp was shown does not matter.

    They are the placements for which one planned motion can be followed, then the first that the arm reaches
    with some motion: the robot's planner may find it.

    Args:
        seed: of the postures that are tried.
        planner: of the motion that must be followed; one motion without candidates if None.

    Yields:
        the object, world frame, shape [7].

    Raises:
        UnreachableError: there is none nearby.
    """
    # What is seen differs by millimeters from what is: more room than is needed. Half of the clearance more
    # above the table, and half of it less depth for the fingers: about the error of a tracked height.
    box = cell.workspace
    inner = np.array([ROOM, ROOM, 0.0])
    roomy = replace(
        box,
        lower=tuple(np.add(box.lower, inner).tolist()),
        upper=tuple(np.subtract(box.upper, inner).tolist()),
        table_clearance=1.5 * box.table_clearance,
        hand_depth=box.hand_depth - 0.5 * box.table_clearance,
    )
    cell = replace(cell, workspace=roomy)
    planner = planner or MotionPlanner(hand, {obj.name: obj})
    preparer = GraspPreparer(cell, hand, obj, planner, seed=seed, advise=False)
    home = np.asarray(cell.arm.home)
    refused, found = None, False
    middle = _at_rest(obj, grasp.object_rest_pose[0])
    middle[:2] = 0.5 * (np.array(box.lower[:2]) + box.upper[:2])
    for pose, _ in islice(preparer.placements(grasp, middle), PLACEMENTS_PLANNED):
        try:
            preparer.prepare(grasp, pose, home, plans=1)
        except UnreachableError:
            refused = pose if refused is None else refused
            continue
        found = True
        yield pose
    if refused is not None:
        yield refused
    elif not found:
        why = preparer.hindrance(grasp, middle)
        raise UnreachableError(
            f"no placement of '{obj.name}' was found from which the arm can grasp it: "
            + (why or "take another grasp")
        )


def _at_rest(obj: ObjectModel, pose: np.ndarray) -> np.ndarray:
    """An object on the broad stable face that it is nearest to, world frame, shape [7]: measured poses at
    rest are a few degrees and up to a centimeter off."""
    up = np.array([0.0, 0.0, 1.0])
    leaning = rotate(pose[3:], broad_settled_up(obj, rotate(invert(pose)[3:], up)))
    axis = np.cross(leaning, up)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, leaning @ up)
    turn = quaternion_from_rotation_vector(angle * axis / max(sine, 1e-12))
    settled = pose.copy()
    settled[3:] = quaternion_multiply(turn, pose[3:])
    settled[2] = -rotate(settled[3:], obj.vertices)[:, 2].min()
    return settled


def deploy_on_twin(
    task: DeploymentTask,
    placement: np.ndarray,
    truth: TwinParameters,
    observers: Sequence[DeploymentObserver] = (),
    *,
    switch: StopSwitch | None = None,
    physics: TwinPhysics | None = None,
    advise: bool = True,
) -> DeploymentResult:
    """Deploy one grasp on a fresh twin. Its seed is of the tracker's noise as well.

    Args:
        placement: where the object is put, world frame, shape [7]; it settles.
        truth: what is true of the twin.
        observers: told of everything in this order.
        switch: stops the robot; that of the cell's stop file if None.
        physics: of the twin; the default if None.
        advise: whether a grasp that can't be reached is refused with a placement that would do.

    Returns:
        How it went, with what only a twin knows. Run in real time or as fast as it goes, as the specification
        says.

    Raises:
        FungraspError: the grasp can't be planned or reached.
    """
    cell, hand, spec = task.cell, task.hand, task.spec
    world = TwinWorld(cell, hand, task.obj, truth, seed=spec.seed, physics=physics)
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
            dry_run=spec.dry_run,
            switch=switch,
        )
        stack.enter_context(robot)
        for observer in observers:
            observer.connected(robot)
        everyone = [watch, *observers]
        result = Deployment(robot, task.policy, task.preparer(advise), spec, everyone).run(task.grasp)
    sag, tracking = watch.open_hand_errors(result)
    judge = watch.judge
    return replace(result, success=judge.success, height=float(judge.height), tracking=tracking, sag=sag)


class _TwinWatch(DeploymentObserver):
    """Judges the hold, and keeps by how much the fingers miss their setpoints."""

    def __init__(self, world: TwinWorld):
        self._world, self.judge = world, TwinJudge(world)
        self._errors: list[tuple[float, np.ndarray]] = []

    def phase(self, time: float, phase: Phase) -> None:
        if phase is Phase.GRASP:
            self.judge.begin_attempt()

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        self.judge.watch(phase is Phase.HOLD)
        if phase is Phase.GRASP:
            self._errors.append((self._world.time, self._world.finger_positions() - command.hand))

    def open_hand_errors(self, result: DeploymentResult) -> tuple[float, float]:
        """Largest mean and RMS of the hand's errors before its fingers close [rad]."""
        if result.prepared is None or Phase.GRASP not in result.times:
            return np.nan, np.nan
        plan = result.prepared.plan
        closing = result.times[Phase.GRASP] + float(plan.closing_step[0]) * plan.control_period
        before = np.array([error for time, error in self._errors if time < closing])
        if not len(before):
            return np.nan, np.nan
        return float(np.abs(before.mean(axis=0)).max()), float(np.sqrt(np.mean(before**2)))

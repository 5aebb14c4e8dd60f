"""Deployments on a twin without a wire: on the clock of the wall, or as fast as they go."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from fungrasp.deployment.deployment import Confirm, Deployment
from fungrasp.deployment.deployment_result import DeploymentResult, DeploymentSettings
from fungrasp.deployment.hand_knowledge import HandDynamics
from fungrasp.deployment.log import DeploymentLog
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import GraspPreparer, Preparer, UnreachableError
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
from fungrasp.robots.clock import Clock, WallClock
from fungrasp.robots.robot import Robot
from fungrasp.robots.robot_state import RobotCommand
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.clocks import RealTimeTwin, TwinClock
from fungrasp.robots.twin.devices import TwinArm, TwinHand, TwinTracker
from fungrasp.robots.twin.judge import TwinJudge
from fungrasp.robots.twin.parameters import TwinParameters
from fungrasp.robots.twin.twin_model import TwinPhysics
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.task import Policy

ROOM = 0.02
"""An object is put so that the palm stays so far within the sides of the workspace [m]: what is seen of it is
up to a centimetre off, and plans differ."""

PLACEMENTS_PLANNED = 12
"""Placements for which a motion is planned: a second or two each."""


@dataclass(frozen=True, eq=False)
class TwinOutcome:
    """How a deployment on a twin went."""

    result: DeploymentResult
    """What the robot's computer knows of it."""
    success: bool
    """Whether the object was lifted and held, in truth."""
    height: float
    """Least height of its center of mass during the hold [m]; infinite where there was none."""
    tracking: float
    """RMS error of the hand's joints from their setpoints before the fingers close [rad]; nan where the
    motion did not begin."""
    sag: float
    """Largest mean error of a joint over the same time [rad]."""
    twin_latest: float
    """How far the twin has fallen behind the clock of the wall at worst [s]; zero on its own clock."""


def reachable_placement(
    cell: RobotCell, hand: Hand, thing: ObjectModel, grasp: RobotGraspSet, seed: int = 0
) -> np.ndarray:
    """Where a person would put the object so that the arm can grasp it: the first of
    ``reachable_placements``. Arguments and errors: as there.

    Returns:
        the object, world frame, shape [7].
    """
    return next(reachable_placements(cell, hand, thing, grasp, seed))


def reachable_placements(
    cell: RobotCell, hand: Hand, thing: ObjectModel, grasp: RobotGraspSet, seed: int = 0
) -> Iterator[np.ndarray]:
    """Where a person would put the object so that the arm can grasp it, and where next if the robot says that
    it can't: near the middle of the workspace, turned as the arm needs it. Where the object stood as the
    grasp was shown does not matter.

    They are the placements for which one planned motion can be followed, then the first that the arm reaches
    with some motion: the robot's planner may find it.

    Args:
        cell: the robot.
        hand: on its arm.
        thing: the object.
        grasp: one.
        seed: of the postures that are tried.

    Yields:
        the object, world frame, shape [7].

    Raises:
        UnreachableError: there is none nearby.
    """
    # What is seen differs by millimetres from what is: more room than is needed. Half of the clearance more
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
    planner = MotionPlanner(hand, {thing.name: thing})
    preparer = GraspPreparer(cell, hand, thing, planner, seed=seed, advise=False)
    home = np.asarray(cell.arm.home)
    refused, found = None, False
    middle = _at_rest(thing, grasp.object_rest_pose[0])
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
            f"no placement of '{thing.name}' was found from which the arm can grasp it: "
            + (why or "take another grasp")
        )


def _at_rest(thing: ObjectModel, pose: np.ndarray) -> np.ndarray:
    """An object on the broad stable face that it is nearest to, world frame, shape [7]: measured poses at
    rest are a few degrees and up to a centimeter off."""
    up = np.array([0.0, 0.0, 1.0])
    leaning = rotate(pose[3:], broad_settled_up(thing, rotate(invert(pose)[3:], up)))
    axis = np.cross(leaning, up)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, leaning @ up)
    turn = quaternion_from_rotation_vector(angle * axis / max(sine, 1e-12))
    settled = pose.copy()
    settled[3:] = quaternion_multiply(turn, pose[3:])
    settled[2] = -rotate(settled[3:], thing.vertices)[:, 2].min()
    return settled


def deploy_on_twin(
    cell: RobotCell,
    hand: Hand,
    thing: ObjectModel,
    grasp: RobotGraspSet,
    placement: np.ndarray,
    policy: Policy,
    planner: Planner,
    truth: TwinParameters,
    *,
    wall_clock: bool = False,
    dynamics: HandDynamics | None = None,
    compensate: bool = True,
    dry_run: bool = False,
    seed: int = 0,
    physics: TwinPhysics | None = None,
    log: DeploymentLog | None = None,
    switch: StopSwitch | None = None,
    settings: DeploymentSettings | None = None,
    about: dict[str, str] | None = None,
    on_phase: Callable[[Phase], None] = lambda phase: None,
    confirm: Confirm | None = None,
    prepare_world: Callable[[TwinWorld], None] = lambda world: None,
    preparer: Preparer | None = None,
    advise: bool = True,
) -> TwinOutcome:
    """Deploy one grasp on a fresh twin.

    Args:
        cell: the robot.
        hand: on its arm.
        thing: the object as it is believed.
        grasp: one.
        placement: where the object is put, world frame, shape [7]; it settles.
        policy: what acts.
        planner: of the policy.
        truth: what is true of the twin.
        wall_clock: run in real time; else as fast as it goes, the same to the last bit.
        dynamics: identified; the model's if None.
        compensate: whether the hand's weight is carried.
        dry_run: read everything, send nothing.
        seed: of the plan and of the tracker's noise.
        physics: of the twin; the default if None.
        log: of every tick; none if None.
        switch: stops the robot; that of the cell's stop file if None.
        settings: times; the defaults if None.
        about: what the log says of it.
        on_phase: called as a phase begins.
        confirm: called before each phase in which the robot moves; not if None.
        prepare_world: called with the twin after the object has settled, to spoil it.
        preparer: what has a plan already; None to plan.
        advise: whether a grasp that can't be reached is refused with a placement that would do.

    Raises:
        FungraspError: the grasp can't be planned or reached.
    """
    world = TwinWorld(cell, hand, thing, truth, seed=seed, physics=physics)
    world.settle(placement)
    judge = TwinJudge(world)
    prepare_world(world)
    errors: list[tuple[float, np.ndarray]] = []

    def begun(phase: Phase) -> None:
        if phase is Phase.GRASP:
            judge.begin_attempt()
        on_phase(phase)

    def watch(phase: Phase, command: RobotCommand) -> None:
        judge.watch(phase is Phase.HOLD)
        if phase is Phase.GRASP:
            errors.append((world.time, world.finger_positions() - command.hand))

    stiffness = np.array([servo.kp for servo in hand.actuators.values()])
    if dynamics is not None:
        driven = [hand.joint_names.index(name) for name in hand.actuators]
        stiffness = stiffness * dynamics.servo_stiffness[driven]
    with ExitStack() as stack:
        real_time = stack.enter_context(RealTimeTwin(world)) if wall_clock else None
        clock: Clock = WallClock() if wall_clock else TwinClock(world)
        arm, fingers, tracker = TwinArm(world, cell), TwinHand(world, cell, hand), TwinTracker(world)
        robot = Robot(
            cell,
            hand,
            arm,
            fingers,
            tracker,
            clock,
            stiffness=stiffness,
            compensate=compensate,
            dry_run=dry_run,
            switch=switch,
        )
        stack.enter_context(robot)
        deployment = Deployment(
            robot,
            policy,
            preparer or GraspPreparer(cell, hand, thing, planner, dynamics, seed, advise=advise),
            log=log,
            settings=settings,
            about=about,
            on_phase=begun,
            on_setpoint=watch,
            confirm=confirm,
        )
        result = deployment.run(grasp)
        latest = 0.0 if real_time is None else real_time.latest
    mean, rms = _open_hand_errors(result, errors)
    return TwinOutcome(result, judge.success, float(judge.height), rms, mean, latest)


def _open_hand_errors(
    result: DeploymentResult, errors: Sequence[tuple[float, np.ndarray]]
) -> tuple[float, float]:
    """Largest mean and RMS of the hand's errors before its fingers close [rad]. errors: each with its
    time."""
    if result.prepared is None or Phase.GRASP not in result.times:
        return np.nan, np.nan
    plan = result.prepared.plan
    closing = result.times[Phase.GRASP] + float(plan.closing_step[0]) * plan.control_period
    before = np.array([error for time, error in errors if time < closing])
    if not len(before):
        return np.nan, np.nan
    return float(np.abs(before.mean(axis=0)).max()), float(np.sqrt(np.mean(before**2)))

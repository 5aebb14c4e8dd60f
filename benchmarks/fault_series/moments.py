"""When a fault comes: a share of a phase of the deployment without one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from fungrasp.deployment.deployment import Deployment
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import GraspPreparer, PreparedGrasp
from fungrasp.deployment.spec import Phase
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.device import RobotCommand, RobotState
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.devices import TwinArm, TwinClock, TwinHand, TwinTracker
from fungrasp.robots.twin.parameters import cell_twin
from fungrasp.robots.twin.world import TwinJudge, TwinWorld
from fungrasp.task import Policy

PLAN_TIME = 0.8
"""Planning takes so long [s]: longer than drivers wait to hear of their computer."""
EDGE = 0.05
"""Share of a phase at its beginning and at its end in which no fault comes: it might come in the next."""
LOOK, PLAN = "look", "plan"
"""Events beside the phases of a deployment."""


class Moment(StrEnum):
    """A part of a deployment."""

    LOOK = "look"
    PLAN = "plan"
    START = "move to start"
    APPROACH = "approach"
    CLOSE = "close"
    LIFT = "lift"
    HOLD = "hold"
    PUT_DOWN = "put down"
    HOME = "home"


@dataclass(frozen=True)
class Span:
    """Where a part of a deployment lies."""

    event: str
    """What begins at or before it: ``LOOK``, ``PLAN`` or a phase."""
    after: float
    """How long after that event it begins [s]."""
    length: float
    """Its time [s]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A twin on which a deployment without faults succeeds."""

    cell: RobotCell
    """The robot."""
    hand: Hand
    """On its arm."""
    obj: ObjectModel
    """The object as it is believed."""
    grasp: RobotGraspSet
    """One."""
    placement: np.ndarray
    """Where the object is put, world frame, shape [7]."""
    twin: int
    """Which twin."""
    prepared: PreparedGrasp
    """What was planned for it."""
    spans: Mapping[Moment, Span]
    """Of the deployment without faults."""
    events: Mapping[str, float]
    """When each event came [s], on the twin's clock."""


class PreparerOf:
    """A ``Preparer`` that says when it begins and takes its time. It has its plan already, or asks another
    one."""

    def __init__(
        self,
        robot: Robot,
        prepared: PreparedGrasp | GraspPreparer,
        said: Callable[[str], None] = lambda event: None,
    ):
        """
        Args:
            prepared: the plan, or who makes it.
            said: told ``PLAN`` as planning begins.
        """
        self._robot, self._prepared, self._said = robot, prepared, said
        self.objects: Mapping[str, ObjectModel] = {}
        """See ``Preparer``: nobody judges a single attempt."""

    def prepare(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0
    ) -> PreparedGrasp:
        self._said(PLAN)
        clock = self._robot.clock
        clock.sleep_until(clock.now() + PLAN_TIME)
        if isinstance(self._prepared, GraspPreparer):
            self._prepared = self._prepared.prepare(grasp, object_pose, arm)
        return self._prepared


class Happened(DeploymentObserver):
    """Says when phases begin, and lets a judge watch the hold."""

    def __init__(self, said: Callable[[str], None], judge: TwinJudge | None = None):
        self._said, self._judge = said, judge

    def phase(self, time: float, phase: Phase) -> None:
        self._said(phase.value)

    def fault(self, time: float, reason: str) -> None:
        self._said(Phase.FAULT.value)

    def setpoint(self, phase: Phase, state: RobotState, command: RobotCommand) -> None:
        if self._judge is not None:
            self._judge.watch(phase is Phase.HOLD)


@dataclass(eq=False)
class TwinRun:
    """A deployment on a twin that is on its own clock, ready to begin."""

    world: TwinWorld
    """The twin."""
    robot: Robot
    """Not connected."""
    deployment: Deployment
    """Of the robot."""
    judge: TwinJudge
    """Of the hold."""
    events: dict[str, float]
    """When each event came [s]."""


def twin_world(scene_cell: RobotCell, hand: Hand, obj: ObjectModel, twin: int) -> TwinWorld:
    """A twin of a cell, in which nothing has been put down yet."""
    return TwinWorld(scene_cell, hand, obj, cell_twin(scene_cell, hand, twin), seed=twin)


def twin_run(
    world: TwinWorld,
    cell: RobotCell,
    hand: Hand,
    prepared: PreparedGrasp | GraspPreparer,
    policy: Policy,
    *,
    clock: TwinClock | None = None,
    log: DeploymentObserver | None = None,
) -> TwinRun:
    """Make a robot of a twin whose object has settled, and its deployment."""
    devices = TwinArm(world, cell), TwinHand(world, cell, hand), TwinTracker(world)
    robot = Robot(cell, hand, *devices, clock or TwinClock(world), switch=StopSwitch())
    judge, events = TwinJudge(world), {LOOK: world.time}

    def happened(event: str) -> None:
        events[event] = world.time

    deployment = Deployment(
        robot,
        policy,
        PreparerOf(robot, prepared, happened),
        observers=[*([] if log is None else [log]), Happened(happened, judge)],
    )
    return TwinRun(world, robot, deployment, judge, events)


def scene(
    cell: RobotCell, hand: Hand, obj: ObjectModel, grasp: RobotGraspSet, placement: np.ndarray, twin: int
) -> Scene | None:
    """A deployment without faults on one twin; None where the object is not held: nothing could be said of a
    fault.

    Args:
        placement: of the object, world frame, shape [7].

    Raises:
        UnreachableError: the arm can't follow any plan.
    """
    world = twin_world(cell, hand, obj, twin)
    world.settle(placement)
    preparer = GraspPreparer(cell, hand, obj, MotionPlanner(hand, {obj.name: obj}))
    run = twin_run(world, cell, hand, preparer, OpenLoopPolicy())
    with run.robot:
        result = run.deployment.run(grasp)
    if result.fault or not run.judge.success:
        return None
    plan, at = run.deployment.prepared.plan, run.events
    closing = float(plan.closing_step[0]) * plan.control_period

    def until(event: str, end: str, after: float = 0.0) -> Span:
        return Span(event, after, at[end] - at[event] - after)

    spans = {
        Moment.LOOK: until(LOOK, PLAN),
        Moment.PLAN: Span(PLAN, 0.0, PLAN_TIME),
        Moment.START: until(Phase.MOVE_TO_START, Phase.GRASP),
        Moment.APPROACH: Span(Phase.GRASP, 0.0, closing),
        Moment.CLOSE: until(Phase.GRASP, Phase.LIFT, closing),
        Moment.LIFT: until(Phase.LIFT, Phase.HOLD),
        Moment.HOLD: until(Phase.HOLD, Phase.PUT_DOWN),
        Moment.PUT_DOWN: until(Phase.PUT_DOWN, Phase.HOME),
        Moment.HOME: until(Phase.HOME, Phase.DONE),
    }
    return Scene(cell, hand, obj, grasp, placement, twin, run.deployment.prepared, spans, dict(run.events))

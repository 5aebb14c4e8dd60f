"""Small twins for the tests of robots and deployment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from ideal_twin import IDEAL

from fungrasp.deployment.deploy import DeploymentTask, deploy_on_twin
from fungrasp.deployment.deployment_result import DeploymentResult
from fungrasp.deployment.observer import DeploymentObserver
from fungrasp.deployment.preparation import GraspPreparer, reachable_placements
from fungrasp.deployment.spec import DeploymentSpec, Phase, Until
from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retargeting import retarget
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.robot import Robot
from fungrasp.robots.stop_switch import StopSwitch
from fungrasp.robots.twin.parameters import TwinParameters, draw_twin

ROW = 10
"""A built-in grasp that an ideal twin lifts: the wine glass."""


@cache
def cell_and_hand() -> tuple[RobotCell, Hand]:
    cell = load_cell("ur5e-allegro")
    return cell, load_hand(cell.hand)


@cache
def grasp_and_object(row: int = ROW) -> tuple[RobotGraspSet, ObjectModel]:
    human = builtin_grasps().select(np.array([row]))
    objects = load_objects(human)
    robot = retarget(human, objects, cell_and_hand()[1])
    return robot, objects[human.object_name[0]]


@cache
def placed(row: int = ROW) -> np.ndarray:
    cell, hand = cell_and_hand()
    grasp, obj = grasp_and_object(row)
    return next(reachable_placements(cell, hand, obj, grasp))


@cache
def near_cell(row: int = ROW) -> RobotCell:
    """The cell with the arm where the plan begins: less to simulate."""
    cell, hand = cell_and_hand()
    grasp, obj = grasp_and_object(row)
    preparer = GraspPreparer(cell, hand, obj, MotionPlanner(hand, {obj.name: obj}))
    start = preparer.prepare(grasp, placed(row), np.array(cell.arm.home)).reach.start
    return replace(cell, arm=replace(cell.arm, home=tuple(start.tolist())))


class Told(DeploymentObserver):
    """Calls what it was given."""

    def __init__(
        self,
        phase: Callable[[Phase], object] = lambda phase: None,
        connected: Callable[[Robot], object] = lambda robot: None,
        confirm: Callable[[Phase, Callable[[], None]], object] = lambda phase, meanwhile: None,
        hold: Callable[[Robot], object] | None = None,
    ):
        self._phase, self._connected, self._confirm, self._hold = phase, connected, confirm, hold

    def phase(self, time: float, phase: Phase) -> None:
        self._phase(phase)

    def connected(self, robot: Robot) -> None:
        self._connected(robot)

    def confirm(self, phase: Phase, meanwhile: Callable[[], None]) -> None:
        self._confirm(phase, meanwhile)

    def hold(self, robot: Robot) -> bool:
        if self._hold is not None:
            self._hold(robot)
        return self._hold is not None


def spec(**options: Any) -> DeploymentSpec:
    """A short look, without a clock."""
    return DeploymentSpec(**{"look_time": 0.3, "policy": "reference", **options})


def task(
    *, policy: Any = None, cell: RobotCell | None = None, row: int = ROW, planner: Any = None, **options: Any
) -> DeploymentTask:
    """The built-in grasp with a plan of one motion."""
    _, hand = cell_and_hand()
    grasp, obj = grasp_and_object(row)
    return DeploymentTask(
        spec(**options),
        cell or near_cell(row),
        hand,
        obj,
        grasp,
        policy or OpenLoopPolicy(),
        planner or MotionPlanner(hand, {obj.name: obj}),
    )


@cache
def ideal() -> TwinParameters:
    hand = cell_and_hand()[1]
    return draw_twin(0, len(hand.joint_names), len(hand.actuators), IDEAL)


def deploy(
    *observers: DeploymentObserver,
    until: Until = "lift",
    spoil: Callable[[Any], object] = lambda world: None,
    switch: StopSwitch | None = None,
    row: int = ROW,
    **options: Any,
) -> DeploymentResult:
    """The built-in grasp on an ideal twin, without a clock. spoil: called with the twin's world."""
    told = Told(connected=lambda robot: spoil(robot.clock._world))  # pyright: ignore[reportAttributeAccessIssue]
    what = task(until=until, row=row, **options)
    return deploy_on_twin(what, placed(row), ideal(), [told, *observers], switch=switch)

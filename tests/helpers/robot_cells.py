"""Small twins for the tests of robots and deployment."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from ideal_twin import IDEAL

from fungrasp.deployment.deployment import DeploymentSettings
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.preparation import GraspPreparer
from fungrasp.deployment.twin_deployment import TwinOutcome, deploy_on_twin, reachable_placement
from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_objects
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.retargeting import retarget
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.twin.parameters import draw_twin

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
    grasp, thing = grasp_and_object(row)
    return reachable_placement(cell, hand, thing, grasp)


@cache
def near_cell(row: int = ROW) -> RobotCell:
    """The cell with the arm where the plan begins: less to simulate."""
    cell, hand = cell_and_hand()
    grasp, thing = grasp_and_object(row)
    preparer = GraspPreparer(cell, hand, thing, MotionPlanner(hand, {thing.name: thing}))
    start = preparer.prepare(grasp, placed(row), np.array(cell.arm.home)).reach.start
    return replace(cell, arm=replace(cell.arm, home=tuple(start.tolist())))


def deploy(
    *,
    until: Phase = Phase.HOLD,
    speed: float = 1.0,
    policy: Any = None,
    cell: RobotCell | None = None,
    attempts: int = 1,
    row: int = ROW,
    **options: Any,
) -> TwinOutcome:
    """The built-in grasp on an ideal twin, without a clock."""
    _, hand = cell_and_hand()
    grasp, thing = grasp_and_object(row)
    truth = draw_twin(0, len(hand.joint_names), len(hand.actuators), IDEAL)
    return deploy_on_twin(
        cell or near_cell(row),
        hand,
        thing,
        grasp,
        placed(row),
        policy or OpenLoopPolicy(),
        MotionPlanner(hand, {thing.name: thing}),
        truth,
        settings=DeploymentSettings(look_time=0.3, until=until, attempts=attempts, speed=speed),
        **options,
    )

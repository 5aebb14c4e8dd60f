"""``plan``: the motions that a policy would follow, in the open."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionSettings
from fungrasp.planning.selection import SelectionSettings
from fungrasp.policies.registry import REFERENCE, make_planner
from fungrasp.sim2real import ProtocolName
from fungrasp.simulation import build_scene
from fungrasp.task import GraspPlan, LiftEnvironment

TOGETHER = 128
"""Grasps planned together."""


def plan(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    policy: str = REFERENCE,
    *,
    protocol: ProtocolName = "nominal",
    rollouts: bool = True,
    for_use: bool = False,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[float], None] = lambda done: None,
) -> GraspPlan:
    """Plan grasps as the lift test does: objects settle in nominal worlds, then the policy's planner makes
    the motion of each grasp, or selects one of many.

    Args:
        robot: N grasps.
        objects: each object of the grasps, by name.
        policy: whose planner it is: a name or a file (``fungrasp.policies.policy_files``).
        protocol: what rollouts are to expect of the worlds.
        rollouts: whether a planner that chooses among candidates tries them in simulation.
        for_use: whether the use motions of the grasps' tasks count.
        seed: of everything that the planner draws.
        threads: 0 means all processors. The plans do not depend on it.
        progress: called with the number of grasps that are planned, fractions included.

    Returns:
        N plans; world frame where a plan's field does not say otherwise.

    Raises:
        FungraspError: no such hand or policy, or one for another hand.
    """
    hand = robot.load_hand()
    selection = SelectionSettings.for_protocol(protocol, rollouts, for_use)
    motions = MotionSettings(for_use=for_use)
    planner = make_planner(policy, hand, objects, selection, threads=threads, motions=motions)
    scene, parts = build_scene(hand, objects), []
    for first in range(0, len(robot), TOGETHER):
        some = robot.select(np.arange(first, min(first + TOGETHER, len(robot))))
        belief = LiftEnvironment(scene, len(some), threads=threads).settle(some)
        parts.append(planner.plan(some, belief, seed, lambda done, before=first: progress(before + done)))
    return GraspPlan.join(parts)

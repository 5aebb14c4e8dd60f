"""What is planned from, after an attempt has failed: the object where it lies now."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import table_below
from fungrasp.task import Belief, GraspPlan, LiftProtocol
from fungrasp.task.attempt_judge import lowest_height
from fungrasp.task.start_pose import StartPoses, start_fingers

ATTEMPT_SEEDS = 1_000_003
"""Added to the seed of a plan for each further attempt: a prime far from the seeds that people give, so that
other variations are tried than those of which one has failed."""
LEAST_EXPECTED = 0.1
"""A plan of which less is expected is not tried: it knocks the object away."""
FALLEN = 0.03
"""An object whose lowest point is farther than this from where it was at rest before [m] is not on the table
any more: an estimated pose is off by less."""
FARTHEST = 0.4
"""An object that lies farther than this from where it was at first [m] is given up: an arm's reach about the
middle of its workspace."""


def within_reach(
    object_pose: np.ndarray, first: np.ndarray, names: list[str], objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """Whether objects lie on the table, near to where they were at first, shape [N] bool.

    Args:
        object_pose: where they are seen, world frame, shape [N, 7].
        first: where they were at first, world frame, shape [N, 7].
        names: of the objects, length N.
        objects: by name.
    """
    models = [objects[name] for name in names]
    above = lowest_height(models, object_pose) - lowest_height(models, first)
    away = np.linalg.norm(object_pose[:, :2] - first[:, :2], axis=1)
    return (np.abs(above) < FALLEN) & (away < FARTHEST)


def worth_trying(plan: GraspPlan) -> np.ndarray:
    """Whether enough is expected of plans, as far as the planner says, shape [N] bool."""
    if plan.expected_success is None:
        return np.ones(len(plan), dtype=bool)
    return plan.expected_success >= LEAST_EXPECTED


def next_belief(
    belief: Belief,
    object_pose: np.ndarray,
    grasps: RobotGraspSet,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    protocol: LiftProtocol,
) -> Belief:
    """The belief for another attempt, with the hand at its new start.

    Args:
        belief: of the attempt before, N rows.
        object_pose: where the objects lie now, world frame, shape [N, 7].
        grasps: N grasps.
        hand: of the grasps.
        objects: by name.
        protocol: with the start.
    """
    names = grasps.object_name.tolist()
    fingers = start_fingers(hand, grasps, protocol.start_closing)
    table = table_below(names, object_pose, belief.table_height, objects)
    present = sorted(set(names))
    index = np.array([present.index(name) for name in names])
    starts = StartPoses(hand, [objects[name] for name in present])
    start, _ = starts.facing(grasps, index, object_pose, protocol.start_distance, fingers, table)
    return replace(belief, object_pose=object_pose, palm_pose=start, joint_positions=fingers)

"""Several attempts at a grasp: the loop that simulated worlds and robots share, and what another attempt is
planned from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

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
NOT_WORTH_TRYING = "no plan for it as it lies now is likely to succeed"
FALLEN = 0.03
"""An object whose lowest point is farther than this from where it was at rest before [m] is not on the table
any more: an estimated pose is off by less."""
FARTHEST = 0.4
"""An object that lies farther than this from where it was at first [m] is given up: an arm's reach about the
middle of its workspace."""


class AttemptCarrier(Protocol):
    """Carries out what attempts consist of, in W worlds: simulated ones, or the one of a robot. Worlds are
    given by their numbers, ``ids``, shape [I]; attempts by theirs, 0 for the first."""

    def attempt(self, ids: np.ndarray, number: int) -> np.ndarray:
        """Grasp, lift and hold. Gives whether the object is seen not to be held then, shape [I] bool."""
        ...

    def withdraw(self, ids: np.ndarray, number: int) -> None:
        """Let go and move the hand off the object, after the attempt of this number."""
        ...

    def look(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where objects rest. Gives the worlds where they do, shape [J], and their poses there, world frame,
        shape [J, 7]."""
        ...

    def plan(self, ids: np.ndarray, object_pose: np.ndarray, number: int) -> np.ndarray:
        """Plan the attempt of this number for objects where they lie, world frame, shape [I, 7], and be ready
        for it. Gives the worlds where that could be done, shape [J]."""
        ...

    def give_up(self, ids: np.ndarray, why: str) -> None:
        """Told of worlds where no further attempt is made though it was allowed, and why, as a phrase."""
        ...


def make_attempts(
    carrier: AttemptCarrier,
    most: int,
    first: np.ndarray,
    names: list[str],
    objects: Mapping[str, ObjectModel],
) -> None:
    """Attempt, and try again where the object is seen not to be held and lies within reach.

    Args:
        carrier: of the attempts, for W worlds.
        most: attempts, 1 or more.
        first: where the objects rested before the first attempt, world frame, shape [W, 7].
        names: of the objects, length W.
        objects: by name.
    """
    ids = np.arange(len(names))
    for number in range(most):
        ids = ids[carrier.attempt(ids, number)]
        if not len(ids):
            return
        carrier.withdraw(ids, number)
        if number + 1 == most:
            return
        resting, pose = carrier.look(ids)
        carrier.give_up(np.setdiff1d(ids, resting), "the object does not come to rest")
        near = within_reach(pose, first[resting], [names[i] for i in resting], objects)
        carrier.give_up(resting[~near], "the object is not within reach on the table any more")
        if not near.any():
            return
        ids = carrier.plan(resting[near], pose[near], number + 1)
        if not len(ids):
            return


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
    if not names:
        return np.zeros(0, dtype=bool)
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

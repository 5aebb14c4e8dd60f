"""The function ``plan``, and planners by policy name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fungrasp.core.progress import ShowProgress, shown_progress
from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import MotionPlanner, MotionSettings
from fungrasp.planning.planner import Planner
from fungrasp.planning.selection.search import SearchPlanner
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.policies import OpenLoopPolicy, policy_source
from fungrasp.policies.checkpoint.checkpoint_file import load_policy, read_card
from fungrasp.policies.registry import REFERENCE
from fungrasp.policies.residual_policy import check_card, residual_policy
from fungrasp.retargeting.robot_grasps import as_robot_grasps
from fungrasp.sim2real import ProtocolName
from fungrasp.simulation import build_scene
from fungrasp.task import GraspPlan, LiftEnvironment, LiftProtocol, Policy

BATCH = 128
"""Grasps planned at once, to limit memory."""


def plan(
    grasps: AnyGrasps,
    objects: Objects = None,
    policy: str = REFERENCE,
    *,
    hand: Hand | str | None = None,
    protocol: ProtocolName = "nominal",
    rollouts: bool = True,
    for_use: bool = False,
    other_places: bool = False,
    seed: int = 0,
    threads: int = 0,
    progress: ShowProgress = None,
) -> GraspPlan:
    """Plan grasps as in the lift test: objects settle in nominal worlds, then the policy's planner makes or
    selects one motion per grasp.

    Args:
        grasps: N robot grasps, or human grasps, which are retargeted first; a set or a single one.
        objects: objects of the grasps, as for ``retarget``.
        policy: name or file of the policy that will follow the plans (``fungrasp.policies.policy_source``).
        hand: hand for human grasps; allegro if None.
        protocol: protocol of the rollouts' randomization.
        rollouts: whether candidates are tested in simulation, if the planner has several.
        for_use: whether plans should also withstand the use motion of the task.
        other_places: if no plan holds the object as shown, allow one that holds it in another way.
        seed: random seed.
        threads: 0 for all processors. Plans do not depend on it.
        progress: called with the number of planned grasps, fractions included. True or False: a progress bar
            or none. None: a bar in terminals and notebooks.

    Returns:
        N plans, for ``evaluate`` and ``deploy`` (``plans=``) and ``view``.

    Raises:
        FungraspError: unknown hand or policy, or a policy for another hand.
    """
    robot, known, used, _ = as_robot_grasps(grasps, objects, hand, threads)
    selection = SelectionSettings.for_protocol(protocol, rollouts, for_use, other_places)
    planner = make_planner(policy, used, known, selection, threads=threads)
    scene, parts = build_scene(used, known), []
    with shown_progress(progress, "planning", len(robot)) as show:
        for first in range(0, len(robot), BATCH):
            some = robot.select(np.arange(first, min(first + BATCH, len(robot))))
            belief = LiftEnvironment(scene, len(some), threads=threads).settle(some)
            parts.append(planner.plan(some, belief, seed, lambda done, before=first: show(before + done)))
    return GraspPlan.join(parts)


def make_planner(
    name: str,
    hand: Hand | str | Path,
    objects: Mapping[str, ObjectModel],
    settings: SelectionSettings | None = None,
    protocol: LiftProtocol | None = None,
    threads: int = 0,
    motions: MotionSettings | None = None,
) -> Planner:
    """Make the planner of a policy.

    Args:
        name: name of the policy, as for ``policy_source``.
        hand: robot hand, its name, or the path of its TOML file.
        settings: defaults if None.
        protocol: published protocol if None.
        threads: 0 for all processors. Plans do not depend on it.
        motions: defaults if None.

    Raises:
        FungraspError: hand or policy is unknown, or the policy is for another hand.
    """
    hand = as_hand(hand)
    source = policy_source(name, hand.name)
    if not source.searches:
        return MotionPlanner(hand, objects, motions, protocol)
    policy: Policy = OpenLoopPolicy()
    if source.network is not None:
        check_card(read_card(source.network), hand)
        made = residual_policy(load_policy(source.network), hand, objects)
        policy = made  # pyright: ignore[reportAssignmentType]
    return SearchPlanner(hand, objects, policy, source.digest, settings, protocol, threads, motions)

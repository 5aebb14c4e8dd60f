"""The verb ``plan``, and planners by the names of the policies that follow their plans."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.core.progress import ShowProgress, shown_progress
from fungrasp.grasps.grasp_arguments import AnyGrasps, Objects
from fungrasp.hands import Hand
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
"""Grasps planned together. It bounds the memory."""


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
    """Plan grasps as the lift test does: objects settle in nominal worlds, then the policy's planner makes
    the motion of each grasp, or selects one of many.

    Args:
        grasps: N grasps of a robot hand or of people, which are retargeted first; a set or one alone.
        objects: their objects, as for ``retarget``.
        policy: whose planner it is: a name or a file (``fungrasp.policies.policy_source``).
        hand: of human grasps, allegro if None.
        protocol: what rollouts are to expect of the worlds.
        rollouts: whether a planner that chooses among candidates tries them in simulation.
        for_use: whether the use motions of the grasps' tasks count.
        other_places: whether a plan may hold the object otherwise than the person where none as shown holds.
        seed: of everything that the planner draws.
        threads: 0 means all processors. The plans do not depend on it.
        progress: called with the number of grasps that are planned, fractions included; True, False: a bar,
            none; a bar in terminals and notebooks if None.

    Returns:
        N plans, which ``evaluate`` and ``deploy`` take as ``plans=`` and ``view`` shows.

    Raises:
        FungraspError: no such hand or policy, or one for another hand.
    """
    robot, known, used, _ = as_robot_grasps(grasps, objects, hand, threads)
    selection = SelectionSettings.for_protocol(protocol, rollouts, for_use, other_places)
    motions = MotionSettings(for_use=for_use)
    planner = make_planner(policy, used, known, selection, threads=threads, motions=motions)
    scene, parts = build_scene(used, known), []
    with shown_progress(progress, "planning", len(robot)) as show:
        for first in range(0, len(robot), BATCH):
            some = robot.select(np.arange(first, min(first + BATCH, len(robot))))
            belief = LiftEnvironment(scene, len(some), threads=threads).settle(some)
            parts.append(planner.plan(some, belief, seed, lambda done, before=first: show(before + done)))
    return GraspPlan.join(parts)


def make_planner(
    name: str,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    settings: SelectionSettings | None = None,
    protocol: LiftProtocol | None = None,
    threads: int = 0,
    motions: MotionSettings | None = None,
) -> Planner:
    """The planner whose plans a policy follows.

    Args:
        name: of the policy, as for ``policy_source``.
        settings: of the selection among candidates; the defaults if None.
        protocol: of the motions; the published one if None.
        threads: 0 means all processors. Plans do not depend on it.
        motions: how grasps are adapted, approached, closed and lifted; the defaults if None.

    Raises:
        FungraspError: no such policy, or one for another hand.
    """
    source = policy_source(name, hand.name)
    if not source.searches:
        return MotionPlanner(hand, objects, motions, protocol)
    policy: Policy = OpenLoopPolicy()
    if source.network is not None:
        check_card(read_card(source.network), hand)
        made = residual_policy(load_policy(source.network), hand, objects)
        policy = made  # pyright: ignore[reportAssignmentType]
    return SearchPlanner(hand, objects, policy, source.digest, settings, protocol, threads, motions)

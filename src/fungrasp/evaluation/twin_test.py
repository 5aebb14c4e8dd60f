"""The lift test on twins, without a clock: what identification and gravity compensation are worth (Table VI
of the paper)."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fungrasp.deployment.deployment import DeploymentSettings
from fungrasp.deployment.preparation import HandDynamics, UnreachableError
from fungrasp.deployment.twin_deployment import deploy_on_twin, reachable_placement
from fungrasp.errors import FungraspError
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import Planner
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.twin.parameters import TwinParameters, TwinSpread, draw_twin
from fungrasp.robots.twin.twin_model import TwinPhysics
from fungrasp.task import Belief, GraspPlan, Policy

Identify = Callable[[TwinParameters], HandDynamics]
"""What is known of the hand's dynamics of a twin."""


@dataclass(frozen=True)
class TwinVariant:
    """A way to deploy."""

    name: str
    """Name in results."""
    compensate: bool = True
    """Whether the hand's weight is carried."""
    identified: bool = True
    """Whether planner and robot know the identified dynamics of the hand."""


VARIANTS = (
    TwinVariant("ours"),
    TwinVariant("no identification", identified=False),
    TwinVariant("no gravity compensation", compensate=False),
)
"""The columns of Table VI."""


@dataclass(frozen=True)
class TwinEpisode:
    """One grasp on one twin."""

    index: int
    """Row of the grasp in its file."""
    object: str
    """Name of the object."""
    twin: int
    """Which twin."""
    variant: str
    """How it was deployed."""
    success: bool
    """Whether the object was lifted and held."""
    height_m: float
    """Least height during the hold [m]; -1 where there was none."""
    fault: str
    """Why the robot stopped, "" if it did not."""


class _RememberingPlanner:
    """Plans of one grasp: variants that know the same are planned once."""

    def __init__(self, planner: Planner):
        self._planner = planner
        self._plans: dict[tuple[int, bytes], GraspPlan] = {}

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """See ``Planner.plan``."""
        key = seed, pickle.dumps(belief)
        if key not in self._plans:
            self._plans[key] = self._planner.plan(grasps, belief, seed, progress)
        return self._plans[key]


def try_on_twins(
    grasps: RobotGraspSet,
    index: Sequence[int],
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    cell: RobotCell,
    policy: Policy,
    planner: Planner,
    twins: Sequence[int],
    variants: Sequence[TwinVariant] = VARIANTS,
    *,
    identify: Identify | None = None,
    spread: TwinSpread | None = None,
    physics: TwinPhysics | None = None,
) -> Iterator[TwinEpisode]:
    """Try each grasp once on each twin in each variant. What no placement makes reachable is left out.

    The arm begins where the plan does, and the object is not put down afterwards; all else is as on a robot.

    Args:
        grasps: of ``hand``.
        index: row of each in its file.
        objects: by name.
        hand: on the arm.
        cell: the robot.
        policy: what acts.
        planner: of the policy.
        twins: seeds of their true parameters.
        variants: ways to deploy.
        identify: what is known of the dynamics of a twin; needed by variants that use it.
        spread: of the twins; the default if None.
        physics: of the twins; the default if None.
    """
    known: dict[int, HandDynamics] = {}
    for row, number in enumerate(index):
        grasp = grasps.select(np.array([row]))
        thing = objects[grasp.object_name[0]]
        try:
            placement, start = reachable_placement(cell, hand, thing, grasp)
        except UnreachableError:
            continue
        remembering = _RememberingPlanner(planner)
        near = replace(cell, arm=replace(cell.arm, home=tuple(start.tolist())))
        for twin in twins:
            truth = draw_twin(twin, len(hand.joint_names), len(hand.actuators), spread)
            for variant in variants:
                dynamics = None
                if variant.identified:
                    if identify is None:
                        raise FungraspError(f"the variant '{variant.name}' needs identified dynamics")
                    if twin not in known:
                        known[twin] = identify(truth)
                    dynamics = known[twin]
                try:
                    outcome = deploy_on_twin(
                        near,
                        hand,
                        thing,
                        grasp,
                        placement,
                        policy,
                        remembering,
                        truth,
                        dynamics=dynamics,
                        compensate=variant.compensate,
                        physics=physics,
                        settings=DeploymentSettings(look_time=0.4, put_down=False),
                    )
                except UnreachableError as error:
                    yield TwinEpisode(number, thing.name, twin, variant.name, False, -1.0, str(error)[:80])
                    continue
                height = outcome.height if np.isfinite(outcome.height) else -1.0
                fault = outcome.result.fault
                yield TwinEpisode(number, thing.name, twin, variant.name, outcome.success, height, fault)


def told_dynamics(hand: Hand) -> Identify:
    """The true stiffness and damping of twins, for comparison: an identification without error."""
    driven = [hand.joint_names.index(name) for name in hand.actuators]

    def identify(truth: TwinParameters) -> HandDynamics:
        stiffness = np.ones(len(hand.joint_names))
        stiffness[driven] = truth.stiffness
        return HandDynamics(truth.damping, stiffness, stiffness.copy())

    return identify


def episode_rows(episodes: Sequence[TwinEpisode]) -> list[dict[str, Any]]:
    """Rows of a result file."""
    return [asdict(episode) for episode in episodes]

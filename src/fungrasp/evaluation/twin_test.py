"""The lift test on twins, without a clock: what identification and gravity compensation are worth (Table VI
of the paper)."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from typing import Any

import numpy as np

from fungrasp.deployment.deployment import DeploymentSettings
from fungrasp.deployment.hand_knowledge import HandDynamics
from fungrasp.deployment.preparation import UnreachableError
from fungrasp.deployment.twin_deployment import deploy_on_twin, reachable_placement
from fungrasp.errors import FungraspError
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import ConstrainedPlanner, Planner
from fungrasp.planning.selection import Feasible
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.twin.parameters import TwinParameters, TwinSpread, cell_twin
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
    tracking_rad: float
    """RMS error of the hand's joints before the fingers close [rad]; -1 where the motion did not begin."""
    sag_rad: float
    """Largest mean error of a joint over the same time [rad]; -1 where the motion did not begin."""


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

    def plan_within(
        self, grasps: RobotGraspSet, belief: Belief, feasible: Feasible, seed: int = 0
    ) -> GraspPlan:
        """See ``ConstrainedPlanner.plan_within``: what is feasible is the same in all variants."""
        if not isinstance(self._planner, ConstrainedPlanner):
            return self.plan(grasps, belief, seed)
        key = seed, pickle.dumps(belief)
        if key not in self._plans:
            self._plans[key] = self._planner.plan_within(grasps, belief, feasible, seed)
        return self._plans[key]


@dataclass(frozen=True, eq=False)
class PlacedGrasp:
    """A grasp that the arm can reach with the object where a person would put it."""

    number: int
    """Row of the grasp in its file."""
    grasp: RobotGraspSet
    """One grasp."""
    placement: np.ndarray
    """Where the object is put, world frame, shape [7]; it settles."""


def placed_grasps(
    grasps: RobotGraspSet,
    index: Sequence[int],
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    cell: RobotCell,
    each: int | None = None,
) -> tuple[list[PlacedGrasp], list[int]]:
    """The grasps that the arm can reach from some placement of the object, the first of every object before
    the second of any.

    Args:
        grasps: of ``hand``.
        index: row of each in its file.
        objects: by name.
        hand: on the arm.
        cell: the robot.
        each: of each object the first so many that can be reached; all if None.

    Returns:
        them, and the rows of those that were tried and can't be reached.
    """
    placed: dict[str, list[PlacedGrasp]] = {}
    beyond: list[int] = []
    for row, number in enumerate(index):
        grasp = grasps.select(np.array([row]))
        mine = placed.setdefault(grasp.object_name[0], [])
        if each is not None and len(mine) >= each:
            continue
        try:
            where = reachable_placement(cell, hand, objects[grasp.object_name[0]], grasp)
        except UnreachableError:
            beyond.append(number)
            continue
        mine.append(PlacedGrasp(number, grasp, where))
    turns = zip_longest(*placed.values())
    return [one for turn in turns for one in turn if one is not None], beyond


def try_on_twins(
    placed: Sequence[PlacedGrasp],
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    cell: RobotCell,
    policy: Policy,
    planner: Planner,
    twins: Sequence[int],
    variants: Sequence[TwinVariant] = VARIANTS,
    *,
    in_turn: bool = False,
    identify: Identify | None = None,
    spread: TwinSpread | None = None,
    physics: TwinPhysics | None = None,
) -> Iterator[TwinEpisode]:
    """Try each grasp once on each twin in each variant.

    The object is not put down afterwards; all else is as on a robot.

    Args:
        placed: grasps of ``hand`` and where the objects are put.
        objects: by name.
        hand: on the arm.
        cell: the robot.
        policy: what acts.
        planner: of the policy.
        twins: seeds of their true parameters.
        variants: ways to deploy.
        in_turn: each grasp on one of the twins, in turn, in place of all.
        identify: what is known of the dynamics of a twin; needed by variants that use it.
        spread: of the twins; the default if None.
        physics: of the twins; the default if None.
    """
    known: dict[int, HandDynamics] = {}
    for row, one in enumerate(placed):
        thing = objects[one.grasp.object_name[0]]
        remembering = _RememberingPlanner(planner)
        for twin in [twins[row % len(twins)]] if in_turn else twins:
            truth = cell_twin(cell, hand, twin, spread)
            for variant in variants:
                dynamics = None
                if variant.identified:
                    if identify is None:
                        raise FungraspError(f"the variant '{variant.name}' needs identified dynamics")
                    if twin not in known:
                        known[twin] = identify(truth)
                    dynamics = known[twin]
                name = one.number, thing.name, twin, variant.name
                try:
                    outcome = deploy_on_twin(
                        cell,
                        hand,
                        thing,
                        one.grasp,
                        one.placement,
                        policy,
                        remembering,
                        truth,
                        dynamics=dynamics,
                        compensate=variant.compensate,
                        physics=physics,
                        settings=DeploymentSettings(look_time=0.4, put_down=False),
                        advise=False,
                    )
                except UnreachableError as error:
                    yield TwinEpisode(*name, False, -1.0, str(error)[:80], -1.0, -1.0)
                    continue
                height, tracking, sag = (
                    value if np.isfinite(value) else -1.0
                    for value in (outcome.height, outcome.tracking, outcome.sag)
                )
                fault = outcome.result.fault
                yield TwinEpisode(*name, outcome.success, height, fault, tracking, sag)


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

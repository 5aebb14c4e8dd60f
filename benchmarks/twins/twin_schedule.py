"""Which grasps are tried on which twins, and in what order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from benchmarks.twins.twin_episode import (
    PlacedGrasp,
    RememberingPlanner,
    TwinEpisode,
    TwinSetup,
    TwinVariant,
)
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.identified_dynamics import HandDynamics
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.robots.twin.parameters import TwinParameters, TwinSpread, cell_twin

Identify = Callable[[TwinParameters], HandDynamics]
"""What is known of the hand's dynamics of a twin."""


class GraspSource(Protocol):
    """Grasps of which each is made when its turn comes, such as those in images: most may not be needed."""

    @property
    def hand(self) -> str:
        """Name of the hand that they are of."""
        ...

    @property
    def numbers(self) -> Sequence[int]:
        """Of each in results."""
        ...

    @property
    def names(self) -> Sequence[str]:
        """Name of the object of each."""
        ...

    def take(self, row: int) -> RobotGraspSet | None:
        """One grasp; None where it turns out to be none. row: which."""
        ...

    @property
    def about(self) -> Mapping[str, Any]:
        """What the header of a result says of those that were taken so far."""
        ...


@dataclass(frozen=True, eq=False)
class KnownGrasps:
    """``GraspSource`` of grasps that are known already."""

    grasps: RobotGraspSet
    """N of them."""
    numbers: Sequence[int]
    """Of each in results, N."""

    @property
    def hand(self) -> str:
        """See ``GraspSource``."""
        return self.grasps.hand

    @property
    def names(self) -> Sequence[str]:
        """See ``GraspSource``."""
        return self.grasps.object_name.tolist()

    def take(self, row: int) -> RobotGraspSet:
        """See ``GraspSource.take``."""
        return self.grasps.select(np.array([row]))

    @property
    def about(self) -> Mapping[str, Any]:
        """See ``GraspSource``."""
        return {}


def placed_grasps(
    setup: TwinSetup, source: GraspSource, per_object: int | None = None
) -> Iterator[PlacedGrasp]:
    """Look for a placement of the object of every grasp, as they are asked for: the first grasp of every
    object that can be reached comes before the second of any.

    Args:
        setup: of the test.
        source: of grasps of its hand.
        per_object: of each object the first so many that can be reached; all if None.

    Yields:
        the grasps that were tried, in each of their places, those out of reach included.
    """
    waiting: dict[str, deque[int]] = {}
    for row, name in enumerate(source.names):
        waiting.setdefault(name, deque()).append(row)
    for _ in range(len(source.names) if per_object is None else per_object):
        for rows in waiting.values():
            while rows:
                row = rows.popleft()
                grasp = source.take(row)
                if grasp is None:
                    continue
                placed = setup.place(source.numbers[row], grasp)
                yield from placed
                if len(placed[0].placements):
                    break


def try_on_twins(
    setup: TwinSetup,
    placed: Iterable[PlacedGrasp],
    twins: Sequence[int],
    variants: Sequence[TwinVariant],
    *,
    in_turn: bool = False,
    identify: Identify | None = None,
    spread: TwinSpread | None = None,
) -> Iterator[TwinEpisode]:
    """Try each grasp once on each twin in each variant.

    Every grasp is tried on one of the twins, in turn, before any is tried on its next one, so that what a
    stopped run has done is balanced. The object is not put down afterwards; all else is as on a robot.

    Args:
        setup: of the test.
        placed: grasps, and where the objects are put; those out of reach are passed over.
        twins: seeds of their true parameters.
        variants: ways to deploy.
        in_turn: each grasp on one of the twins, in turn, in place of all.
        identify: what is known of the dynamics of a twin; needed by variants that use it.
        spread: of the twins; the default if None.

    Raises:
        FungraspError: a variant needs ``identify``.
    """
    for variant in variants:
        if variant.identified and identify is None:
            raise FungraspError(f"the variant '{variant.name}' needs identified dynamics")
    known: dict[int, HandDynamics] = {}
    for one, twin in _turns(placed, twins, 1 if in_turn else len(twins)):
        truth = cell_twin(setup.cell, setup.hand, twin, spread)
        planner = RememberingPlanner(setup.planner)
        for variant in variants:
            dynamics = None
            if variant.identified and identify is not None:
                if twin not in known:
                    known[twin] = identify(truth)
                dynamics = known[twin]
            yield setup.run(one, twin, truth, variant, dynamics, planner)


def _turns(
    placed: Iterable[PlacedGrasp], twins: Sequence[int], turns: int
) -> Iterator[tuple[PlacedGrasp, int]]:
    """Grasps within reach, each with a twin: in every turn each grasp with another one."""
    reached: list[PlacedGrasp] = []
    for one in placed:
        if len(one.placements):
            yield one, twins[len(reached) % len(twins)]
            reached.append(one)
    for turn in range(1, turns):
        for row, one in enumerate(reached):
            yield one, twins[(row + turn) % len(twins)]


def given_dynamics(hand: Hand) -> Identify:
    """The true stiffness and damping of twins, for comparison: an identification without error."""
    driven = [hand.joint_names.index(name) for name in hand.actuators]

    def identify(truth: TwinParameters) -> HandDynamics:
        stiffness = np.ones(len(hand.joint_names))
        stiffness[driven] = truth.stiffness
        return HandDynamics(truth.damping, stiffness, stiffness.copy())

    return identify

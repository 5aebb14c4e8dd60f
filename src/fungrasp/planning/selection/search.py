"""Of many variations of a grasp, the one that holds best: a learned critic names the promising plans, and
rehearsals decide between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import digest
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import table_height
from fungrasp.planning.references import References
from fungrasp.planning.selection.candidates import Start, propose
from fungrasp.planning.selection.rollouts import Actor, RehearsalSettings, Rounds, blind, rehearse
from fungrasp.planning.selection.variations import Spread, with_settings
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.policies.residual_policy import LearnedPolicy
from fungrasp.task import Action, LiftTask, Protocol
from fungrasp.transfer import Differences

WIDE = Spread(position=0.015, rotation=0.2, joints=0.1, closing=0.15, force=0.5, press=0.02)


@dataclass(frozen=True)
class SearchSettings:
    """Of looking further where nothing holds: the best plans are varied again."""

    most: int = 3
    """Times that plans are varied again."""
    enough: float = 0.6
    """Expected success from which a plan is good enough."""
    parents: int = 3
    """Best plans of a grasp that are varied, and kept beside the new ones."""
    spread: Spread = WIDE
    """Of the variations."""
    rounds: Rounds = ((27, 1), (8, 2), (3, 3))
    """Of the rehearsal of old and new plans."""


@dataclass(frozen=True)
class ChoiceSettings:
    """How many variations to choose from, and how."""

    tries: int = 24
    """Plans of each grasp that are made together, the unchanged one included."""
    rehearsal: RehearsalSettings | None = field(default_factory=RehearsalSettings)
    """Trials that decide between the most promising; the critic alone decides if None."""
    rounds: Rounds = ((12, 1), (6, 2), (3, 3))
    """Of the rehearsal."""
    prior: float = 4.0
    """Trials that the critic's expectation stands for."""
    search: SearchSettings = field(default_factory=SearchSettings)
    """Where the rehearsal has found nothing that holds."""
    chunk: int = 512
    """Plans made together."""

    def __post_init__(self) -> None:
        if min(self.tries, self.search.parents) < 1:
            raise FungraspError(f"there must be at least one plan to choose from, not {self}")
        for rounds in (self.rounds, self.search.rounds):
            if not rounds or min(number for pair in rounds for number in pair) < 1:
                raise FungraspError(f"a rehearsal needs rounds of at least one plan and trial, not {rounds}")


class Planner:
    """Chooses plans for tasks, and remembers what it has chosen."""

    def __init__(self, settings: ChoiceSettings | None = None, threads: int = 0):
        """
        Args:
            settings: the defaults if None.
            threads: 0 means all processors. The choice does not depend on it.
        """
        self.settings, self._threads = settings or ChoiceSettings(), threads
        self._known: dict[str, tuple[References, np.ndarray]] = {}

    def __call__(
        self,
        task: LiftTask,
        objects: Mapping[str, ObjectModel],
        critic: PolicyNetwork,
        seed: int = 0,
        policy: PolicyNetwork | None = None,
    ) -> tuple[References, np.ndarray]:
        """As ``choose_references``, for each world of a task that has been reset."""
        table = table_height(task.grasps.object_name.tolist(), task.settled_pose, objects)
        start = Start.of(task, table)
        keys = [
            self._key(start.select(np.array([i])), task, objects, critic, seed, policy)
            for i in range(len(start))
        ]
        fresh = np.flatnonzero([key not in self._known for key in keys])
        if len(fresh):
            plans, expected = choose_references(
                start.select(fresh),
                task.scene.hand,
                objects,
                critic,
                self.settings,
                seed,
                self._threads,
                policy,
                task.protocol,
            )
            for i, row in enumerate(fresh):
                self._known[keys[row]] = plans.select(np.array([i])), expected[i]
        found, value = zip(*(self._known[key] for key in keys), strict=True)
        return References.join(found).raised(table), np.array(value)

    @staticmethod
    def _key(
        start: Start,
        task: LiftTask,
        objects: Mapping[str, ObjectModel],
        critic: PolicyNetwork,
        seed: int,
        policy: PolicyNetwork | None,
    ) -> str:
        """All that the choice for one grasp depends on."""
        grasps = start.grasps
        return digest(
            seed,
            critic.card.sha256,
            "" if policy is None else policy.card.sha256,
            {name: getattr(grasps, name) for name in grasps.FIELDS},
            grasps.extra,
            objects[grasps.object_name[0]].digest,
            (start.settled_pose, start.palm, start.fingers),
            task.protocol,
        )


def choose_references(
    start: Start,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    critic: PolicyNetwork,
    settings: ChoiceSettings | None = None,
    seed: int = 0,
    threads: int = 0,
    policy: PolicyNetwork | None = None,
    protocol: Protocol | None = None,
) -> tuple[References, np.ndarray]:
    """Plan variations of each grasp, rehearse the most promising, and keep the best.

    All grasps are varied in the same ways, so that the choice for one does not depend on the others.

    Args:
        start: what the grasps are planned from.
        hand: of the grasps.
        objects: by name.
        critic: a policy file of the kind "critic", made for the hand.
        settings: the defaults if None.
        seed: of the variations and rehearsals.
        threads: of the rehearsals; 0 means all processors.
        policy: that will follow the plans, and rehearses them; they are rehearsed blindly if None.
        protocol: of the motions; the published one if None.

    Returns:
        One reference for each grasp; the success expected of it, shape [N].

    Raises:
        FungraspError: the critic was made for another hand or other features.
    """
    s = settings or ChoiceSettings()
    everyone = np.arange(len(start))
    plan = partial(
        propose,
        seed=seed,
        objects=objects,
        hand=hand,
        protocol=protocol or Protocol(),
        critic=critic,
        prior=s.prior,
        chunk=s.chunk,
    )
    first = with_settings(start.grasps).select(np.tile(everyone, s.tries))
    pool = plan(start, first, np.repeat(np.arange(s.tries), len(start)), 0, Spread())
    if s.rehearsal is None:
        return pool.best()
    try_plans = partial(
        rehearse,
        objects=objects,
        hand=hand,
        settings=s.rehearsal,
        threads=threads,
        actor=blind if policy is None else _follower(policy, objects),
    )
    try_plans(pool.plans, pool.tally, s.rounds, seed=(seed, 0))
    chosen, expected = pool.best()
    left, value = everyone, expected
    for search in range(1, s.search.most + 1):
        hard = np.flatnonzero(value < s.search.enough)
        if not len(hard):
            break
        left, parents = left[hard], pool.among_best(s.search.parents, hard)
        number = np.arange(s.tries)[:, None] % len(parents.tally.expected)
        rows = (number * len(left) + np.arange(len(left))).ravel()
        attempts = np.repeat(np.arange(1, s.tries + 1), len(left))
        children = plan(start.select(left), parents.grasps.select(rows), attempts, search, s.search.spread)
        pool = parents.join(children)
        try_plans(pool.plans, pool.tally, s.search.rounds, seed=(seed, search))
        found, value = pool.best()
        place = everyone.copy()
        place[left] = len(everyone) + np.arange(len(left))
        chosen = References.join([chosen, found]).select(place)
        expected[left] = value
    return chosen, expected


def _follower(policy: PolicyNetwork, objects: Mapping[str, ObjectModel]) -> Actor:
    def begin(task: LiftTask, plans: References, sensors: Differences) -> Callable[[], Action]:
        return LearnedPolicy(task, objects, policy, plans, sensors).act

    return begin

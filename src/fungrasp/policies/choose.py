"""Of many variations of a grasp, the one that holds best: a learned critic names the promising plans, and
rehearsals decide between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import digest
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.learned import LearnedPolicy
from fungrasp.policies.motion import plan_motion
from fungrasp.policies.network import PolicyNetwork
from fungrasp.policies.plan_features import plan_features
from fungrasp.policies.policy_file import check_fits
from fungrasp.policies.references import References
from fungrasp.policies.rehearse import Actor, RehearsalSettings, Rounds, Tally, blind, rehearse
from fungrasp.policies.variations import Spread, vary, with_settings
from fungrasp.task import Action, LiftTask
from fungrasp.task.observation import flatten, layout
from fungrasp.transfer import Differences


@dataclass(frozen=True)
class SearchSettings:
    """Of looking further where nothing holds: the best plans are varied again."""

    most: int = 3
    """Times that plans are varied again."""
    enough: float = 0.6
    """Expected success from which a plan is good enough."""
    parents: int = 3
    """Best plans of a grasp that are varied, and kept beside the new ones."""
    spread: Spread = field(default_factory=lambda: Spread(0.015, 0.2, 0.1, 0.15, 0.5, 0.02))
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
        """As ``choose_references``."""
        grasps = task.grasps
        key = digest(
            seed,
            critic.card.sha256,
            "" if policy is None else policy.card.sha256,
            {name: getattr(grasps, name) for name in grasps.FIELDS},
            grasps.extra,
            [objects[name].digest for name in grasps.object_name.tolist()],
            (task.settled_pose, task.set_point.pose, task.finger_set_point),
        )
        if key not in self._known:
            chosen = choose_references(task, objects, critic, self.settings, seed, self._threads, policy)
            self._known[key] = chosen
        return self._known[key]


def choose_references(
    task: LiftTask,
    objects: Mapping[str, ObjectModel],
    critic: PolicyNetwork,
    settings: ChoiceSettings | None = None,
    seed: int = 0,
    threads: int = 0,
    policy: PolicyNetwork | None = None,
) -> tuple[References, np.ndarray]:
    """Plan variations of each world's grasp, rehearse the most promising, and keep the best.

    All grasps are varied in the same ways, so that a world's choice does not depend on the others.

    Args:
        task: reset.
        objects: by name.
        critic: a policy file of the kind "critic", made for the task's hand.
        settings: the defaults if None.
        seed: of the variations and rehearsals.
        threads: of the rehearsals; 0 means all processors.
        policy: that will follow the plans, and rehearses them; they are rehearsed blindly if None.

    Returns:
        One reference for each world; the success expected of it, shape [W].

    Raises:
        FungraspError: the critic was made for another hand or other features.
    """
    s = settings or ChoiceSettings()
    worlds = np.arange(len(task.worlds))
    first = with_settings(task.grasps).select(np.tile(worlds, s.tries))
    attempts = np.repeat(np.arange(s.tries), len(worlds))
    propose = partial(_propose, task, objects, critic, s, seed)
    pool = propose(first, worlds, attempts, 0, Spread())
    if s.rehearsal is None:
        return pool.best()
    try_plans = partial(
        rehearse,
        objects=objects,
        hand=task.scene.hand,
        settings=s.rehearsal,
        threads=threads,
        actor=blind if policy is None else _follower(policy, objects),
    )
    try_plans(pool.plans, pool.tally, s.rounds, seed=(seed, 0))
    chosen, expected = pool.best()
    left, value = worlds, expected
    for search in range(1, s.search.most + 1):
        hard = np.flatnonzero(value < s.search.enough)
        if not len(hard):
            break
        left, parents = left[hard], pool.among_best(s.search.parents, hard)
        number = np.arange(s.tries)[:, None] % parents.tally.expected.shape[0]
        rows = (number * len(left) + np.arange(len(left))).ravel()
        attempts = np.repeat(np.arange(1, s.tries + 1), len(left))
        children = propose(parents.grasps.select(rows), left, attempts, search, s.search.spread)
        pool = parents.join(children)
        try_plans(pool.plans, pool.tally, s.search.rounds, seed=(seed, search))
        found, value = pool.best()
        place = worlds.copy()
        place[left] = len(worlds) + np.arange(len(left))
        chosen = References.join([chosen, found]).select(place)
        expected[left] = value
    return chosen, expected


@dataclass(frozen=True, eq=False)
class _Pool:
    """K plans of each of G grasps, those of one variation after those of another."""

    grasps: RobotGraspSet
    """As varied, K G of them."""
    plans: References
    """K G of them."""
    tally: Tally
    """Shape [K, G]."""

    def best(self) -> tuple[References, np.ndarray]:
        """The best plan of each grasp, and the success expected of it, shape [G]."""
        count = self.tally.expected.shape[1]
        best, grasps = self.tally.order[0], np.arange(count)
        return self.plans.select(best * count + grasps), self.tally.success[best, grasps]

    def among_best(self, number: int, grasps: np.ndarray) -> _Pool:
        """So many plans, the best, of some grasps."""
        best = self.tally.order[:number, grasps]
        rows = (best * self.tally.expected.shape[1] + grasps).ravel()
        return _Pool(self.grasps.select(rows), self.plans.select(rows), self.tally.select(best, grasps))

    def join(self, other: _Pool) -> _Pool:
        """With more plans of the same grasps."""
        return _Pool(
            RobotGraspSet.concatenate([self.grasps, other.grasps]),
            References.join([self.plans, other.plans]),
            self.tally.join(other.tally),
        )


def _follower(policy: PolicyNetwork, objects: Mapping[str, ObjectModel]) -> Actor:
    def begin(task: LiftTask, plans: References, sensors: Differences) -> Callable[[], Action]:
        return LearnedPolicy(task, objects, policy, plans, sensors).act

    return begin


def _propose(
    task: LiftTask,
    objects: Mapping[str, ObjectModel],
    critic: PolicyNetwork,
    s: ChoiceSettings,
    seed: int,
    grasps: RobotGraspSet,
    worlds: np.ndarray,
    attempts: np.ndarray,
    search: int,
    spread: Spread,
) -> _Pool:
    """Plans of variations.

    Args:
        task: where hands and objects are.
        objects: by name.
        critic: says what to expect.
        s: settings.
        seed: of the variations.
        grasps: to vary, those of all worlds in turn, N of them.
        worlds: of these grasps, shape [G].
        attempts: number of each variation, shape [N].
        search: another number of them.
        spread: of the variations.
    """
    hand, where = task.scene.hand, np.resize(worlds, len(grasps))
    varied = vary(grasps, hand, np.full(len(grasps), search), attempts, seed, spread)
    plans, expected = [], []
    for first in range(0, len(grasps), s.chunk):
        part = slice(first, first + s.chunk)
        rows = where[part]
        motion = plan_motion(
            hand,
            varied.select(part),
            objects,
            task.settled_pose[rows],
            task.set_point.pose[rows],
            task.finger_set_point[rows],
            protocol=task.protocol,
        )
        plans.append(References.of(motion, varied.select(part), task.settled_pose[rows], hand))
        expected.append(expect(critic, hand, plans[-1], objects, 1 / task.protocol.control_period))
    tally = Tally.untried(np.concatenate(expected).reshape(-1, len(worlds)), s.prior)
    return _Pool(varied, References.join(plans), tally)


def expect(
    critic: PolicyNetwork, hand: Hand, plans: References, objects: Mapping[str, ObjectModel], rate: float
) -> np.ndarray:
    """Expected success of plans, in [0, 1], shape [N].

    Args:
        critic: of the kind "critic".
        hand: of the plans.
        plans: N of them.
        objects: by name.
        rate: of control [Hz].
    """
    parts = plan_features(plans, objects)
    check_fits(critic.card, hand, layout(parts), (), rate)
    value, _, _ = critic(np.nan_to_num(flatten(parts)).astype(np.float32))
    return value[:, 0]

"""The best of many candidates of a grasp: a learned predictor selects the promising ones, and simulated
rollouts decide between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from fungrasp.core.files import digest
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import MotionPlanner, MotionSettings, lowered, table_below
from fungrasp.planning.selection.candidates import Candidates, VariationSpread, propose, with_settings
from fungrasp.planning.selection.rollouts import try_candidates
from fungrasp.planning.selection.settings import SelectionSettings
from fungrasp.planning.selection.success_predictor import SuccessPredictor
from fungrasp.planning.selection.use_strength import chance_of_use
from fungrasp.task import Belief, GraspPlan, LiftProtocol, Policy

Feasible = Callable[[GraspPlan], np.ndarray]
"""Says of P plans which can be carried out, a bool array of shape [P]."""

RESOLUTION = 1e-4
"""Beliefs are rounded to steps of so much [m, rad], so that what has settled anew is not planned anew."""


class SearchPlanner:
    """Plans many variations of each grasp and selects one; remembers what it has planned.

    It simulates ``settings.rollouts_per_grasp`` episodes for each grasp, in an engine of its own, never in
    the world that the plan is for.
    """

    def __init__(
        self,
        hand: Hand,
        objects: Mapping[str, ObjectModel],
        predictor: SuccessPredictor,
        policy: Policy,
        policy_digest: str = "",
        settings: SelectionSettings | None = None,
        protocol: LiftProtocol | None = None,
        threads: int = 0,
        motions: MotionSettings | None = None,
    ):
        """
        Args:
            predictor: of success, made for the hand.
            policy: what will follow the plans, and follows them in the rollouts.
            settings: the defaults if None.
            protocol: of the motions; the published one if None.
            threads: of the rollouts; 0 means all processors. The choice does not depend on it.
            motions: how candidates are approached, closed and lifted; the defaults if None.
        """
        self.settings = settings or SelectionSettings()
        self._hand, self._objects, self._threads = hand, objects, threads
        self._predictor, self._policy, self._policy_digest = predictor, policy, policy_digest
        self._single = MotionPlanner(hand, objects, motions, protocol)
        self.key = digest(predictor.digest, policy_digest, self.settings, self._single.key)
        """Digest of all that plans depend on besides the arguments of ``plan``."""
        self._known: dict[str, GraspPlan] = {}

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """See ``Planner.plan``. All grasps are varied in the same ways, so that the choice for one does not
        depend on the others."""
        names = grasps.object_name.tolist()
        table = table_below(names, belief.object_pose, belief.table_height, self._objects)
        rounded = _rounded(lowered(belief, table))
        keys = [
            self._key(grasps.select(np.array([i])), rounded.select(np.array([i])), seed)
            for i in range(len(grasps))
        ]
        fresh = np.flatnonzero([key not in self._known for key in keys])
        known = len(grasps) - len(fresh)
        progress(known)
        if len(fresh):
            planned = self._search(
                grasps.select(fresh),
                rounded.select(fresh),
                seed,
                lambda share: progress(known + share * len(fresh)),
            )
            for i, row in enumerate(fresh):
                self._known[keys[row]] = planned.select(np.array([i]))
        progress(len(grasps))
        return GraspPlan.join([self._known[key] for key in keys]).raised(table)

    def plan_within(
        self, grasps: RobotGraspSet, belief: Belief, feasible: Feasible, seed: int = 0
    ) -> GraspPlan:
        """See ``ConstrainedPlanner.plan_within``. Nothing is remembered."""
        names = grasps.object_name.tolist()
        table = table_below(names, belief.object_pose, belief.table_height, self._objects)

        def raised(plans: GraspPlan) -> np.ndarray:
            return feasible(plans.raised(np.resize(table, len(plans))))

        rounded = _rounded(lowered(belief, table))
        return self._search(grasps, rounded, seed, lambda share: None, raised).raised(table)

    def _search(
        self,
        grasps: RobotGraspSet,
        beliefs: Belief,
        seed: int,
        progress: Callable[[float], None],
        feasible: Feasible | None = None,
    ) -> GraspPlan:
        """One plan for each grasp, table at zero. progress: called with the share that is done."""
        s, everyone = self.settings, np.arange(len(grasps))
        chance = partial(chance_of_use, hand=self._hand, objects=self._objects) if s.for_use else None
        make = partial(
            propose,
            self._single,
            self._predictor,
            self._hand,
            seed=seed,
            prior=s.prior,
            chunk=s.chunk,
            other_places=s.other_places,
            chance=chance,
        )
        first = with_settings(grasps).select(np.tile(everyone, s.candidates))
        numbers = np.repeat(np.arange(s.candidates), len(grasps))
        pool = _only(make(beliefs, first, numbers, VariationSpread(), search=0), feasible)
        spent = np.zeros(len(grasps), dtype=int)
        hopeless = feasible is not None and not pool.statistics.expected.any()
        if s.rollouts is None or hopeless:
            return replace(pool.best()[0], rollouts=spent)
        roll = partial(
            try_candidates,
            objects=self._objects,
            hand=self._hand,
            policy=self._policy,
            settings=s.rollouts,
            threads=self._threads,
        )
        most = s.rollouts_per_grasp[1] * len(grasps)
        roll(pool, s.first_rounds, seed=(seed, 0))
        pool = self._tried_on(pool, roll, seed)
        spent += pool.statistics.tried.sum(axis=0).astype(int)
        progress(spent.sum() / most)
        chosen, value = pool.best()
        left = everyone
        for search in range(1, s.search.most + 1):
            hard = np.flatnonzero(value < s.search.enough)
            if not len(hard):
                break
            left, parents = left[hard], pool.among_best(s.search.parents, hard)
            number = np.arange(s.candidates)[:, None] % len(parents.statistics.expected)
            rows = (number * len(left) + np.arange(len(left))).ravel()
            numbers = np.repeat(np.arange(1, s.candidates + 1), len(left))
            children = make(
                beliefs.select(left), parents.grasps.select(rows), numbers, s.search.spread, search=search
            )
            before = parents.statistics.tried.sum(axis=0)
            pool = parents.join(_only(children, feasible))
            roll(pool, s.search.rounds, seed=(seed, search))
            spent[left] += (pool.statistics.tried.sum(axis=0) - before).astype(int)
            progress(spent.sum() / most)
            found, value = pool.best()
            place = everyone.copy()
            place[left] = len(everyone) + np.arange(len(left))
            chosen = GraspPlan.join([chosen, found]).select(place)
        return replace(chosen, rollouts=spent)

    def _tried_on(
        self,
        pool: Candidates,
        roll: Callable[..., None],
        seed: int,
    ) -> Candidates:
        """The candidates after more rollouts of those grasps of which none is sure."""
        statistics, all_of_them = pool.statistics, len(pool.statistics.expected)
        unsure = np.flatnonzero(pool.best()[1] < self.settings.sure)
        if len(unsure):
            order = statistics.order[:, unsure]
            some = pool.among_best(all_of_them, unsure)
            roll(some, self.settings.rounds, seed=(seed, 0, 1))
            for name in ("tried", "held", "shown", "bonus"):
                getattr(statistics, name)[order, unsure] = getattr(some.statistics, name)
        return pool

    def _key(self, grasp: RobotGraspSet, belief: Belief, seed: int) -> str:
        """Digest of all that the choice for one grasp depends on."""
        return digest(
            seed,
            self._predictor.digest,
            self._policy_digest,
            {name: getattr(grasp, name) for name in grasp.FIELDS},
            grasp.extra,
            self._objects[grasp.object_name[0]].digest,
            belief.arrays(),
        )


def _only(candidates: Candidates, feasible: Feasible | None) -> Candidates:
    """The candidates, where of those that can't be carried out nothing is expected: they come last."""
    if feasible is not None:
        statistics = candidates.statistics
        impossible = ~feasible(candidates.plans).reshape(statistics.expected.shape)
        statistics.expected[impossible] = statistics.expected_shown[impossible] = 0.0
    return candidates


def _rounded(belief: Belief) -> Belief:
    """The belief, rounded to steps of ``RESOLUTION``."""

    def steps(values: np.ndarray) -> np.ndarray:
        return RESOLUTION * np.round(values / RESOLUTION) + 0.0  # no -0.0, which has another digest

    def pose(values: np.ndarray) -> np.ndarray:
        rounded = steps(values)
        rounded[:, 3:] /= np.linalg.norm(rounded[:, 3:], axis=1, keepdims=True)
        return rounded

    return replace(
        belief,
        object_pose=pose(belief.object_pose),
        palm_pose=pose(belief.palm_pose),
        joint_positions=steps(belief.joint_positions),
    )

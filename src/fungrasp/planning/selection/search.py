"""Search for the best of many candidates of a grasp by simulated rollouts."""

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
from fungrasp.planning.selection.candidates import (
    HOPE,
    HOPE_WEIGHT,
    Candidates,
    propose,
    with_settings,
)
from fungrasp.planning.selection.rollouts import WITHSTOOD, RolloutTrials
from fungrasp.planning.selection.settings import SelectionSettings, VariationSpread
from fungrasp.task import Belief, GraspPlan, LiftProtocol, Policy

Feasible = Callable[[GraspPlan], np.ndarray]
"""Function from P plans to a bool array of shape [P]: whether each plan is feasible."""

WIDEST = 8
"""Largest number of candidates of a grasp that are tried in parallel."""

PASSED = 0.6
"""Mean value below which a candidate has failed."""

RESOLUTION = 1e-4
"""Resolution to which beliefs are rounded [m, rad], so that tiny differences reuse a known plan."""


class SearchPlanner:
    """Plans many variations of each grasp, selects one, and caches the result.

    It simulates ``settings.rollouts_per_grasp`` episodes per grasp in its own engine, never in the world for
    which it plans.
    """

    def __init__(
        self,
        hand: Hand,
        objects: Mapping[str, ObjectModel],
        policy: Policy,
        policy_digest: str = "",
        settings: SelectionSettings | None = None,
        protocol: LiftProtocol | None = None,
        threads: int = 0,
        motions: MotionSettings | None = None,
    ):
        """
        Args:
            policy: policy that will follow the plans, also used in the rollouts.
            settings: defaults if None.
            protocol: published protocol if None.
            threads: threads of the rollouts, 0 for all processors. Plans do not depend on it.
            motions: defaults if None.
        """
        self.settings = SelectionSettings.given(settings)
        self._hand, self._objects, self._threads = hand, objects, threads
        self._policy, self._policy_digest = policy, policy_digest
        self._single = MotionPlanner(hand, objects, motions, protocol)
        self.key = digest(policy_digest, self.settings, self._single.key)
        """Digest of everything that plans depend on besides the arguments of ``plan``."""
        self._known: dict[str, GraspPlan] = {}

    def plan(
        self,
        grasps: RobotGraspSet,
        belief: Belief,
        seed: int = 0,
        progress: Callable[[float], None] = lambda done: None,
    ) -> GraspPlan:
        """See ``Planner.plan``. All grasps get the same variations, so that the plan of one grasp does not
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
        """See ``ConstrainedPlanner.plan_within``. Results are not cached."""
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
        """Return one plan per grasp, table at zero. progress: called with the completed fraction."""
        s, names = self.settings, grasps.object_name.tolist()
        make = partial(
            propose,
            self._single,
            self._hand,
            seed=seed,
            chunk=s.chunk,
        )
        # If few plans are feasible, more candidates are needed.
        number = s.candidates if feasible is None else max(s.candidates, s.more)
        number = 1 if s.rollouts is None and feasible is None else number
        everyone = np.arange(len(grasps))
        first = with_settings(grasps).select(np.tile(everyone, number))
        numbers = np.repeat(np.arange(number), len(grasps))
        pool = _only(make(beliefs, first, numbers, VariationSpread(), search=0), feasible)
        hopeless = feasible is not None and not pool.tally.possible.any()
        if s.rollouts is None or hopeless:
            return pool.best(s.other_places)
        most = s.rollouts_per_grasp[1]
        roll = RolloutTrials(
            self._objects, self._hand, self._policy, s.rollouts, beliefs, names, most, (seed,), self._threads
        )
        chosen: list[GraspPlan] = []
        order: list[np.ndarray] = []
        left = everyone
        last = s.searches + s.more_searches
        for search in range(last + 1):
            if search:
                pool = self._varied_again(pool, left, beliefs, make, search, feasible)
            self._race(pool, left, roll, s.budget(search))
            best = pool.best(s.other_places)
            done = self._sure(pool) | (search == last)
            if best.expected_as_shown is not None and search >= s.searches:
                done |= best.expected_as_shown >= PASSED
            chosen.append(best.select(done))
            order.append(left[done])
            pool, left = pool.of(np.flatnonzero(~done)), left[~done]
            progress((len(everyone) - len(left) * (1 - (search + 1) / (last + 1))) / len(everyone))
            if not len(left):
                break
        return GraspPlan.join(chosen).select(np.argsort(np.concatenate(order)))

    def _race(self, pool: Candidates, grasps: np.ndarray, roll: RolloutTrials, budget: int) -> None:
        """Try the leading candidates of each grasp until one is confirmed or the budget is used up.

        As many candidates are tried in parallel as have failed so far, up to ``WIDEST``, so that hard grasps
        need fewer rounds.

        Args:
            pool: candidates of S grasps.
            grasps: indices of these grasps in the search, shape [S].
            budget: rollouts per grasp.
        """
        tally, s = pool.tally, self.settings
        before = tally.tried.sum(axis=0)
        while True:
            spent = tally.tried.sum(axis=0) - before
            active = np.flatnonzero(~self._sure(pool) & (spent < budget))
            if not len(active):
                return
            failed = ((tally.tried > 0) & (tally.shown < tally.tried * PASSED)).sum(axis=0)
            width = np.minimum(np.clip(failed, 1, WIDEST), budget - spent).astype(int)
            hope = tally.hope(s.other_places, roll.settings.share)
            order = np.argsort(-hope, axis=0, kind="stable")
            possible = np.isfinite(hope).sum(axis=0)
            chosen = [order[: min(width[g], possible[g]), g] for g in active]
            which = np.repeat(active, [len(some) for some in chosen])
            if not len(which):
                return
            roll(pool, grasps, np.concatenate(chosen), which)

    def _sure(self, pool: Candidates) -> np.ndarray:
        """Return whether each grasp has a confirmed candidate, shape [S] bool: one as good as
        ``confirmations`` rollouts as shown. With use motions, a passed rollout counts ``WITHSTOOD``."""
        s, tally = self.settings, pool.tally
        passed = WITHSTOOD if s.for_use else 1.0
        enough = (passed * s.confirmations + HOPE_WEIGHT * HOPE) / (s.confirmations + HOPE_WEIGHT)
        return np.any(
            (tally.tried >= s.confirmations) & (tally.hoped(s.other_places) >= enough - 1e-9), axis=0
        )

    def _varied_again(
        self,
        pool: Candidates,
        grasps: np.ndarray,
        beliefs: Belief,
        make: Callable[..., Candidates],
        search: int,
        feasible: Feasible | None,
    ) -> Candidates:
        """Add variations of the best candidates. grasps: indices of the pool's grasps, shape [S]."""
        s, count = self.settings, len(grasps)
        parents = pool.tally.best(s.other_places)[: s.parents]
        number = np.arange(s.more) % len(parents)
        rows = (parents[number] * count + np.arange(count)).ravel()
        numbers = np.repeat(np.arange(1, s.more + 1), count)
        children = make(beliefs.select(grasps), pool.grasps.select(rows), numbers, s.spread, search=search)
        return pool.join(_only(children, feasible))

    def _key(self, grasp: RobotGraspSet, belief: Belief, seed: int) -> str:
        """Return a digest of everything that the plan of one grasp depends on."""
        return digest(
            seed,
            self._policy_digest,
            {name: getattr(grasp, name) for name in grasp.FIELDS},
            grasp.extra,
            self._objects[grasp.object_name[0]].digest,
            belief.arrays(),
        )


def _only(candidates: Candidates, feasible: Feasible | None) -> Candidates:
    """Mark infeasible candidates."""
    if feasible is not None:
        possible = candidates.tally.possible
        possible &= feasible(candidates.plans).reshape(possible.shape)
    return candidates


def _rounded(belief: Belief) -> Belief:
    """Round a belief to ``RESOLUTION``."""

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

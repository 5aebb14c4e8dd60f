"""Several attempts of the lift test, one after the other in the same worlds.

After each attempt the object's tracked pose says whether it is held (``AttemptJudge``). Where it is not, the
hand lets go, withdraws, looks where the object lies now, and a planner plans anew for that pose. What
follows sees observations alone; the simulation only says how often the judgement was wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.geometry.poses import compose
from fungrasp.grasps import RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.planning import Planner
from fungrasp.planning.next_attempt import (
    ATTEMPT_SEEDS,
    NOT_WORTH_TRYING,
    make_attempts,
    next_belief,
    worth_trying,
)
from fungrasp.planning.withdrawal import Waypoints, way_off, way_round
from fungrasp.policies.open_loop import WaypointPolicy
from fungrasp.sim2real import random_stream
from fungrasp.task import Action, Belief, GraspPlan, LiftEnvironment, Outcomes, Policy, PrivilegedPolicy, play
from fungrasp.task.attempt_judge import AttemptJudge, TrackedFrames

LONGEST_WAY = 150
"""Control steps after which a hand that has not arrived is taken not to: three times what ways take."""
LONGEST_LOOK = 30
"""Control steps in which the object has to come to rest before it is given up."""


@dataclass(frozen=True, eq=False, repr=False)
class AttemptRecord(BatchRecord):
    """What became of the attempts of W episodes, a number each, shape [W]."""

    attempts: np.ndarray
    """Attempts made, 1 or more."""
    first_success: np.ndarray
    """Whether the first attempt passed the lift test, bool."""
    held_given_up: np.ndarray
    """Attempts that passed the lift test and were judged to have failed."""
    misses_unnoticed: np.ndarray
    """Attempts that failed and were judged not to have."""
    no_plan: np.ndarray
    """Whether the episode ended because the object lay where nothing was planned, bool."""

    @classmethod
    def none(cls, count: int) -> AttemptRecord:
        """Before the first attempt. count: W."""
        number, flag = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
        return cls(number, flag, number.copy(), number.copy(), flag.copy())

    def summary(self, which: np.ndarray) -> dict[str, Any]:
        """Rates and counts of some episodes. which: shape [N] bool."""
        count, first = int(which.sum()), int(self.first_success[which].sum())
        again = which & (self.attempts > 1)
        return {
            "first_success_rate": first / count,
            "first_success_interval": list(wilson_interval(first, count)),
            "tried_again": int(again.sum()),
            "held_given_up": int(self.held_given_up[which].sum()),
            "misses_unnoticed": int(self.misses_unnoticed[which].sum()),
            "no_plan": int(self.no_plan[which].sum()),
        }


@dataclass(frozen=True, eq=False)
class AttemptSetting:
    """What several attempts need besides a policy and the first plan."""

    attempts: int
    """Most attempts of an episode."""
    planner: Planner
    """Of the further plans."""
    grasps: RobotGraspSet
    """One for each world."""
    objects: Mapping[str, ObjectModel]
    """By name, as they are believed to be."""
    belief: Belief
    """That the first plan was made from."""
    seed: int
    """Of the plans, and of the sensors."""
    rows: np.ndarray
    """Number of each episode, shape [W]."""


def play_attempts(
    environment: LiftEnvironment,
    policy: Policy | PrivilegedPolicy,
    plan: GraspPlan,
    setting: AttemptSetting,
    *,
    watch: Callable[[], None] = lambda: None,
) -> tuple[Outcomes, AttemptRecord, GraspPlan]:
    """Let a policy act, and try again where it is seen to have failed.

    Args:
        environment: whose episodes have begun.
        policy: what acts.
        plan: the first, one for each world.
        setting: what further attempts need.
        watch: called after each setpoint.

    Returns:
        outcomes of the last attempts, what became of all, and the last plans, whose rollouts are all that
        were spent.
    """
    carrier = _SimulatedAttempts(environment, policy, plan, setting, watch)
    names = setting.grasps.object_name.tolist()
    make_attempts(carrier, setting.attempts, setting.belief.object_pose, names, setting.objects)
    outcomes, record = environment.task.outcomes(), carrier.record
    outcomes.reason[record.no_plan & outcomes.success] = "let go though it was held"
    outcomes.success[record.no_plan] = False
    return outcomes, record, carrier.plans


class _SimulatedAttempts:
    """Carries out the attempts of W simulated worlds (``AttemptCarrier``)."""

    def __init__(
        self,
        environment: LiftEnvironment,
        policy: Policy | PrivilegedPolicy,
        plan: GraspPlan,
        setting: AttemptSetting,
        watch: Callable[[], None],
    ):
        self._environment, self._policy, self._setting, self._watch = environment, policy, setting, watch
        self.plans = plan
        """The last ones, one for each world."""
        self.record = AttemptRecord.none(len(environment))
        """What became of the attempts so far."""
        self._belief = setting.belief
        self._gap = np.zeros(len(environment))

    def attempt(self, ids: np.ndarray, number: int) -> np.ndarray:
        """Play the worlds; whether they are judged to have failed, shape [I] bool."""
        judge = AttemptJudge(self.plans, self._setting.objects)
        success = play(
            self._environment, self._policy, self.plans, watch=self._watch, look=judge.watch
        ).success
        verdict, record = judge.verdict(), self.record
        record.attempts[ids] += 1
        if number == 0:
            record.first_success[:] = success
        record.held_given_up[ids] += success[ids] & verdict.missed[ids]
        record.misses_unnoticed[ids] += ~success[ids] & ~verdict.missed[ids]
        self._gap = verdict.gap
        return verdict.missed[ids]

    def withdraw(self, ids: np.ndarray, number: int) -> None:
        """Off the objects; after the last attempt nothing more is to be seen."""
        s, environment = self._setting, self._environment
        if number + 1 == s.attempts:
            return
        # A stream for each attempt: the others of a chunk do not decide what is drawn.
        streams = [random_stream("sensor jitter", s.seed, int(row), number + 1) for row in s.rows[ids]]
        environment.withdraw(ids, streams)
        off = way_off(self.plans.select(ids), environment.observe().select(ids), self._gap[ids])
        _go(environment, ids, off, self._watch)

    def look(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the objects rest; hands stay where they are."""
        environment = self._environment
        environment.resume(ids)
        frames, task = TrackedFrames(len(ids)), environment.task
        for _ in range(LONGEST_LOOK):
            environment.step(_still(environment), self._watch)
            frames.add(environment.observe().select(ids), ~task.done[ids])
            task.done[ids[frames.at_rest]] = True
            if frames.at_rest.all():
                break
        task.done[ids] = True
        rows = np.flatnonzero(frames.at_rest)
        return ids[rows], frames.pose()[rows]

    def plan(self, ids: np.ndarray, object_pose: np.ndarray, number: int) -> np.ndarray:
        """Plan, and take hands to their starts, round the objects."""
        s, environment = self._setting, self._environment
        grasps, protocol = s.grasps.select(ids), environment.protocol
        hand = environment.scene.hand
        beliefs = next_belief(self._belief.select(ids), object_pose, grasps, hand, s.objects, protocol)
        plans = s.planner.plan(grasps, beliefs, s.seed + ATTEMPT_SEEDS * number)
        worth = worth_trying(plans)
        self.give_up(ids[~worth], NOT_WORTH_TRYING)
        ids = ids[worth]
        if not len(ids):
            return ids
        belief = beliefs.select(worth)
        self.plans = _with_plans(self.plans, ids, plans.select(worth))
        self._belief = self._belief.replaced(ids, belief)
        environment.resume(ids)
        names = s.grasps.object_name[ids].tolist()
        start = belief.palm_pose, belief.joint_positions
        ways = way_round(environment.observe().select(ids), belief.object_pose, s.objects, names, *start)
        arrived = _go(environment, ids, ways, self._watch)
        self.give_up(ids[~arrived], "the hand does not arrive at its start")
        ids = ids[arrived]
        environment.begin_attempt(ids, compose(self.plans.object_pose, self.plans.grasp_palm_pose)[ids])
        return ids

    def give_up(self, ids: np.ndarray, why: str) -> None:
        """Counted, whatever the reason."""
        self.record.no_plan[ids] = True


def _go(
    environment: LiftEnvironment, ids: np.ndarray, ways: Waypoints, watch: Callable[[], None]
) -> np.ndarray:
    """Take hands along ways. Each world stands still once its hand has arrived, so that it does not depend on
    the others.

    Args:
        environment: with the hands.
        ids: worlds, shape [I].
        ways: of these, I rows.
        watch: called after each setpoint.

    Returns:
        Whether they have arrived, shape [I] bool.
    """
    environment.resume(ids)
    policy, task = WaypointPolicy(ways), environment.task
    for _ in range(LONGEST_WAY):
        action = policy.act(environment.observe().select(ids))
        task.done[ids[policy.arrived]] = True
        if policy.arrived.all():
            break
        environment.step(_for_all(environment, ids, action), watch)
    task.done[ids] = True
    return policy.arrived


def _with_plans(plan: GraspPlan, ids: np.ndarray, fresh: GraspPlan) -> GraspPlan:
    """The plans with those of some worlds replaced; the rollouts of both are counted."""
    place = np.arange(len(plan))
    place[ids] = len(plan) + np.arange(len(ids))
    both = GraspPlan.join([plan, fresh]).select(place)
    if plan.rollouts is None or both.rollouts is None:
        return both
    spent = plan.rollouts.copy()
    spent[ids] += both.rollouts[ids]
    return replace(both, rollouts=spent)


def _still(environment: LiftEnvironment) -> Action:
    """Stay where the setpoints are."""
    setpoints = environment.task.setpoints
    return Action(
        setpoints.wrist.pose.copy(), setpoints.fingers.copy(), np.zeros(len(environment), dtype=bool)
    )


def _for_all(environment: LiftEnvironment, ids: np.ndarray, action: Action) -> Action:
    """An action for all worlds; those without one stay. ids: worlds, shape [I]; action: of these, I rows."""
    return _still(environment).replaced(ids, action)

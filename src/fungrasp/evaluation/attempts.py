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

from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.geometry.poses import compose
from fungrasp.grasps import RobotGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.planning import Planner
from fungrasp.planning.next_attempt import ATTEMPT_SEEDS, next_belief, within_reach, worth_trying
from fungrasp.planning.withdrawal import Waypoints, way_off, way_round
from fungrasp.policies.waypoints import WaypointPolicy
from fungrasp.records import BatchRecord
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
    s, task = setting, environment.task
    record = AttemptRecord.none(len(environment))
    tried = np.ones(len(environment), dtype=bool)
    belief = s.belief
    for attempt in range(s.attempts):
        judge = AttemptJudge(plan, s.objects)
        outcomes = play(environment, policy, plan, watch=watch, look=judge.watch)
        verdict = judge.verdict()
        _count(record, attempt, tried, outcomes.success, verdict.missed)
        again = tried & verdict.missed
        if attempt + 1 == s.attempts or not again.any():
            break
        ids = np.flatnonzero(again)
        # A stream for each attempt: the others of a chunk do not decide what is drawn.
        streams = [random_stream("sensor jitter", s.seed, int(row), attempt + 1) for row in s.rows[ids]]
        environment.withdraw(ids, streams)
        off = way_off(plan.select(ids), environment.observe().select(ids), verdict.gap[ids])
        _go(environment, ids, off, watch)
        ids, seen = _look(environment, s, ids, watch)
        if len(ids):
            ids, fresh, beliefs = _plan_anew(environment, s, ids, seen, belief, attempt + 1)
            plan, belief = _with_plans(plan, ids, fresh), belief.replaced(ids, beliefs)
        if len(ids):
            ids = _start(environment, s, ids, belief.select(ids), watch)
            environment.begin_attempt(ids, compose(plan.object_pose, plan.grasp_palm_pose)[ids])
        tried = np.isin(np.arange(len(environment)), ids)
        record.no_plan[again & ~tried] = True
        if not len(ids):
            break
    outcomes = task.outcomes()
    outcomes.reason[record.no_plan & outcomes.success] = "let go though it was held"
    outcomes.success[record.no_plan] = False
    return outcomes, record, plan


def _count(
    record: AttemptRecord, attempt: int, tried: np.ndarray, success: np.ndarray, missed: np.ndarray
) -> None:
    """Count an attempt. tried: who made it; success: the truth; missed: the judgement; shape [W] bool."""
    record.attempts[tried] += 1
    if attempt == 0:
        record.first_success[:] = success
    record.held_given_up[tried & success & missed] += 1
    record.misses_unnoticed[tried & ~success & ~missed] += 1


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


def _look(
    environment: LiftEnvironment, s: AttemptSetting, ids: np.ndarray, watch: Callable[[], None]
) -> tuple[np.ndarray, np.ndarray]:
    """The worlds in which the object is seen to lie within reach, shape [I], and where it lies, world frame,
    shape [I, 7]; hands stay where they are. ids: worlds that are looked at."""
    environment.resume(ids)
    frames, task = TrackedFrames(len(ids)), environment.task
    for _ in range(LONGEST_LOOK):
        environment.step(_still(environment), watch)
        frames.add(environment.observe().select(ids), ~task.done[ids])
        task.done[ids[frames.at_rest]] = True
        if frames.at_rest.all():
            break
    task.done[ids] = True
    rows = np.flatnonzero(frames.at_rest)
    ids, seen = ids[rows], frames.pose()[rows]
    if not len(ids):
        return ids, seen
    names = s.grasps.object_name[ids].tolist()
    near = within_reach(seen, s.belief.object_pose[ids], names, s.objects)
    return ids[near], seen[near]


def _start(
    environment: LiftEnvironment,
    s: AttemptSetting,
    ids: np.ndarray,
    belief: Belief,
    watch: Callable[[], None],
) -> np.ndarray:
    """Take hands to their starts, round the objects; the worlds in which they have arrived, shape [I].

    Args:
        environment: with the hands.
        s: what attempts need.
        ids: worlds.
        belief: with the starts in these.
        watch: called after each setpoint.
    """
    environment.resume(ids)
    names = s.grasps.object_name[ids].tolist()
    start = belief.palm_pose, belief.joint_positions
    ways = way_round(environment.observe().select(ids), belief.object_pose, s.objects, names, *start)
    return ids[_go(environment, ids, ways, watch)]


def _plan_anew(
    environment: LiftEnvironment,
    s: AttemptSetting,
    ids: np.ndarray,
    seen: np.ndarray,
    belief: Belief,
    attempt: int,
) -> tuple[np.ndarray, GraspPlan, Belief]:
    """Plans for objects where they lie now: in which worlds there is one, shape [I], these plans, and the
    beliefs that they were made from.

    Args:
        environment: with hand and protocol.
        s: what attempts need.
        ids: worlds, shape [I].
        seen: where their objects lie, world frame, shape [I, 7].
        belief: of the attempt before, W rows.
        attempt: number of the new one.
    """
    hand, protocol = environment.scene.hand, environment.protocol
    grasps = s.grasps.select(ids)
    beliefs = next_belief(belief.select(ids), seen, grasps, hand, s.objects, protocol)
    plans = s.planner.plan(grasps, beliefs, s.seed + ATTEMPT_SEEDS * attempt)
    worth = worth_trying(plans)
    return ids[worth], plans.select(worth), beliefs.select(worth)


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

"""Several attempts at a grasp.

After each attempt the object's tracked pose says whether it is held (``AttemptJudge``). Where it is not, the
hand lets go, withdraws, looks where the object lies now, and a planner plans anew for that pose. The loop is
one for simulated worlds and for robots (``AttemptCarrier``). It sees observations alone; a simulation only
says how often the judgment was wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.records import BatchRecord
from fungrasp.geometry.poses import compose
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.grasp_motion import table_below
from fungrasp.planning.planner import Planner
from fungrasp.planning.withdrawal import WaypointPolicy, Waypoints, way_off, way_round
from fungrasp.sim2real import random_stream
from fungrasp.task import (
    Action,
    Belief,
    GraspPlan,
    LiftEnvironment,
    LiftProtocol,
    Outcomes,
    Policy,
    PrivilegedPolicy,
    play,
)
from fungrasp.task.attempt_judge import AttemptJudge, TrackedFrames, lowest_height
from fungrasp.task.start_pose import StartPoses, start_fingers

ATTEMPT_SEEDS = 1_000_003
"""Added to the seed of a plan for each further attempt: a prime far from the seeds that people give, so that
other variations are tried than those of which one has failed."""
LEAST_EXPECTED = 0.1
"""A plan of which less is expected is not tried: it knocks the object away."""
NOT_WORTH_TRYING = "no plan for it as it lies now is likely to succeed"
FALLEN = 0.03
"""An object whose lowest point is farther than this from where it was at rest before [m] is not on the table
any more: an estimated pose is off by less."""
FARTHEST = 0.4
"""An object that lies farther than this from where it was at first [m] is given up: an arm's reach about the
middle of its workspace."""
LONGEST_WAY = 150
"""Control steps after which a hand that has not arrived is taken not to: three times what ways take."""
LONGEST_LOOK = 30
"""Control steps in which the object has to come to rest before it is given up."""


def check_attempts(attempts: int, watches: bool) -> None:
    """Check the number of attempts.

    Args:
        attempts: of an episode, at most.
        watches: whether the policy uses feedback.

    Raises:
        FungraspError: less than one, or several for an open-loop policy.
    """
    if attempts < 1:
        raise FungraspError(f"there must be 1 attempt or more, not {attempts}")
    if attempts > 1 and not watches:
        raise FungraspError(
            "an open-loop policy can't notice that it failed: several attempts need --policy student"
        )


class AttemptCarrier(Protocol):
    """Carries out what attempts consist of, in W worlds: simulated ones, or the one of a robot. Worlds are
    given by their numbers, ``ids``, shape [I]; attempts by theirs, 0 for the first."""

    def attempt(self, ids: np.ndarray, number: int) -> np.ndarray:
        """Grasp, lift and hold. Gives whether the object is seen not to be held then, shape [I] bool."""
        ...

    def withdraw(self, ids: np.ndarray, number: int) -> None:
        """Let go and move the hand off the object, after the attempt of this number."""
        ...

    def look(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where objects rest. Gives the worlds where they do, shape [J], and their poses there, world frame,
        shape [J, 7]."""
        ...

    def plan(self, ids: np.ndarray, object_pose: np.ndarray, number: int) -> np.ndarray:
        """Plan the attempt of this number for objects where they lie, world frame, shape [I, 7], and be ready
        for it. Gives the worlds where that could be done, shape [J]."""
        ...

    def give_up(self, ids: np.ndarray, why: str) -> None:
        """Told of worlds where no further attempt is made though it was allowed, and why, as a phrase."""
        ...


def make_attempts(
    carrier: AttemptCarrier,
    most: int,
    first: np.ndarray,
    names: list[str],
    objects: Mapping[str, ObjectModel],
) -> None:
    """Attempt, and try again where the object is seen not to be held and lies within reach.

    Args:
        carrier: of the attempts, for W worlds.
        most: attempts, 1 or more.
        first: where the objects rested before the first attempt, world frame, shape [W, 7].
        names: of the objects, length W.
    """
    ids = np.arange(len(names))
    for number in range(most):
        ids = ids[carrier.attempt(ids, number)]
        if not len(ids):
            return
        carrier.withdraw(ids, number)
        if number + 1 == most:
            return
        resting, pose = carrier.look(ids)
        carrier.give_up(np.setdiff1d(ids, resting), "the object does not come to rest")
        near = within_reach(pose, first[resting], [names[i] for i in resting], objects)
        carrier.give_up(resting[~near], "the object is not within reach on the table any more")
        if not near.any():
            return
        ids = carrier.plan(resting[near], pose[near], number + 1)
        if not len(ids):
            return


def within_reach(
    object_pose: np.ndarray, first: np.ndarray, names: list[str], objects: Mapping[str, ObjectModel]
) -> np.ndarray:
    """Whether objects lie on the table, near to where they were at first, shape [N] bool.

    Args:
        object_pose: where they are seen, world frame, shape [N, 7].
        first: where they were at first, world frame, shape [N, 7].
        names: of the objects, length N.
    """
    if not names:
        return np.zeros(0, dtype=bool)
    models = [objects[name] for name in names]
    above = lowest_height(models, object_pose) - lowest_height(models, first)
    away = np.linalg.norm(object_pose[:, :2] - first[:, :2], axis=1)
    return (np.abs(above) < FALLEN) & (away < FARTHEST)


def worth_trying(plan: GraspPlan) -> np.ndarray:
    """Whether enough is expected of plans, as far as the planner says, shape [N] bool."""
    if plan.expected_success is None:
        return np.ones(len(plan), dtype=bool)
    return plan.expected_success >= LEAST_EXPECTED


def next_belief(
    belief: Belief,
    object_pose: np.ndarray,
    grasps: RobotGraspSet,
    hand: Hand,
    objects: Mapping[str, ObjectModel],
    protocol: LiftProtocol,
) -> Belief:
    """The belief for another attempt, with the hand at its new start.

    Args:
        belief: of the attempt before, N rows.
        object_pose: where the objects lie now, world frame, shape [N, 7].
        grasps: N grasps.
        protocol: with the start.
    """
    names = grasps.object_name.tolist()
    fingers = start_fingers(hand, grasps, protocol.start_closing)
    table = table_below(names, object_pose, belief.table_height, objects)
    present = sorted(set(names))
    index = np.array([present.index(name) for name in names])
    starts = StartPoses(hand, [objects[name] for name in present])
    start, _ = starts.facing(grasps, index, object_pose, protocol.start_distance, fingers, table)
    return replace(belief, object_pose=object_pose, palm_pose=start, joint_positions=fingers)


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
        plan: the first, one for each world.
        watch: called after each setpoint.

    Returns:
        outcomes of the last attempts, what became of all, and the last plans, whose rollouts are all that
        were spent.
    """
    carrier = _SimulatedAttempts(environment, policy, plan, setting, watch)
    names = setting.grasps.object_name.tolist()
    make_attempts(carrier, setting.attempts, setting.belief.object_pose, names, setting.objects)
    outcomes, record = environment.task.outcomes(), carrier.record
    outcomes.fail(record.no_plan, "let go though it was held")
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

"""Several attempts at a grasp.

After each attempt, the tracked pose of the object shows whether it is held (``AttemptJudge``). If not, the
hand opens and withdraws, the object's new pose is observed, and a planner plans for it. The loop is the same
for simulation and robots (``AttemptCarrier``) and uses only observations; a simulation additionally records
wrong judgments.
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
"""Added to the seed of a plan for each further attempt, so that new variations are tried: a prime far from
usual seeds."""
LEAST_EXPECTED = 0.1
"""Smallest expected success of a plan that is tried; others would only push the object away."""
NOT_WORTH_TRYING = "no plan for it as it lies now is likely to succeed"
FALLEN = 0.03
"""Change of height of an object's lowest point [m] beyond which it is not on the table any more; larger than
the error of an estimated pose."""
FARTHEST = 0.4
"""Distance of an object from its first place [m] beyond which it is given up: an arm's reach about the middle
of its workspace."""
LONGEST_WAY = 150
"""Largest number of control steps for a motion between attempts, three times the usual number."""
LONGEST_LOOK = 30
"""Largest number of control steps to wait until an object is at rest."""


def check_attempts(attempts: int, watches: bool) -> None:
    """Check the number of attempts.

    Args:
        attempts: largest number of attempts per episode.
        watches: whether the policy uses feedback.

    Raises:
        FungraspError: the number is less than one, or more than one for an open-loop policy.
    """
    if attempts < 1:
        raise FungraspError(f"there must be 1 attempt or more, not {attempts}")
    if attempts > 1 and not watches:
        raise FungraspError(
            "an open-loop policy can't notice that it failed: several attempts need the policy student"
        )


class AttemptCarrier(Protocol):
    """Carries out the parts of attempts in W simulated worlds or in the world of a robot. Worlds are given by
    index, ``ids``, shape [I]; attempts are numbered from 0."""

    def attempt(self, ids: np.ndarray, number: int) -> np.ndarray:
        """Grasp, lift and hold. Return whether the object is seen not to be held, shape [I] bool."""
        ...

    def withdraw(self, ids: np.ndarray, number: int) -> None:
        """Open the hand and withdraw it from the object after this attempt."""
        ...

    def look(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observe the objects. Return the worlds in which they are at rest, shape [J], and their poses, world
        frame, shape [J, 7]."""
        ...

    def plan(self, ids: np.ndarray, object_pose: np.ndarray, number: int) -> np.ndarray:
        """Plan this attempt for object poses, world frame, shape [I, 7], and move to its start. Return the
        worlds in which this succeeded, shape [J]."""
        ...

    def give_up(self, ids: np.ndarray, why: str) -> None:
        """Handle worlds in which no further attempt is possible. why: reason, as a phrase."""
        ...


def make_attempts(
    carrier: AttemptCarrier,
    most: int,
    first: np.ndarray,
    names: list[str],
    objects: Mapping[str, ObjectModel],
) -> None:
    """Make attempts until the object is held, out of reach, or the number of attempts is used up.

    Args:
        carrier: carrier for W worlds.
        most: largest number of attempts, 1 or more.
        first: rest poses of the objects before the first attempt, world frame, shape [W, 7].
        names: object names, length W.
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
    """Return whether objects are on the table near their first places, shape [N] bool.

    Args:
        object_pose: estimated poses, world frame, shape [N, 7].
        first: poses before the first attempt, world frame, shape [N, 7].
        names: object names, length N.
    """
    if not names:
        return np.zeros(0, dtype=bool)
    models = [objects[name] for name in names]
    above = lowest_height(models, object_pose) - lowest_height(models, first)
    away = np.linalg.norm(object_pose[:, :2] - first[:, :2], axis=1)
    return (np.abs(above) < FALLEN) & (away < FARTHEST)


def worth_trying(plan: GraspPlan) -> np.ndarray:
    """Return whether plans have enough expected success, shape [N] bool; True if it is unknown."""
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
    """Return the belief for another attempt, with the hand at its new start pose.

    Args:
        belief: belief of the previous attempt, N rows.
        object_pose: current poses of the objects, world frame, shape [N, 7].
        grasps: N grasps.
        protocol: protocol with the start pose.
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
    """Results of the attempts of W episodes, shape [W] each."""

    attempts: np.ndarray
    """Number of attempts, 1 or more."""
    first_success: np.ndarray
    """Whether the first attempt passed the lift test, bool."""
    held_given_up: np.ndarray
    """Number of attempts that passed the lift test but were judged as failed."""
    misses_unnoticed: np.ndarray
    """Number of attempts that failed but were not judged as failed."""
    no_plan: np.ndarray
    """Whether the episode ended because no further attempt was possible, bool."""

    @classmethod
    def none(cls, count: int) -> AttemptRecord:
        """Create a record before the first attempt. count: W."""
        number, flag = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
        return cls(number, flag, number.copy(), number.copy(), flag.copy())


@dataclass(frozen=True, eq=False)
class AttemptSetting:
    """Inputs of several attempts besides a policy and the first plan."""

    attempts: int
    """Largest number of attempts per episode."""
    planner: Planner
    """Planner of further plans."""
    grasps: RobotGraspSet
    """One grasp per world."""
    objects: Mapping[str, ObjectModel]
    """Believed object models, by name."""
    belief: Belief
    """Belief used for the first plan."""
    seed: int
    """Seed of plans and sensors."""
    rows: np.ndarray
    """Index of each episode, shape [W]."""


def play_attempts(
    environment: LiftEnvironment,
    policy: Policy | PrivilegedPolicy,
    plan: GraspPlan,
    setting: AttemptSetting,
    *,
    watch: Callable[[], None] = lambda: None,
) -> tuple[Outcomes, AttemptRecord, GraspPlan]:
    """Run a policy with several attempts.

    Args:
        plan: first plans, one per world.
        watch: called after each setpoint.

    Returns:
        outcomes of the last attempts, record of all attempts, and last plans with the total number of
        rollouts.
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
        """Last plans, one per world."""
        self.record = AttemptRecord.none(len(environment))
        """Record of the attempts so far."""
        self._belief = setting.belief
        self._gap = np.zeros(len(environment))

    def attempt(self, ids: np.ndarray, number: int) -> np.ndarray:
        """Play the worlds; see ``AttemptCarrier.attempt``."""
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
        """Withdraw from the objects, except after the last attempt."""
        s, environment = self._setting, self._environment
        if number + 1 == s.attempts:
            return
        # One random stream per episode and attempt, so that results do not depend on other episodes.
        streams = [random_stream("sensor jitter", s.seed, int(row), number + 1) for row in s.rows[ids]]
        environment.withdraw(ids, streams)
        off = way_off(self.plans.select(ids), environment.observe().select(ids), self._gap[ids])
        _go(environment, ids, off, self._watch)

    def look(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observe the objects; the hands do not move."""
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
        """Plan, and move the hands around the objects to their start poses."""
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
        """Count the worlds; the reason is ignored."""
        self.record.no_plan[ids] = True


def _go(
    environment: LiftEnvironment, ids: np.ndarray, ways: Waypoints, watch: Callable[[], None]
) -> np.ndarray:
    """Move hands along waypoints. Each world is paused once its hand has arrived, so that it does not depend
    on the others.

    Args:
        ids: worlds, shape [I].
        ways: waypoints of these worlds, I rows.
        watch: called after each setpoint.

    Returns:
        Whether each hand has arrived, shape [I] bool.
    """
    environment.resume(ids)
    policy, task = WaypointPolicy(ways), environment.task
    for _ in range(LONGEST_WAY):
        action = policy.act(environment.observe().select(ids))
        task.done[ids[policy.arrived]] = True
        if policy.arrived.all():
            break
        environment.step(_still(environment).replaced(ids, action), watch)
    task.done[ids] = True
    return policy.arrived


def _with_plans(plan: GraspPlan, ids: np.ndarray, fresh: GraspPlan) -> GraspPlan:
    """Replace the plans of some worlds, and add up the rollouts."""
    place = np.arange(len(plan))
    place[ids] = len(plan) + np.arange(len(ids))
    both = GraspPlan.join([plan, fresh]).select(place)
    if plan.rollouts is None or both.rollouts is None:
        return both
    spent = plan.rollouts.copy()
    spent[ids] += both.rollouts[ids]
    return replace(both, rollouts=spent)


def _still(environment: LiftEnvironment) -> Action:
    """Return the action that keeps the current setpoints."""
    setpoints = environment.task.setpoints
    return Action(
        setpoints.wrist.pose.copy(), setpoints.fingers.copy(), np.zeros(len(environment), dtype=bool)
    )

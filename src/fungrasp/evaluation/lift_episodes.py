"""Episodes of a lift test: sample worlds, plan, play, and run the use test."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays
from fungrasp.evaluation.contact_estimate import ContactEstimateMeter, ContactEstimates
from fungrasp.evaluation.lift_test_spec import LiftTestSpec
from fungrasp.evaluation.trajectory import Recorder, UseRecorder
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel, with_sizes
from fungrasp.planning import MotionPlanner, MotionSettings, Planner, make_planner
from fungrasp.planning.attempts import AttemptSetting, check_attempts, play_attempts
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.planning.selection.search import SearchPlanner
from fungrasp.policies import OpenLoopPolicy, StudentPolicy, make_policy, policy_source
from fungrasp.policies.registry import PolicySource
from fungrasp.sim2real import Randomization, draw_each, random_stream
from fungrasp.simulation import Scene, build_scene
from fungrasp.task import LiftEnvironment, Policy, PrivilegedPolicy, play
from fungrasp.task.use import load_use_motions, motion_of, play_use

USE_PREFIX = "use."
"""Prefix of fields of ``UseOutcomes`` in the arrays of a part."""

USE_FILE = "{}_use.npz"
"""File name of a recorded use test, from the stem of the lift test's file."""

ATTEMPT_PREFIX = "attempts."
"""Prefix of fields of ``AttemptRecord``."""

HOLD_PREFIX = "hold."
"""Prefix of fields of ``HoldMiddle``."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """Episodes simulated together."""

    condition: str
    """Name of the condition, which gives the randomization."""
    seed: int
    """Random seed."""
    rows: np.ndarray
    """Rows of the grasps in their set, shape [W]."""


@dataclass(frozen=True, eq=False)
class LiftTest:
    """Grasps to test, and settings.

    Raises:
        FungraspError: the policy is unknown, the grasps are of another hand, an open-loop policy has several
            attempts, or there are several seeds without randomness.
    """

    grasps: RobotGraspSet
    """N grasps."""
    objects: Mapping[str, ObjectModel]
    """Object models, by name."""
    hand: Hand
    """Hand of the grasps."""
    spec: LiftTestSpec
    """Settings of the test."""
    given_policy: Policy | PrivilegedPolicy | None = None
    """A policy object, instead of the named policy."""
    given_planner: Planner | GivenPlans | None = None
    """A planner or plans, instead of the policy's planner."""
    record: Path | None = None
    """Folder for the recorded episodes."""
    threads: int = 0
    """Number of threads, 0 for all processors."""

    def __post_init__(self) -> None:
        spec = self.spec
        self.grasps.check_hand(self.hand)
        _ = self.policy_digest
        check_attempts(spec.attempts, not isinstance(self.policy, OpenLoopPolicy))
        if spec.attempts > 1 and self.record is not None:
            raise FungraspError("only one attempt is recorded: give record a single attempt, or leave it out")
        if len(spec.seeds) > 1 and not any(map(self.is_random, spec.conditions.values())):
            raise FungraspError(
                "nothing is random here, so several seeds would only repeat the same episodes: give one "
                "seed, or something random (a protocol, pose noise, pushes, an object shift, a learned "
                "policy that chooses plans)"
            )

    @cached_property
    def _source(self) -> PolicySource:
        if self.given_policy is not None:
            return PolicySource(None, False)
        return policy_source(self.spec.policy, self.hand.name)

    @property
    def policy_digest(self) -> str:
        """SHA-256 of the policy's network, "" without a network."""
        return self._source.digest

    @cached_property
    def policy(self) -> Policy | PrivilegedPolicy:
        """The policy."""
        return self.given_policy or make_policy(self.spec.policy, self.hand, self.objects)

    @cached_property
    def planner(self) -> Planner:
        """The planner, shared by all conditions, so that plans are reused."""
        if self.given_planner is not None and not isinstance(self.given_planner, GivenPlans):
            return self.given_planner
        spec = self.spec
        motions = MotionSettings() if spec.adapt else MotionSettings(adapt=None)
        if self.given_policy is not None:
            return MotionPlanner(self.hand, self.objects, motions, spec.lift)
        selection = spec.selection_settings
        return make_planner(spec.policy, self.hand, self.objects, selection, spec.lift, self.threads, motions)

    @cached_property
    def searches(self) -> bool:
        """Whether the planner searches among candidates, which takes more than ten times as long."""
        return self._source.searches and not isinstance(self.given_planner, GivenPlans)

    @cached_property
    def _scenes(self) -> dict[str, Scene]:
        return {}

    def is_random(self, randomization: Randomization) -> bool:
        """Return whether episodes depend on the seed; True for user-defined policies and planners."""
        made = self.given_planner is not None and not isinstance(self.given_planner, GivenPlans)
        own = self.given_policy is not None or made
        return bool(own or randomization.is_random or self.searches)

    def files(self, part: Episodes) -> list[Path]:
        """Return the files of a part's recorded episodes, W or none."""
        if self.record is None:
            return []
        folder = self.record / part.condition.replace(",", "").replace(" ", "-")
        label = ""
        if len(self.spec.seeds) > 1 and self.is_random(self.spec.conditions[part.condition]):
            label = f"_{part.seed}"
        names = self.grasps.object_name
        return [folder / f"{row:04d}{label}_{names[row]}.npz" for row in part.rows.tolist()]

    def simulate(self, part: Episodes, progress: Callable[[float], None]) -> Arrays:
        """Plan and play episodes.

        Args:
            part: W episodes.
            progress: called with the number of finished episodes, fractions included.

        Returns:
            fields of ``Outcomes`` and ``ContactEstimates``, ``rollouts``, ``expected_as_shown``, fields of
            ``HoldMiddle``, and with use tests or several attempts those of ``UseOutcomes`` and
            ``AttemptRecord``; the first axis is W.
        """
        rows, seed, files, spec = part.rows, part.seed, self.files(part), self.spec
        r, p = spec.conditions[part.condition], spec.lift
        grasps = self.grasps.select(rows)
        sample = draw_each(r, seed, rows, len(self.hand.joint_names))
        jitter = [random_stream("sensor jitter", seed, int(row)) for row in rows]
        environment = LiftEnvironment(self._scene(r), len(rows), r, p, jitter, self.threads)
        belief = environment.settle(grasps, sample)
        # A search takes most of the time: it counts as half of the progress.
        half = 0.5 if self.searches and isinstance(self.planner, SearchPlanner) else 0.0
        if isinstance(self.given_planner, GivenPlans):
            plan = self.given_planner.rows(rows, belief)
        else:
            plan = self.planner.plan(grasps, belief, seed, lambda done: progress(half * done))
        environment.move_objects()
        recorder = Recorder(environment.task, grasps, r) if files else None
        longest, furthest = p.approach_time + p.hold_time + 1.2, 0.0

        def watch() -> None:
            nonlocal furthest
            # Each attempt starts at time zero.
            furthest = max(furthest, min(float(environment.task.time.max()) / longest, 1.0))
            progress(len(rows) * (half + (1 - half) * furthest))
            if recorder is not None:
                recorder()

        policy, estimates = self.policy, ContactEstimates.none(len(rows))
        if isinstance(policy, StudentPolicy) and policy.estimates_contacts:
            policy = ContactEstimateMeter(policy, environment)
            estimates = policy.estimates
        tries = {}
        if spec.attempts > 1:
            setting = AttemptSetting(spec.attempts, self.planner, grasps, self.objects, belief, seed, rows)
            outcomes, made, plan = play_attempts(environment, policy, plan, setting, watch=watch)
            tries = {ATTEMPT_PREFIX + name: values for name, values in made.arrays().items()}
        else:
            outcomes = play(environment, policy, plan, watch=watch)
        if recorder is not None:
            for trajectory, file in zip(recorder.trajectories(rows), files, strict=True):
                trajectory.save(file)
        middle = environment.task.measurements.middle.arrays()
        use = {}
        if spec.use:
            use = self._use(environment, grasps, rows, outcomes.success, files)
        return (
            outcomes.arrays()
            | estimates.arrays()
            | {HOLD_PREFIX + name: values for name, values in middle.items()}
            | use
            | tries
            | {
                "rollouts": np.zeros(len(rows), dtype=int) if plan.rollouts is None else plan.rollouts,
                "expected_as_shown": np.full(len(rows), np.nan)
                if plan.expected_as_shown is None
                else plan.expected_as_shown,
            }
        )

    def _use(
        self,
        environment: LiftEnvironment,
        grasps: RobotGraspSet,
        rows: np.ndarray,
        held: np.ndarray,
        files: Sequence[Path],
    ) -> Arrays:
        """Play the use motions of the held objects. held: shape [W] bool."""
        assert grasps.task is not None
        known = load_use_motions().values()
        motions = [motion_of(task, known) for task in grasps.task.tolist()]
        watching = UseRecorder(environment, grasps, motions) if files else None
        tried = play_use(environment, motions, held, watching or (lambda controls: None))
        if watching is not None:
            for trajectory, file in zip(watching.trajectories(rows, tried), files, strict=True):
                if trajectory is not None:
                    trajectory.save(file.with_name(USE_FILE.format(file.stem)))
        return {USE_PREFIX + name: values for name, values in tried.arrays().items()}

    def _scene(self, randomization: Randomization) -> Scene:
        """Return the scene, which is built once per set of object sizes."""
        objects, key = with_sizes(self.objects, randomization.object_scales), str(randomization.object_scales)
        if key not in self._scenes:
            self._scenes[key] = build_scene(self.hand, objects, self.spec.physics)
        return self._scenes[key]

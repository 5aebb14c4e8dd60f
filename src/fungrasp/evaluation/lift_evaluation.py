"""The function ``evaluate``: the lift test on many grasps (docs/evaluate.md), as a job of independent
episodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, Job, PartStore, RayCluster, part_key, run_job
from fungrasp.core.progress import ShowProgress, shown_progress
from fungrasp.evaluation.contact_estimate import ContactEstimates
from fungrasp.evaluation.grasp_quality import static_quality
from fungrasp.evaluation.lift_episodes import (
    ATTEMPT_PREFIX,
    HOLD_PREFIX,
    USE_PREFIX,
    Episodes,
    LiftTest,
)
from fungrasp.evaluation.lift_test_spec import LiftTestSpec
from fungrasp.evaluation.results import LiftTestResult
from fungrasp.grasps.as_shown import with_shown_places
from fungrasp.grasps.grasp_arguments import AnyGrasps, HumanGrasps, Objects, as_human_grasps
from fungrasp.hands import Hand
from fungrasp.planning import Planner
from fungrasp.planning.attempts import AttemptRecord
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.retargeting.robot_grasps import as_robot_grasps
from fungrasp.sim2real import ProtocolName
from fungrasp.task import GraspPlan, Outcomes, Policy, PrivilegedPolicy
from fungrasp.task.outcome import HoldMiddle
from fungrasp.task.policy_checks import check_policy
from fungrasp.task.use import UseOutcomes, load_use_motions

EPISODES = (8, 32)
"""Smallest and largest number of episodes in a part: at most 5 s of work, little overhead, and enough parts
for many processors."""

SEARCHED_EPISODES = (2, 32)
"""The same for policies that search for plans."""

BATCH = 128
"""Largest number of episodes that one process simulates together. It limits memory and the work lost by an
interruption."""

LOSS = 8
"""Desired number of parts; an interrupted run loses at most one of them."""


def evaluate(
    grasps: AnyGrasps,
    objects: Objects = None,
    policy: str | Path | Policy | PrivilegedPolicy | None = None,
    protocol: ProtocolName | None = None,
    *,
    spec: LiftTestSpec | None = None,
    hand: Hand | str | None = None,
    human: HumanGrasps | None = None,
    plans: GraspPlan | Planner | None = None,
    record: str | Path | None = None,
    threads: int = 0,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: ShowProgress = None,
) -> LiftTestResult:
    """Test each grasp in simulation, once per seed.

    Args:
        grasps: robot grasps, or human grasps, which are retargeted first; a set or a single one.
        objects: objects of the grasps, as for ``retarget``.
        policy: policy instead of the one in ``spec``: a name, a file, or a policy object.
        protocol: protocol instead of the one in ``spec``.
        spec: settings of the test; defaults if None.
        hand: hand for human grasps; allegro if None. For robot grasps only if its dynamics differ from its
            files.
        human: human grasps of the robot grasps, for the static quality and for grasps without the person's
            contacts.
        plans: one plan per grasp (``fungrasp.plan``), or a planner. Default: the policy's planner.
        record: folder for the recorded episodes, ``<row>_<object>.npz`` (``<row>_<seed>_<object>.npz`` with
            several seeds), and of the use tests, ``<row>_<object>_use.npz``; with several conditions, one
            folder each.
        threads: 0 for all processors. Results do not depend on it.
        store: keeps finished parts, so that an interrupted run can continue; the caller removes it. It
            needs a policy given by name and a planner with a key.
        ray: cluster to run on, under the same condition.
        progress: called with the number of finished episodes, fractions included. True or False: a progress
            bar or none. None: a bar in terminals and notebooks.

    Raises:
        FungraspError: there are no grasps, the policy is unknown, the grasps are of another hand, options
            contradict each other, or a folder can't be written.
    """
    spec = LiftTestSpec.given(spec)
    policy = str(policy) if isinstance(policy, Path) else policy
    own = policy if policy is not None and not isinstance(policy, str) else None
    if own is not None:
        check_policy(own)
    if policy is not None:
        spec = replace(spec, policy=policy if isinstance(policy, str) else type(policy).__name__)
    if protocol is not None:
        spec = replace(spec, protocol=protocol)
    robot, known, used, made_of = as_robot_grasps(grasps, objects, hand, threads)
    shown = made_of if human is None else as_human_grasps(human)
    if shown is not None and robot.shown_places is None:
        robot = with_shown_places(robot, shown, known, used)
    if plans is not None and not isinstance(plans, GraspPlan) and not hasattr(plans, "plan"):
        raise FungraspError(f"plans= takes plans (fungrasp.plan) or a planner, not a {type(plans).__name__}")
    given = GivenPlans(plans, robot) if isinstance(plans, GraspPlan) else plans
    record = None if record is None else Path(record)
    job = LiftTestJob(robot, known, used, spec, own, given, record, threads)
    if (store is not None or ray is not None) and not job.is_named():
        raise FungraspError("store= and ray= need a policy given by name, and a planner with a key")
    start = perf_counter()
    episodes = sum(len(part.rows) for part in job.parts())
    with shown_progress(progress, f"lifting with {used.name}", episodes) as show:
        found = run_job(job, store, ray=ray, progress=show)
    done = list(zip(job.parts(), found, strict=True))
    results = {
        name: _result(job, name, [(part, arrays) for part, arrays in done if part.condition == name])
        for name in spec.conditions
    }
    result = next(iter(results.values()))
    if spec.static and shown is not None:
        result = replace(result, quality=static_quality(robot, shown, known, used))
    conditions = results if len(results) > 1 else {}
    seconds = perf_counter() - start
    return replace(result, conditions=conditions, grasps=robot, human=shown, objects=known, seconds=seconds)


@dataclass(frozen=True, eq=False)
class LiftTestJob(LiftTest, Job[Episodes]):
    """The episodes of a lift test, in parts."""

    def is_named(self) -> bool:
        """Return whether policy and planner are identified by name, so that results can be stored and
        computed elsewhere."""
        return self.given_policy is None and (
            self.given_planner is None
            or hasattr(self.given_planner, "key")
            or isinstance(self.given_planner, GivenPlans)
        )

    def parts(self) -> list[Episodes]:
        """Return all episodes, by condition; without randomness, only those of the first seed."""
        size, count, spec = self._part_size, len(self.grasps), self.spec
        return [
            Episodes(name, seed, np.arange(first, min(first + size, count)))
            for name, randomization in spec.conditions.items()
            for seed in (spec.seeds if self.is_random(randomization) else spec.seeds[:1])
            for first in range(0, count, size)
        ]

    def key(self, part: Episodes) -> str:
        """Return a digest of everything that the outcomes depend on."""
        grasps, spec = self.grasps.select(part.rows), self.spec
        motions = load_use_motions() if spec.use else {}
        return part_key(
            "lift test",
            self.hand,
            grasps,
            {name: self.objects[name] for name in np.unique(grasps.object_name).tolist()},
            (spec.policy, self.policy_digest),
            getattr(self.given_planner or self.planner, "key", ""),
            (spec.lift, spec.conditions[part.condition], spec.physics, spec.attempts),
            (part.rows, part.seed),
            [str(file.absolute()) for file in self.files(part)],
            {name: str(motion) for name, motion in motions.items()},
        )

    def size(self, part: Episodes) -> float:
        """Return the number of episodes."""
        return len(part.rows)

    def together(self, missing: list[Episodes]) -> list[list[Episodes]]:
        """Group parts of the same condition and seed."""
        size = self._part_size
        most = min(max(math.ceil(len(self.grasps) / LOSS), size), BATCH)
        groups: list[list[Episodes]] = []
        episodes = 0
        for part in missing:
            episodes += len(part.rows)
            last = groups[-1][0] if groups else None
            same = last is not None and (last.condition, last.seed) == (part.condition, part.seed)
            if not same or episodes > most or self.searches:
                groups.append([])
                episodes = len(part.rows)
            groups[-1].append(part)
        return groups

    def is_whole(self, part: Episodes) -> bool:
        """Return whether the recorded episodes exist."""
        return all(file.is_file() for file in self.files(part))

    def on_one_processor(self) -> Self:
        """Return the job with one thread."""
        return replace(self, threads=1)

    def run(self, parts: Sequence[Episodes], progress: Callable[[float], None]) -> list[Arrays]:
        """Return the result of ``simulate`` for each part."""
        first = parts[0]
        rows = np.concatenate([part.rows for part in parts])
        found = self.simulate(Episodes(first.condition, first.seed, rows), progress)
        ends = np.cumsum([len(part.rows) for part in parts])[:-1]
        split = {name: np.split(values, ends) for name, values in found.items()}
        return [{name: values[i] for name, values in split.items()} for i in range(len(parts))]

    @property
    def _part_size(self) -> int:
        fewest, most = SEARCHED_EPISODES if self.searches else EPISODES
        return min(max(math.ceil(len(self.grasps) / LOSS), fewest), most)


def _result(job: LiftTestJob, condition: str, parts: list[tuple[Episodes, Arrays]]) -> LiftTestResult:
    merged = {name: np.concatenate([arrays[name] for _, arrays in parts]) for name in parts[0][1]}
    index = np.concatenate([part.rows for part, _ in parts])
    grasps, spec = job.grasps, job.spec
    assert grasps.task is not None
    return LiftTestResult(
        hand=job.hand.name,
        spec=spec,
        randomization=spec.conditions[condition],
        index=index,
        seed=np.concatenate([np.full(len(part.rows), part.seed) for part, _ in parts]),
        object_name=grasps.object_name[index],
        task=grasps.task[index],
        outcomes=Outcomes.from_arrays(merged),
        hold=HoldMiddle.from_arrays(_without(merged, HOLD_PREFIX)),
        rollouts=merged["rollouts"],
        expected_as_shown=merged["expected_as_shown"],
        contact_estimates=ContactEstimates.from_arrays(merged),
        use=UseOutcomes.from_arrays(_without(merged, USE_PREFIX)) if spec.use else None,
        attempts=AttemptRecord.from_arrays(_without(merged, ATTEMPT_PREFIX)) if spec.attempts > 1 else None,
    )


def _without(arrays: Mapping[str, np.ndarray], prefix: str) -> Arrays:
    """Select arrays whose names have a prefix, and remove the prefix."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}

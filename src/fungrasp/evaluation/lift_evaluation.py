"""The lift test on any number of grasps: reach, grasp, lift, hold (docs/evaluate.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import Arrays, PartStore, RayCluster, run_job
from fungrasp.evaluation.attempts import AttemptRecord
from fungrasp.evaluation.contact_estimate import ContactEstimates
from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
from fungrasp.evaluation.lift_test_job import ATTEMPT_PREFIX, USE_PREFIX, Episodes, LiftTest
from fungrasp.evaluation.lift_test_spec import LiftTestSpec
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.planning import Planner
from fungrasp.sim2real import ProtocolName, Randomization
from fungrasp.task import Outcomes, Policy, PrivilegedPolicy
from fungrasp.task.use import UseOutcomes


@dataclass(frozen=True, eq=False, repr=False)
class LiftTestResult:
    """Outcome of N episodes under one condition; of several conditions the first, and all in
    ``conditions``."""

    hand: str
    """Name of the hand."""
    spec: LiftTestSpec
    """What was asked."""
    randomization: Randomization
    """How the worlds differed from the nominal ones that were planned for."""
    index: np.ndarray
    """Row of each episode's grasp in the set, shape [N]."""
    seed: np.ndarray
    """Seed of each episode, shape [N]."""
    object_name: np.ndarray
    """Name of each object, shape [N] str."""
    task: np.ndarray
    """What each grasp is for, shape [N] str."""
    outcomes: Outcomes
    """Outcomes of the N episodes."""
    rollouts: np.ndarray
    """Episodes that were simulated to plan each grasp, shape [N] int."""
    contact_estimates: ContactEstimates
    """How well the policy knew what it touched, N rows."""
    use: UseOutcomes | None = None
    """Outcomes of the use tests that followed; None if there were none."""
    attempts: AttemptRecord | None = None
    """What became of the attempts; None if there was one only."""
    quality: StaticQuality | None = None
    """Of the grasps, if it was asked for and the human grasps are known."""
    conditions: Mapping[str, LiftTestResult] = field(default_factory=dict)
    """By name, this one included; empty where there is only one."""
    grasps: RobotGraspSet | None = None
    """The grasps that were tried; not written to files."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Theirs, by name; not written to files."""
    seconds: float = 0.0
    """Time that it took, that of an earlier run that was interrupted left out [s]."""

    @property
    def policy(self) -> str:
        """Name or file of the policy."""
        return self.spec.policy

    @property
    def success(self) -> np.ndarray:
        """Whether the object was lifted and held, shape [N] bool."""
        return self.outcomes.success

    @property
    def episodes(self) -> int:
        """Number of episodes of all conditions."""
        return sum(len(each.index) for each in self.conditions.values()) or len(self.index)

    def table(self) -> str:
        """Rates of success by object, or by condition, and why episodes failed, as text."""
        from fungrasp.evaluation.result_tables import result_table

        return result_table(self)

    def json(self) -> dict[str, Any]:
        """All numbers, what was asked, and what ran where; nothing in it is NaN or infinite."""
        from fungrasp.evaluation.results import result_json, result_record

        return result_record(result_json(self), self.seconds)

    def save(self, path: str | Path, compact: bool = False) -> None:
        """Write all numbers; ``fungrasp.evaluation.read_result`` reads them.

        Args:
            path: of a JSON file.
            compact: the episodes go to a CSV file beside it, with one row each.

        Raises:
            FungraspError: a file can't be written.
        """
        from fungrasp.evaluation.result_files import save_result

        save_result(path, self.json(), compact)

    def frame(self) -> Any:
        """One row for each episode, as a data frame of pandas, or of Polars where pandas is not installed.

        Raises:
            FungraspError: neither is installed.
        """
        rows = self.json()["trials"]
        for name in ("pandas", "polars"):
            if find_spec(name) is not None:
                return import_module(name).DataFrame(rows)
        raise FungraspError("a frame needs pandas or Polars: pip install pandas")

    def __repr__(self) -> str:
        held = int(np.sum(self.success))
        return (
            f"<LiftTestResult: hand {self.hand!r}, policy {self.policy!r}, {held} of {len(self.index)} held>"
        )


def evaluate(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    policy: str | Path | Policy | PrivilegedPolicy | None = None,
    protocol: ProtocolName | None = None,
    *,
    spec: LiftTestSpec | None = None,
    hand: Hand | None = None,
    human: HumanGraspSet | None = None,
    planner: Planner | None = None,
    record: str | Path | None = None,
    threads: int = 0,
    store: PartStore | None = None,
    ray: RayCluster | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> LiftTestResult:
    """Try each grasp once for each seed.

    Args:
        robot: the grasps.
        objects: by name.
        policy: in the place of the one that ``spec`` names: its name or file, or a policy of one's own.
        protocol: in the place of that of ``spec``.
        spec: what is asked; the defaults if None.
        hand: the hand of the grasps, where it has other dynamics than its files say; theirs if None.
        human: what the grasps were retargeted from: for the use test, and the static quality.
        planner: in the place of the one that belongs to the policy.
        record: folder for the recorded episodes, ``<row>_<object>.npz`` (``<row>_<seed>_<object>.npz`` with
            several seeds), and of the use tests, ``<row>_<object>_use.npz``; with several conditions a folder
            of each.
        threads: 0 means all processors. The result does not depend on it.
        store: keeps finished parts, and knows those of an interrupted run; who calls removes it. Only for a
            policy and a planner that are given by name.
        ray: simulates on a cluster, under the same condition.
        progress: called with the number of episodes that are done, fractions included.

    Raises:
        FungraspError: human grasps, an unknown policy, grasps of another hand, options that do not go
            together, or a folder that can't be written to.
    """
    if not isinstance(robot, RobotGraspSet):
        raise FungraspError(
            f"expected robot grasps, not a {type(robot).__name__}: retarget them first (fungrasp.retarget)"
        )
    spec = spec or LiftTestSpec()
    policy = str(policy) if isinstance(policy, Path) else policy
    own = policy if policy is not None and not isinstance(policy, str) else None
    if policy is not None:
        spec = replace(spec, policy=policy if isinstance(policy, str) else type(policy).__name__)
    if protocol is not None:
        spec = replace(spec, protocol=protocol)
    check_objects(robot.object_name.tolist(), objects)
    record = None if record is None else Path(record)
    job = LiftTest(robot, objects, hand or robot.load_hand(), spec, human, own, planner, record, threads)
    if (store is not None or ray is not None) and not job.is_named():
        raise FungraspError(
            "parts are kept, and sent to a cluster, only for a policy that is given by name and a planner "
            "that has a key"
        )
    start = perf_counter()
    found = run_job(job, store, ray=ray, progress=progress)
    done = list(zip(job.parts(), found, strict=True))
    results = {
        name: _result(job, name, [(part, arrays) for part, arrays in done if part.condition == name])
        for name in spec.conditions
    }
    result = next(iter(results.values()))
    if spec.static and human is not None:
        result = replace(result, quality=static_quality(robot, human, objects, job.hand))
    conditions = results if len(results) > 1 else {}
    seconds = perf_counter() - start
    return replace(result, conditions=conditions, grasps=robot, objects=objects, seconds=seconds)


def _result(job: LiftTest, condition: str, parts: list[tuple[Episodes, Arrays]]) -> LiftTestResult:
    """Of one condition."""
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
        rollouts=merged["rollouts"],
        contact_estimates=ContactEstimates.from_arrays(merged),
        use=UseOutcomes.from_arrays(_without(merged, USE_PREFIX)) if spec.use else None,
        attempts=AttemptRecord.from_arrays(_without(merged, ATTEMPT_PREFIX)) if spec.attempts > 1 else None,
    )


def _without(arrays: Mapping[str, np.ndarray], prefix: str) -> Arrays:
    """Those arrays whose names have a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}

"""The lift test on any number of grasps: reach, grasp, lift, hold (docs/evaluate.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.evaluation.attempts import AttemptRecord
from fungrasp.evaluation.contact_estimate import ContactEstimates
from fungrasp.evaluation.lift_test_chunks import (
    ATTEMPT_PREFIX,
    CHUNK,
    USE_PREFIX,
    Chunk,
    LiftTest,
    Refinement,
    check_hand,
)
from fungrasp.evaluation.use_test import UseTest
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, as_hand
from fungrasp.jobs import PartStore
from fungrasp.objects import ObjectModel, check_objects, with_sizes
from fungrasp.planning import MotionPlanner, Planner
from fungrasp.planning.selection import SelectionSettings
from fungrasp.policies import OpenLoopPolicy, check_attempts, make_planner, make_policy, policy_files
from fungrasp.sim2real import NOMINAL, Randomization
from fungrasp.simulation import SceneSettings, build_scene
from fungrasp.task import LiftProtocol, Outcomes, Policy, PrivilegedPolicy
from fungrasp.task.use import UseOutcomes


@dataclass(frozen=True, eq=False, repr=False)
class LiftTestResult:
    """Outcome of N episodes."""

    hand: str
    """Name of the hand."""
    policy: str
    """Name or file of the policy."""
    protocol: LiftProtocol
    """The numbers of the test."""
    physics: SceneSettings
    """Settings of the engine."""
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
    refined_tries: np.ndarray
    """Episodes that refining the grasp took, 1 if it was not refined, negative where none succeeded;
    shape [N]."""
    rollouts: np.ndarray
    """Episodes that were simulated to plan each grasp, shape [N] int."""
    contact_estimates: ContactEstimates
    """How well the policy knew what it touched, N rows."""
    use: UseOutcomes | None = None
    """Outcomes of the use tests that followed; None if there were none."""
    attempts: AttemptRecord | None = None
    """What became of the attempts; None if there was one only."""
    most_attempts: int = 1
    """Attempts that an episode could have."""

    def __repr__(self) -> str:
        held = int(np.sum(self.outcomes.success))
        return (
            f"<LiftTestResult: hand {self.hand!r}, policy {self.policy!r}, {held} of {len(self.index)} held>"
        )


def evaluate(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand | str,
    policy: str | Policy | PrivilegedPolicy = "reference",
    *,
    planner: Planner | None = None,
    selection: SelectionSettings | None = None,
    seeds: tuple[int, ...] = (0,),
    threads: int = 0,
    protocol: LiftProtocol | None = None,
    physics: SceneSettings | None = None,
    randomization: Randomization = NOMINAL,
    refine: Refinement | None = None,
    use: UseTest | None = None,
    attempts: int = 1,
    record: Path | None = None,
    store: PartStore | None = None,
    chunk: int = CHUNK,
    progress: Callable[[float], None] = lambda done: None,
) -> LiftTestResult:
    """Try each grasp once for each seed.

    Args:
        grasps: of ``hand``.
        objects: by name.
        hand: the robot hand, or its name.
        policy: a policy, or the name or file of one (``fungrasp.policies.make_policy``).
        planner: whose plans it follows; the one that belongs to a policy's name, and ``MotionPlanner`` for a
            policy object, if None.
        selection: how that planner selects among candidates; the defaults if None.
        seeds: of everything that is random.
        threads: 0 means all processors. The result does not depend on it.
        protocol: the published one if None.
        physics: settings of the engine; the defaults if None.
        randomization: how worlds differ from the nominal ones; not at all if left out.
        refine: applied to the grasps, chunk by chunk, before they are tried.
        use: the use test of the grasps, which then follows every lift test that is passed.
        attempts: most attempts of an episode: a policy that watches tries again, by another plan, where it is
            seen to have failed. The published protocol is one.
        record: folder for the recorded episodes, ``<row>_<object>.npz`` (``<row>_<seed>_<object>.npz`` with
            several seeds), and of the use tests, ``<row>_<object>_use.npz``.
        store: keeps finished chunks, and knows those of an earlier run; only for a policy and a planner that
            are given by name.
        chunk: episodes simulated together.
        progress: called with the number of episodes that are done, fractions included.

    Raises:
        FungraspError: an unknown policy, grasps of another hand, or a folder that can't be written to.
    """
    if store is not None and not (isinstance(policy, str) and (planner is None or hasattr(planner, "key"))):
        raise FungraspError(
            "partial results are kept only for a policy that is given by name and a planner that has a key"
        )
    test = make_lift_test(
        grasps,
        objects,
        hand,
        policy,
        planner=planner,
        selection=selection,
        seeds=seeds,
        threads=threads,
        protocol=protocol,
        physics=physics,
        randomization=randomization,
        refine=refine,
        use=use,
        attempts=attempts,
        record=record,
    )
    return run_lift_test(test, store, chunk, progress)


def make_lift_test(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand | str,
    policy: str | Policy | PrivilegedPolicy = "reference",
    *,
    planner: Planner | None = None,
    selection: SelectionSettings | None = None,
    seeds: tuple[int, ...] = (0,),
    threads: int = 0,
    protocol: LiftProtocol | None = None,
    physics: SceneSettings | None = None,
    randomization: Randomization = NOMINAL,
    refine: Refinement | None = None,
    use: UseTest | None = None,
    attempts: int = 1,
    record: Path | None = None,
) -> LiftTest:
    """A test that ``run_lift_test`` runs; ``evaluate`` does both, and says what the arguments are.

    Raises:
        FungraspError: an unknown policy, grasps of another hand, or several attempts where they can't be.
    """
    hand = as_hand(hand)
    check_hand(grasps, hand)
    check_objects(grasps.object_name.tolist(), objects)
    if isinstance(policy, str):
        policy_key = (policy, *policy_files(policy, hand.name).digests())
    else:
        policy_key = (type(policy).__name__, "", "")
    if planner is None:
        planner = (
            make_planner(policy, hand, objects, selection, protocol, threads)
            if isinstance(policy, str)
            else MotionPlanner(hand, objects, protocol=protocol)
        )
    acting = make_policy(policy, hand, objects) if isinstance(policy, str) else policy
    check_attempts(attempts, not isinstance(acting, OpenLoopPolicy))
    if attempts > 1 and record is not None:
        raise FungraspError("an episode of several attempts can't be recorded: record one attempt")
    return LiftTest(
        grasps,
        build_scene(hand, with_sizes(objects, randomization.object_scales), physics),
        objects,
        acting,
        planner,
        policy_key,
        protocol or LiftProtocol(),
        randomization,
        seeds,
        threads,
        refine,
        use,
        record,
        attempts,
    )


def run_lift_test(
    test: LiftTest,
    store: PartStore | None = None,
    chunk: int = CHUNK,
    progress: Callable[[float], None] = lambda done: None,
    together: int = 0,
) -> LiftTestResult:
    """Try each grasp once for each seed.

    Args:
        test: what to run.
        store: keeps finished chunks, and knows those of an earlier run.
        chunk: episodes kept together.
        progress: called with the number of episodes that are done, fractions included.
        together: most episodes of several missing chunks that are simulated together; one chunk at a time if
            it is less than two of them.

    Raises:
        FungraspError: a folder can't be written to.
    """
    chunks = test.chunks(chunk)
    parts = [None if store is None else test.finished(each, store) for each in chunks]
    done = sum(len(each.rows) for each, part in zip(chunks, parts, strict=True) if part is not None)
    progress(done)
    for group in _missing(chunks, parts, together):
        found = test.run(Chunk.join([chunks[i] for i in group]), partial(_report, progress, done))
        for i in group:
            count = len(chunks[i].rows)
            parts[i] = part = {name: values[:count] for name, values in found.items()}
            found = {name: values[count:] for name, values in found.items()}
            if store is not None:
                store.save(test.key(chunks[i]), part)
            done += count
        progress(done)
    kept = [part for part in parts if part is not None]
    merged = {key: np.concatenate([part[key] for part in kept]) for key in kept[0]}
    merged["index"] = np.concatenate([each.rows for each in chunks])
    merged["seed"] = np.concatenate([np.full(len(each.rows), each.seed) for each in chunks])
    index, grasps = merged["index"], test.grasps
    assert grasps.task is not None
    return LiftTestResult(
        hand=test.scene.hand.name,
        policy=test.policy_key[0],
        protocol=test.protocol,
        physics=test.scene.settings,
        randomization=test.randomization,
        index=index,
        seed=merged["seed"],
        object_name=grasps.object_name[index],
        task=grasps.task[index],
        outcomes=Outcomes.from_arrays(merged),
        refined_tries=merged["refined_tries"],
        rollouts=merged["rollouts"],
        contact_estimates=ContactEstimates.from_arrays(merged),
        use=None if test.use is None else UseOutcomes.from_arrays(_without(merged, USE_PREFIX)),
        attempts=None if test.attempts == 1 else AttemptRecord.from_arrays(_without(merged, ATTEMPT_PREFIX)),
        most_attempts=test.attempts,
    )


def _missing(chunks: Sequence[Chunk], parts: Sequence[object], together: int) -> list[list[int]]:
    """Numbers of the chunks without a part, in groups of one seed and so many episodes at most, but for a
    single larger chunk."""
    groups: list[list[int]] = []
    episodes = 0
    for number, (chunk, part) in enumerate(zip(chunks, parts, strict=True)):
        if part is not None:
            continue
        episodes += len(chunk.rows)
        if not groups or episodes > together or chunks[groups[-1][0]].seed != chunk.seed:
            groups.append([])
            episodes = len(chunk.rows)
        groups[-1].append(number)
    return groups


def _without(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Those arrays whose names have a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _report(progress: Callable[[float], None], before: int, done: float) -> None:
    progress(before + done)

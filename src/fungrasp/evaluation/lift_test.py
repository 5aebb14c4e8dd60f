"""The lift test on any number of grasps: reach, grasp, lift, hold (docs/evaluation.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from fungrasp import __version__
from fungrasp.errors import FungraspError
from fungrasp.evaluation.contact_estimate import ContactEstimateMeter, ContactEstimates
from fungrasp.evaluation.partial_results import PartialResults
from fungrasp.evaluation.trajectory import Recorder
from fungrasp.evaluation.use_test import UseTest
from fungrasp.files import digest
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, as_hand
from fungrasp.objects import ObjectModel, check_objects, with_sizes
from fungrasp.planning import MotionPlanner, Planner
from fungrasp.planning.selection import SearchPlanner, SelectionSettings
from fungrasp.policies import StudentPolicy, make_planner, make_policy, policy_files
from fungrasp.simulation import Scene, SceneSettings, build_scene
from fungrasp.task import LiftEnvironment, LiftProtocol, Outcomes, Policy, PrivilegedPolicy, play
from fungrasp.task.use import UseOutcomes
from fungrasp.transfer import NOMINAL, Randomization, draw_each, random_stream

USE_PREFIX = "use."
"""Before the names of the fields of ``UseOutcomes`` where they stand beside those of ``Outcomes``."""

CHUNK = 128
"""Episodes simulated together. It bounds the memory, and an episode does not depend on the others of its
chunk."""


@dataclass(frozen=True)
class Refinement:
    """Improves grasps before they are tried."""

    refine: Callable[[RobotGraspSet, int], RobotGraspSet]
    """Function of grasps and a seed that returns refined grasps."""
    name: str
    """Name of the refinement, settings included."""


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
    record: Path | None = None,
    store: PartialResults | None = None,
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
        record: folder for the recorded episodes, ``<row>_<object>.npz`` (``<row>_<seed>_<object>.npz`` with
            several seeds).
        store: keeps finished chunks, and knows those of an earlier run; only for a policy and a planner that
            are given by name.
        chunk: episodes simulated together.
        progress: called with the number of episodes that are done, fractions included.

    Raises:
        FungraspError: an unknown policy, grasps of another hand, or a folder that can't be written to.
    """
    hand = as_hand(hand)
    check_hand(grasps, hand)
    check_objects(grasps.object_name.tolist(), objects)
    if store is not None and not (isinstance(policy, str) and (planner is None or hasattr(planner, "key"))):
        raise FungraspError(
            "partial results are kept only for a policy that is given by name and a planner that has a key"
        )
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
    test = _Test(
        build_scene(hand, with_sizes(objects, randomization.object_scales), physics),
        objects,
        make_policy(policy, hand, objects) if isinstance(policy, str) else policy,
        planner,
        policy_key,
        protocol or LiftProtocol(),
        randomization,
        threads,
        use,
    )
    parts: list[dict[str, np.ndarray]] = []
    for seed in seeds:
        for start in range(0, len(grasps), chunk):
            rows = np.arange(start, min(start + chunk, len(grasps)))
            before = sum(len(part["index"]) for part in parts)
            files = (
                [record / _file_name(grasps, int(row), seed, len(seeds) > 1) for row in rows]
                if record
                else []
            )
            chosen = grasps.select(rows)
            key = test.key(chosen, rows, seed, refine, files) if store is not None else ""
            part = store.load(key) if store is not None and all(file.is_file() for file in files) else None
            if part is None:
                if refine is not None:
                    chosen = refine.refine(chosen, seed)
                part = test.run(chosen, rows, seed, files, partial(_report, progress, before, len(rows)))
                if store is not None:
                    store.save(key, part)
            parts.append(part | {"index": rows, "seed": np.full(len(rows), seed)})
            progress(before + len(rows))
    merged = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    index = merged["index"]
    assert grasps.task is not None
    return LiftTestResult(
        hand=hand.name,
        policy=test.policy_key[0],
        protocol=test.protocol,
        physics=test.scene.settings,
        randomization=randomization,
        index=index,
        seed=merged["seed"],
        object_name=grasps.object_name[index],
        task=grasps.task[index],
        outcomes=Outcomes.from_arrays(merged),
        refined_tries=merged["refined_tries"],
        rollouts=merged["rollouts"],
        contact_estimates=ContactEstimates.from_arrays(merged),
        use=None if use is None else UseOutcomes.from_arrays(_without(merged, USE_PREFIX)),
    )


def check_hand(grasps: RobotGraspSet, hand: Hand) -> None:
    """Complain about grasps of another hand.

    Raises:
        FungraspError: human grasps, another name, other joints or other contact links.
    """
    if not isinstance(grasps, RobotGraspSet):
        raise FungraspError(
            f"expected robot grasps, not a {type(grasps).__name__}: retarget them first "
            "(fungrasp.retarget.retarget)"
        )
    if grasps.hand != hand.name:
        raise FungraspError(f"the grasps are of the hand '{grasps.hand}', not of '{hand.name}'")
    if grasps.joint_names != hand.joint_names or grasps.link_contacts.shape[1] != len(hand.links):
        raise FungraspError(
            f"the grasps were made for another version of the hand '{hand.name}': retarget again"
        )


def _file_name(grasps: RobotGraspSet, row: int, seed: int, several: bool) -> str:
    label = f"_{seed}" if several else ""
    return f"{row:04d}{label}_{grasps.object_name[row]}.npz"


def _without(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Those arrays whose names have a prefix, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _report(progress: Callable[[float], None], before: int, count: int, share: float) -> None:
    progress(before + share * count)


@dataclass(frozen=True, eq=False)
class _Test:
    """Settings that all chunks share."""

    scene: Scene
    objects: Mapping[str, ObjectModel]
    policy: Policy | PrivilegedPolicy
    planner: Planner
    policy_key: tuple[str, str, str]
    """Name of the policy, digests of its network and of its success predictor."""
    protocol: LiftProtocol
    randomization: Randomization
    threads: int
    use: UseTest | None = None

    def key(
        self,
        grasps: RobotGraspSet,
        rows: np.ndarray,
        seed: int,
        refine: Refinement | None,
        files: list[Path],
    ) -> str:
        """Digest of all that the outcome depends on."""
        hand = self.scene.hand
        names = np.unique(grasps.object_name).tolist()
        return digest(
            __version__,
            mujoco.__version__,
            hand.path.read_bytes(),
            hand.model_path.read_bytes(),
            {name: asdict(servo) for name, servo in hand.actuators.items()},
            {name: getattr(grasps, name) for name in grasps.FIELDS},
            grasps.extra,
            {name: self.objects[name].digest for name in names},
            self.policy_key,
            getattr(self.planner, "key", ""),
            self.protocol,
            self.randomization,
            self.scene.settings,
            rows,
            seed,
            refine.name if refine is not None else "",
            [str(file.absolute()) for file in files],
            "" if self.use is None else self.use.key(rows),
        )

    def run(
        self,
        grasps: RobotGraspSet,
        rows: np.ndarray,
        seed: int,
        files: list[Path],
        progress: Callable[[float], None],
    ) -> dict[str, np.ndarray]:
        """Fields of ``Outcomes`` and ``ContactEstimates``, ``refined_tries`` and ``rollouts``, each of shape
        [W].

        Args:
            grasps: W grasps.
            rows: of the grasps in their set, shape [W].
            seed: of what is random.
            files: to record the episodes to, W of them or none.
            progress: called with the share that is done.
        """
        hand, r, p = self.scene.hand, self.randomization, self.protocol
        sample = draw_each(r, seed, rows, len(hand.joint_names))
        jitter = [random_stream("sensor jitter", seed, int(row)) for row in rows]
        environment = LiftEnvironment(self.scene, len(rows), r, p, jitter, self.threads)
        belief = environment.settle(grasps, sample)
        # A searching planner takes most of the time: half of the progress is its.
        half = 0.5 if isinstance(self.planner, SearchPlanner) else 0.0
        plan = self.planner.plan(grasps, belief, seed, lambda done: progress(half * done / len(rows)))
        environment.move_objects()
        recorder = Recorder(environment.task, grasps, r) if files else None
        longest = p.approach_time + p.hold_time + 1.2

        def watch() -> None:
            progress(half + (1 - half) * min(float(environment.task.time.max()) / longest, 1.0))
            if recorder is not None:
                recorder()

        policy, estimates = self.policy, ContactEstimates.none(len(rows))
        if isinstance(policy, StudentPolicy) and policy.estimates_contacts:
            policy = ContactEstimateMeter(policy, environment)
            estimates = policy.estimates
        outcomes = play(environment, policy, plan, watch=watch)
        if recorder is not None:
            for trajectory, file in zip(recorder.trajectories(rows), files, strict=True):
                trajectory.save(file)
        use = {}
        if self.use is not None:
            assert grasps.task is not None
            tried = self.use.run(environment, rows, grasps.task.tolist(), outcomes.success)
            use = {USE_PREFIX + name: values for name, values in tried.arrays().items()}
        none = np.zeros(len(rows), dtype=int)
        return (
            outcomes.arrays()
            | estimates.arrays()
            | use
            | {
                "refined_tries": grasps.extra.get("refined_tries", none + 1),
                "rollouts": none if plan.rollouts is None else plan.rollouts,
            }
        )

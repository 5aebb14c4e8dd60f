"""The dynamic test on any number of grasps: reach, grasp, lift, hold (docs/evaluation.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np

from fungrasp import __version__
from fungrasp.errors import FungraspError
from fungrasp.evaluation.partial_results import PartialResults
from fungrasp.evaluation.robustness import Disturbance
from fungrasp.evaluation.trajectory import Recorder
from fungrasp.files import digest
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.selection.search import Planner
from fungrasp.policies import chooses, make_policy, play, resolve_policy
from fungrasp.policies.checkpoint.checkpoint_file import read_card
from fungrasp.simulation import Scene, build_scene
from fungrasp.task import LiftTask, Protocol, Trials

CHUNK = 128
"""Trials simulated together. It bounds the memory, and a trial does not depend on the others of its chunk."""


@dataclass(frozen=True)
class Refinement:
    """Improves grasps before they are tried."""

    refine: Callable[[RobotGraspSet, int], RobotGraspSet]
    """Takes grasps and a seed."""
    name: str
    """Tells refinements apart, settings included."""


@dataclass(frozen=True, eq=False)
class DynamicResult:
    """Outcome of N trials."""

    hand: str
    policy: str
    protocol: Protocol
    disturbance: Disturbance
    index: np.ndarray
    """Row of each trial's grasp in the set, shape [N]."""
    seed: np.ndarray
    """Of each trial, shape [N]."""
    object_name: np.ndarray
    """Shape [N] str."""
    task: np.ndarray
    """What the grasp is for, shape [N] str."""
    trials: Trials
    """Each field of shape [N]."""
    legacy_success: np.ndarray
    """Whether the object did not touch the table during the hold, at whatever height: the definition of
    earlier published code; shape [N] bool."""
    refined_tries: np.ndarray
    """Trials that refining the grasp took, 1 if it was not refined, negative where none succeeded;
    shape [N]."""
    rehearsed: bool = False
    """Whether the policy chose among plans and tried them in a simulation of its own first."""


def evaluate(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    policy: str = "reference",
    *,
    seeds: tuple[int, ...] = (0,),
    threads: int = 0,
    protocol: Protocol | None = None,
    disturbance: Disturbance | None = None,
    refine: Refinement | None = None,
    planner: Planner | None = None,
    record: Path | None = None,
    store: PartialResults | None = None,
    chunk: int = CHUNK,
    progress: Callable[[float], None] = lambda done: None,
) -> DynamicResult:
    """Try each grasp once for each seed.

    Args:
        grasps: of ``hand``.
        objects: by name.
        hand: the robot hand.
        policy: name or file, see ``fungrasp.policies.resolve_policy``.
        seeds: of everything that is random.
        threads: 0 means all processors. The result does not depend on it.
        protocol: the published one if None.
        disturbance: what the policy is not told; nothing if None.
        refine: applied to the grasps, chunk by chunk, before they are tried.
        planner: of policies that choose what to follow; one with the default settings if None.
        record: folder for the recorded trials, ``<row>_<object>.npz`` (``<row>_<seed>_<object>.npz`` with
            several seeds).
        store: keeps finished chunks, and knows those of an earlier run.
        chunk: trials simulated together.
        progress: called with the number of trials that are done, fractions included.

    Raises:
        FungraspError: an unknown policy, grasps of another hand, or a folder that can't be written to.
    """
    weights = check_policy(policy, hand)
    check_hand(grasps, hand)
    test = _Test(
        build_scene(hand, objects),
        objects,
        policy,
        weights,
        protocol or Protocol(),
        disturbance or Disturbance(),
        planner or Planner(threads=threads),
        threads,
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
    return DynamicResult(
        hand=hand.name,
        policy=policy,
        protocol=test.protocol,
        disturbance=test.disturbance,
        index=index,
        seed=merged["seed"],
        object_name=grasps.object_name[index],
        task=grasps.task[index],
        trials=Trials(**{field.name: merged[field.name] for field in fields(Trials)}),
        legacy_success=merged["legacy_success"],
        refined_tries=merged["refined_tries"],
        rehearsed=test.planner.settings.rehearsal is not None and chooses(policy, hand.name),
    )


def check_policy(name: str, hand: Hand) -> str:
    """Complain about a policy that does not exist or can't be read.

    Returns:
        The SHA-256 of its file; "" for a policy without weights.

    Raises:
        FungraspError: it does not.
    """
    path = resolve_policy(name, hand.name)
    return "" if path is None else read_card(path).sha256


def check_hand(grasps: RobotGraspSet, hand: Hand) -> None:
    """Complain about grasps of another hand.

    Raises:
        FungraspError: another name, other joints or other contact links.
    """
    if grasps.hand != hand.name:
        raise FungraspError(f"the grasps are of the hand '{grasps.hand}', not of '{hand.name}'")
    if grasps.joint_names != hand.joint_names or grasps.link_contacts.shape[1] != len(hand.links):
        raise FungraspError(
            f"the grasps were made for another version of the hand '{hand.name}': retarget again"
        )


def _file_name(grasps: RobotGraspSet, row: int, seed: int, several: bool) -> str:
    label = f"_{seed}" if several else ""
    return f"{row:04d}{label}_{grasps.object_name[row]}.npz"


def _report(progress: Callable[[float], None], before: int, count: int, share: float) -> None:
    progress(before + share * count)


@dataclass(frozen=True, eq=False)
class _Test:
    """What the chunks have in common."""

    scene: Scene
    objects: Mapping[str, ObjectModel]
    policy: str
    weights: str
    protocol: Protocol
    disturbance: Disturbance
    planner: Planner
    threads: int

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
            hand.path.read_bytes(),
            hand.model_path.read_bytes(),
            {name: getattr(grasps, name) for name in grasps.FIELDS},
            grasps.extra,
            {name: self.objects[name].digest for name in names},
            self.policy,
            self.weights,
            self.protocol,
            self.disturbance,
            self.planner.settings,
            self.scene.settings,
            rows,
            seed,
            refine.name if refine is not None else "",
            [str(file.absolute()) for file in files],
        )

    def run(
        self,
        grasps: RobotGraspSet,
        rows: np.ndarray,
        seed: int,
        files: list[Path],
        progress: Callable[[float], None],
    ) -> dict[str, np.ndarray]:
        """Fields of ``Trials``, ``legacy_success`` and ``refined_tries``, each of shape [W].

        Args:
            grasps: W grasps.
            rows: of the grasps in their set, shape [W].
            seed: of what is random.
            files: to record the trials to, W of them or none.
            progress: called with the share that is done.
        """
        d = self.disturbance
        task = LiftTask(
            self.scene, d.placed(grasps), d.worlds(self.scene, grasps, self.threads), self.protocol
        )
        task.reset()
        centers = np.array([self.objects[name].center_of_mass for name in grasps.object_name.tolist()])
        policy = make_policy(
            self.policy, d.disturb(task, centers, seed, rows), self.objects, self.planner, seed
        )
        push = d.pusher(task, seed, rows)
        recorder = Recorder(task) if files else None
        touched = np.zeros(len(rows), dtype=bool)

        p = self.protocol
        longest = p.approach_time + p.hold_time + 1.2

        def watch() -> None:
            nonlocal touched
            touched = touched | (np.isfinite(task.hold_time) & ~task.done & task.worlds.object_on_table)
            push()
            progress(min(float(task.time.max()) / longest, 1.0))
            if recorder is not None:
                recorder()

        trials = play(task, policy, watch)
        if recorder is not None:
            for trajectory, file in zip(recorder.trajectories(rows), files, strict=True):
                trajectory.save(file)
        return {field.name: getattr(trials, field.name) for field in fields(trials)} | {
            "legacy_success": ~touched & (trials.reason != "the simulation diverged"),
            "refined_tries": grasps.extra.get("refined_tries", np.ones(len(grasps), dtype=int)),
        }

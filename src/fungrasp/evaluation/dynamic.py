"""The dynamic test on any number of grasps: reach, grasp, lift, hold (docs/evaluation.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol as Interface

import numpy as np

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.evaluation.robustness import Disturbance
from fungrasp.evaluation.trajectory import Recorder
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.reference import ReferenceController
from fungrasp.simulation import Scene, build_scene
from fungrasp.task import LiftTask, Protocol, Trials

CHUNK = 128
"""Trials simulated together. It bounds the memory, and a trial does not depend on the others of its chunk."""

POLICIES: Mapping[str, Callable[[LiftTask, Mapping[str, ObjectModel]], ReferenceController]] = {
    "reference": ReferenceController
}

Refine = Callable[[RobotGraspSet, int], RobotGraspSet]
"""Improves grasps before they are tried; takes them and a seed."""


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


class Store(Interface):
    """Keeps finished chunks, so that an interrupted test can go on."""

    def load(self, name: str) -> dict[str, np.ndarray] | None:
        """Arrays of a finished chunk, None if it is not finished."""
        ...

    def save(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of a chunk."""
        ...


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
    refine: Refine | None = None,
    record: Path | None = None,
    store: Store | None = None,
    chunk: int = CHUNK,
    progress: Callable[[float], None] = lambda done: None,
) -> DynamicResult:
    """Try each grasp once for each seed.

    Args:
        grasps: of ``hand``.
        objects: by name.
        hand: the robot hand.
        policy: one of ``POLICIES``.
        seeds: of everything that is random.
        threads: 0 means all processors. The result does not depend on it.
        protocol: the published one if None.
        disturbance: what the policy is not told; nothing if None.
        refine: applied to the grasps, chunk by chunk, before they are tried.
        record: folder for the recorded trials, ``<row>_<object>.npz`` (with several seeds ``<row>_<seed>_...``).
        store: keeps finished chunks.
        chunk: trials simulated together.
        progress: called with the number of trials that are done, fractions included.

    Raises:
        FungraspError: an unknown policy, grasps of another hand, or a folder that can't be written to.
    """
    if policy not in POLICIES:
        raise UnknownNameError("policy", policy, POLICIES)
    check_hand(grasps, hand)
    test = _Test(
        build_scene(hand, objects),
        objects,
        policy,
        protocol or Protocol(),
        disturbance or Disturbance(),
        threads,
    )
    parts: list[dict[str, np.ndarray]] = []
    for turn, seed in enumerate(seeds):
        for start in range(0, len(grasps), chunk):
            rows = np.arange(start, min(start + chunk, len(grasps)))
            before = turn * len(grasps) + start
            name = f"seed {seed} rows {start}"
            part = store.load(name) if store is not None else None
            if part is None:
                chosen = grasps.select(rows)
                if refine is not None:
                    chosen = refine(chosen, seed)
                label = None if record is None else (record, f"_{seed}" if len(seeds) > 1 else "")
                part = test.run(
                    chosen, rows, seed, label, lambda share, b=before, n=len(rows): progress(b + share * n)
                )
                if store is not None:
                    store.save(name, part)
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
    )


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


@dataclass(frozen=True, eq=False)
class _Test:
    scene: Scene
    objects: Mapping[str, ObjectModel]
    policy: str
    protocol: Protocol
    disturbance: Disturbance
    threads: int

    def run(
        self,
        grasps: RobotGraspSet,
        rows: np.ndarray,
        seed: int,
        record: tuple[Path, str] | None,
        progress: Callable[[float], None],
    ) -> dict[str, np.ndarray]:
        """Fields of ``Trials`` and ``legacy_success``, each of shape [W]. progress: called with the share that is done."""
        d = self.disturbance
        task = LiftTask(
            self.scene, d.placed(grasps), d.worlds(self.scene, grasps, self.threads), self.protocol
        )
        task.reset()
        centers = np.array([self.objects[name].center_of_mass for name in grasps.object_name.tolist()])
        policy = POLICIES[self.policy](d.seen_by_policy(task, centers, seed, rows), self.objects)
        recorder = Recorder(task) if record is not None else None
        touched = np.zeros(len(rows), dtype=bool)

        def watch() -> None:
            nonlocal touched
            touched = touched | (np.isfinite(task.hold_time) & ~task.done & task.worlds.object_on_table)
            if recorder is not None:
                recorder()

        p = self.protocol
        longest = p.approach_time + p.hold_time + 1.2
        while not task.done.all():
            task.step(policy.act(), watch)
            progress(min(task.time / longest, 1.0))
        trials = task.trials()
        if record is not None and recorder is not None:
            folder, label = record
            for trajectory in recorder.trajectories(rows):
                trajectory.save(folder / f"{trajectory.index:04d}{label}_{trajectory.object_name}.npz")
        return {field.name: getattr(trials, field.name) for field in fields(trials)} | {
            "legacy_success": ~touched & (trials.reason != "the simulation diverged")
        }

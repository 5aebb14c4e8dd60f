"""The references to train on: planned once, with many variations of each grasp against memorising."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning.references import References
from fungrasp.planning.selection.candidates import expect
from fungrasp.planning.selection.variations import Spread, vary, with_settings
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.policies.scripted import planned
from fungrasp.simulation import Worlds, build_scene
from fungrasp.task import LiftTask

CHUNK = 256
"""Grasps planned together."""


@dataclass(frozen=True)
class Variety:
    """How many variations of a grasp there are, and how they differ."""

    copies: int = 8
    """Of each grasp."""
    tries: int = 24
    """Variations that a critic chooses these copies from, if there is one; else the grasp as it is, and
    ``copies`` - 1 variations, are taken as they come."""
    spread: Spread = field(default_factory=Spread)

    def __post_init__(self) -> None:
        if self.copies < 1:
            raise FungraspError(f"training needs at least one copy of each grasp, not {self.copies}")
        if self.tries < self.copies:
            raise FungraspError(f"{self.copies} copies can't be chosen from {self.tries} variations")

    def planned(self, with_critic: bool) -> int:
        """References that are planned for each grasp."""
        return self.tries if with_critic else self.copies


@dataclass(frozen=True, eq=False)
class Library:
    """References to train on."""

    references: References
    group: np.ndarray
    """Which grasp each reference is a copy of, shape [N] int."""


def build_library(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    variety: Variety,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
    critic: PolicyNetwork | None = None,
) -> Library:
    """Plan the motions of variations of grasps.

    Args:
        grasps: of ``hand``.
        objects: by name.
        hand: the robot hand.
        variety: of the copies.
        seed: of the variations.
        threads: 0 means all processors.
        progress: called with the number of references that are planned.
        critic: of plans: the most promising variations become the copies.

    Raises:
        FungraspError: no grasp of the set has a finite plan, or the critic was made for another hand.
    """
    tries = variety.planned(critic is not None)
    group, attempt = np.repeat(np.arange(len(grasps)), tries), np.tile(np.arange(tries), len(grasps))
    start, scene = with_settings(grasps), build_scene(hand, objects)
    parts, expected = [], []
    for first in range(0, len(group), CHUNK):
        rows = slice(first, first + CHUNK)
        part = vary(start.select(group[rows]), hand, group[rows], attempt[rows], seed, variety.spread)
        index = scene.indices(part.object_name.tolist())
        task = LiftTask(scene, part, Worlds(scene, index, part.object_mass, threads=threads))
        task.reset()
        parts.append(References.of(planned(task, objects), part, task.settled_pose, hand))
        if critic is not None:
            expected.append(expect(critic, hand, parts[-1], objects, 1 / task.protocol.control_period))
        progress(first + len(part))
    references = References.join(parts)
    chosen = _usable(references)
    if critic is not None:
        score = np.where(chosen, np.concatenate(expected), -1.0).reshape(len(grasps), tries)
        best = np.argsort(-score, axis=1, kind="stable")[:, : variety.copies]
        among = np.zeros(score.shape, dtype=bool)
        np.put_along_axis(among, best, True, axis=1)
        chosen &= among.ravel()
    if not chosen.any():
        raise FungraspError("none of the grasps can be trained on: no object settles, or no plan is finite")
    rows = np.flatnonzero(chosen)
    return Library(references.select(rows), group[rows])


def _usable(references: References) -> np.ndarray:
    """Finite, and the object is on the table."""
    motion = references.motion
    finite = np.isfinite(motion.wrist_goal).all(axis=(1, 2)) & np.isfinite(motion.finger_targets).all(
        axis=(1, 2)
    )
    settled = references.settled_pose
    return finite & np.isfinite(settled).all(axis=1) & (np.abs(settled[:, 2]) < 0.5)

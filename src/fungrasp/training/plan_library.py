"""The plans to train on: made once, with many variations of each grasp against memorising."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.planning import MotionPlanner
from fungrasp.planning.selection.candidates import VariationSpread, vary, with_settings
from fungrasp.planning.selection.success_predictor import SuccessPredictor
from fungrasp.simulation import build_scene
from fungrasp.task import GraspPlan, LiftEnvironment

CHUNK = 256
"""Grasps planned together."""


@dataclass(frozen=True)
class Variety:
    """How many variations of a grasp there are, and how they differ."""

    copies: int = 8
    """Perturbed copies of each grasp."""
    tries: int = 24
    """Variations that a success predictor chooses these copies from, if there is one; else the grasp as it
    is, and ``copies`` - 1 variations, are taken as they come."""
    spread: VariationSpread = field(default_factory=VariationSpread)
    """How far the variations differ from the grasp."""

    def __post_init__(self) -> None:
        if self.copies < 1:
            raise FungraspError(f"training needs at least one copy of each grasp, not {self.copies}")
        if self.tries < self.copies:
            raise FungraspError(f"{self.copies} copies can't be chosen from {self.tries} variations")

    def planned(self, with_predictor: bool) -> int:
        """Plans that are made for each grasp."""
        return self.tries if with_predictor else self.copies


@dataclass(frozen=True, eq=False)
class PlanLibrary:
    """Plans to train on."""

    plans: GraspPlan
    """The plans, N rows."""
    group: np.ndarray
    """Row of the grasp that each plan is a copy of, shape [N] int."""


def build_plan_library(
    grasps: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    hand: Hand,
    variety: Variety,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
    predictor: SuccessPredictor | None = None,
) -> PlanLibrary:
    """Plan the motions of variations of grasps.

    Args:
        predictor: of success: the most promising variations become the copies.

    Raises:
        FungraspError: no grasp of the set has a finite plan, or the predictor was made for another hand.
    """
    tries = variety.planned(predictor is not None)
    group, attempt = np.repeat(np.arange(len(grasps)), tries), np.tile(np.arange(tries), len(grasps))
    start, scene = with_settings(grasps), build_scene(hand, objects)
    planner = MotionPlanner(hand, objects)
    parts, expected = [], []
    for first in range(0, len(group), CHUNK):
        rows = slice(first, first + CHUNK)
        part = vary(start.select(group[rows]), hand, group[rows], attempt[rows], seed, variety.spread)
        belief = LiftEnvironment(scene, len(part), threads=threads).settle(part)
        parts.append(planner.plan(part, belief))
        if predictor is not None:
            expected.append(predictor(parts[-1]))
        progress(first + len(part))
    plans = GraspPlan.join(parts)
    chosen = _usable(plans)
    if predictor is not None:
        score = np.where(chosen, np.concatenate(expected), -1.0).reshape(len(grasps), tries)
        best = np.argsort(-score, axis=1, kind="stable")[:, : variety.copies]
        among = np.zeros(score.shape, dtype=bool)
        np.put_along_axis(among, best, True, axis=1)
        chosen &= among.ravel()
    if not chosen.any():
        raise FungraspError("none of the grasps can be trained on: no object settles, or no plan is finite")
    rows = np.flatnonzero(chosen)
    return PlanLibrary(plans.select(rows), group[rows])


def _usable(plans: GraspPlan) -> np.ndarray:
    """Finite, and the object is on the table."""
    finite = np.isfinite(plans.palm_goal).all(axis=(1, 2)) & np.isfinite(plans.finger_targets).all(
        axis=(1, 2)
    )
    settled = plans.object_pose
    return finite & np.isfinite(settled).all(axis=1) & (np.abs(settled[:, 2]) < 0.5)

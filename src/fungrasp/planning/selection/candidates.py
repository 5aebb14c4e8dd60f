"""Candidates: variations of grasps, their plans, and how their rollouts went."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    quaternion_from_rotation_vector,
    rotate,
    transform_points,
)
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.planning.grasp_motion import MotionSettings
from fungrasp.planning.planner import Planner
from fungrasp.planning.selection.settings import VariationSpread
from fungrasp.task import Belief, GraspPlan


def with_settings(grasps: RobotGraspSet, settings: MotionSettings | None = None) -> RobotGraspSet:
    """The grasps with the settings of their motion written out in ``extra`` where they have none."""
    s = settings or MotionSettings()
    count = len(grasps)
    defaults = {
        "force_scale": np.ones(count),
        "press_down": np.full(count, s.press_down),
        "press_in": np.full(count, s.press_in),
    }
    return replace(grasps, extra={**defaults, **grasps.extra})


def _touched_points(grasps: RobotGraspSet) -> np.ndarray:
    """Mean of where the links touch that should, world frame [m], shape [N, 3]; of the key points where the
    person's places are not known, or none is wanted."""
    middle = grasps.keypoints.mean(axis=1)
    if grasps.shown_places is None:
        return middle
    places = transform_points(grasps.object_pose, grasps.shown_places)
    wanted = grasps.link_contacts[:, 1:, None]
    mean = (places * wanted).sum(axis=1) / np.maximum(wanted.sum(axis=1), 1)
    return np.where(wanted.any(axis=1), mean, middle)


def vary(
    grasps: RobotGraspSet,
    hand: Hand,
    indices: np.ndarray,
    attempts: np.ndarray,
    seed: int,
    spread: VariationSpread,
) -> RobotGraspSet:
    """Grasps with wrist, fingers, squeeze and last press varied; each depends on seed, index and attempt
    alone.

    Args:
        grasps: N grasps that have settings (``with_settings``).
        indices: a number for each grasp, shape [N].
        attempts: a number for each variation of a grasp, 0 for the grasp as it is, shape [N].
    """
    kinematics = HandKinematics(hand, 1)
    independent = hand.independent(grasps.joint_positions)
    size = independent.shape[1]
    noise = np.stack(
        [
            np.random.default_rng([seed, int(i), int(a)]).normal(size=10 + size)
            for i, a in zip(indices, attempts, strict=True)
        ]
    )
    noise *= (attempts > 0)[:, None]
    # The wrist turns about where the fingers touch, so that they stay there: x -> center + turn (x - center).
    center = inverse_transform_points(grasps.wrist_pose, _touched_points(grasps)[:, None])[:, 0]
    turn = quaternion_from_rotation_vector(spread.rotation * noise[:, 3:6])
    shift = np.concatenate([center - rotate(turn, center) + spread.position * noise[:, :3], turn], axis=1)
    fingers = independent * (1 + spread.closing * noise[:, 6:7]) + spread.joints * noise[:, 10:]
    fingers = np.clip(fingers, kinematics.lower, kinematics.upper)
    extra = dict(grasps.extra)
    extra["force_scale"] = np.clip(extra["force_scale"] * np.exp(spread.force * noise[:, 7]), 0.3, 3.0)
    for name, column in (("press_down", 8), ("press_in", 9)):
        extra[name] = np.clip(extra[name] + 0.5 * spread.press * noise[:, column], 0.0, 1.5 * spread.press)
    return replace(
        grasps,
        wrist_pose=compose(grasps.wrist_pose, shift),
        joint_positions=hand.all_joints(fingers),
        extra=extra,
    )


HOPE, HOPE_WEIGHT = 0.7, 2.0
"""Success expected of a candidate before its first rollout, and the number of rollouts that this stands for:
one that fails at once comes after those not tried yet, one that holds comes first."""


@dataclass(frozen=True, eq=False)
class Tally:
    """How the rollouts of K candidates of each of G grasps went; all arrays have the shape [K, G]."""

    possible: np.ndarray
    """Candidates that can be carried out, bool; others are never tried."""
    tried: np.ndarray
    """Number of rollouts of each candidate."""
    held: np.ndarray
    """Number of rollouts that succeeded."""
    shown: np.ndarray
    """Number of those in which the object was held as shown."""
    bonus: np.ndarray
    """Sum over the rollouts of the weighted shown share and contact ratio less the weighted slip."""

    @classmethod
    def untried(cls, shape: tuple[int, int]) -> Tally:
        """Before any rollout."""
        return cls(np.ones(shape, dtype=bool), *(np.zeros(shape) for _ in range(4)))

    def hope(self, other_places: float, share: float) -> np.ndarray:
        """The larger, the sooner a candidate is tried: success as shown if ``HOPE`` was expected, and the
        bonus.

        Args:
            other_places: what success otherwise than shown counts.
            share: bonus of a rollout that is expected before the first.
        """
        bonus = (self.bonus + HOPE_WEIGHT * share) / (self.tried + HOPE_WEIGHT)
        return np.where(self.possible, self.hoped(other_places) + bonus, -np.inf)

    def hoped(self, other_places: float) -> np.ndarray:
        """Success as shown after the rollouts if ``HOPE`` was expected before."""
        counted = self.shown + other_places * (self.held - self.shown)
        return (counted + HOPE_WEIGHT * HOPE) / (self.tried + HOPE_WEIGHT)

    def expected(self, counted: np.ndarray) -> np.ndarray:
        """Share of the rollouts that ``counted``; ``HOPE_WEIGHT`` more are added that go like those of all
        candidates of the grasp, so that luck counts less where little holds."""
        common = (counted.sum(axis=0) + HOPE_WEIGHT * HOPE) / (self.tried.sum(axis=0) + HOPE_WEIGHT)
        mean = (counted + HOPE_WEIGHT * common) / (self.tried + HOPE_WEIGHT)
        return np.where(self.possible, mean, 0.0)

    def best(self, other_places: float) -> np.ndarray:
        """Candidates of each grasp, the best first; those that were tried before the others."""
        shown, held = self.expected(self.shown), self.expected(self.held)
        value = shown + other_places * np.maximum(held - shown, 0.0) + self.bonus / np.maximum(self.tried, 1)
        return np.lexsort((~self.possible, -value, self.tried == 0), axis=0)

    def add(
        self,
        candidates: np.ndarray,
        grasps: np.ndarray,
        held: np.ndarray,
        shown: np.ndarray,
        bonus: np.ndarray,
    ) -> None:
        """Count one rollout each of different candidates, shape [R]."""
        self.tried[candidates, grasps] += 1
        for total, values in ((self.held, held), (self.shown, shown), (self.bonus, bonus)):
            total[candidates, grasps] += values

    def select(self, candidates: np.ndarray, grasps: np.ndarray) -> Tally:
        """Of candidates, shape [P, S], of some grasps, shape [S]."""
        return Tally(*(getattr(self, f.name)[candidates, grasps] for f in fields(self)))

    def join(self, other: Tally) -> Tally:
        """These and more candidates of the same grasps."""
        return Tally(*(np.concatenate([getattr(t, f.name) for t in (self, other)]) for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Candidates:
    """K candidates of each of G grasps, those of one variation after those of another: candidate k of grasp g
    is row k G + g."""

    grasps: RobotGraspSet
    """The varied grasps, K G rows."""
    plans: GraspPlan
    """Plans of the varied grasps, K G rows."""
    tally: Tally
    """How their rollouts went, arrays of shape [K, G]."""

    def best(self, other_places: float) -> GraspPlan:
        """The best plan of each grasp, with what is expected of it."""
        tally, grasps = self.tally, np.arange(self.tally.tried.shape[1])
        best = tally.best(other_places)[0]
        return replace(
            self.plans.select(best * len(grasps) + grasps),
            expected_success=tally.expected(tally.held)[best, grasps],
            expected_as_shown=tally.expected(tally.shown)[best, grasps],
            rollouts=tally.tried.sum(axis=0).astype(int),
        )

    def of(self, grasps: np.ndarray) -> Candidates:
        """The candidates of some grasps, shape [S] of indices."""
        count, size = self.tally.tried.shape
        candidates = np.arange(count)[:, None]
        rows = (candidates * size + grasps).ravel()
        return Candidates(
            self.grasps.select(rows), self.plans.select(rows), self.tally.select(candidates, grasps)
        )

    def join(self, other: Candidates) -> Candidates:
        """These and more candidates of the same grasps."""
        return Candidates(
            RobotGraspSet.concatenate([self.grasps, other.grasps]),
            GraspPlan.join([self.plans, other.plans]),
            self.tally.join(other.tally),
        )


def propose(
    planner: Planner,
    hand: Hand,
    beliefs: Belief,
    grasps: RobotGraspSet,
    attempts: np.ndarray,
    spread: VariationSpread,
    seed: int,
    search: int,
    chunk: int,
) -> Candidates:
    """Plan variations of grasps.

    Args:
        beliefs: of G grasps.
        grasps: to vary, G after G, K G of them.
        attempts: number of each variation, shape [K G].
        search: another number of the variations.
    """
    count = len(beliefs)
    where = np.resize(np.arange(count), len(grasps))
    varied = vary(grasps, hand, np.full(len(grasps), search), attempts, seed, spread)
    plans = []
    for first in range(0, len(grasps), chunk):
        rows = slice(first, first + chunk)
        plans.append(planner.plan(varied.select(rows), beliefs.select(where[rows])))
    tally = Tally.untried((len(grasps) // count, count))
    return Candidates(varied, GraspPlan.join(plans), tally)

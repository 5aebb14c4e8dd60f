"""Candidates: variations of grasps, their plans, and results of their rollouts."""

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
    """Add the motion settings to ``extra`` of grasps that lack them."""
    s = MotionSettings.given(settings)
    count = len(grasps)
    defaults = {
        "force_scale": np.ones(count),
        "press_down": np.full(count, s.press_down),
        "press_in": np.full(count, s.press_in),
    }
    return replace(grasps, extra={**defaults, **grasps.extra})


def _touched_points(grasps: RobotGraspSet) -> np.ndarray:
    """Return the mean of the target links' shown contacts, world frame [m], shape [N, 3]; the mean of the key
    points if there are none."""
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
    """Vary wrist, fingers, squeeze and press of grasps. Each variation depends only on seed, index and
    attempt.

    Args:
        grasps: N grasps with settings (``with_settings``).
        indices: number of each grasp, shape [N].
        attempts: number of each variation, 0 for the unchanged grasp, shape [N].
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
    # The wrist turns about the contacts, which keeps the fingers there: x -> center + turn (x - center).
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
"""Prior success probability of a candidate, and its weight in rollouts: a candidate that fails at once ranks
below untried ones, and one that holds ranks first."""


@dataclass(frozen=True, eq=False)
class Tally:
    """Results of the rollouts of K candidates of each of G grasps; all arrays have shape [K, G]."""

    possible: np.ndarray
    """Whether the candidate is feasible, bool; others are never tried."""
    tried: np.ndarray
    """Number of rollouts of each candidate."""
    held: np.ndarray
    """Number of successful rollouts."""
    shown: np.ndarray
    """Number of rollouts in which the object was held as shown."""
    bonus: np.ndarray
    """Sum over the rollouts of weighted shown share plus weighted contact ratio minus weighted slip."""

    @classmethod
    def untried(cls, shape: tuple[int, int]) -> Tally:
        """Create results without rollouts."""
        return cls(np.ones(shape, dtype=bool), *(np.zeros(shape) for _ in range(4)))

    def hope(self, other_places: float, share: float) -> np.ndarray:
        """Return the priority of each candidate: success as shown (``hoped``) plus mean bonus.

        Args:
            other_places: value of a success that is not as shown.
            share: prior of the bonus.
        """
        bonus = (self.bonus + HOPE_WEIGHT * share) / (self.tried + HOPE_WEIGHT)
        return np.where(self.possible, self.hoped(other_places) + bonus, -np.inf)

    def hoped(self, other_places: float) -> np.ndarray:
        """Return the mean success as shown, with the prior ``HOPE``."""
        counted = self.shown + other_places * (self.held - self.shown)
        return (counted + HOPE_WEIGHT * HOPE) / (self.tried + HOPE_WEIGHT)

    def expected(self, counted: np.ndarray) -> np.ndarray:
        """Return the share of rollouts that ``counted``, shrunk towards the mean of all candidates of the
        grasp with weight ``HOPE_WEIGHT``, so that luck matters less if few candidates hold."""
        common = (counted.sum(axis=0) + HOPE_WEIGHT * HOPE) / (self.tried.sum(axis=0) + HOPE_WEIGHT)
        mean = (counted + HOPE_WEIGHT * common) / (self.tried + HOPE_WEIGHT)
        return np.where(self.possible, mean, 0.0)

    def best(self, other_places: float) -> np.ndarray:
        """Rank the candidates of each grasp, best first, and tried ones before untried ones."""
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
        """Add one rollout each of R distinct candidates; all arguments have shape [R]."""
        self.tried[candidates, grasps] += 1
        for total, values in ((self.held, held), (self.shown, shown), (self.bonus, bonus)):
            total[candidates, grasps] += values

    def select(self, candidates: np.ndarray, grasps: np.ndarray) -> Tally:
        """Select candidates, shape [P, S], of some grasps, shape [S]."""
        return Tally(*(getattr(self, f.name)[candidates, grasps] for f in fields(self)))

    def join(self, other: Tally) -> Tally:
        """Append more candidates of the same grasps."""
        return Tally(*(np.concatenate([getattr(t, f.name) for t in (self, other)]) for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Candidates:
    """K candidates of each of G grasps, ordered by variation: candidate k of grasp g is row k G + g."""

    grasps: RobotGraspSet
    """The varied grasps, K G rows."""
    plans: GraspPlan
    """Plans of the varied grasps, K G rows."""
    tally: Tally
    """Results of their rollouts, arrays of shape [K, G]."""

    def best(self, other_places: float) -> GraspPlan:
        """Return the best plan of each grasp, with its expected success."""
        tally, grasps = self.tally, np.arange(self.tally.tried.shape[1])
        best = tally.best(other_places)[0]
        return replace(
            self.plans.select(best * len(grasps) + grasps),
            expected_success=tally.expected(tally.held)[best, grasps],
            expected_as_shown=tally.expected(tally.shown)[best, grasps],
            rollouts=tally.tried.sum(axis=0).astype(int),
        )

    def of(self, grasps: np.ndarray) -> Candidates:
        """Select the candidates of some grasps, given by indices of shape [S]."""
        count, size = self.tally.tried.shape
        candidates = np.arange(count)[:, None]
        rows = (candidates * size + grasps).ravel()
        return Candidates(
            self.grasps.select(rows), self.plans.select(rows), self.tally.select(candidates, grasps)
        )

    def join(self, other: Candidates) -> Candidates:
        """Append more candidates of the same grasps."""
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
        beliefs: G rows.
        grasps: K G grasps to vary, ordered as in ``Candidates``.
        attempts: number of each variation, shape [K G].
        search: index of the search, which changes the variations.
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

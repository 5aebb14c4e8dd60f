"""Candidates: variations of grasps, their plans, and how likely each is to succeed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

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
from fungrasp.planning.selection.success_predictor import SuccessPredictor
from fungrasp.task import Belief, GraspPlan


@dataclass(frozen=True)
class VariationSpread:
    """How much variations differ, one standard deviation unless said."""

    position: float = 0.004
    """Standard deviation of the wrist's shift along each axis [m]."""
    rotation: float = 0.15
    """Standard deviation of the wrist's turn about each axis through the middle of the wanted places
    [rad]."""
    joints: float = 0.03
    """Standard deviation of each joint by itself [rad]."""
    closing: float = 0.05
    """Standard deviation of a change of all joints in proportion to their angle [fraction]."""
    force: float = 0.4
    """Standard deviation of the logarithm of the squeeze."""
    press: float = 0.006
    """Range of how far the wrist goes beyond its target [m]."""


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


_ARRAYS = ("expected", "expected_shown", "tried", "held", "shown", "bonus")


@dataclass(frozen=True, eq=False)
class CandidateStatistics:
    """Expected and observed success of K candidates of each of G grasps; all arrays have the shape [K, G]."""

    expected: np.ndarray
    """Probability of success that the predictor expects."""
    expected_shown: np.ndarray
    """Probability of success as shown, from the predictor and the planned contacts."""
    prior: float
    """Number of rollouts that the expectations stand for."""
    other_places: float
    """What success otherwise than shown counts (``SelectionSettings.other_places``)."""
    tried: np.ndarray
    """Number of rollouts of each candidate."""
    held: np.ndarray
    """Number of rollouts that succeeded."""
    shown: np.ndarray
    """Number of those in which the object was held as shown."""
    bonus: np.ndarray
    """Sum over the rollouts of the weighted shown share and contact ratio less the weighted slip."""

    @classmethod
    def untried(
        cls,
        expected: np.ndarray,
        prior: float,
        expected_shown: np.ndarray | None = None,
        other_places: float = 0.0,
    ) -> CandidateStatistics:
        """Statistics of candidates before any rollout.

        Args:
            expected, expected_shown: shape [K, G]; the second is as the first if None.
        """
        expected_shown = expected.copy() if expected_shown is None else expected_shown
        none = (np.zeros(expected.shape) for _ in range(4))
        return cls(expected, expected_shown, prior, other_places, *none)

    @property
    def success(self) -> np.ndarray:
        """Success expected after the rollouts (``_after_rollouts``)."""
        return self._after_rollouts(self.held, self.expected)

    @property
    def as_shown(self) -> np.ndarray:
        """Success as shown that is expected after the rollouts."""
        return self._after_rollouts(self.shown, self.expected_shown)

    @property
    def value(self) -> np.ndarray:
        """What candidates are compared with a threshold by: success as shown, and the share that counts of
        the other successes."""
        shown = self.as_shown
        return shown + self.other_places * np.maximum(self.success - shown, 0.0)

    def _after_rollouts(self, counted: np.ndarray, expected: np.ndarray) -> np.ndarray:
        """Mean of the rollouts with the prior's added. Where the grasp's candidates together succeed less
        often than was expected of them, so much less is expected of each: what the predictor does not see of
        an object fails them all."""
        hoped = (self.tried * expected).sum(axis=0)
        right = np.minimum((counted.sum(axis=0) + self.prior) / (hoped + self.prior), 1.0)
        return (counted + self.prior * right * expected) / (self.tried + self.prior)

    @property
    def order(self) -> np.ndarray:
        """Candidates of each grasp, the best first."""
        score = self.value + self.bonus / np.maximum(self.tried, 1)
        return np.argsort(-score, axis=0, kind="stable")

    def add(
        self, candidates: np.ndarray, success: np.ndarray, as_shown: np.ndarray, bonus: np.ndarray
    ) -> None:
        """Count rollouts.

        Args:
            candidates: of each grasp, shape [P, G].
            success: of as many rollouts of each, P G candidates in turn.
            as_shown: success as shown of the same rollouts.
            bonus: of the same rollouts.
        """
        grasps = np.arange(candidates.shape[1])
        self.tried[candidates, grasps] += len(bonus) // candidates.size
        for total, values in ((self.held, success), (self.shown, as_shown), (self.bonus, bonus)):
            total[candidates, grasps] += values.reshape(*candidates.shape, -1).sum(axis=2)

    def select(self, candidates: np.ndarray, grasps: np.ndarray) -> CandidateStatistics:
        """Statistics of candidates, shape [P, S], of some grasps, shape [S]."""
        return self._each(lambda name: getattr(self, name)[candidates, grasps])

    def join(self, other: CandidateStatistics) -> CandidateStatistics:
        """These and more candidates of the same grasps."""
        return self._each(lambda name: np.concatenate([getattr(self, name), getattr(other, name)]))

    def _each(self, values: Callable[[str], np.ndarray]) -> CandidateStatistics:
        """A copy with another array in the place of each."""
        return replace(self, **{name: values(name) for name in _ARRAYS})


@dataclass(frozen=True, eq=False)
class Candidates:
    """K candidates of each of G grasps, those of one variation after those of another: candidate k of grasp g
    is row k G + g."""

    grasps: RobotGraspSet
    """The varied grasps, K G rows."""
    plans: GraspPlan
    """Plans of the varied grasps, K G rows."""
    beliefs: Belief
    """Nominal scenes that were planned for, G rows."""
    statistics: CandidateStatistics
    """Expected and observed success of the candidates, arrays of shape [K, G]."""

    def best(self) -> tuple[GraspPlan, np.ndarray]:
        """The best plan of each grasp, with what is expected of it, and its value, shape [G]."""
        statistics = self.statistics
        count = statistics.expected.shape[1]
        best, grasps = statistics.order[0], np.arange(count)
        plans = replace(
            self.plans.select(best * count + grasps),
            expected_success=statistics.success[best, grasps],
            expected_as_shown=statistics.as_shown[best, grasps],
        )
        return plans, statistics.value[best, grasps]

    def among_best(self, number: int, grasps: np.ndarray) -> Candidates:
        """The best so many candidates of some grasps."""
        best = self.statistics.order[:number, grasps]
        rows = (best * self.statistics.expected.shape[1] + grasps).ravel()
        return Candidates(
            self.grasps.select(rows),
            self.plans.select(rows),
            self.beliefs.select(grasps),
            self.statistics.select(best, grasps),
        )

    def join(self, other: Candidates) -> Candidates:
        """These and more candidates of the same grasps."""
        return Candidates(
            RobotGraspSet.concatenate([self.grasps, other.grasps]),
            GraspPlan.join([self.plans, other.plans]),
            self.beliefs,
            self.statistics.join(other.statistics),
        )


def propose(
    planner: Planner,
    predictor: SuccessPredictor,
    hand: Hand,
    beliefs: Belief,
    grasps: RobotGraspSet,
    attempts: np.ndarray,
    spread: VariationSpread,
    seed: int,
    search: int,
    prior: float,
    chunk: int,
    other_places: float,
    chance: Callable[[GraspPlan, np.ndarray], np.ndarray] | None = None,
) -> Candidates:
    """Plan variations of grasps.

    Args:
        predictor: says what to expect of them.
        beliefs: of G grasps.
        grasps: to vary, G after G, K G of them.
        attempts: number of each variation, shape [K G].
        search: another number of the variations.
        prior: number of rollouts that the expectation stands for.
        chance: factor of what is expected of plans for tasks (``use_strength.chance_of_use``); one if None,
            and where grasps have no task.
    """
    count = len(beliefs)
    where = np.resize(np.arange(count), len(grasps))
    varied = vary(grasps, hand, np.full(len(grasps), search), attempts, seed, spread)
    plans, expected = [], []
    for first in range(0, len(grasps), chunk):
        rows = slice(first, first + chunk)
        plans.append(planner.plan(varied.select(rows), beliefs.select(where[rows])))
        expected.append(predictor(plans[-1]))
        if chance is not None and varied.task is not None:
            expected[-1] = expected[-1] * chance(plans[-1], varied.task[rows])[:, None]
    success, as_shown = np.concatenate(expected).T.reshape(2, -1, count)
    statistics = CandidateStatistics.untried(success.copy(), prior, as_shown.copy(), other_places)
    return Candidates(varied, GraspPlan.join(plans), beliefs, statistics)

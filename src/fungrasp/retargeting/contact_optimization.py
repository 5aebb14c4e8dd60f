"""Our retargeting: initialize by wrist, fingertips and link directions, then optimize contact and collision
(paper IV.A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    quaternion_from_rotation_vector,
    rotate,
)
from fungrasp.hands import Hand
from fungrasp.hands.collisions import self_collision_depth
from fungrasp.hands.kinematics import HandKinematics, partly_closed
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.terms import Term, contact_error
from fungrasp.optimization.wrench_resistance import DEEPEST, NO_GRIP, unresisted_share

TOLERATED_SHARE = 0.2
"""Unresisted share of the load below which a grasp counts as firm: of those below six of seven hold, however
far below they are."""

ERROR_UNIT = 0.1
"""Mean distance of the contacts from the person's that counts like a whole unresisted weight, at a likeness
of one [m]."""


@dataclass(frozen=True)
class Start:
    """How a start differs from the hand that is laid along the person's. Axes are those of a right hand's
    palm: along the fingers, out of the palm, and across; those of a left hand are mirrored."""

    turn: tuple[float, float, float]
    """Rotation vector about the mean fingertip [rad]."""
    shift: tuple[float, float, float]
    """Of the wrist, afterwards [m]."""
    straighter: float
    """Share of the joints' angles that is taken away, negative to bend them."""


STARTS = (
    Start((-0.22, -0.31, 0.45), (-0.01, 0.01, 0.0), 0.13),
    Start((-0.09, -0.10, 0.53), (-0.01, 0.0, -0.02), 0.21),
    Start((-0.05, 0.27, 0.49), (-0.03, 0.01, -0.01), 0.18),
    Start((0.05, -0.28, -0.10), (0.01, 0.01, -0.01), 0.24),
    Start((-0.20, 0.64, -0.17), (0.01, 0.02, -0.01), -0.04),
    Start((-0.32, -0.53, 0.05), (0.0, 0.02, 0.01), 0.05),
)
"""Of 93 that were drawn at random those that, one after another, made most of 400 grasps of 80 objects firmer
(lab/decisions.md, 0073)."""


@dataclass(frozen=True)
class RetargetSettings:
    """The size at which each term of the objective counts as one unit, and numbers of iterations."""

    fingertip_unit: float = 0.01
    """Distance of a fingertip from the human one, first stage [m]."""
    direction_unit: float = 0.5
    """Difference of the unit vectors along a link, first stage [-]."""
    contact_unit: float = 0.0033
    """Distance of a contact from its target on the surface [m]."""
    inner_contact_weight: float = 0.6
    """Factor for contacts of links that do not end in a fingertip [-]."""
    gap_unit: float = 0.001
    """Gap between a link that should touch and the object [m]."""
    object_unit: float = 0.0006
    """Penetration of the object [m]."""
    table_unit: float = 0.0007
    """Penetration of the table [m]."""
    table_margin: float = 0.001
    """Distance to keep from the table [m]."""
    self_unit: float = 0.001
    """Penetration of the hand by itself [m]."""
    closure_unit: float = 0.1
    """Unbalanced part of contact forces that sum to one [-]."""
    closure_friction: float = 0.3
    """Friction coefficient that the balance may use; well below the nominal one [-]."""
    posture_unit: float = 0.85
    """Difference of the unit vectors along a link, second stage [-]."""
    first_iterations: int = 15
    """Solver iterations of the first stage."""
    second_iterations: int = 12
    """Solver iterations of the second stage."""
    likeness: float = 1.0
    """How much the person's contact places count against firmness, from 0, as firm as possible wherever the
    hand touches, to infinity, as shown."""
    loose_contact_unit: float = 0.01
    """``contact_unit`` of a grasp that is solved again, at a likeness of one [m]."""
    loose_closure_unit: float = 0.02
    """``closure_unit`` of one."""
    loose_closure_friction: float = 0.2
    """``closure_friction`` of one."""
    loose_posture_unit: float = 1.0
    """``posture_unit`` of one."""
    starts: tuple[Start, ...] = STARTS
    """From where grasps are solved again that would not be firm."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: likeness is negative, or no number.
        """
        if not self.likeness >= 0:
            raise FungraspError(f"likeness must be 0 or more, up to inf, not {self.likeness}")

    @property
    def loose(self) -> RetargetSettings:
        """With the terms of a grasp that is solved again."""
        unit = self.loose_contact_unit / self.likeness if self.likeness else np.inf
        return replace(
            self,
            contact_unit=max(unit, self.contact_unit),
            closure_unit=self.loose_closure_unit,
            closure_friction=self.loose_closure_friction,
            posture_unit=self.loose_posture_unit,
        )


def retarget_by_contact_optimization(
    points: HandPoints, problem: RetargetingProblem, settings: RetargetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Wrist poses in the object's frame [N, 7] and independent joints [N, U]."""
    wrist_pose, independent = initial_pose(points, problem)
    first: list[Term] = [
        partial(terms.fingertip_position, unit=settings.fingertip_unit),
        partial(terms.link_direction, unit=settings.direction_unit),
        partial(terms.table_penetration, unit=0.005, margin=settings.table_margin),
    ]
    wrist_pose, independent, _ = minimize(
        points, problem, first, wrist_pose, independent, settings.first_iterations
    )
    near = (wrist_pose, independent)
    wrist_pose, independent = _touch(points, problem, settings, near, near)
    if not settings.starts or np.isinf(settings.likeness):
        return wrist_pose, independent
    score, share = _score(points, problem, settings.likeness, (wrist_pose, independent))
    poor = np.flatnonzero(share > TOLERATED_SHARE)
    if not len(poor):
        return wrist_pose, independent
    # All starts of all poor grasps at once, start after start.
    rows = np.tile(poor, len(settings.starts))
    again, part = points.for_hands(len(rows)), problem.rows(rows)
    beside = (near[0][rows], near[1][rows])
    start = moved_starts(again, *beside, settings.starts)
    new_pose, new_independent = _touch(again, part, settings.loose, start, beside)
    new_score, _ = _score(again, part, settings.likeness, (new_pose, new_independent), score[rows])
    # Index of each poor grasp's best new solution among those of all starts.
    best = new_score.reshape(-1, len(poor)).argmin(axis=0) * len(poor) + np.arange(len(poor))
    better = new_score[best] < score[poor]
    # The terms know nothing of fingers that go into the palm.
    hand = points.kinematics.hand
    depth = self_collision_depth(hand.model, hand.all_joints(new_independent[best[better]]))
    better[better] = depth < 2 * DEEPEST
    wrist_pose[poor[better]] = new_pose[best[better]]
    independent[poor[better]] = new_independent[best[better]]
    return wrist_pose, independent


def _score(
    points: HandPoints,
    problem: RetargetingProblem,
    likeness: float,
    solution: tuple[np.ndarray, np.ndarray],
    least: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What solutions are compared by, lower is better: the unresisted share of the load, at least
    ``TOLERATED_SHARE``, and how far the contacts are from the person's; and that share, shape [N] each.

    Args:
        points, problem: N grasps.
        solution: wrist poses [N, 7] and independent joints [N, U].
        least: scores that count, shape [N]; of what is too far off by its places alone the share is infinite.
    """
    apart = likeness / ERROR_UNIT * contact_error(points, problem, *solution)
    upper = None if least is None else least - apart
    share = unresisted_share(points.dense, problem, *solution, TOLERATED_SHARE, upper)
    collisions: list[Term] = [
        partial(terms.table_penetration, unit=DEEPEST, margin=0.0),
        partial(terms.self_penetration, unit=DEEPEST, margin=0.0),
    ]
    # A hand in itself or in the table by twice ``DEEPEST`` has no grip either.
    inside = minimize(points, problem, collisions, *solution, 0)[2] > 2.0
    share = np.where(inside, np.maximum(share, NO_GRIP), share)
    return np.maximum(share, TOLERATED_SHARE) + apart, share


def _touch(
    points: HandPoints,
    problem: RetargetingProblem,
    settings: RetargetSettings,
    start: tuple[np.ndarray, np.ndarray],
    near: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """The second stage: wrist poses [N, 7] and independent joints [N, U].

    Args:
        points, problem: N grasps.
        start: wrist poses [N, 7] and independent joints [N, U] to start from.
    """
    s = settings
    second: list[Term] = [
        partial(terms.contact_position, unit=s.contact_unit, inner_weight=s.inner_contact_weight),
        partial(terms.contact_gap, unit=s.gap_unit),
        partial(terms.object_penetration, unit=s.object_unit),
        partial(terms.link_direction, unit=s.posture_unit),
        partial(terms.force_closure, unit=s.closure_unit, friction=s.closure_friction),
        partial(terms.stay_near, start=near, unit=3.0),
        partial(terms.table_penetration, unit=s.table_unit, margin=s.table_margin),
        partial(terms.self_penetration, unit=s.self_unit),
    ]
    return minimize(points, problem, second, *start, s.second_iterations)[:2]


def moved_starts(
    points: HandPoints, wrist_pose: np.ndarray, independent: np.ndarray, starts: Sequence[Start]
) -> tuple[np.ndarray, np.ndarray]:
    """Wrist poses [N, 7] and independent joints [N, U] of starts.

    Args:
        points: kinematics made for N hands.
        wrist_pose, independent: to start from but for the differences, shape [N, 7] and [N, U].
        starts: K of them, each for N / K hands in turn.
    """
    kinematics, each = points.kinematics, len(wrist_pose) // len(starts)
    hand = kinematics.hand
    axes = np.stack([hand.palm_fingers, hand.palm_normal, np.cross(hand.palm_fingers, hand.palm_normal)])
    turns = np.repeat([start.turn for start in starts], each, axis=0)
    shifts = np.repeat([start.shift for start in starts], each, axis=0)
    straighter = np.repeat([start.straighter for start in starts], each)
    if hand.side == "left":
        # In a mirror the axis across changes its sign, and all turns theirs.
        axes[2], turns = -axes[2], -turns
    wrist = turned_about_fingertips(points, wrist_pose, independent, turns @ axes)
    wrist[:, :3] += rotate(wrist[:, 3:], shifts @ axes)
    joints = np.clip(independent * (1 - straighter[:, None]), kinematics.lower, kinematics.upper)
    return wrist, joints


def turned_about_fingertips(
    points: HandPoints, wrist_pose: np.ndarray, independent: np.ndarray, turns: np.ndarray
) -> np.ndarray:
    """Wrist poses turned about the mean of the hand's fingertips, shape [N, 7].

    Args:
        points: kinematics made for N hands.
        wrist_pose: shape [N, 7].
        independent: joints [rad], shape [N, U].
        turns: rotation vectors, palm frame [rad], shape [N, 3].
    """
    points.kinematics.update(wrist_pose, independent)
    tips = points.kinematics.points(points.keypoints)[:, points.match.far[points.match.is_last]]
    center = inverse_transform_points(wrist_pose, tips.mean(axis=1, keepdims=True))[:, 0]
    turn = quaternion_from_rotation_vector(turns)
    # The center stays where it is: center = turn center + shift, in the palm's frame before the turn.
    shift = center - rotate(turn, center)
    return compose(wrist_pose, np.concatenate([shift, turn], axis=1))


def initial_pose(points: HandPoints, problem: RetargetingProblem) -> tuple[np.ndarray, np.ndarray]:
    """Palms aligned by the directions wrist to middle finger and palm normal, fingers a quarter closed."""
    kinematics = points.kinematics
    rotation = palm_alignment(kinematics.hand, problem.joints)
    quarter = partly_closed(HandKinematics(kinematics.hand, 5), 0.25)
    independent = np.repeat(quarter[None], len(problem), axis=0)
    pose = np.concatenate([np.zeros((len(problem), 3)), rotation], axis=1)
    kinematics.update(pose, independent)
    tips = kinematics.points(points.keypoints)[:, points.match.far[points.match.is_last]]
    human = problem.joints[:, points.match.human_far[points.match.is_last]]
    pose[:, :3] = human.mean(axis=1) - tips.mean(axis=1)
    return pose, independent


def palm_alignment(hand: Hand, joints: np.ndarray) -> np.ndarray:
    """Rotation that lays the robot's palm along the human's, wxyz, shape [N, 4].

    Args:
        joints: human joints of the same side [m], any frame, shape [N, 21, 3].
    """
    fingers = joints[:, 5] - joints[:, 0]
    fingers = fingers / np.linalg.norm(fingers, axis=1, keepdims=True)
    # Joints 0, 1, 5, 13: wrist, and the bases of index, middle and pinky.
    normal = np.cross(joints[:, 1] - joints[:, 0], joints[:, 13] - joints[:, 0])
    normal -= np.sum(normal * fingers, axis=1, keepdims=True) * fingers
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if hand.side == "left":
        normal = -normal
    # Columns of both matrices are the same three axes of the palm, so that human = rotation @ robot.
    human = np.stack([fingers, normal, np.cross(fingers, normal)], axis=-1)
    robot = np.stack(
        [hand.palm_fingers, hand.palm_normal, np.cross(hand.palm_fingers, hand.palm_normal)], axis=-1
    )
    return Rotation.from_matrix(human @ robot.T).as_quat(scalar_first=True)

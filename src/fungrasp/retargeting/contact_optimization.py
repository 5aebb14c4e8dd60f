"""Our retargeting: initialize by wrist, fingertips and link directions, then optimize contact and collision
(paper IV.A)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    quaternion_from_rotation_vector,
    rotate,
)
from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.hands.opening import partly_closed
from fungrasp.optimization import terms
from fungrasp.optimization.firmness import FIRMNESS_WEIGHT, unresisted_share
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.retargeting_problem import RetargetingProblem
from fungrasp.optimization.terms import Term

LEAST_GAIN = 1.0
"""Decrease of the objective that a turned start must bring: equal solutions differ by less."""


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
    gap_unit: float = 0.002
    """Gap between a link that should touch and the object [m]."""
    object_unit: float = 0.0006
    """Penetration of the object [m]."""
    table_unit: float = 0.0007
    """Penetration of the table [m]."""
    table_margin: float = 0.0015
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
    second_iterations: int = 20
    """Solver iterations of the second stage."""
    firmness_weight: float = FIRMNESS_WEIGHT
    """What a load of the object's weight that the contacts cannot take adds to the objective when solutions
    are compared: how much likeness to the human grasp a firm grip is worth."""
    good_enough: float = 8.0
    """A solution whose objective, firmness included, is below this is kept; others are solved again."""
    start_turns: tuple[tuple[float, float, float], ...] = (
        (0.35, 0.0, 0.0),
        (-0.35, 0.0, 0.0),
        (0.0, 0.35, 0.0),
        (0.0, -0.35, 0.0),
    )
    """Turns of the wrist about the mean fingertip, palm frame, from which they are solved again [rad]."""
    trial_iterations: int = 4
    """Solver iterations after which the starts are compared."""
    kept_starts: int = 2
    """How many of them go on."""


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
    wrist_pose, independent, cost = _touch(points, problem, settings, near, near, settings.second_iterations)
    score = cost + settings.firmness_weight * unresisted_share(points.dense, problem, wrist_pose, independent)
    poor = np.flatnonzero(score > settings.good_enough)
    if not len(poor) or not settings.start_turns:
        return wrist_pose, independent
    # All starts of all poor grasps at once, start after start; after a few steps the most promising go on.
    turns = np.repeat(np.array(settings.start_turns), len(poor), axis=0)
    rows = np.tile(poor, len(settings.start_turns))
    again = points.for_hands(len(rows))
    turned = (turned_about_fingertips(again, near[0][rows], near[1][rows], turns), near[1][rows])
    trial = _touch(again, problem.rows(rows), settings, turned, _rows(near, rows), settings.trial_iterations)
    order = np.argsort(trial[2].reshape(-1, len(poor)), axis=0, kind="stable")[: settings.kept_starts]
    kept = (order * len(poor) + np.arange(len(poor))).ravel()
    rows, again = rows[kept], points.for_hands(len(kept))
    part = problem.rows(rows)
    new_pose, new_independent, cost = _touch(
        again, part, settings, _rows(trial, kept), _rows(near, rows), settings.second_iterations
    )
    # Where the objective alone is too high, firmness need not be looked at.
    might = cost < score[rows] - LEAST_GAIN
    share = unresisted_share(again.dense, part, new_pose, new_independent, might)
    new_score = cost + settings.firmness_weight * share
    # Index of each poor grasp's best new solution among those of all starts.
    best = new_score.reshape(-1, len(poor)).argmin(axis=0) * len(poor) + np.arange(len(poor))
    better = new_score[best] < score[poor] - LEAST_GAIN
    wrist_pose[poor[better]] = new_pose[best[better]]
    independent[poor[better]] = new_independent[best[better]]
    return wrist_pose, independent


def _rows(solution: tuple[np.ndarray, ...], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wrist poses and joints of some rows."""
    return solution[0][rows], solution[1][rows]


def _touch(
    points: HandPoints,
    problem: RetargetingProblem,
    settings: RetargetSettings,
    start: tuple[np.ndarray, np.ndarray],
    near: tuple[np.ndarray, np.ndarray],
    iterations: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The second stage: wrist poses [N, 7], independent joints [N, U], and the objective, shape [N].

    Args:
        points, problem: N grasps.
        settings: of the terms.
        start: wrist poses [N, 7] and independent joints [N, U] to start from.
        near: the same, to stay near.
        iterations: of the solver.
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
    return minimize(points, problem, second, *start, iterations)


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

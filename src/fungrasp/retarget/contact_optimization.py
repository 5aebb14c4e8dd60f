"""Our retargeting: initialize by wrist, fingertips and link directions, then optimize contact and collision
(paper IV.A)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.hands import Hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.hands.opening import partly_closed
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import Term, minimize
from fungrasp.optimization.retargeting_problem import RetargetingProblem


@dataclass(frozen=True)
class RetargetSettings:
    """The size at which each term of the objective counts as one unit, and numbers of iterations."""

    fingertip_unit: float = 0.01
    """Distance of a fingertip from the human one, first stage [m]."""
    direction_unit: float = 0.5
    """Difference of the unit vectors along a link, first stage [-]."""
    contact_unit: float = 0.0033
    """Distance of a contact from its target on the surface [m]."""
    inner_contact_weight: float = 0.3
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
    closure_unit: float = 0.3
    """Unbalanced part of contact forces that sum to one [-]."""
    closure_friction: float = 0.3
    """Friction coefficient that the balance may use; well below the nominal one [-]."""
    posture_unit: float = 0.85
    """Difference of the unit vectors along a link, second stage [-]."""
    first_iterations: int = 15
    """Solver iterations of the first stage."""
    second_iterations: int = 30
    """Solver iterations of the second stage."""


def retarget_by_contact_optimization(
    points: HandPoints, problem: RetargetingProblem, settings: RetargetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Wrist poses in the object's frame [N, 7] and independent joints [N, U]."""
    wrist_pose, independent = initial_pose(points, problem)
    table = partial(terms.table_penetration, unit=settings.table_unit, margin=settings.table_margin)
    itself = partial(terms.self_penetration, unit=settings.self_unit)
    first: list[Term] = [
        partial(terms.fingertip_position, unit=settings.fingertip_unit),
        partial(terms.link_direction, unit=settings.direction_unit),
        partial(table, unit=0.005),
    ]
    wrist_pose, independent, _ = minimize(
        points, problem, first, wrist_pose, independent, settings.first_iterations
    )
    start = (wrist_pose, independent)
    second: list[Term] = [
        partial(
            terms.contact_position, unit=settings.contact_unit, inner_weight=settings.inner_contact_weight
        ),
        partial(terms.contact_gap, unit=settings.gap_unit),
        partial(terms.object_penetration, unit=settings.object_unit),
        partial(terms.link_direction, unit=settings.posture_unit),
        partial(terms.force_closure, unit=settings.closure_unit, friction=settings.closure_friction),
        partial(terms.stay_near, start=start, unit=3.0),
        table,
        itself,
    ]
    wrist_pose, independent, _ = minimize(
        points, problem, second, wrist_pose, independent, settings.second_iterations
    )
    return wrist_pose, independent


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

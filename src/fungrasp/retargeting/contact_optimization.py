"""Retargeting by contact optimization: initialize from wrist, fingertips and link directions, then optimize
contacts and collisions (paper IV.A)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    quaternion_from_rotation_vector,
    rotate,
)
from fungrasp.grasps.as_shown import NEAR, TOUCH, enough, nearest_points
from fungrasp.hands import Hand
from fungrasp.hands.collisions import collision_spheres, self_collision_depth
from fungrasp.hands.kinematics import HandKinematics, partly_closed
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.terms import Term
from fungrasp.retargeting.settings import RetargetSettings

INSIDE = 0.002
"""Largest penetration of object, table or hand in a valid grasp [m]."""

WRONG = 3.0
"""Cost of a grasp that is not valid or not as shown; more than links can cost, which is at most two."""


def retarget_by_contact_optimization(
    points: HandPoints, problem: RetargetingProblem, settings: RetargetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return wrist poses in the object's frame, shape [N, 7], and independent joints, shape [N, U]."""
    first: list[Term] = [
        partial(terms.fingertip_position, unit=settings.fingertip_unit),
        partial(terms.link_direction, unit=settings.direction_unit),
        partial(terms.table_penetration, unit=0.005, margin=settings.table_margin),
    ]
    near = minimize(points, problem, first, *initial_pose(points, problem), settings.iterations[0])[:2]
    wrist_pose, independent = near[0].copy(), near[1].copy()
    cost, rows = np.full(len(problem), np.inf), np.arange(len(problem))
    for turn, shift in starts(settings):
        part, hands = problem.rows(rows), points.for_hands(len(rows))
        pose = moved(hands, near[0][rows], near[1][rows], turn, shift)
        found = _touch(hands, part, settings, pose)
        new = _cost(hands, part, *found)
        better = new < cost[rows]
        chosen = rows[better]
        wrist_pose[chosen], independent[chosen], cost[chosen] = (
            found[0][better],
            found[1][better],
            new[better],
        )
        rows = np.flatnonzero(cost >= WRONG)
        if not len(rows):
            break
    return wrist_pose, independent


def starts(settings: RetargetSettings) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the starts of the solver as rotation vector [rad] and shift [m], shape [3] each. Axes of a right
    palm: along the fingers, out of the palm, across it; mirrored for a left hand."""
    yield np.zeros(3), np.zeros(3)
    for noise in np.random.default_rng(0).normal(size=(settings.starts, 6)):
        yield settings.start_turn * noise[:3], settings.start_shift * noise[3:]


def _touch(
    points: HandPoints,
    problem: RetargetingProblem,
    settings: RetargetSettings,
    pose: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Solve the second and third stage. Return wrist poses, shape [N, 7], and independent joints, shape [N,
    U].

    Args:
        points, problem: N grasps.
        pose: initial wrist poses, shape [N, 7], and independent joints, shape [N, U].
    """
    s = settings
    place = partial(terms.contact_position, unit=s.contact_unit)
    table = partial(terms.table_penetration, unit=s.table_unit, margin=s.table_margin)
    second: list[Term] = [
        place,
        partial(terms.object_penetration, unit=s.soft_object_unit),
        partial(terms.link_direction, unit=s.direction_unit),
        partial(terms.stay_near, start=pose, unit=3.0),
        table,
        partial(terms.self_penetration, unit=0.002),
    ]
    pose = minimize(points, problem, second, *pose, s.iterations[1])[:2]
    third: list[Term] = [
        place,
        partial(terms.contact_gap, unit=s.gap_unit),
        partial(terms.object_penetration, unit=s.object_unit),
        partial(terms.link_direction, unit=s.posture_unit),
        partial(terms.force_closure, unit=s.closure_unit, friction=s.closure_friction),
        partial(terms.stay_near, start=pose, unit=3.0),
        table,
        partial(terms.self_penetration, unit=s.self_unit),
    ]
    return minimize(points, problem, third, *pose, s.iterations[2])[:2]


def _cost(
    points: HandPoints, problem: RetargetingProblem, wrist_pose: np.ndarray, independent: np.ndarray
) -> np.ndarray:
    """Return the cost of solutions, shape [N]: ``WRONG`` if they are not valid, ``WRONG`` if they are not as
    shown, the share of the wanted links that are not, and their mean distance from the human contacts
    relative to twice the distance that counts as the same place.

    Args:
        points, problem: N grasps.
        wrist_pose, independent: the solutions, shape [N, 7] and [N, U].
    """
    hand, wanted = points.kinematics.hand, problem.contacts[:, 1:]
    points.kinematics.update(wrist_pose, independent)
    near = nearest_points(points.kinematics, collision_spheres(hand), problem.bank, problem.grid)
    error = np.linalg.norm(near.points - problem.surface, axis=-1)
    same_side = (near.outward * problem.normals).sum(axis=-1) >= 0
    touching = near.clearance < TOUCH
    shown = wanted & touching & (error <= NEAR) & same_side
    holds, share = enough(shown, wanted, points.match.is_thumb)
    off = np.where(touching, np.minimum(error / (2 * NEAR), 1.0), 1.0)
    off = (wanted * off).sum(axis=1) / np.maximum(wanted.sum(axis=1), 1)
    # Denser spheres than the solver's: penetration between those must not go unnoticed.
    clearance = contacts_of_links(points.dense, problem, wrist_pose, independent).clearance.min(axis=1)
    table: list[Term] = [partial(terms.table_penetration, unit=INSIDE, margin=0.0)]
    below = minimize(points, problem, table, wrist_pose, independent, 0)[2] > 0.5
    # The terms do not include collisions of fingers with the palm.
    inside = self_collision_depth(hand.model, hand.all_joints(independent)) > INSIDE
    valid = (clearance > -INSIDE) & ~below & ~inside
    return WRONG * ~valid + WRONG * ~holds + (1 - np.nan_to_num(share)) + off


def moved(
    points: HandPoints, wrist_pose: np.ndarray, independent: np.ndarray, turn: np.ndarray, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Turn wrist poses about the mean fingertips and shift them; return them, shape [N, 7], and the joints.

    Args:
        points: kinematics for N hands.
        wrist_pose, independent: poses and joints before, shape [N, 7] and [N, U].
        turn, shift: as ``starts`` yields them.
    """
    hand = points.kinematics.hand
    axes = np.stack([hand.palm_fingers, hand.palm_normal, np.cross(hand.palm_fingers, hand.palm_normal)])
    if hand.side == "left":
        # Mirroring flips the axis across the palm and the sense of rotations.
        axes[2], turn = -axes[2], -turn
    points.kinematics.update(wrist_pose, independent)
    tips = points.kinematics.points(points.keypoints)[:, points.match.far[points.match.is_last]]
    center = inverse_transform_points(wrist_pose, tips.mean(axis=1, keepdims=True))[:, 0]
    rotation = np.tile(quaternion_from_rotation_vector(turn @ axes), (len(center), 1))
    # The center stays in place: center = rotation center + position, in the initial palm frame.
    position = center - rotate(rotation, center)
    wrist = compose(wrist_pose, np.concatenate([position, rotation], axis=1))
    wrist[:, :3] += rotate(wrist[:, 3:], shift @ axes)
    return wrist, independent


def initial_pose(points: HandPoints, problem: RetargetingProblem) -> tuple[np.ndarray, np.ndarray]:
    """Return poses with aligned palms and mean fingertips, and fingers a quarter closed."""
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
    """Return the rotation that aligns the robot's palm with the human's, wxyz, shape [N, 4].

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
    # Both matrices have the same three palm axes as columns, so that human = rotation @ robot.
    human = np.stack([fingers, normal, np.cross(fingers, normal)], axis=-1)
    robot = np.stack(
        [hand.palm_fingers, hand.palm_normal, np.cross(hand.palm_fingers, hand.palm_normal)], axis=-1
    )
    return Rotation.from_matrix(human @ robot.T).as_quat(scalar_first=True)

"""Retargeting by contact optimization: initialize from wrist, fingertips and link directions, then optimize
contacts and collisions (paper IV.A)."""

from __future__ import annotations

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
from fungrasp.hands.collisions import self_collision_depth
from fungrasp.hands.kinematics import HandKinematics, partly_closed
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.link_contacts import contacts_of_links
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.optimization.terms import Term
from fungrasp.optimization.wrench_resistance import DEEPEST, NO_GRIP, torque_limits, unresisted_share
from fungrasp.retargeting.settings import RetargetSettings, Start

TOLERATED_SHARE = 0.2
"""Unresisted share of the load below which a grasp is firm. Six of seven such grasps hold, regardless of the
share."""

INSIDE = 0.002
"""Largest penetration of object or hand in a valid grasp [m]."""

NEAR, TOUCH, ENOUGH = 0.02, 0.005, 2 / 3
"""A link is as shown if its distance from the person's contact is below the first value and its clearance
below the second [m]. A grasp is as shown if the thumb and the third value's share of the target links are."""

ELSEWHERE, SHARE_COST, PLACE_COST = 3.0, 0.5, 20.0
"""Costs, in units of the unresisted share, of a grasp that is not as shown, of the share of target links that
are not, and of one meter between contacts of person and hand."""

GOOD = 0.5
"""Cost below which a grasp is not solved again."""


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
    for start in settings.starts:
        part, hands = problem.rows(rows), points.for_hands(len(rows))
        pose = moved(hands, near[0][rows], near[1][rows], start)
        found = _touch(hands, part, settings, pose, start)
        new = _cost(hands, part, found, cost[rows])
        better = new < cost[rows]
        chosen = rows[better]
        wrist_pose[chosen], independent[chosen], cost[chosen] = (
            found[0][better],
            found[1][better],
            new[better],
        )
        rows = np.flatnonzero(cost > GOOD)
        if not len(rows):
            break
    return wrist_pose, independent


def _touch(
    points: HandPoints,
    problem: RetargetingProblem,
    settings: RetargetSettings,
    pose: tuple[np.ndarray, np.ndarray],
    start: Start,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve the second and third stage. Return wrist poses, shape [N, 7], and independent joints, shape [N,
    U].

    Args:
        points, problem: N grasps.
        pose: initial wrist poses, shape [N, 7], and independent joints, shape [N, U].
        start: units of the cost terms.
    """
    s = settings
    place = partial(terms.contact_position, unit=start.contact_unit)
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
        partial(terms.force_closure, unit=start.closure_unit, friction=s.closure_friction),
        partial(terms.stay_near, start=pose, unit=3.0),
        table,
        partial(terms.self_penetration, unit=s.self_unit),
    ]
    return minimize(points, problem, third, *pose, s.iterations[2])[:2]


def _cost(
    points: HandPoints,
    problem: RetargetingProblem,
    solution: tuple[np.ndarray, np.ndarray],
    least: np.ndarray,
) -> np.ndarray:
    """Return the cost of solutions, shape [N]: mainly whether they are as shown; then the unresisted share of
    the load, at least ``TOLERATED_SHARE``, and the distance of contacts from the person's.

    Args:
        points, problem: N grasps.
        solution: wrist poses, shape [N, 7], and independent joints, shape [N, U].
        least: lowest costs so far, shape [N]. If contacts alone cost as much, the result is infinite.
    """
    match, hand = points.match, points.kinematics.hand
    contacts = contacts_of_links(points.dense, problem, *solution, TOUCH)
    wanted, touching = problem.contacts[:, 1:], np.isfinite(contacts.clearance[:, 1:])
    off = np.linalg.norm(contacts.place[:, 1:] - problem.surface, axis=2)
    off = np.where(touching, np.minimum(off, 2 * NEAR), 2 * NEAR)
    facing = (contacts.inward[:, 1:] * problem.normals).sum(axis=2) < 0
    shown = wanted & touching & facing & (off < NEAR)
    number = np.maximum(wanted.sum(axis=1), 1)
    share = shown.sum(axis=1) / number
    by_thumb = wanted & match.is_thumb
    holds = (share >= ENOUGH - 1e-9) & (~by_thumb.any(axis=1) | (shown & match.is_thumb).any(axis=1))
    collisions: list[Term] = [partial(terms.table_penetration, unit=DEEPEST, margin=0.0)]
    inside = minimize(points, problem, collisions, *solution, 0)[2] > 2.0
    inside |= contacts.clearance.min(axis=1) < -INSIDE
    cost = PLACE_COST * (wanted * off).sum(axis=1) / number + SHARE_COST * (1 - share) + ELSEWHERE * ~holds
    cost += NO_GRIP * inside
    unresisted = unresisted_share(contacts, problem, torque_limits(hand), TOLERATED_SHARE, least - cost)
    cost += np.maximum(unresisted, TOLERATED_SHARE)
    # The terms do not include collisions of fingers with the palm.
    better = np.flatnonzero(cost < least)
    depth = self_collision_depth(hand.model, hand.all_joints(solution[1][better]))
    cost[better] += ELSEWHERE * (depth > INSIDE)
    return cost


def moved(
    points: HandPoints, wrist_pose: np.ndarray, independent: np.ndarray, start: Start
) -> tuple[np.ndarray, np.ndarray]:
    """Turn wrist poses about the mean fingertips and shift them; return them, shape [N, 7], and the joints.

    Args:
        points: kinematics for N hands.
        wrist_pose, independent: poses and joints before, shape [N, 7] and [N, U].
    """
    hand = points.kinematics.hand
    axes = np.stack([hand.palm_fingers, hand.palm_normal, np.cross(hand.palm_fingers, hand.palm_normal)])
    turn, shift = np.array(start.turn), np.array(start.shift)
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

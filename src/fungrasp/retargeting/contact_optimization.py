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
from fungrasp.grasps.as_shown import NEAR, TOUCH, holds_as_shown, nearest_points
from fungrasp.hands import Hand
from fungrasp.hands.collisions import collision_spheres, self_collision_depth
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

ELSEWHERE, SHARE_COST, PLACE_COST = 4.0, 0.5, 20.0
"""Costs, in units of the unresisted share, of a grasp that is not as shown, of the share of target links that
are not, and of one meter between contacts of person and hand. A grasp as shown that penetrates the object
costs less than one that is not as shown."""

GOOD, BAD = 0.5, 2 * NO_GRIP
"""Cost below which a grasp is not solved again, and above which it penetrates the object (counted twice: as a
penetration, and as a grip that resists nothing) or is not as shown."""

SAME_PLACE = NEAR - 0.002
"""Distance between contacts at the same place [m], less the error of places from the grid."""

TURN, SHIFT = 0.2, 0.01
"""Standard deviation of random starts about and along each axis [rad, m]."""


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
    further = _random_starts(settings.further_starts)
    for number, start in enumerate((*settings.starts, *further), start=1):
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
        rows = np.flatnonzero(cost > (GOOD if number < len(settings.starts) else BAD))
        if not len(rows):
            break
    return wrist_pose, independent


def _random_starts(count: int) -> tuple[Start, ...]:
    """Return ``count`` random starts, always the same."""
    noise = np.random.default_rng(0).normal(size=(count, 6)) * [TURN, TURN, TURN, SHIFT, SHIFT, SHIFT]
    return tuple(Start((a, b, c), (x, y, z)) for a, b, c, x, y, z in noise.tolist())


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
    hand, wanted = points.kinematics.hand, problem.contacts[:, 1:]
    points.kinematics.update(*solution)
    near = nearest_points(points.kinematics, collision_spheres(hand), problem.bank, problem.grid)
    off = np.linalg.norm(near.points - problem.surface, axis=-1)
    same_side, touching = (near.outward * problem.normals).sum(axis=-1) >= 0, near.clearance < TOUCH
    shown = wanted & touching & same_side & (off <= SAME_PLACE)
    holds, _, share = holds_as_shown(shown, wanted, points.match.is_thumb)
    off = (wanted * np.where(touching, np.minimum(off, 2 * NEAR), 2 * NEAR)).sum(axis=1)
    cost = PLACE_COST * off / np.maximum(wanted.sum(axis=1), 1) + SHARE_COST * (1 - np.nan_to_num(share))
    cost += ELSEWHERE * ~holds
    contacts = contacts_of_links(points.dense, problem, *solution, TOUCH)
    collisions: list[Term] = [partial(terms.table_penetration, unit=DEEPEST, margin=0.0)]
    inside = minimize(points, problem, collisions, *solution, 0)[2] > 2.0
    inside |= contacts.clearance.min(axis=1) < -INSIDE
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

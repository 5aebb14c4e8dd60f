"""Baseline "angle-copy": set the human's joint angles on the robot, ignoring contacts.

"Angle Reset" in the paper.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np

from fungrasp.geometry.poses import rotate
from fungrasp.grasps.human_hand import joint_bends, mirror_points
from fungrasp.hands import FINGERS, Hand
from fungrasp.hands.correspondence import HUMAN_FINGER_JOINTS
from fungrasp.hands.kinematic_tree import ancestors
from fungrasp.hands.kinematics import HandKinematics, partly_closed
from fungrasp.optimization import terms
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.levenberg_marquardt import minimize
from fungrasp.optimization.problem import RetargetingProblem
from fungrasp.retargeting.contact_optimization import palm_alignment
from fungrasp.retargeting.settings import RetargetSettings

PARALLEL, PERPENDICULAR = np.cos(np.radians(25.0)), np.cos(np.radians(65.0))
"""Cosines of angles to a finger's flexion axis: joints flex above the first and spread below the second."""

THUMB_ITERATIONS = 20
"""Solver iterations for the joints at the base of the thumb."""


class JointRoles(NamedTuple):
    """Roles of the joints: flexion of a finger link, or spreading of a finger.

    ``angles = matrix @ joint_positions`` [rad] are the flexions of each finger's links towards the palm and
    its deviation towards the index finger's side.
    """

    matrix: np.ndarray
    """Shape [5, 4, M]: finger in the order of ``FINGERS``; flexion of its three links, deviation."""
    fan: np.ndarray
    """Deviation of each straight finger towards the index finger's side [rad], shape [5]."""
    thumb_base: np.ndarray
    """Whether an independent joint belongs to the thumb but has no role, shape [U] bool."""


def retarget_by_angle_copy(
    points: HandPoints, problem: RetargetingProblem, settings: RetargetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return wrist poses in the object's frame, shape [N, 7], and independent joints, shape [N, U].

    The palms are aligned. Each robot joint is set to the human angle of its role (``joint_roles``), clipped
    to its limits; coupled joints are fitted by least squares. The joints at the base of the thumb have no
    human counterpart, because thumbs are mounted differently on each hand. They are solved so that the
    directions of the thumb's first two links match. Then the hand is moved so that the means of the
    fingertips coincide. ``settings`` is not used.
    """
    kinematics = points.kinematics
    roles = joint_roles(kinematics.hand)
    independent = copied_angles(points, roles, problem.joints)
    rotation = palm_alignment(kinematics.hand, problem.joints)
    pose = np.concatenate([np.zeros((len(problem), 3)), rotation], axis=1)
    match = points.match
    thumb = partial(terms.link_direction, unit=1.0, links=np.flatnonzero(match.is_thumb)[:2])
    free = np.concatenate([np.zeros(6, dtype=bool), roles.thumb_base])
    pose, independent, _ = minimize(points, problem, [thumb], pose, independent, THUMB_ITERATIONS, free=free)
    kinematics.update(pose, independent)
    tips = kinematics.points(points.keypoints)[:, match.far[match.is_last]]
    pose[:, :3] = problem.joints[:, match.human_far[match.is_last]].mean(axis=1) - tips.mean(axis=1)
    return pose, independent


def copied_angles(points: HandPoints, roles: JointRoles, joints: np.ndarray) -> np.ndarray:
    """Return independent joints nearest to the human's angles, within limits; the thumb's base is a quarter
    closed.

    Human fingers deviate from their fanned metacarpals, robot fingers from their direction when straight.
    This difference decreases as a finger bends.

    Args:
        joints: human joints [m], any frame, shape [N, 21, 3].

    Returns:
        Joints [rad], shape [N, U].
    """
    kinematics = points.kinematics
    fingers = straightened(kinematics.hand, joints)
    flexion, deviation = joint_bends(fingers if kinematics.hand.side == "right" else mirror_points(fingers))
    spread = deviation[..., 0] + np.cos(flexion[..., 0]) * (human_fan(kinematics.hand, joints) - roles.fan)
    angles = np.concatenate([flexion, spread[..., None]], axis=-1).reshape(len(joints), -1)
    matrix = roles.matrix.reshape(angles.shape[1], -1)
    wanted = (angles - matrix @ kinematics.offset) @ np.linalg.pinv(matrix @ kinematics.matrix).T
    quarter = partly_closed(HandKinematics(kinematics.hand, 5), 0.25)
    return np.clip(np.where(roles.thumb_base, quarter, wanted), kinematics.lower, kinematics.upper)


def human_fan(hand: Hand, joints: np.ndarray) -> np.ndarray:
    """Return the deviation of each metacarpal towards the index finger's side, for the robot's palm axes.

    Args:
        joints: human joints [m], shape [N, 21, 3].

    Returns:
        Angles [rad], shape [N, 5].
    """
    across = rotate(palm_alignment(hand, joints), hand.index_side)
    bones = joints[:, 1::4] - joints[:, :1]
    bones = bones / np.linalg.norm(bones, axis=-1, keepdims=True)
    return np.arcsin(np.clip(np.einsum("nfi,ni->nf", bones, across), -1.0, 1.0))


def straightened(hand: Hand, joints: np.ndarray) -> np.ndarray:
    """Move human joints that a shorter robot finger lacks onto the line from the previous joint to the tip.

    Args:
        joints: human joints [m], shape [N, 21, 3].
    """
    joints = joints.copy()
    for finger in hand.fingers.values():
        human = HUMAN_FINGER_JOINTS[finger.name]
        last, tip = human[len(finger.links) - 1], human[3]
        missing = range(last + 1, tip)
        for joint in missing:
            part = (joint - last) / (tip - last)
            joints[:, joint] = (1 - part) * joints[:, last] + part * joints[:, tip]
    return joints


def joint_roles(hand: Hand) -> JointRoles:
    """Determine joint roles from the straight hand. A finger's flexion axis is that of its last joint. Joints
    parallel to it flex their link, joints perpendicular to it spread the finger, others have no role.

    The thumb's flexion is positive towards the larger end of the range; its first link has no role.
    """
    model = hand.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    to_palm = data.body(hand.palm).xquat * [1, -1, -1, -1]
    axes = rotate(to_palm, data.xaxis)
    across = np.cross(hand.palm_fingers, hand.palm_normal)
    sideways = hand.palm_fingers - hand.palm_normal
    if hand.side == "left":
        sideways = -sideways
    matrix, fan = np.zeros((len(FINGERS), 4, model.njnt)), np.zeros(len(FINGERS))
    in_thumb = np.zeros(model.njnt, dtype=bool)
    for finger, links in _moved_links(hand).items():
        row, joints = FINGERS.index(finger), list(links)
        bend = axes[joints[-1]]
        for joint, link in links.items():
            cosine = axes[joint] @ bend
            if finger == "thumb":
                in_thumb[joint] = True
                if link > 0 and abs(cosine) > PARALLEL:
                    matrix[row, link, joint] = 1.0 if model.jnt_range[joint].sum() >= 0 else -1.0
            elif abs(cosine) > PARALLEL:
                matrix[row, link, joint] = np.sign(axes[joint] @ across)
            elif abs(cosine) < PERPENDICULAR:
                matrix[row, 3, joint] = np.sign(axes[joint] @ sideways)
        near, far = (
            _position(data, name) for name in (*hand.fingers[finger].joints, hand.fingers[finger].tip)[:2]
        )
        direction = rotate(to_palm, far - near)
        fan[row] = np.arcsin(direction @ hand.index_side / np.linalg.norm(direction))
    coupling = hand.coupling[0]
    has_role = np.any(matrix.reshape(-1, model.njnt) @ coupling, axis=0)
    return JointRoles(matrix, fan, np.any(coupling[in_thumb], axis=0) & ~has_role)


def _moved_links(hand: Hand) -> dict[str, dict[int, int]]:
    """Return the joints of each finger with the first link that each moves, except joints of several
    fingers."""
    model = hand.model
    chains = {name: [model.body(link).id for link in finger.links] for name, finger in hand.fingers.items()}
    result: dict[str, dict[int, int]] = {name: {} for name in chains}
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        moved = [
            (name, i)
            for name, chain in chains.items()
            for i, link in enumerate(chain)
            if body in ancestors(model, link)
        ]
        if len({name for name, _ in moved}) == 1:
            name, first = moved[0]
            result[name][joint] = first
    return {name: joints for name, joints in result.items() if joints}


def _position(data: mujoco.MjData, name: str) -> np.ndarray:
    is_site = mujoco.mj_name2id(data.model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0
    return (data.site(name) if is_site else data.body(name)).xpos

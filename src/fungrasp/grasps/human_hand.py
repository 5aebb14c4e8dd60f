"""The 21 joints and 16 links of a human hand: orders, reflections, bones, joint angles and radii."""

from __future__ import annotations

import numpy as np

from fungrasp.core.errors import UnknownNameError

HUMAN_FINGERS = ("index", "middle", "ring", "pinky", "thumb")
"""Finger names, in the order of joints and links."""

HUMAN_JOINTS = (
    "wrist",
    *(f"{finger}_{joint}" for finger in HUMAN_FINGERS[:4] for joint in ("mcp", "pip", "dip", "tip")),
    *(f"thumb_{joint}" for joint in ("cmc", "mcp", "ip", "tip")),
)
"""The 21 joints of ``hand_joints``; "tip" is the end of the finger."""

FINGERTIPS = [joint for joint, name in enumerate(HUMAN_JOINTS) if name.endswith("tip")]
"""Indices of the fingertips in ``HUMAN_JOINTS``."""

FINGER_LINKS = ("proximal", "middle", "distal")
"""Links of a finger, from base to tip."""

HUMAN_LINKS = ("palm", *(f"{finger}_{link}" for finger in HUMAN_FINGERS for link in FINGER_LINKS))
"""The 16 links of ``link_contacts``. The thumb's three are its metacarpal, proximal and distal bones."""

BONES = tuple((0 if joint % 4 == 1 else joint - 1, joint) for joint in range(1, 21))
"""The 20 bones as pairs of joint indices (near, far): four per finger, the first from the wrist."""

FLAT_HAND = 0.01
"""Smallest height of the fingertips above the palm that determines the side of a hand [m]."""

MIRROR = np.array([1.0, -1.0, 1.0])
"""Reflection in the plane y = 0, by coordinate."""


def bone_lengths(hand_joints: np.ndarray) -> np.ndarray:
    """Return the lengths of ``BONES`` [m], shape [..., 20]. hand_joints: [m], shape [..., 21, 3]."""
    near, far = np.transpose(BONES)
    return np.linalg.norm(hand_joints[..., far, :] - hand_joints[..., near, :], axis=-1)


def finger_link_directions(hand_joints: np.ndarray) -> np.ndarray:
    """Return the unit vector along each finger link, from its near to its far joint.

    Args:
        hand_joints: joints [m], any frame, shape [..., 21, 3].

    Returns:
        Shape [..., 5, 3, 3]: finger as in ``HUMAN_FINGERS``, link as in ``FINGER_LINKS``, xyz.
    """
    fingers = hand_joints[..., 1:, :].reshape(*hand_joints.shape[:-2], 5, 4, 3)
    bones = fingers[..., 1:, :] - fingers[..., :-1, :]
    return bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-12)


def hand_sides(hand_joints: np.ndarray) -> np.ndarray:
    """Return whether hands are "right" or "left", shape [...], from the side to which fingers and thumb bend.

    The palm of a right hand faces along the cross product of the directions from the wrist to the bases of
    index and little finger. A flat hand counts as right.

    Args:
        hand_joints: joints [m], any frame, shape [..., 21, 3].
    """
    from_wrist = hand_joints - hand_joints[..., :1, :]
    normal = np.cross(from_wrist[..., 1, :], from_wrist[..., 13, :])
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    bases, tips = hand_joints[..., 1:17:4, :], hand_joints[..., 4:17:4, :]
    heights = np.mean(tips - bases, axis=-2) + from_wrist[..., 20, :]
    return np.where(np.sum(heights * normal, axis=-1) < -FLAT_HAND, "left", "right")


def mirror_points(points: np.ndarray) -> np.ndarray:
    """Reflect points, shape [..., 3], in the plane y = 0. The joints of a left hand become those of a right
    hand. The whole scene must be reflected together, see ``mirror_pose``."""
    return points * MIRROR


def mirror_pose(pose: np.ndarray) -> np.ndarray:
    """Return the pose of an object after a reflection in the world's plane y = 0, shape [..., 7].

    The reflection ``S`` transforms the rotation ``R`` to ``S R S``. The object's mesh must be reflected in
    the plane y = 0 of its own frame, unless it is symmetric there: vertices by ``mirror_points``, and the
    corners of each triangle in reverse order.

    Args:
        pose: ``[x y z qw qx qy qz]``, world frame, shape [..., 7].
    """
    return pose * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])


OPENPOSE = np.array([0, *range(5, 21), *range(1, 5)])
"""Wrist, then thumb, index, middle, ring and little finger, each from base to tip, as in OpenPose, HaMeR,
WiLoR, FreiHAND and MediaPipe."""

MANO = np.array([0, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20, 13, 14, 15, 16])
"""MANO's 16 joints (wrist, then three each of index, middle, little finger, ring, thumb), then the tips of
thumb, index, middle, ring and little finger."""

_FRANKMOCAP = np.array([0, 1, 2, 3, 16, 4, 5, 6, 17, 10, 11, 12, 19, 7, 8, 9, 18, 13, 14, 15, 20])
"""MANO's 16 joints, then the tips of index, middle, little, ring finger and thumb."""

_INTERHAND = np.array(
    [20, *(4 * finger + 7 - joint for finger in range(4) for joint in range(4)), 3, 2, 1, 0]
)
"""Thumb, index, middle, ring and little finger, each from tip to base, then the wrist."""

_MANO_FINGERS = np.array([0, *range(1, 9), *range(13, 17), *range(9, 13), *range(17, 21)])
"""Wrist, then MANO's order of fingers (index, middle, little finger, ring, thumb), each from base to tip."""

_TIP_FIRST = np.array([0, *(4 * finger + 4 - joint for finger in range(5) for joint in range(4))])
"""Wrist, then the fingers as in ``HUMAN_FINGERS``, each from tip to base."""

ORDERS = {
    "openpose": OPENPOSE,
    "mano": MANO,
    "fungrasp": np.arange(21),
    "frankmocap": _FRANKMOCAP,
    "interhand": _INTERHAND,
    "mano-fingers": _MANO_FINGERS,
    "tip-first": _TIP_FIRST,
}
"""Index of each of ``HUMAN_JOINTS`` in an order, shape [21], by the order's name."""

SAME_ORDER: dict[str, str] = dict.fromkeys(("mediapipe", "hamer", "wilor", "freihand", "hocap"), "openpose")
"""Other names of orders."""


def joint_order(name: str) -> np.ndarray:
    """Return the index of each of ``HUMAN_JOINTS`` in an order, shape [21].

    Raises:
        FungraspError: the order is unknown.
    """
    name = SAME_ORDER.get(name, name)
    if name not in ORDERS:
        raise UnknownNameError("order of joints", name, [*ORDERS, *SAME_ORDER])
    return ORDERS[name]


ADULT_BONES = np.array(
    [
        [(68.1, 90.6), (33.0, 39.8), (22.2, 22.4), (15.8, 23.6)],
        [(64.6, 94.7), (31.7, 44.6), (23.3, 26.3), (17.4, 31.7)],
        [(58.0, 86.1), (28.8, 41.4), (24.8, 25.7), (17.3, 30.5)],
        [(53.7, 81.8), (21.1, 32.7), (18.1, 18.9), (16.0, 22.8)],
        [(38.6, 38.6), (30.8, 46.2), (27.1, 31.6), (21.7, 38.2)],
    ]
)
"""Mean lengths of adults' bones [mm], shape [5, 4, 2]: finger, bone from the wrist outwards, lower and upper
of two sources: radiographs (Buryanov and Kotiuk, "Proportions of hand segments", 2010) and the tracked hand
in D-Grasp's labels, whose first bones begin at the wrist and whose last bones end at the skin."""

BONE_VARIATION = 0.3
"""Largest relative deviation of a bone from the mean lengths: three standard deviations of radiographs."""

HAND_SIZE_SPREAD = 0.11
"""Standard deviation of the logarithm of adults' hand sizes, including errors of an estimated shape."""

FLEXION_RANGE = np.radians([[(-45, 90), (0, 100), (0, 80)]] * 4 + [[(-180, 180), (-10, 55), (-15, 80)]])
"""Normal range of active motion [rad], shape [5, 3, 2] (Electronic Textbook of Hand Surgery, eatonhand.com):
MCP, PIP, DIP; for the thumb CMC (no limit), MCP, IP."""

DEVIATION_LIMIT = np.radians([20.0, 0.0, 0.0])
"""Largest deviation of a finger's MCP, PIP and DIP to either side [rad]."""

JOINT_RANGE_SLACK = np.radians(25.0)
"""Tolerance of these ranges [rad]: joint centers lie off the bones' axes, and objects bend fingers beyond the
active range."""


KNUCKLES = ((1, 5), (5, 9), (9, 13))
"""Neighboring bases of fingers, as pairs of joint indices."""

KNUCKLE_DISTANCES = np.array([25.2, 26.8, 21.8])
"""Distances of ``KNUCKLES`` of the tracked hand in D-Grasp's labels [mm]."""


def order_misfit(hand_joints: np.ndarray) -> np.ndarray:
    """Return the deviation of hands from human proportions, shape [N]: the root mean square of logarithms of
    bone lengths and knuckle distances relative to an adult's hand of the same size.

    Args:
        hand_joints: joints in any unit, shape [N, 21, 3].
    """
    near, far = np.transpose(KNUCKLES)
    across = np.linalg.norm(hand_joints[:, near] - hand_joints[:, far], axis=-1) * 1e3 / KNUCKLE_DISTANCES
    ratio = np.log(np.maximum(np.concatenate([bone_ratios(hand_joints), across], axis=1), 1e-6))
    return np.sqrt(np.mean((ratio - ratio.mean(axis=1, keepdims=True)) ** 2, axis=1))


def bone_ratios(hand_joints: np.ndarray) -> np.ndarray:
    """Return bone lengths relative to an adult's, shape [..., 20]. hand_joints: [m], shape [..., 21, 3]."""
    return bone_lengths(hand_joints) / (ADULT_BONES.mean(axis=-1).ravel() * 1e-3)


def hand_size(joints: np.ndarray) -> float:
    """Return the median over the bones of ``bone_ratios``. joints: [m], shape [21, 3]."""
    return float(np.median(bone_ratios(joints)))


def joint_bends(hand_joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint angles of the fingers.

    The flexion axis is the line from the base of the little finger to that of the index finger, made
    perpendicular to the bone before the joint. The joints do not determine the axes of the thumb; its flexion
    is the unsigned angle between bones.

    Args:
        hand_joints: joints of right hands [m], any frame, shape [..., 21, 3].

    Returns:
        flexion: [rad], shape [..., 5, 3]: finger, joint (MCP, PIP, DIP; thumb CMC, MCP, IP).
        deviation: towards the index finger [rad], same shape; zero for the thumb.
    """
    base = hand_joints[..., 1::4, :] - hand_joints[..., :1, :]
    base = base / np.maximum(np.linalg.norm(base, axis=-1, keepdims=True), 1e-12)
    links = finger_link_directions(hand_joints)
    before = np.concatenate([base[..., None, :], links[..., :-1, :]], axis=-2)
    across = (hand_joints[..., 1, :] - hand_joints[..., 13, :])[..., None, None, :]
    axis = across - np.sum(across * before, axis=-1, keepdims=True) * before
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    turn, straight = np.cross(before, links), np.sum(before * links, axis=-1)
    flexion = np.arctan2(np.sum(turn * axis, axis=-1), straight)
    deviation = np.arcsin(np.clip(np.sum(links * axis, axis=-1), -1.0, 1.0))
    flexion[..., 4, :] = np.arctan2(np.linalg.norm(turn[..., 4, :, :], axis=-1), straight[..., 4, :])
    deviation[..., 4, :] = 0.0
    return flexion, deviation


FINGER_RADII = np.array([[10.5, 9.5, 8.5, 7.8]] * 4 + [[17.0, 12.5, 10.5, 9.0]]) * 1e-3
"""Radii at the four joints of each finger [m], as in ``HUMAN_FINGERS``, shape [5, 4]; the thumb's first joint
lies in the ball of the thumb."""

WRIST_RADIUS = 0.022
"""Radius at the wrist [m]."""

PALM_RADIUS = 0.014
"""Radius in the middle of the palm [m]."""

PALM_BALL_RADIUS = 0.0165
"""Radius at the wrist's end of the palm, including the balls [m]."""

LINK_RADII = np.array([0.012] + [0.010, 0.009, 0.008] * 4 + [0.012, 0.011, 0.010])
"""Radii in the middle of ``HUMAN_LINKS`` [m], shape [16]."""

FOREARM_RADII = np.array([0.018, 0.028])
"""Radii of the bare forearm at the wrist and 0.25 m from it [m]."""

"""The human hand of the grasp sets: names of its joints and links, bones, directions, mirroring."""

from __future__ import annotations

import numpy as np

HUMAN_FINGERS = ("index", "middle", "ring", "pinky", "thumb")
"""Order of the fingers in joints and links."""

HUMAN_JOINTS = (
    "wrist",
    *(f"{finger}_{joint}" for finger in HUMAN_FINGERS[:4] for joint in ("mcp", "pip", "dip", "tip")),
    *(f"thumb_{joint}" for joint in ("cmc", "mcp", "ip", "tip")),
)
"""The 21 joints of ``hand_joints``; "tip" is the end of the finger."""

FINGER_LINKS = ("proximal", "middle", "distal")
"""Links of a finger, from base to tip."""

HUMAN_LINKS = ("palm", *(f"{finger}_{link}" for finger in HUMAN_FINGERS for link in FINGER_LINKS))
"""The 16 links of ``link_contacts``. The thumb's three are its metacarpal, proximal and distal bones."""

BONES = tuple((0 if joint % 4 == 1 else joint - 1, joint) for joint in range(1, 21))
"""The 20 bones as pairs of joint indices (near, far); four per finger, the first from the wrist."""

FLAT_HAND = 0.01
"""Height of the fingertips above the palm below which the side of a hand is not told [m]."""

MIRROR = np.array([1.0, -1.0, 1.0])
"""Reflection in the plane y = 0, by coordinate."""


def bone_lengths(hand_joints: np.ndarray) -> np.ndarray:
    """Length of each of ``BONES`` [m], shape [..., 20]. hand_joints: [m], shape [..., 21, 3], any frame."""
    near, far = np.transpose(BONES)
    return np.linalg.norm(hand_joints[..., far, :] - hand_joints[..., near, :], axis=-1)


def finger_link_directions(hand_joints: np.ndarray) -> np.ndarray:
    """Unit vector along each finger link, from its near joint to its far one.

    Args:
        hand_joints: [m], shape [..., 21, 3], any frame.

    Returns:
        Shape [..., 5, 3, 3]: finger in the order of ``HUMAN_FINGERS``, link in that of ``FINGER_LINKS``, xyz.
    """
    fingers = hand_joints[..., 1:, :].reshape(*hand_joints.shape[:-2], 5, 4, 3)
    bones = fingers[..., 1:, :] - fingers[..., :-1, :]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def hand_sides(hand_joints: np.ndarray) -> np.ndarray:
    """Whether hands are right or left, from the side to which fingers and thumb bend.

    The palm of a right hand faces along the cross product of the directions from the wrist to the bases of
    index and little finger. A hand that is as good as flat counts as right.

    Args:
        hand_joints: [m], shape [..., 21, 3], any frame.

    Returns:
        "right" or "left", shape [...].
    """
    from_wrist = hand_joints - hand_joints[..., :1, :]
    normal = np.cross(from_wrist[..., 1, :], from_wrist[..., 13, :])
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    bases, tips = hand_joints[..., 1:17:4, :], hand_joints[..., 4:17:4, :]
    heights = np.mean(tips - bases, axis=-2) + from_wrist[..., 20, :]
    return np.where(np.sum(heights * normal, axis=-1) < -FLAT_HAND, "left", "right")


def mirror_points(points: np.ndarray) -> np.ndarray:
    """Points reflected in the plane y = 0 of their frame: a left hand's joints become a right hand's.

    points: [m], shape [..., 3]. Reflect the whole scene together, see ``mirror_pose``.
    """
    return points * MIRROR


def mirror_pose(pose: np.ndarray) -> np.ndarray:
    """Pose of an object in the scene reflected in the world's plane y = 0.

    The reflection ``S`` turns the rotation ``R`` into ``S R S``. The object's mesh must be reflected too, in
    the plane y = 0 of its own frame: ``mirror_points`` of its vertices, and each triangle's corners in
    reverse order. A mesh that is its own mirror image there stays as it is.

    Args:
        pose: ``[x y z qw qx qy qz]``, shape [..., 7], world frame.

    Returns:
        Shape [..., 7].
    """
    return pose * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])

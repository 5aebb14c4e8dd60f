"""Which links of a human hand touch an object, from the 21 joints alone or from the surface of the hand."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps.human_hand import HUMAN_FINGERS, LINK_RADII

TRACKED_CONTACT_GAP = 0.005
"""Gap that still counts as contact [m]: about the error of a tracked hand. On the 375 training
grasps of D-Grasp the flags of the distal links then agree with its labels in 96 % of the cases."""

CONTACT_REACH = 0.03
"""Largest distance between the skin of a link and what it touches, as annotated [m]."""

POINTS_PER_LINK = 5


def link_points(hand_joints: np.ndarray) -> np.ndarray:
    """Points along the axis of each link.

    Args:
        hand_joints: [m], shape [N, 21, 3].

    Returns:
        [m], shape [N, 16, P, 3]. The palm's lie between the wrist and the bases of the four fingers.
    """
    count = len(hand_joints)
    fingers = hand_joints[:, 1:].reshape(count, len(HUMAN_FINGERS), 4, 3)
    along = np.linspace(0.0, 1.0, POINTS_PER_LINK)[:, None]
    links = fingers[:, :, :-1, None] * (1 - along) + fingers[:, :, 1:, None] * along
    bases = fingers[:, :4, 0]
    across = bases[:, [0, 1, 1, 2, 3]] * 0.5 + bases[:, [0, 1, 2, 3, 3]] * 0.5
    palm = hand_joints[:, :1] + (across - hand_joints[:, :1]) * np.array([0.4, 0.7, 0.7, 0.7, 0.4])[:, None]
    return np.concatenate([palm[:, None], links.reshape(count, 15, POINTS_PER_LINK, 3)], axis=1)


def link_contacts(
    hand_joints: np.ndarray,
    object_pose: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
) -> np.ndarray:
    """Links, as capsules about their bones, within ``TRACKED_CONTACT_GAP`` of the object or inside it.

    Args:
        hand_joints: [m], shape [N, 21, 3], world frame.
        object_pose: of one object in N grasps, shape [N, 7], world frame.
        vertices: of its mesh [m], shape [V, 3], object frame.
        faces: outward, shape [F, 3].

    Returns:
        bool, shape [N, 16].
    """
    points = link_points(hand_joints)
    distance = _distance(points.reshape(len(points), -1, 3), object_pose, vertices, faces)
    distance = distance.reshape(points.shape[:3])
    return distance.min(axis=2) < LINK_RADII + TRACKED_CONTACT_GAP


def surface_contacts(
    surface: np.ndarray,
    vertex_links: np.ndarray,
    object_pose: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
) -> np.ndarray:
    """Links of which a vertex of the hand's surface is so near to the object or inside it.

    Args:
        surface: of the hand [m], shape [N, V, 3], world frame.
        vertex_links: which of ``HUMAN_LINKS`` each vertex belongs to, shape [V].
        object_pose: of one object in N grasps, shape [N, 7], world frame.
        vertices: of its mesh [m], shape [W, 3], object frame.
        faces: outward, shape [F, 3].

    Returns:
        bool, shape [N, 16].
    """
    distance = _distance(surface, object_pose, vertices, faces)
    near = distance < TRACKED_CONTACT_GAP
    return np.stack([(near & (vertex_links == link)).any(axis=1) for link in range(len(LINK_RADII))], axis=1)


def _distance(
    points: np.ndarray, object_pose: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Signed distance [m] of points of N grasps, shape [N, P, 3], world frame. Returns shape [N, P]."""
    import trimesh

    from fungrasp.geometry.signed_distance import mesh_signed_distance

    local = inverse_transform_points(object_pose, points)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return mesh_signed_distance(mesh, local.reshape(-1, 3)).reshape(points.shape[:2])

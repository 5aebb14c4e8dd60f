"""Contacts of a human hand's links with an object, from the 21 joints or from the hand's surface."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps.human_hand import HUMAN_FINGERS, LINK_RADII

TRACKED_CONTACT_GAP = 0.005
"""Smallest gap that is not a contact [m], about the error of hand tracking. With this value, 96 % of the
distal links' contacts agree with D-Grasp's labels (375 training grasps)."""

CONTACT_REACH = 0.03
"""Largest plausible distance between a link's skin and its annotated contact [m]."""

POINTS_PER_LINK = 5


def link_points(hand_joints: np.ndarray) -> np.ndarray:
    """Return points along the axis of each link [m], shape [N, 16, P, 3]. Those of the palm lie between the
    wrist and the bases of the four fingers. hand_joints: [m], shape [N, 21, 3]."""
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
    """Return which links, as capsules about their bones, are within ``TRACKED_CONTACT_GAP`` of the object or
    inside it, shape [N, 16] bool.

    Args:
        hand_joints: joints [m], world frame, shape [N, 21, 3].
        object_pose: poses of one object in N grasps, world frame, shape [N, 7].
        vertices: vertices of its mesh [m], object frame, shape [V, 3].
        faces: outward triangles, shape [F, 3].
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
    """Return which links have a surface vertex within ``TRACKED_CONTACT_GAP`` of the object or inside it,
    shape [N, 16] bool.

    Args:
        surface: vertices of the hand [m], world frame, shape [N, V, 3].
        vertex_links: index into ``HUMAN_LINKS`` of each vertex, shape [V].
        object_pose: poses of one object in N grasps, world frame, shape [N, 7].
        vertices: vertices of its mesh [m], object frame, shape [W, 3].
        faces: outward triangles, shape [F, 3].
    """
    distance = _distance(surface, object_pose, vertices, faces)
    near = distance < TRACKED_CONTACT_GAP
    return np.stack([(near & (vertex_links == link)).any(axis=1) for link in range(len(LINK_RADII))], axis=1)


def _distance(
    points: np.ndarray, object_pose: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Return the signed distance of world points, shape [N, P, 3], from the object [m], shape [N, P]."""
    import trimesh

    from fungrasp.geometry.signed_distance import mesh_signed_distance

    local = inverse_transform_points(object_pose, points)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return mesh_signed_distance(mesh, local.reshape(-1, 3)).reshape(points.shape[:2])

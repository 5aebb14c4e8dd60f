"""Which links of a perceived hand touch the object, and how deep its flesh is in it."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid
from fungrasp.grasps.importers.contacts import LINK_RADII, link_points

TOLERANCE = 0.005
"""Gap between skin and surface that still counts as contact [m]."""


def link_gaps(joints: np.ndarray, surface: SignedDistanceGrid, pose: np.ndarray) -> np.ndarray:
    """Gap between the skin of each link and the object [m], negative where the flesh is in it.

    A link is a capsule about its bone, with the thickness of an adult's.

    Args:
        joints: [m], shape [21, 3], any frame.
        surface: of the object, object's frame.
        pose: of the object in the frame of the joints, shape [7].

    Returns:
        In the order of ``HUMAN_LINKS``, shape [16].
    """
    points = link_points(joints[None])[0]
    local = inverse_transform_points(pose, points.reshape(-1, 3))
    distance = SignedDistanceBank([surface]).query(np.zeros(1, dtype=int), local[None])[0]
    return distance.reshape(points.shape[:2]).min(axis=1) - LINK_RADII

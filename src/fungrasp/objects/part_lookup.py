"""On which named part of an object a point lies."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.signed_distance import nearest_on_mesh
from fungrasp.objects.object_model import ObjectModel


def nearest_parts(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Name of the part on which the nearest point of the surface lies, "" where the object has no parts.

    Args:
        model: the object.
        points: object frame [m], shape [P, 3].

    Returns:
        shape [P] str.
    """
    names = np.full(len(points), "", dtype=object)
    if model.parts and len(points):
        face = nearest_on_mesh(model.mesh, points)[1]
        for name, mask in model.parts.items():
            names[mask[face]] = name
    return names.astype(str)

"""How an object can rest on a table."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.triangle_mesh import normals_and_areas
from fungrasp.objects.object_model import ObjectModel

ALIKE = np.deg2rad(8.0)
"""Faces of a hull whose directions differ by less count as one: measured meshes are not flat [rad]."""

BROAD = 0.03
"""Share of a hull's surface from which such faces are broad: the end of a marker has 1 %, its side 20 %."""


def resting_directions(model: ObjectModel) -> np.ndarray:
    """Downward unit normals of the faces on which the object is stable: those of its convex hull below the
    center of mass.

    Returns:
        object frame, shape [R, 3].
    """
    triangles, center = model.hull, model.center_of_mass
    normals = normals_and_areas(triangles)[0]
    foot = center - normals * np.sum((center - triangles[:, 0]) * normals, axis=1, keepdims=True)
    inside = np.ones(len(triangles), dtype=bool)
    for corner in range(3):
        edge = triangles[:, (corner + 1) % 3] - triangles[:, corner]
        inside &= np.sum(np.cross(edge, foot - triangles[:, corner]) * normals, axis=1) >= -1e-9
    return normals[inside]


def settled_up(model: ObjectModel, up: np.ndarray) -> np.ndarray:
    """The table's normal once the object has settled from a pose in which it was ``up``: that of the nearest
    stable face.

    Measured poses are a few degrees off; a flat object would then hover or sink on one side.

    Args:
        up: unit vector, object frame, shape [..., 3].
    """
    downs = resting_directions(model)
    return -downs[np.argmin(up @ downs.T, axis=-1)]


def broad_settled_up(model: ObjectModel, up: np.ndarray) -> np.ndarray:
    """As ``settled_up``, of the faces that an object would be put down on: together with those that hardly
    differ in direction they are a considerable share of the convex hull, so that it stands there even where
    the table is tilted a little.

    Args:
        up: unit vector, object frame, shape [3].
    """
    normals, areas = normals_and_areas(model.hull)
    downs = resting_directions(model)
    alike = downs @ normals.T > np.cos(ALIKE)
    broad = alike @ areas >= BROAD * areas.sum()
    candidates = downs[broad] if broad.any() else downs
    return -candidates[np.argmin(candidates @ up)]

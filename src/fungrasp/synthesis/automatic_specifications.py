"""Automatic grasp specifications for a mesh: around the whole body, from above, and at thin parts and
handles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.text_files import read_json
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import settled_up
from fungrasp.synthesis.grasp_specification import WHOLE, GraspSpecification, Vector3

WIDEST_WRAP, WIDEST_SPAN = 0.085, 0.10
"""Largest widths of objects that a hand can wrap, and span between thumb and fingers [m]."""

THIN = 0.016
"""Largest radius of balls inside a thin part [m]."""

SHORTEST_PART = 0.03
"""Length of the shortest thin part to hold [m]."""

BAR = 0.06
"""Shortest length of a thin part that is held in the fist; shorter ones are held by fewer fingers [m]."""

HIGH = 0.04
"""Clearance above the table for a fist around a lying part [m]."""

SAMPLES, JOIN = 3000, 0.008
"""Number of surface samples, and largest distance of neighboring samples of a part [m]."""


def automatic_specifications(
    model: ObjectModel, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> list[GraspSpecification]:
    """Return about a dozen specifications, likely ones first.

    Args:
        model: the object. Its named parts are held, if it has any; otherwise thin parts are detected.
        up: unit vector, object frame. The object rests on the stable face for which this direction is most
            nearly up.
    """
    settled = settled_up(model, np.array(up, dtype=float))
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, SAMPLES, seed=0)[0])
    specs = _whole(model.name, points, settled)
    if model.parts:
        for name, mask in model.parts.items():
            part = trimesh.Trimesh(model.vertices, model.faces[mask], process=False)
            on_part = np.asarray(trimesh.sample.sample_surface(part, SAMPLES // 3, seed=0)[0])
            specs += _part(model.name, name, on_part, points, settled)
    else:
        for cluster in _thin_clusters(model, points, settled):
            specs += _part(model.name, WHOLE, cluster, points, settled)
    return [replace(spec, up=_vector(settled)) for spec in specs]


def parts_from_boxes(model: ObjectModel, path: str | Path) -> ObjectModel:
    """Add the named parts of a JSON file to an object: ``{"handle": [[x, y, z], [x, y, z]]}`` are the lower
    and upper corner of a box, object frame [m]; a part has the faces whose centers are in its box.

    Raises:
        FungraspError: the file is invalid, or a box has no faces.
    """
    boxes = read_json(path, "file of parts")
    if not isinstance(boxes, Mapping) or not boxes:
        raise FungraspError(f"{path}: expected a box for each name of a part")
    middles = model.vertices[model.faces].mean(axis=1)
    parts = {}
    for name, corners in boxes.items():
        try:
            low, high = np.array(corners, dtype=float).reshape(2, 3)
        except (TypeError, ValueError) as error:
            raise FungraspError(f"{path}: part '{name}' must be [[x, y, z], [x, y, z]]") from error
        parts[name] = ((middles >= low) & (middles <= high)).all(axis=1)
        if not parts[name].any():
            raise FungraspError(f"{path}: no face of '{model.name}' is inside the box of part '{name}'")
    return replace(model, parts=parts)


def _whole(name: str, points: np.ndarray, up: np.ndarray) -> list[GraspSpecification]:
    """Specify grasps of the whole object from the sides and from above."""
    long, short = _horizontal_axes(points, up)
    length, width = (float(np.ptp(points @ axis)) for axis in (long, short))
    middle, height = _center(points), float(np.ptp(points @ up))
    top = middle + up * (float((points @ up).max()) - middle @ up)
    specs = []

    def add(task: str, kind: str, at: np.ndarray, palm: np.ndarray, fingers: np.ndarray) -> None:
        specs.append(
            GraspSpecification(name, task, WHOLE, kind, _vector(at), _vector(palm), _vector(fingers))
        )

    round_ = length < 1.25 * width
    if width <= WIDEST_WRAP and height >= 0.05:
        for palm in (short, -short, *((long, -long) if round_ else ())):
            add("hold", "wrap", middle, palm, np.cross(palm, up))
    if width <= WIDEST_SPAN:
        for sign in (1, -1):
            kind = "disk" if round_ and width > 0.045 else "prism"
            add("lift", kind, top - 0.25 * min(height, 0.06) * up, -up, sign * short)
    if length <= WIDEST_SPAN and height <= WIDEST_SPAN:
        add("lift", "cover", top, -up, long)
    if width > WIDEST_SPAN:
        # Too wide to span: pinch a possible wall or edge from above.
        for outward in (long, -long, short, -short):
            edge = top + outward * float(((points - middle) @ outward).max())
            add("lift", "pinch", edge - 0.01 * up, -up, outward)
    if width <= 0.06:
        for sign in (1, -1):
            add("lift", "pinch", top - 0.2 * min(height, 0.06) * up, -up, sign * short)
    return specs


def _part(
    name: str, part: str, cluster: np.ndarray, points: np.ndarray, up: np.ndarray
) -> list[GraspSpecification]:
    """Specify grasps of a part: upright parts from outside, others from above, across the longest axis."""
    middle, whole = _center(cluster), _center(points)
    axis = np.linalg.svd(cluster - middle, full_matrices=False)[2][0]
    length = float(np.ptp(cluster @ axis))
    outward = middle - whole
    outward = outward - (outward @ up) * up
    specs = []
    if abs(axis @ up) > 0.7:
        far = np.linalg.norm(outward) > 0.01
        palms = [-outward] if far else [*_horizontal_axes(points, up)]
        for palm in palms:
            palm = palm / np.linalg.norm(palm)
            for tilt in (0.0, -0.3):
                kind = "fist" if length >= BAR else "handle"
                specs.append((kind, palm + tilt * up, np.cross(palm, up)))
    else:
        along = axis - (axis @ up) * up
        side = np.cross(up, along / np.linalg.norm(along))
        clearance = float(((cluster - middle) @ up).min() + (middle - points[np.argmin(points @ up)]) @ up)
        kinds = ("fist", "pinch") if length >= BAR and clearance >= HIGH else ("pinch", "tripod")
        specs += [(kind, -up, sign * side) for kind in kinds for sign in (1, -1)]
    return [
        GraspSpecification(name, "use", part, kind, _vector(middle), _vector(palm), _vector(fingers))
        for kind, palm, fingers in specs
    ]


def _thin_clusters(model: ObjectModel, points: np.ndarray, up: np.ndarray, most: int = 3) -> list[np.ndarray]:
    """Return surface samples of the largest thin parts [m], shape [P, 3] each.

    A part is thin if it is outside of everything that a ball of radius ``THIN`` reaches inside the object,
    whose horizontal sections are filled.
    """
    grid = model.signed_distance
    # Filling makes a mug count as solid.
    sections = np.moveaxis(grid.values < 0, int(np.argmax(np.abs(up))), 0)
    filled = np.stack([np.asarray(ndimage.binary_fill_holes(section)) for section in sections])
    core = _distance(filled) * grid.spacing > THIN
    if core.any():
        reached = _distance(~core) * grid.spacing <= THIN
        # Edges and corners of a thick body are within (sqrt(3) - 1) radii of the region that the ball
        # reaches.
        filled &= _distance(~reached) * grid.spacing > 0.75 * THIN
    filled = np.moveaxis(np.asarray(ndimage.binary_dilation(filled)), 0, int(np.argmax(np.abs(up))))
    cells = np.round((points - grid.origin) / grid.spacing).astype(int)
    thin = points[filled[tuple(cells.T)]]
    if len(thin) < 20:
        return []
    pairs = KDTree(thin).query_pairs(JOIN, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(thin), len(thin)))
    label = connected_components(graph, directed=False)[1]
    clusters = sorted((thin[label == number] for number in np.unique(label)), key=len, reverse=True)
    return [c for c in clusters if len(c) >= 20 and np.ptp(c, axis=0).max() >= SHORTEST_PART][:most]


def _distance(inside: np.ndarray) -> np.ndarray:
    """Return the distance of each cell to the nearest one outside, in cells."""
    transformed: Any = ndimage.distance_transform_edt(inside)
    return transformed


def _horizontal_axes(points: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the horizontal unit vectors of largest and smallest extent, at right angles."""
    flat = points - _center(points)
    flat = flat - np.outer(flat @ up, up)
    first = np.linalg.svd(flat, full_matrices=False)[2][0]
    return first, np.cross(up, first)


def _center(points: np.ndarray) -> np.ndarray:
    return (points.min(axis=0) + points.max(axis=0)) / 2


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = (round(float(value), 6) for value in values)
    return (x, y, z)

"""One image of an object on a table, as points in a frame on the table top: z up, z = 0 the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, transform_points
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.scene.table import largest_plane, world_from_table

ABOVE = 0.008
"""Points so high above the table are on something [m]: depth there is wrong by up to half of that."""

TALLEST = 0.45
"""Nothing that is scanned is higher [m]."""

CELL = 0.006
"""Cells of the table on which things are told apart [m]."""

LEAST_POINTS = 150
"""An object shows at least so many points."""

EDGE, EDGE_PIXELS = 0.012, 3
"""Beside a jump of depth [m] so many pixels are left out: a depth camera sees the mean of both sides
there."""


@dataclass(frozen=True, eq=False)
class TableView:
    """An image and where its camera is above the table."""

    capture: Capture
    """The image."""
    pose_table_camera: np.ndarray
    """Camera in a frame on the table, shape [7]; the origin is below the middle of the object."""
    points: np.ndarray
    """Points of the object [m], table frame, shape [P, 3]."""
    colors: np.ndarray
    """Their colors, RGB from 0 to 1, shape [P, 3]."""
    depth: np.ndarray
    """Depth without what is beside its jumps [m], shape [H, W]; 0: none."""


def table_view(capture: Capture, rng: np.random.Generator, number: int) -> TableView:
    """Find table and object: what stands on the table nearest to the middle of the image, or in its box or
    mask.

    Args:
        capture: the image.
        rng: chooses the planes that are tried.
        number: of the view, for messages.

    Raises:
        FungraspError: there is no table, or nothing on it.
    """
    plane = largest_plane(capture, rng)
    if plane is None:
        raise FungraspError(f"view {number}: no table was found; it must be much of the image")
    depth = without_edges(capture.depth)
    lens = capture.intrinsics
    points = lens.rays() * depth[..., None]
    height = points @ plane[:3] + plane[3]
    on = (depth > 0) & (height > ABOVE) & (height < TALLEST)
    if capture.mask is not None:
        on &= capture.mask
    if on.sum() < LEAST_POINTS:
        raise FungraspError(f"view {number}: nothing stands on the table")
    # A frame below anything on the table, to tell things apart in.
    pose = world_from_table(plane, np.median(points[on], axis=0))
    rows, columns = np.nonzero(on)
    places = transform_points(pose, points[rows, columns])
    chosen = _one_thing(places, rows, columns, capture)
    if chosen.sum() < LEAST_POINTS:
        raise FungraspError(
            f"view {number}: what stands in the middle of the image shows only {chosen.sum()} points: "
            "go nearer"
        )
    places, rows, columns = places[chosen], rows[chosen], columns[chosen]
    low, high = np.percentile(places[:, :2], (2, 98), axis=0)
    shift = np.append(0.5 * (low + high), 0.0)
    pose = np.concatenate([pose[:3] - shift, pose[3:]])
    return TableView(capture, pose, places - shift, capture.color[rows, columns] / 255.0, depth)


def without_edges(depth: np.ndarray) -> np.ndarray:
    """Depth with 0 beside its jumps and holes. depth: [m], shape [H, W]."""
    far = np.where(depth > 0, depth, np.inf)
    near = np.where(depth > 0, depth, -np.inf)
    with np.errstate(invalid="ignore"):
        jump = ndimage.maximum_filter(near, 3) - ndimage.minimum_filter(far, 3) > EDGE * np.maximum(
            depth, 0.5
        )
    lost = ndimage.binary_dilation(jump, iterations=EDGE_PIXELS - 1)
    return np.where(lost, 0.0, depth)


def _one_thing(places: np.ndarray, rows: np.ndarray, columns: np.ndarray, capture: Capture) -> np.ndarray:
    """Which points belong to the one thing that is meant, shape [P] bool."""
    cells = np.floor((places[:, :2] - places[:, :2].min(axis=0)) / CELL).astype(int)
    seen = np.zeros(cells.max(axis=0) + 3, bool)
    seen[tuple(cells.T + 1)] = True
    # Depth is missing where sides are steep: things with a narrow gap are one.
    joined = ndimage.binary_closing(seen, np.ones((3, 3)))
    names, _ = ndimage.label(joined | seen, np.ones((3, 3)))  # type: ignore[reportGeneralTypeIssues]
    name = names[tuple(cells.T + 1)]
    if capture.box is not None:
        x0, y0, x1, y1 = capture.box
        middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    else:
        middle = np.array([(capture.intrinsics.width - 1) / 2, (capture.intrinsics.height - 1) / 2])
    if capture.mask is not None:
        return name == np.bincount(name).argmax()
    best, nearest = 0, np.inf
    for one in np.unique(name):
        member = name == one
        if member.sum() < LEAST_POINTS:
            continue
        pixels = np.stack([columns[member], rows[member]], axis=1)
        away = float(np.linalg.norm(np.median(pixels, axis=0) - middle))
        if away < nearest:
            best, nearest = int(one), away
    return name == best


def moved_on_table(pose: np.ndarray, yaw: float, shift: np.ndarray) -> np.ndarray:
    """A pose in the table frame, turned about z and then shifted. pose: shape [7]; shift: [m], shape [3]."""
    motion = np.concatenate([shift, [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]])
    return compose(motion, pose)


def depth_at(view: TableView, points: np.ndarray) -> np.ndarray:
    """Depth measured where points are seen [m], 0 where there is none. points: camera frame, shape [P, 3]."""
    pixels = view.capture.intrinsics.project(points)
    height, width = view.depth.shape
    u, v = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(int).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return np.where(inside, view.depth[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], 0.0)

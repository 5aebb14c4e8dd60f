"""From a few images with depth of an object on a table to its mesh, in three steps.

1. Table and object in each image (``table_view``).
2. Where the views are to each other, by what is printed on the table (``registration``).
3. One surface for all (``fusion``), cut off at the table, closed, in metres.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.scan.fusion import fused_mesh
from fungrasp.perception.scan.registration import (
    match_prints,
    refined,
    turn_points,
    view_from_above,
)
from fungrasp.perception.scan.table_view import TableView, moved_on_table, table_view

LEAST_CORRELATION = 0.25
"""Prints on the table that correlate less are not the same."""

OVERLAP = 0.6
"""Part of a view's points that the others see as well."""

LEAST_VIEWS = 2
"""From one side nothing is known of the other."""


@dataclass(frozen=True)
class ScanSettings:
    """How a scan is made."""

    cell: float = 0.002
    """Edge of the grid's cells [m]: finer things are lost."""
    seed: int = 0
    """The same seed gives the same mesh."""

    def __post_init__(self) -> None:
        if not 0.0005 <= self.cell <= 0.02:
            raise FungraspError(f"a scan's cells are 0.0005 to 0.02 m large, not {self.cell:g}")


@dataclass(frozen=True, eq=False)
class ObjectScan:
    """What was scanned."""

    mesh: trimesh.Trimesh
    """Closed, [m], z up as it stood, origin on the table below its middle, colors per vertex."""
    yaws: np.ndarray
    """How the camera of each view is turned about the object, against the first [rad], shape [views]."""
    residuals: np.ndarray
    """How well each view meets those before it: root mean square distance [m], shape [views]; 0 for the
    first."""


def scan_object(captures: Sequence[Capture], settings: ScanSettings | None = None) -> ObjectScan:
    """The mesh of an object that stands on a newspaper, or on something else with a pattern, on a table.

    Args:
        captures: images all round, each turned against the one before it by no more than about 45 degrees,
            so that they overlap; in each the object is nearest to the middle, or in its box or mask.
        settings: how fine.

    Raises:
        FungraspError: there are too few views, one shows no table or no object, or one doesn't fit the
            others.
    """
    settings = settings or ScanSettings()
    if len(captures) < LEAST_VIEWS:
        raise FungraspError(f"a scan needs {LEAST_VIEWS} views or more, not {len(captures)}")
    rng = np.random.default_rng(settings.seed)
    views = [table_view(capture, rng, i + 1) for i, capture in enumerate(captures)]
    yaws, shifts = _by_print(views)
    placed = [_moved(view, yaw, shift) for view, yaw, shift in zip(views, yaws, shifts, strict=True)]
    residuals = np.array([_residual(placed, i) for i in range(len(placed))])
    mesh = fused_mesh(placed, settings.cell)
    low, high = mesh.bounds
    mesh.apply_translation([-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -low[2]])
    return ObjectScan(mesh, yaws - yaws[0], residuals)


def _by_print(views: Sequence[TableView]) -> tuple[np.ndarray, np.ndarray]:
    """Turns [rad], shape [views], and shifts [m], shape [views, 2], of a camera that was moved."""
    prints = [view_from_above(view) for view in views]
    yaws, shifts = np.zeros(len(views)), np.zeros((len(views), 2))
    pairs = []
    for i in range(1, len(views)):
        turn, way, score = match_prints(prints[i - 1], prints[i])
        if score < LEAST_CORRELATION:
            raise FungraspError(
                f"view {i + 1} does not fit the one before it: stand the object on a newspaper, by which the "
                "camera is found again, and move it by no more than 45 degrees"
            )
        pairs.append((i - 1, i, turn, way, score))
        yaws[i] = yaws[i - 1] + turn
        shifts[i] = shifts[i - 1] + turn_points(yaws[i - 1], np.append(way, 0.0)[None])[0, :2]
    if len(views) > LEAST_VIEWS:
        # The last view may see what the first one saw, which closes the round.
        turn, way, score = match_prints(prints[-1], prints[0])
        if score > LEAST_CORRELATION:
            pairs.append((len(views) - 1, 0, turn, way, score))
    return refined(yaws, shifts, pairs)


def _moved(view: TableView, yaw: float, shift: np.ndarray) -> TableView:
    way = np.append(shift, 0.0)
    pose = moved_on_table(view.pose_table_camera, float(yaw), way)
    motion = moved_on_table(np.array([0.0, 0, 0, 1, 0, 0, 0]), float(yaw), way)
    return dataclasses.replace(view, pose_table_camera=pose, points=transform_points(motion, view.points))


def _residual(views: Sequence[TableView], number: int) -> float:
    """Root mean square distance of the nearer part of a view's points from those of the others [m]."""
    others = np.concatenate([view.points[::4] for i, view in enumerate(views) if i != number])
    distance = np.sort(KDTree(others).query(views[number].points[::8])[0])
    return float(np.sqrt(np.mean(distance[: int(OVERLAP * len(distance))] ** 2)))

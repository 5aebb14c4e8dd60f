"""From a few images with depth of an object on a table to its mesh, in three steps.

1. Table and object in each image (``table_view``).
2. Where the views are to each other (``registration``), unless that is known.
3. One surface for all (``fusion``), cut off at the table, closed, in metres.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.scan.fusion import fused_mesh
from fungrasp.perception.scan.registration import Registered, register
from fungrasp.perception.scan.table_view import TableView, table_view, turned

FIRST_STEPS = np.radians([-50.0, -35.0, -20.0, 20.0, 35.0, 50.0])
"""Turns of the second view against the first from which its search starts, if nothing is known [rad]."""

LATER_STEPS = np.radians([-20.0, -10.0, 0.0, 10.0, 20.0])
"""How much less or more than the last one a view is turned at the start of its search [rad]."""

KNOWN_STEPS = np.radians([-6.0, 0.0, 6.0])
"""The same where it is said how much [rad]."""

ROUNDS = 2
"""So often each view is registered onto all others in the end, which closes the round."""

WORST = 0.005
"""Views whose points are farther from the others' than this [m] don't fit."""

LEAST_VIEWS = 2
"""From one side nothing is known of the other."""


@dataclass(frozen=True)
class ScanSettings:
    """How a scan is made."""

    cell: float = 0.002
    """Edge of the grid's cells [m]: finer things are lost."""
    turntable: float | None = None
    """How far the object is turned from each image to the next [degrees], counter-clockwise from above; None: the
    camera is moved, or the turn is not known."""
    seed: int = 0
    """The same seed gives the same mesh."""

    def __post_init__(self) -> None:
        if not 0.0005 <= self.cell <= 0.02:
            raise FungraspError(f"a scan's cells are 0.0005 to 0.02 m large, not {self.cell:g}")


@dataclass(frozen=True, eq=False)
class ObjectScan:
    """What was scanned."""

    mesh: trimesh.Trimesh
    """Closed, [m], z up as it stood, origin on the table below its middle, colours per vertex."""
    yaws: np.ndarray
    """How the camera of each view is turned about the object, against the first [rad], shape [views]."""
    residuals: np.ndarray
    """How well each view meets those before it: root mean square distance [m], shape [views]; 0 for the first."""


def scan_object(captures: Sequence[Capture], settings: ScanSettings | None = None) -> ObjectScan:
    """The mesh of an object that stands alone on a table.

    Args:
        captures: images all round, each turned against the one before it by no more than about 45 degrees, so that
            they overlap; in each the object is nearest to the middle, or in its box or mask.
        settings: how fine, and what is known about the views.

    Raises:
        FungraspError: there are too few views, one shows no table or no object, or one doesn't fit the others.
    """
    settings = settings or ScanSettings()
    if len(captures) < LEAST_VIEWS:
        raise FungraspError(f"a scan needs {LEAST_VIEWS} views or more, not {len(captures)}")
    rng = np.random.default_rng(settings.seed)
    views = [table_view(capture, rng, i + 1) for i, capture in enumerate(captures)]
    found = [Registered(0.0, np.zeros(3), 0.0)]
    for i, view in enumerate(views[1:], start=1):
        if settings.turntable is None:
            # People go round a thing in one direction; the first step tells which.
            steps = FIRST_STEPS if i == 1 else LATER_STEPS + found[-1].yaw - found[-2].yaw
            turns = found[-1].yaw + steps
        else:
            # Turned back by as much as the object was turned forth under the camera.
            turns = KNOWN_STEPS - i * np.radians(settings.turntable)
        found.append(_onto(view, views[:i], found, turns, rng))
    for _ in range(ROUNDS):
        for i in range(1, len(views)):
            others = [k for k in range(len(views)) if k != i]
            found[i] = _onto(
                views[i], [views[k] for k in others], [found[k] for k in others], [found[i].yaw], rng
            )
    for i, one in enumerate(found):
        if one.residual > WORST:
            raise FungraspError(
                f"view {i + 1} does not fit the others (it is {1000 * one.residual:.1f} mm off): turn the object or the "
                "camera by less from view to view, say how much it was turned, and leave the object as it stands"
            )
    placed = [_moved(view, one) for view, one in zip(views, found, strict=True)]
    yaws, residuals = ([getattr(one, name) for one in found] for name in ("yaw", "residual"))
    mesh = fused_mesh(placed, settings.cell)
    low, high = mesh.bounds
    mesh.apply_translation([-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -low[2]])
    return ObjectScan(mesh, np.array(yaws), np.array(residuals))


def _onto(
    view: TableView,
    others: Sequence[TableView],
    found: Sequence[Registered],
    turns: Sequence[float] | np.ndarray,
    rng: np.random.Generator,
) -> Registered:
    """A view registered onto others that are placed already."""
    placed = [_moved(other, one) for other, one in zip(others, found, strict=True)]
    points = np.concatenate([other.points for other in placed])
    colors = np.concatenate([other.colors for other in placed])
    return register(view.points, view.colors, points, colors, turns, rng)


def _moved(view: TableView, found: Registered) -> TableView:
    pose = turned(view.pose_table_camera, found.yaw, found.shift)
    motion = turned(np.array([0.0, 0, 0, 1, 0, 0, 0]), found.yaw, found.shift)
    return dataclasses.replace(view, pose_table_camera=pose, points=transform_points(motion, view.points))

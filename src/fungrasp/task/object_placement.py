"""Poses of objects and tables in worlds that differ from the belief."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from fungrasp.geometry.poses import invert, quaternion_from_rotation_vector, rotate
from fungrasp.objects import ObjectModel
from fungrasp.sim2real import EpisodeSample, offset_pose, tilt_on_table

REST_ANGLE = float(np.deg2rad(5.0))
"""An object is at rest if tipping or rolling by this angle raises its center of mass [rad]. The angle exceeds
the error of an estimated rotation, so an object that starts on an edge falls back."""

REST_DIRECTIONS = 180
"""Number of tested tipping directions, 2 degrees apart: a can on its side rolls only across its axis, as any
tilt along the axis raises it."""


@dataclass(frozen=True, eq=False)
class Placement:
    """Objects at rest on their tables, I of them."""

    object_pose: np.ndarray
    """World frame, shape [I, 7]."""
    table_height: np.ndarray
    """Height of the table top under the object [m], shape [I]."""
    table_tilt: np.ndarray
    """Rotation vector of the table top, world frame x and y [rad], shape [I, 2]."""

    @property
    def height_at_origin(self) -> np.ndarray:
        """Height of the table top at the world's origin [m], shape [I]."""
        zero = np.zeros((len(self.table_tilt), 1))
        turn = quaternion_from_rotation_vector(np.concatenate([self.table_tilt, zero], axis=1))
        normal = rotate(turn, np.array([0.0, 0.0, 1.0]))
        slope = np.sum(normal[:, :2] * self.object_pose[:, :2], axis=1) / normal[:, 2]
        return self.table_height + slope


def on_drawn_table(pose: np.ndarray, height: np.ndarray, sample: EpisodeSample) -> Placement:
    """Place objects on tables with sampled height and tilt.

    Args:
        pose: poses on the nominal tables, world frame, shape [I, 7].
        height: heights of the nominal tables [m], shape [I].
        sample: random parameters, I rows.
    """
    raised, table = pose.copy(), height + sample.table_height
    raised[:, 2] += sample.table_height
    if sample.table_tilt.any():
        raised = tilt_on_table(raised, sample.table_tilt, table)
    return Placement(raised, table, sample.table_tilt)


def where_seen(
    seen: np.ndarray,
    height: np.ndarray,
    sample: EpisodeSample,
    models: Sequence[ObjectModel],
    center: np.ndarray,
) -> Placement:
    """Place objects so that their estimated poses are the given poses.

    The table height is estimated from the object on it: if the object is seen too high, so is the table. The
    distance of the object's lowest point from the table is kept; an object tilted by the error settles.

    Args:
        seen: poses with the sample's error, world frame, shape [I, 7].
        height: estimated table heights [m], shape [I].
        sample: random parameters, I rows.
        models: object models, length I.
        center: center of the rotation error, the center of mass [m], object frame, shape [I, 3].
    """
    if not sample.object_bias.any():
        return on_drawn_table(seen, height, sample)
    pose = offset_pose(seen, -sample.object_bias, center)
    too_high = sample.object_bias[:, 2]
    pose[:, 2] = seen[:, 2] + lowest_above_origin(models, seen) - lowest_above_origin(models, pose) - too_high
    return on_drawn_table(pose, height - too_high, sample)


def resting_shift(models: Sequence[ObjectModel], pose: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Limit shifts of centers of mass so that objects stay at rest.

    Without the limit, a can on its side could roll away at once, although it was seen at rest. With u the
    down direction in the object frame, ``S(u)`` the extent of the object along it (support function), and c
    its center of mass, ``H(u) = S(u) - c . u`` is the center's height above the table. The object is at rest
    at u0 if ``H(u_k) >= H(u0)`` in all directions k, ``REST_ANGLE`` away. This is linear in the shift d:
    ``d . (u_k - u0) <= S(u_k) - S(u0) - c . (u_k - u0)``. The horizontal part of the result is that of the
    nearest feasible shift. The removed length is added downwards, where the mass of a rolled object is, as
    far as no fraction exceeds the largest sampled one.

    Args:
        models: object models, length I.
        pose: rest poses, world frame, shape [I, 7].
        shift: sampled shifts along the object's axes, as fractions of its extents, shape [I, 3].

    Returns:
        Feasible shifts in the same units, shape [I, 3].
    """
    result = shift.copy()
    around = 2 * np.pi * np.arange(REST_DIRECTIONS) / REST_DIRECTIONS
    tipped = np.stack(
        [
            np.sin(REST_ANGLE) * np.cos(around),
            np.sin(REST_ANGLE) * np.sin(around),
            np.full(REST_DIRECTIONS, -np.cos(REST_ANGLE)),
        ],
        axis=1,
    )
    down = np.array([0.0, 0.0, -1.0])
    for i in np.flatnonzero(shift.any(axis=1)).tolist():
        model, turn = models[i], pose[i, 3:]
        wanted = rotate(turn, shift[i] * model.size)
        points = np.concatenate([piece.vertices for piece in model.pieces]) - model.center_of_mass
        points = rotate(turn[None], points)
        # Objects that settled in soft contacts may be slightly off their rest pose.
        room = np.maximum((points @ tipped.T).max(axis=0) - (points @ down).max(), 0.0)
        steps = tipped - down
        if np.all(steps @ wanted <= room):
            continue
        kept = wanted + _least_change(-steps, steps @ wanted - room)
        back, most = invert(pose[i])[3:], np.abs(shift[i]).max()
        nearest = rotate(back, kept) / model.size
        # A shorter or lower shift is also feasible.
        shorter = min(1.0, most / np.abs(nearest).max(initial=1e-12))
        nearest, kept = shorter * nearest, shorter * kept
        below = np.sqrt(max(wanted @ wanted - kept[:2] @ kept[:2], 0.0))
        lowered = rotate(back, np.array([0.0, 0.0, -below - kept[2]])) / model.size
        moving = np.abs(lowered) > 1e-9
        ways = (np.copysign(most, lowered[moving]) - nearest[moving]) / lowered[moving]
        result[i] = nearest + min(1.0, float(ways.min(initial=1.0))) * lowered
    return result


def _least_change(rows: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Return the shortest x with ``rows @ x >= least``, shape [3] (least distance programming: Lawson and
    Hanson, Solving Least Squares Problems, chapter 23). rows: shape [K, 3]; least: shape [K]."""
    scale = np.abs(least).max()
    stacked = np.vstack([rows.T, least / scale])
    goal = np.array([0.0, 0.0, 0.0, 1.0])
    residual = stacked @ nnls(stacked, goal)[0] - goal
    return -scale * residual[:3] / residual[3]


def lowest_above_origin(models: Sequence[ObjectModel], pose: np.ndarray) -> np.ndarray:
    """Return the height of each object's lowest point above its origin [m], shape [I]."""
    up = rotate(invert(pose)[:, 3:], np.array([0.0, 0.0, 1.0]))
    return np.array([np.min(model.vertices @ u) for model, u in zip(models, up, strict=True)])

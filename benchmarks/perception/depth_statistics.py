"""How depth images look, in numbers, so that rendered ones can be held beside measured ones.

Nothing here needs to know the true depth: an edge is judged by the surfaces on both sides of it, noise by the
planes that lie near the measured points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from fungrasp.perception import Intrinsics

STEP = (0.03, 0.4)
"""Differences of depth [m] that are taken for an outline in front of something behind it."""

FARTHEST = 1.3
"""Edges in front of things farther than this [m] are left out: noise there is as large as steps."""

REACH, PLATEAU = 16, 12
"""An edge lies within ``REACH`` pixels each way; the ``PLATEAU`` pixels beyond are the surfaces."""

MIXED, LEAST_MIXED = 0.1, 0.006
"""A depth is mixed if it is farther than this part of the step, and this [m], from both surfaces."""

FLAT = 0.4
"""Surfaces may change over ``REACH`` by this part of the step."""

JUMP, ACROSS = 0.4, 8
"""Somewhere depth must change by this part of the step within so many pixels: bent surfaces do not."""

WINDOWS = (13, 61)
"""Edges of the square windows in which planes are fitted [pixels]: fine noise, and waves."""

BINS = (0.3, 0.6, 0.8, 1.0, 1.3)
"""Limits of distance between which noise is counted [m]."""

TILT = 1.5
"""Planes steeper than this (change of depth over change along the image, both in meters) are not counted."""


@dataclass(frozen=True)
class DepthStatistics:
    """Figures of one or more depth images."""

    edge_mixed: np.ndarray
    """Mixed pixels of every edge found along rows and columns, shape [E]."""
    edge_holes: np.ndarray
    """Pixels without depth within ``REACH`` of the same edges, shape [E]."""
    holes: np.ndarray
    """Part of each image nearer than 1.5 m that has no depth, shape [images]."""
    noise: np.ndarray
    """Root mean square distance of depth from a plane [m], by window and bin of distance, median over the
    windows, shape [2, len(BINS) - 1]; NaN where too few were found."""

    def rows(self) -> list[tuple[str, float]]:
        """Name and value of every figure; widths in pixels, noise in millimeters."""
        found: list[tuple[str, float]] = []
        for name, values in (
            ("mixed pixels at an edge", self.edge_mixed),
            ("holes at an edge", self.edge_holes),
        ):
            for quantile, word in ((0.5, "median"), (0.9, "90th percentile")):
                value = float(np.quantile(values, quantile)) if len(values) else float("nan")
                found.append((f"{name}, {word}", value))
        found.append(("without depth [%]", 100 * float(self.holes.mean())))
        for k, window in enumerate(WINDOWS):
            for i, (low, high) in enumerate(pairwise(BINS)):
                found.append(
                    (f"off a plane of {window} px, {low}-{high} m [mm]", 1000 * float(self.noise[k, i]))
                )
        return found


def depth_statistics(images: Iterable[tuple[np.ndarray, Intrinsics]]) -> DepthStatistics:
    """Statistics of depth images.

    Args:
        images: depth [m], 0 where nothing was measured, shape [H, W], each with its intrinsics.
    """
    mixed, lost, holes = [], [], []
    noise: list[list[list[np.ndarray]]] = [[[] for _ in BINS[1:]] for _ in WINDOWS]
    for depth, intrinsics in images:
        for lines in (depth, depth.T):
            m, h = edge_widths(lines)
            mixed.append(m)
            lost.append(h)
        holes.append(_part_without_depth(depth))
        for k, window in enumerate(WINDOWS):
            distance, off = plane_noise(depth, intrinsics, window)
            for i in range(len(BINS) - 1):
                noise[k][i].append(off[(distance >= BINS[i]) & (distance < BINS[i + 1])])
    return DepthStatistics(
        np.concatenate(mixed) if mixed else np.zeros(0),
        np.concatenate(lost) if lost else np.zeros(0),
        np.array(holes),
        np.array([[_median(np.concatenate(part)) if part else np.nan for part in row] for row in noise]),
    )


def edge_widths(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mixed and lost pixels of each step in depth along the rows of an image.

    Args:
        depth: [m], shape [H, W].

    Returns:
        Both shape [E].
    """
    width = 2 * (REACH + PLATEAU) + 1
    if depth.shape[1] < width:
        return np.zeros(0), np.zeros(0)
    measured = np.where(depth > 0, depth, np.nan)
    lines = sliding_window_view(measured, width, axis=1)
    # Each surface goes on as it does beyond the edge: most of what a sloped table changes by is no step.
    places = np.arange(width) - (width - 1) / 2
    near, near_slope = _line(lines[..., :PLATEAU], places[:PLATEAU])
    far, far_slope = _line(lines[..., -PLATEAU:], places[-PLATEAU:])
    size = np.nan_to_num(np.abs(far - near))
    curved = np.maximum(np.abs(near_slope), np.abs(far_slope)) * REACH
    chosen = (size > STEP[0]) & (size < STEP[1]) & (curved < FLAT * size) & (np.fmax(near, far) < FARTHEST)
    # Of neighboring places one counts, where the surfaces differ most.
    size = np.where(chosen, size, 0.0)
    chosen &= size >= ndimage.maximum_filter1d(size, 2 * REACH + 1, axis=1)
    inner = places[PLATEAU:-PLATEAU]
    mixed, lost = [], []
    last = (-1, 0)
    for row, column in np.argwhere(chosen):
        if row == last[0] and column - last[1] <= 2 * REACH:
            continue
        line, step = lines[row, column, PLATEAU:-PLATEAU], size[row, column]
        seen = np.flatnonzero(~np.isnan(line))
        if len(seen) < 2:
            continue
        whole = np.interp(np.arange(len(line)), seen, line[seen])
        if np.abs(whole[ACROSS:] - whole[:-ACROSS]).max() < JUMP * step:
            continue
        last = (row, column)
        off_near = np.abs(line - near[row, column] - near_slope[row, column] * inner)
        off_far = np.abs(line - far[row, column] - far_slope[row, column] * inner)
        mixed.append(int((np.fmin(off_near, off_far) > max(MIXED * step, LEAST_MIXED)).sum()))
        lost.append(int(np.isnan(line).sum()))
    return np.array(mixed, float), np.array(lost, float)


def _line(values: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height at place 0 and slope of the lines through values, shape [..., N]; NaN where one is missing."""
    centered = places - places.mean()
    slope = values @ (centered / (centered @ centered))
    return values.mean(-1) - slope * places.mean(), slope


def plane_noise(depth: np.ndarray, intrinsics: Intrinsics, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance of depth from the plane that fits best, in windows side by side.

    Args:
        depth: [m], shape [H, W].
        intrinsics: of the image.
        window: edge [pixels].

    Returns:
        Mean depth of each window that shows one plane [m], and the root mean square difference of its depth
        from that plane [m], both shape [windows].
    """
    half = window // 2
    # In a plane 1/z is linear over the image; solved for z near the mean to first order.
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    basis = np.stack([np.ones(u.size), u.ravel() / half, v.ravel() / half], axis=-1)
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    distances, offs = [], []
    solve = np.linalg.pinv(basis)
    for row in range(half, depth.shape[0] - half, window):
        for column in range(half, depth.shape[1] - half, window):
            z = depth[row - half : row + half + 1, column - half : column + half + 1].ravel()
            if not (z > 0).all():
                continue
            inverse = 1.0 / z
            fit = solve @ inverse
            mean = 1.0 / fit[0]
            off = (inverse - basis @ fit) * mean**2
            slope = float(np.hypot(fit[1], fit[2])) * mean * focal / half
            sigma = float(np.sqrt(np.mean(off**2)))
            # An edge or a bent surface is no plane: most of its error is in few places.
            if slope < TILT and sigma < 0.006 * mean and np.abs(off).max() < 4.5 * sigma + 1e-3:
                distances.append(mean)
                offs.append(sigma)
    return np.array(distances), np.array(offs)


def _part_without_depth(depth: np.ndarray) -> float:
    """Of the pixels whose nearest measured neighbor is nearer than 1.5 m."""
    missing = depth <= 0
    if missing.all():
        return 1.0
    nearest = np.asarray(ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True))
    rows, columns = nearest
    near = depth[rows, columns] < 1.5
    return float((missing & near).sum() / max(int(near.sum()), 1))


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) >= 5 else float("nan")


def beside(columns: Sequence[tuple[str, DepthStatistics]]) -> list[tuple[str, ...]]:
    """A table of the figures of several sets of images, header first."""
    rows = [stat.rows() for _, stat in columns]
    table: list[tuple[str, ...]] = [("", *(name for name, _ in columns))]
    for i, (name, _) in enumerate(rows[0]):
        values = [row[i][1] for row in rows]
        table.append((name, *("" if np.isnan(value) else f"{value:.1f}" for value in values)))
    return table

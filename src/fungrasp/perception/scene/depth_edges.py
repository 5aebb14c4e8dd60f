"""How sharp the depth image is at outlines, and how far a pixel's depth may be wrong because of that.

A stereo camera compares windows of pixels: within half a window of a step in depth it gives something between
the two sides. On clean images the steps are a pixel or two wide.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.perception.io.capture import depth_noise

REACH = 12
"""A step is looked for within so many pixels to both sides [pixels of an image 640 wide]."""

SIDE = 5
"""Length of the even stretch that must follow on both sides [pixels]."""

STEPS = (0.025, 0.35)
"""Least and largest step that is looked at [m]: smaller ones drown in noise, larger ones are seldom outlines
of
what is near."""

FARTHEST = 1.5
"""Depth beyond this [m] is not looked at."""

LEAST_STEPS = 40
"""Fewer steps don't tell how wide they are."""

EVEN = 0.15
"""How much the depth may change beside a step, per pixel, as a part of the step's own mean slope."""

SHARP = 2.0
"""Width of steps that is taken where they can't be measured [pixels]."""

SMOOTHED = 6.0
"""Wider steps are worth a warning [pixels]; rendered ones are 0 to 4 pixels wide."""

MIXED = 0.3
"""Standard deviation of the depth near a step, as a part of the step: of an even mixture of both sides."""


def filled(depth: np.ndarray) -> np.ndarray:
    """The depth image with the nearest measurement where there is none [m], shape [H, W]."""
    nearest: Any = ndimage.distance_transform_edt(depth <= 0, return_distances=False, return_indices=True)
    return depth[tuple(nearest)]


def edge_width(depth: np.ndarray) -> float:
    """How many pixels steps in depth are mixed over: from 10 to 90 % of the step, median over the image.

    Args:
        depth: [m], shape [H, W]; 0: not measured.

    Returns:
        [pixels]; ``SHARP`` where there are too few steps.
    """
    if not (depth > 0).any():
        return SHARP
    whole = filled(depth)
    widths = np.concatenate([_step_widths(whole), _step_widths(np.ascontiguousarray(whole.T))])
    return float(max(SHARP, np.median(widths))) if len(widths) >= LEAST_STEPS else SHARP


def _step_widths(depth: np.ndarray) -> np.ndarray:
    """Widths of the steps along the rows [pixels], at most some hundred of them."""
    margin, last = REACH + SIDE, depth.shape[1]
    if last <= 2 * margin:
        return np.zeros(0)
    left, right = depth[:, SIDE : last - SIDE - 2 * REACH], depth[:, SIDE + 2 * REACH : last - SIDE]
    step = np.abs(right - left)
    limit = EVEN * step / (2 * REACH) * SIDE
    even = (np.abs(left - depth[:, : last - 2 * margin]) < limit) & (
        np.abs(depth[:, 2 * margin :] - right) < limit
    )
    even &= (step > STEPS[0]) & (step < STEPS[1]) & (np.maximum(left, right) < FARTHEST)
    slope = np.abs(np.diff(depth, axis=1, append=depth[:, -1:]))
    steepest = slope == ndimage.maximum_filter1d(slope, 2 * REACH - 1, axis=1)
    rows, columns = np.nonzero(even & steepest[:, margin : last - margin])
    every = max(1, len(rows) // 400)
    rows, columns = rows[::every], columns[::every] + margin
    lines = depth[rows[:, None], columns[:, None] + np.arange(-REACH, REACH + 1)]
    part = (lines - lines[:, :1]) / (lines[:, -1:] - lines[:, :1])
    return ((part > 0.1) & (part < 0.9)).sum(axis=1)


def depth_spread(depth: np.ndarray, width: float) -> np.ndarray:
    """Standard deviation of each pixel's depth [m], shape [H, W]: the sensor's noise, and near steps the
    mixture of both sides.

    Args:
        depth: [m], shape [H, W]; 0: not measured.
        width: of the steps, see ``edge_width`` [pixels].
    """
    noise = depth_noise(depth)
    if width <= SHARP:
        return noise
    whole, size = filled(depth), 2 * round(0.5 * width) + 1
    step = ndimage.maximum_filter(whole, size) - ndimage.minimum_filter(whole, size)
    # What an even surface seen at 45 degrees changes within the window is no step.
    return np.hypot(noise, MIXED * np.maximum(step - noise, 0.0))

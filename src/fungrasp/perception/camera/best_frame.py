"""Which of a few frames is the sharpest and steadiest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import ndimage

from fungrasp.perception.camera.frames import CameraFrame
from fungrasp.perception.io.capture import Box

STEADY = 1.5
"""Frames that differ from their neighbours by no more than so many times the least count as steady."""

MARGIN = 0.3
"""The hand's box is widened by this part on each side: the object is beside it."""


def best_first(frames: Sequence[CameraFrame], around: Box) -> list[int]:
    """Indices of frames, best first: the steady ones by sharpness, then the others.

    Sharpness is the variance of the Laplacian of the brightness; steadiness the mean difference of brightness
    from the frames before and after.

    Args:
        frames: one after the other, of one size.
        around: the hand's box ``x0, y0, x1, y1`` [pixels]; only it and what is beside it counts.
    """
    grey = [frame.color[_part(frame, around)].mean(axis=-1, dtype=np.float32) for frame in frames]
    sharp = np.array([np.var(ndimage.laplace(image)) for image in grey])
    change = [float(np.abs(a - b).mean()) for a, b in pairwise(grey)]
    # The first and the last frame have one neighbour.
    moved = np.array([max(change[max(i - 1, 0) : i + 1], default=0.0) for i in range(len(grey))])
    shaky = moved > STEADY * moved.min() + 1e-6
    return [int(i) for i in np.lexsort((-sharp, shaky))]


def _part(frame: CameraFrame, box: Box) -> tuple[slice, slice]:
    x0, y0, x1, y1 = box
    across, down = MARGIN * (x1 - x0), MARGIN * (y1 - y0)
    width, height = frame.intrinsics.width, frame.intrinsics.height
    left, right = np.clip([x0 - across, x1 + across], 0, width).astype(int)
    top, bottom = np.clip([y0 - down, y1 + down], 0, height).astype(int)
    if right - left < 3 or bottom - top < 3:
        return slice(0, height), slice(0, width)
    return slice(top, bottom), slice(left, right)

"""What a person says about where the object is: a mask, a box, or a click."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.perception.io.capture import Box, Capture, Pixel
from fungrasp.perception.scene.pixel_classes import NEVER

MASK_TRUST = 2.5
"""Masks are wrong by so many pixels (standard error); by 6 at most, beyond twice of which nothing is
believed."""

MASK_SURE = 4.0
"""Logarithm of the odds of what is deep in a mask, or clicked at: colours that say otherwise may still win,
as masks have holes and clicks go beside."""

MASK_REACH = 12.0
"""Pixels farther outside a mask are not looked at."""

CLICK = 3.0
"""Pixels so near to the one that was clicked at show the same."""


def told_odds(capture: Capture, size: float) -> tuple[np.ndarray, np.ndarray]:
    """What mask, box or point say about each pixel. size: longest distance within the object [m].

    Returns:
        logarithm of the odds that it shows the object, ``NEVER`` outside a box, shape [H, W]; which pixels
        surely show it, shape [H, W] bool.
    """
    prior: np.ndarray = np.zeros(capture.depth.shape)
    samples: np.ndarray = np.zeros(capture.depth.shape, dtype=bool)
    mask: Any = capture.mask
    if mask is not None:
        inside: Any = ndimage.distance_transform_edt(mask)
        outside: Any = ndimage.distance_transform_edt(~mask)
        prior = np.clip((inside - outside) / MASK_TRUST, NEVER, MASK_SURE)
        prior = np.where(outside > MASK_REACH, NEVER, prior)
        samples = inside >= min(MASK_REACH / 2, 0.5 * float(inside.max()))
    elif capture.box is not None:
        prior = np.where(_in_box(capture.box, prior.shape), 0.0, NEVER)
    if capture.point is not None:
        v, u = np.mgrid[: prior.shape[0], : prior.shape[1]]
        away = np.hypot(u - capture.point[0], v - capture.point[1])
        samples = away <= CLICK
        depths = capture.depth[(away <= 3 * CLICK) & capture.measured]
        depth = float(np.median(depths if len(depths) else capture.depth[capture.measured]))
        prior = np.where(samples, MASK_SURE, prior)
        prior = np.where(away < size * capture.intrinsics.fx / depth, prior, NEVER)
    return prior, samples


def pointed_pieces(pieces: list[np.ndarray], point: Pixel) -> list[np.ndarray]:
    """The piece in which the point is, or the nearest one; and that with the others next to it."""
    if not pieces:
        return []
    away: list[float] = []
    for piece in pieces:
        rows, columns = np.nonzero(piece)
        away.append(float(np.hypot(columns - point[0], rows - point[1]).min()))
    order = np.argsort(away)
    first = pieces[order[0]]
    extent = 0.5 * np.sqrt(float(first.sum()))
    together = [pieces[i] for i in order if away[i] < away[order[0]] + extent]
    return [first, np.logical_or.reduce(together)] if len(together) > 1 else [first]


def _in_box(box: Box, shape: tuple[int, ...]) -> np.ndarray:
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    return (columns >= box[0]) & (columns <= box[2]) & (rows >= box[1]) & (rows <= box[3])

"""Mistakes that images show themselves: a wrong unit of depth, depth that is not aligned, and hints about the
object that contradict each other."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.capture import Capture

DEPTH_RANGE = (0.1, 8.0)
"""Where the middle of a capture's depth must lie [m]."""

USUAL_DEPTH = (0.25, 3.0)
"""Where it mostly lies [m]."""

UNITS = (0.001, 0.0001, 0.00025, 0.01, 1.0)
"""Units of depth that cameras and data sets use [m]."""

SHIFTS = np.arange(-28, 29, 4)
"""Shifts between color and depth that are tried [pixels at 640 x 480]."""

SHIFT_GAIN = 1.4
"""How much better than where it is the depth must fit elsewhere to be called shifted."""

STEP = 0.05
"""Neighboring pixels whose depth differs by this [m] are the edge of a thing."""

EDGES_WITHIN = 1.5
"""Only things nearer than this [m] count: farther away, noise makes steps where nothing ends."""

LEAST_EDGE = 100
"""Least number of pixels of edges [at 640 x 480] for the alignment to be checked."""

TILES, LEAST_TILE = 8, 20
"""Columns and rows of parts of the image that are asked one by one, and pixels of edges that each must have
[at 640 x 480]: depth that is shifted is so everywhere, while stripes beside the edge of one thing, such as
the next finger, are in one place only."""

TELLING = 0.2
"""Parts in which the edges are stronger or weaker by less than this part are not asked."""

AGREEING = 0.75
"""Part of them in which the depth must fit better where it is said to belong."""


def check_depth_range(depth: np.ndarray, unit: float, where: str) -> None:
    """Complain about depth that no camera could have measured in front of a hand.

    Args:
        depth: [m], shape [H, W].
        unit: metres per unit that was used.
        where: name of the file, for messages.

    Raises:
        FungraspError: no measurement, or not plausible in metres; the message names the unit that would be.
    """
    measured = depth[depth > 0]
    if not measured.size:
        raise FungraspError(f"{where}: the depth image is empty: no pixel has a measurement")
    middle = float(np.median(measured))
    if DEPTH_RANGE[0] <= middle <= DEPTH_RANGE[1]:
        return
    fitting = [u for u in UNITS if USUAL_DEPTH[0] <= middle / unit * u <= USUAL_DEPTH[1]]
    hint = (
        f"; with units of {fitting[0]:g} m it would be {middle / unit * fitting[0]:.2g} m: --depth-unit "
        f"{fitting[0]:g}"
        if fitting
        else ""
    )
    raise FungraspError(
        f"{where}: the depth is {middle:.3g} m in the middle of its range, with units of {unit:g} m; that "
        f"can't be right{hint}"
    )


def check_alignment(capture: Capture) -> tuple[int, int] | None:
    """Is the depth shifted against the color?

    Where a thing ends in depth, it mostly ends in the color image, too. The strength of color edges at the
    steps in depth is compared with that at the same steps shifted. Only a peak among the shifts counts: where
    the strongest is at the end of the range, a busy background draws it there.

    Returns:
        Columns and rows by which the depth lies away from where it belongs [pixels], or None if all looks
        well or there are too few edges.
    """
    depth = np.where(capture.measured, capture.depth, np.nan)
    scale = max(1.0, capture.intrinsics.width / 640)
    nearest, farthest = ndimage.minimum_filter(depth, 3), ndimage.maximum_filter(depth, 3)
    with np.errstate(invalid="ignore"):
        steps = (farthest - nearest > STEP) & (nearest < EDGES_WITHIN)
    shifts = np.round(SHIFTS * scale).astype(int)
    reach = int(shifts[-1])
    steps[:reach], steps[-reach:], steps[:, :reach], steps[:, -reach:] = False, False, False, False
    rows, columns = np.nonzero(steps)
    if len(rows) < LEAST_EDGE * scale:
        return None
    gray = ndimage.gaussian_filter(capture.color.mean(axis=-1), 1.5 * scale)
    edges = np.hypot(ndimage.sobel(gray, 0), ndimage.sobel(gray, 1))
    strength = np.array([[edges[rows + dy, columns + dx] for dx in shifts] for dy in shifts])
    fit = strength.mean(axis=-1)
    here = np.argmin(np.abs(shifts))
    near = fit[here - 1 : here + 2, here - 1 : here + 2].max()
    down, across = np.unravel_index(np.argmax(fit), fit.shape)
    last = len(shifts) - 1
    if fit[down, across] < SHIFT_GAIN * near or down in (0, last) or across in (0, last):
        return None
    height, width = depth.shape
    tile = (rows * TILES // height) * TILES + columns * TILES // width
    counts = np.bincount(tile, minlength=TILES**2)
    gain = np.bincount(tile, strength[down, across] - strength[here, here], TILES**2)
    # Edges along the shift are as strong elsewhere: they say nothing.
    telling = (counts >= LEAST_TILE * scale) & (np.abs(gain) > TELLING * near * counts)
    if (gain[telling] > 0).sum() < AGREEING * max(int(telling.sum()), 1):
        return None
    return -int(shifts[across]), -int(shifts[down])


def check_hints(capture: Capture) -> None:
    """Complain about a mask, a box and a point that can't show the same object.

    Raises:
        FungraspError: the point lies outside the box, or box or point where the mask has no pixel.
    """
    around = capture.box
    if capture.mask is not None:
        rows, columns = np.nonzero(capture.mask)
        around = float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max())
        if capture.box is not None:
            x0, y0, x1, y1 = capture.box
            if not ((columns >= x0) & (columns <= x1) & (rows >= y0) & (rows <= y1)).any():
                raise FungraspError("the object's mask has no pixel in the object's box: give one of them")
    if capture.point is None or around is None:
        return
    (u, v), (x0, y0, x1, y1) = capture.point, around
    if not (x0 <= u <= x1 and y0 <= v <= y1):
        other = "box" if capture.mask is None else "mask"
        raise FungraspError(
            f"the object's point {capture.point} lies outside its {other}, which reaches from {x0:g}, {y0:g} "
            f"to {x1:g}, {y1:g}: give one of them"
        )

"""Read captures from image files, and detect wrong units, unaligned depth and contradictory hints."""

from __future__ import annotations

import dataclasses
import logging
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.image_file import read_image
from fungrasp.core.formats.numpy_files import read_npy
from fungrasp.perception.io.capture import DEPTH_LIMIT, Box, Capture, Intrinsics, Pixel
from fungrasp.perception.io.estimates import PerceptionWarning
from fungrasp.perception.io.intrinsics_files import read_intrinsics

# Larger images [pixels] are reduced: more pixels cost time and do not help.
LONGEST_SIDE = 1920

_DEPTH_MODES = ("I", "I;16", "I;16B", "I;16L")
_log = logging.getLogger(__name__)


def read_capture(
    color: str | Path,
    depth: str | Path,
    intrinsics: str | Path | Intrinsics,
    *,
    depth_unit: float | None = None,
    mask: str | Path | None = None,
    box: Box | None = None,
    point: Pixel | None = None,
    image: int | None = None,
) -> Capture:
    """Read a color image, the depth aligned to it and the camera's intrinsics.

    Args:
        depth: 16-bit PNG, 16-bit or float TIFF, or ``.npy``; 0: not measured; floats are meters if
            ``depth_unit`` is None.
        intrinsics: JSON, see ``read_intrinsics``.
        depth_unit: meters per unit of the depth image; from the intrinsics file if None.
        mask: image that is not 0 where the object is.
        box: box around the object [pixels].
        point: a pixel of the object.
        image: number of the image, for intrinsics of many images.

    Returns:
        The capture, reduced if its longer side exceeds ``LONGEST_SIDE`` (with a log message).

    Raises:
        FungraspError: a file can't be read, or the files don't fit together; the message says how.
    """
    picture = read_color(color)
    size = (picture.shape[1], picture.shape[0])
    if isinstance(intrinsics, Intrinsics):
        lens, unit, remarks = intrinsics, depth_unit, ()
        if (lens.width, lens.height) != size:
            raise FungraspError(
                f"the intrinsics are for an image of {lens.width} x {lens.height} pixels, but {color} has "
                f"{size[0]} x {size[1]}"
            )
    else:
        read = read_intrinsics(intrinsics, size, image=image)
        lens, unit = read.intrinsics, depth_unit if depth_unit is not None else read.depth_unit
        remarks = read.warnings
    distance = read_depth(depth, unit, float_unit=1.0 if depth_unit is None else depth_unit)
    if distance.shape != picture.shape[:2]:
        turned = distance.shape == size
        raise FungraspError(
            f"the depth image {depth} has {distance.shape[1]} x {distance.shape[0]} pixels and the color "
            f"image {size[0]} x {size[1]}: "
            + ("one of them is turned or transposed" if turned else "align the depth to the color first")
        )
    distance = _filled(distance, str(depth))
    marked = None if mask is None else read_mask(mask, picture.shape[:2])
    whole = Capture(picture, distance, lens, marked, box, point, remarks)
    capture = whole.reduced(LONGEST_SIDE)
    if capture is not whole:
        smaller = capture.intrinsics
        _log.warning(
            "the images of %d x %d pixels are made smaller: %d x %d", *size, smaller.width, smaller.height
        )
    if how := check_turned(capture):
        warning = PerceptionWarning.of("depth_turned", how=how)
    elif shift := check_alignment(capture):
        warning = PerceptionWarning.of("depth_shifted", across=shift[0], down=shift[1])
    else:
        return capture
    _log.warning("%s: %s", depth, warning)
    return dataclasses.replace(capture, warnings=(*remarks, warning))


@guarded("color image")
def read_color(path: str | Path) -> np.ndarray:
    """Read a PNG or JPEG.

    Returns:
        RGB, shape [H, W, 3] uint8.

    Raises:
        FungraspError: it is missing, truncated, no image, too large or has 16 bits per channel.
    """
    image = read_image(path, "color image")
    if image.mode in ("1", "F", *_DEPTH_MODES):
        raise FungraspError(
            f"{path} is not a color image (its pixels are of type '{image.mode}'): is it the depth?"
        )
    return np.array(image.convert("RGB"))


@guarded("depth image")
def read_depth(path: str | Path, unit: float | None, *, float_unit: float = 1.0) -> np.ndarray:
    """Read a depth image.

    Args:
        path: 16-bit PNG or TIFF, float TIFF, or ``.npy`` of floats or integers, shape [H, W].
        unit: meters per unit of integers; may be None for floats.
        float_unit: meters per unit of floats.

    Returns:
        [m], 0 where nothing was measured, shape [H, W] float32.

    Raises:
        FungraspError: it can't be read, is no depth image, or its unit is missing or implausible.
    """
    path = Path(path)
    raw = read_npy(path, "depth image") if path.suffix.lower() == ".npy" else _depth_pixels(path)
    if raw.ndim != 2 or raw.dtype.kind not in "uif":
        raise FungraspError(
            f"{path}: depth is an array of numbers [H, W], not {raw.dtype} of {list(raw.shape)}"
        )
    if raw.dtype.kind == "f":
        unit = float(float_unit)
        depth = np.nan_to_num(raw, nan=0.0, posinf=0.0, neginf=0.0) * unit
    elif unit is None:
        raise FungraspError(
            f"{path}: say how many meters a unit of depth is: 0.001 (1 mm) is usual, 0.0001 and 0.00025 occur"
        )
    else:
        # Recorders write 65535 where nothing was measured.
        depth = np.where(raw == 65535, 0, raw) * float(unit)
    # Renderers write a large number where a ray hits nothing.
    within = np.where(depth <= DEPTH_LIMIT, depth, 0.0)
    depth = within if np.count_nonzero(within > 0) > LEAST_WITHIN * depth.size else depth
    check_depth_range(depth, unit, str(path))
    # Single values may be arbitrarily wrong.
    return np.clip(depth, -1e6, 1e6).astype(np.float32)


@guarded("mask")
def read_mask(path: str | Path, shape: tuple[int, ...]) -> np.ndarray:
    """Read a mask from an image or a ``.npy`` file: pixels that are not 0 show the object, except transparent
    ones, because the object may have been cut out.

    Args:
        shape: required rows and columns.

    Returns:
        Mask, bool, shape [H, W].

    Raises:
        FungraspError: it can't be read or has another shape.
    """
    if Path(path).suffix.lower() == ".npy":
        array = read_npy(path, "mask")
        if array.ndim != 2 or array.dtype.kind not in "buif":
            raise FungraspError(f"the mask {path} must be numbers [H, W], not {array.dtype} {array.shape}")
        mask = array != 0
    else:
        image = read_image(path, "mask")
        mask = np.array(image) != 0
        if mask.ndim == 3:
            opacity = np.array([band in ("A", "a") for band in image.getbands()])
            mask = mask[..., ~opacity].any(axis=-1) & mask[..., opacity].all(axis=-1)
    if mask.shape != shape:
        raise FungraspError(
            f"the mask {path} has {mask.shape[1]} x {mask.shape[0]} pixels and the color image {shape[1]} x "
            f"{shape[0]}"
        )
    return mask


def parse_box(text: str) -> Box:
    """Parse a box ``x0,y0,x1,y1`` [pixels]. Raises: FungraspError: the text is not one."""
    x0, y0, x1, y1 = _parsed(text, 4, "a box is x0,y0,x1,y1 in pixels")
    return x0, y0, x1, y1


def parse_point(text: str) -> Pixel:
    """Parse a pixel ``u,v``, column and row. Raises: FungraspError: the text is not one."""
    u, v = _parsed(text, 2, "a point is u,v (column and row) in pixels")
    return u, v


def _parsed(text: str, count: int, words: str) -> list[float]:
    with suppress(ValueError):
        numbers = [float(part) for part in text.split(",")]
        if len(numbers) == count:
            return numbers
    raise FungraspError(f"{words}, not '{text}'")


def _depth_pixels(path: Path) -> np.ndarray:
    image = read_image(path, "depth image")
    if image.mode != "F" and image.mode not in _DEPTH_MODES:
        raise FungraspError(
            f"{path} has pixels of type '{image.mode}': a picture of depth; save depth as a 16-bit PNG"
        )
    return np.array(image)


SPARSE, AROUND = 0.6, 9
"""Depth is sparse, like that of a coarser camera projected into the color image, if less than this fraction
of the pixels with a measurement in a square of this size [pixels] are measured; usual are 81 to 99 %."""

LEAST_WITHIN = 0.05
"""Fraction of the pixels within ``DEPTH_LIMIT`` above which farther pixels count as not measured."""


def _filled(depth: np.ndarray, where: str) -> np.ndarray:
    """Fill sparse depth with the nearest measurement in the gaps between measurements [m], shape [H, W]."""
    measured = depth > 0
    part = float(measured.sum() / max(int(ndimage.maximum_filter(measured, AROUND).sum()), 1))
    if part >= SPARSE:
        return depth
    transformed: Any = ndimage.distance_transform_edt(~measured, return_indices=True)
    away, nearest = transformed
    _log.warning("%s: only %.0f %% of the pixels have a depth; gaps are filled", where, 100 * part)
    return np.where(away <= 1.0 / np.sqrt(part), depth[tuple(nearest)], np.float32(0.0))


DEPTH_RANGE = (0.1, 8.0)  # Possible median of a capture's depth [m].
USUAL_DEPTH = (0.25, 3.0)  # Usual median [m].
UNITS = (0.001, 0.0001, 0.00025, 0.01, 1.0)  # Units of depth of cameras and data sets [m].
SHIFTS = np.arange(-28, 29, 4)  # Tested shifts between color and depth [pixels of an image 640 wide].
SHIFT_GAIN = 1.4  # Smallest gain of the fit by a shift for which depth counts as shifted.
TURN_GAIN = 1.1  # Smallest gain of the fit by mirroring or rotating, compared with any shift.
STEP = 0.05  # Depth difference between neighboring pixels at the edge of a thing [m].
# Largest depth of such edges [m]; farther away, noise makes steps.
EDGES_WITHIN = 1.5
LEAST_EDGE = 100  # Smallest number of edge pixels for the check [of an image 640 wide].
# Columns and rows of tiles that are checked one by one, and smallest number of edge pixels in a tile [of an
# image 640 wide]: depth is shifted everywhere, but parallel edges, such as the next finger, are local.
TILES, LEAST_TILE = 8, 20
TELLING = 0.2  # Smallest relative gain or loss of the fit in a tile that counts.
AGREEING = 0.75  # Smallest fraction of these tiles in which the fit gains.


def check_depth_range(depth: np.ndarray, unit: float, where: str) -> None:
    """Check that depth may have been measured in front of a hand.

    Args:
        depth: [m], shape [H, W].
        unit: meters per unit of the file.
        where: name of the source, for messages.

    Raises:
        FungraspError: there is no measurement, or depth is implausible; the message names a plausible unit.
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
        f"{where}: the median depth is {middle:.3g} m with units of {unit:g} m; that can't be right{hint}"
    )


def check_alignment(capture: Capture) -> tuple[int, int] | None:
    """Check whether the depth is shifted against the color.

    Edges of things in depth are mostly edges in color. The strength of color edges at steps in depth is
    compared with that at shifted steps. Only a maximum inside the range of shifts counts, because a busy
    background may cause one at its end.

    Returns:
        Columns and rows by which the depth is shifted [pixels]; None if it is not, or without enough edges.
    """
    scale = _scale(capture)
    steps, edges = _depth_steps(capture), _color_edges(capture)
    shifts = np.round(SHIFTS * scale).astype(int)
    reach = int(shifts[-1])
    steps[:reach], steps[-reach:], steps[:, :reach], steps[:, -reach:] = False, False, False, False
    rows, columns = np.nonzero(steps)
    if len(rows) < LEAST_EDGE * scale:
        return None
    strength = np.array([[edges[rows + dy, columns + dx] for dx in shifts] for dy in shifts])
    fit = strength.mean(axis=-1)
    here = np.argmin(np.abs(shifts))
    near = fit[here - 1 : here + 2, here - 1 : here + 2].max()
    down, across = np.unravel_index(np.argmax(fit), fit.shape)
    last = len(shifts) - 1
    if fit[down, across] < SHIFT_GAIN * near or down in (0, last) or across in (0, last):
        return None
    height, width = steps.shape
    tile = (rows * TILES // height) * TILES + columns * TILES // width
    counts = np.bincount(tile, minlength=TILES**2)
    gain = np.bincount(tile, strength[down, across] - strength[here, here], TILES**2)
    # Edges along the shift are equally strong elsewhere and say nothing.
    telling = (counts >= LEAST_TILE * scale) & (np.abs(gain) > TELLING * near * counts)
    if (gain[telling] > 0).sum() < AGREEING * max(int(telling.sum()), 1):
        return None
    return -int(shifts[across]), -int(shifts[down])


def check_turned(capture: Capture) -> str:
    """Return how the depth must be mirrored or rotated to fit the color, in words; empty if it fits or there
    are too few edges. Correct images fit at least 1.6 times as well at the best shift as mirrored, mirrored
    images at most 0.75 times."""
    steps = _depth_steps(capture)
    if steps.sum() < LEAST_EDGE * _scale(capture):
        return ""
    edges = ndimage.maximum_filter(_color_edges(capture), 2 * round(4 * _scale(capture)) + 1)
    ways = {
        "mirrored left to right": steps[:, ::-1],
        "mirrored top to bottom": steps[::-1],
        "turned by 180 degrees": steps[::-1, ::-1],
    }
    fit = {how: float(edges[turned].mean()) for how, turned in ways.items()}
    best = max(fit, key=lambda how: fit[how])
    rows, columns = np.nonzero(steps)
    last = np.array(steps.shape) - 1
    shifts = np.round(SHIFTS[::2] * _scale(capture)).astype(int)
    shifted = (
        edges[np.clip(rows + dy, 0, last[0]), np.clip(columns + dx, 0, last[1])].mean()
        for dy in shifts
        for dx in shifts
    )
    return best if fit[best] > TURN_GAIN * max(shifted) else ""


def _scale(capture: Capture) -> float:
    """Return the width relative to an image 640 wide, at least 1."""
    return max(1.0, capture.intrinsics.width / 640)


def _depth_steps(capture: Capture) -> np.ndarray:
    """Return the pixels at edges of near things, bool, shape [H, W]."""
    depth = np.where(capture.measured, capture.depth, np.nan)
    nearest, farthest = ndimage.minimum_filter(depth, 3), ndimage.maximum_filter(depth, 3)
    with np.errstate(invalid="ignore"):
        return (farthest - nearest > STEP) & (nearest < EDGES_WITHIN)


def _color_edges(capture: Capture) -> np.ndarray:
    """Return the gradient magnitude of the color image's brightness, shape [H, W]."""
    gray = ndimage.gaussian_filter(capture.color.mean(axis=-1), 1.5 * _scale(capture))
    return np.hypot(ndimage.sobel(gray, 0), ndimage.sobel(gray, 1))


def check_hints(capture: Capture) -> None:
    """Check that mask, box and point may show the same object.

    Raises:
        FungraspError: the point is outside box or mask, or the box has no pixel of the mask.
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

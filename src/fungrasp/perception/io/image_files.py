"""Reading a capture from image files, with the usual mistakes named."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.image_file import read_image
from fungrasp.core.formats.numpy_files import read_npy
from fungrasp.perception.estimates import PerceptionWarning
from fungrasp.perception.io.capture import Box, Capture, Intrinsics, Pixel
from fungrasp.perception.io.capture_checks import check_alignment, check_depth_range
from fungrasp.perception.io.intrinsics_files import read_intrinsics

LONGEST_SIDE = 1920
"""Images with a longer side [pixels] are made smaller: more pixels cost time and tell nothing more."""

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
        color: PNG or JPEG.
        depth: 16-bit PNG (or TIFF with 16-bit or float pixels, or ``.npy``), 0 where nothing was measured;
            floats are metres if ``depth_unit`` is not given.
        intrinsics: JSON, see ``read_intrinsics``.
        depth_unit: metres per unit of the depth image; None takes what the intrinsics file says.
        mask: image that is not 0 where the object is.
        box: round the object [pixels].
        point: a pixel that shows the object.
        image: number of the image, for intrinsics of many images.

    Returns:
        The capture, made smaller if its longer side exceeds ``LONGEST_SIDE`` (that is logged).

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
        raise FungraspError(
            f"the depth image {depth} has {distance.shape[1]} x {distance.shape[0]} pixels and the color "
            f"image {size[0]} x {size[1]}: align the depth to the color first"
        )
    marked = None if mask is None else read_mask(mask, picture.shape[:2])
    capture = _not_too_large(Capture(picture, distance, lens, marked, box, point, remarks))
    shift = check_alignment(capture)
    if shift is None:
        return capture
    warning = PerceptionWarning.of("depth_shifted", across=shift[0], down=shift[1])
    _log.warning("%s: %s", depth, warning)
    return dataclasses.replace(capture, warnings=(*remarks, warning))


@guarded("color image")
def read_color(path: str | Path) -> np.ndarray:
    """Read a PNG or JPEG.

    Returns:
        RGB, shape [H, W, 3] uint8.

    Raises:
        FungraspError: it is missing, cut short, no image, too large or has 16 bits per channel.
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
        unit: metres per unit of integers; may be None for floats.
        float_unit: metres per unit of floats.

    Returns:
        [m], 0 where nothing was measured, shape [H, W] float32.

    Raises:
        FungraspError: it can't be read, is no depth image, its unit is not given or can't be right.
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
            f"{path}: say how many metres a unit of depth is: 0.001 (1 mm) is usual, 0.0001 and 0.00025 occur"
        )
    else:
        depth = raw * float(unit)
    check_depth_range(depth, unit, str(path))
    # Single numbers may be as wrong as they like.
    return np.clip(depth, -1e6, 1e6).astype(np.float32)


@guarded("mask")
def read_mask(path: str | Path, shape: tuple[int, ...]) -> np.ndarray:
    """Read an image that is not 0 where the object is.

    Args:
        path: the image.
        shape: rows and columns it must have.

    Returns:
        bool, shape [H, W].

    Raises:
        FungraspError: it can't be read or has another shape.
    """
    image = read_image(path, "mask")
    mask = np.array(image) != 0
    if mask.ndim == 3:
        # How opaque a pixel is says nothing about what it shows.
        mask = mask[..., [band not in ("A", "a") for band in image.getbands()]].any(axis=-1)
    if mask.shape != shape:
        raise FungraspError(
            f"the mask {path} has {mask.shape[1]} x {mask.shape[0]} pixels and the color image {shape[1]} x "
            f"{shape[0]}"
        )
    return mask


def parse_box(text: str) -> Box:
    """The box written as ``x0,y0,x1,y1`` [pixels].

    Raises:
        FungraspError: it is something else.
    """
    try:
        x0, y0, x1, y1 = (float(part) for part in text.split(","))
    except ValueError as error:
        raise FungraspError(f"a box is x0,y0,x1,y1 in pixels, not '{text}'") from error
    return x0, y0, x1, y1


def parse_point(text: str) -> Pixel:
    """The pixel written as ``u,v``: column and row.

    Raises:
        FungraspError: it is something else.
    """
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError as error:
        raise FungraspError(f"a point is u,v (column and row) in pixels, not '{text}'") from error
    return u, v


def _depth_pixels(path: Path) -> np.ndarray:
    image = read_image(path, "depth image")
    if image.mode != "F" and image.mode not in _DEPTH_MODES:
        raise FungraspError(
            f"{path} has pixels of type '{image.mode}': a picture of depth; save depth as a 16-bit PNG"
        )
    return np.array(image)


def _not_too_large(capture: Capture) -> Capture:
    height, width = capture.depth.shape
    stride = -(-max(width, height) // LONGEST_SIDE)
    if stride == 1:
        return capture
    size = (width // stride, height // stride)
    _log.warning("the images of %d x %d pixels are made smaller: %d x %d", width, height, *size)
    whole = np.s_[: size[1] * stride, : size[0] * stride]
    middle = np.s_[stride // 2 : size[1] * stride : stride, stride // 2 : size[0] * stride : stride]
    cropped = dataclasses.replace(capture.intrinsics, width=size[0] * stride, height=size[1] * stride)
    color = Image.fromarray(capture.color[whole]).reduce(stride)
    box = capture.box
    return Capture(
        np.array(color),
        capture.depth[middle],
        cropped.resized(*size),
        None if capture.mask is None else capture.mask[middle],
        None if box is None else tuple(edge / stride for edge in box),
        None if capture.point is None else _within(capture.point, stride, size),
        capture.warnings,
    )


def _within(point: Pixel, stride: int, size: tuple[int, int]) -> Pixel:
    """The pixel in the image that is smaller by ``stride``, of that width and height."""
    u, v = point
    return min(u / stride, size[0] - 1.0), min(v / stride, size[1] - 1.0)

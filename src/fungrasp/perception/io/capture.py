"""RGB-D captures: a color image, the depth aligned to it, and camera intrinsics.

Camera frame: OpenCV (x right, y down, z forward) [m]. Pixels are ``[u v]``, column and row, with
whole numbers at pixel centers: the top left pixel is ``[0 0]`` and covers -0.5 to 0.5.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.estimates import PerceptionWarning

# Median depth beyond this is a mistake of units: no depth camera for hands sees so far [m].
DEPTH_LIMIT = 20.0

Box = tuple[float, float, float, float]
"""``x0, y0, x1, y1`` [pixels]: left, top, right and bottom edge."""

Pixel = tuple[float, float]
"""``u, v`` [pixels]: column and row."""


def depth_noise(depth: np.ndarray) -> np.ndarray:
    """Return the standard deviation of a depth camera's error [m], shape of ``depth`` [m]."""
    return 0.0025 + 0.002 * depth**2


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of a pinhole camera without distortion."""

    width: int
    """Image width [pixels]."""
    height: int
    """Image height [pixels]."""
    fx: float
    """Focal length along the columns [pixels]."""
    fy: float
    """Focal length along the rows [pixels]."""
    cx: float
    """Column of the optical axis [pixels]."""
    cy: float
    """Row of the optical axis [pixels]."""

    def __post_init__(self) -> None:
        if not (self.width > 0 and self.height > 0):
            raise FungraspError(f"an image must have pixels; the intrinsics say {self.width} x {self.height}")
        if not all(math.isfinite(value) and value > 0 for value in (self.fx, self.fy)):
            raise FungraspError(
                f"the focal lengths fx and fy must be positive [pixels], not {self.fx} and {self.fy}"
            )
        if not (0 <= self.cx <= self.width and 0 <= self.cy <= self.height):
            raise FungraspError(
                f"the optical axis cx = {self.cx:g}, cy = {self.cy:g} lies outside the image of {self.width} "
                f"x {self.height}: intrinsics of another resolution?"
            )

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project camera-frame points [m], shape [..., 3], to pixels, shape [..., 2]; NaN for points that are
        not in front of the camera."""
        points = np.asarray(points, dtype=float)
        depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
        return points[..., :2] / depth * [self.fx, self.fy] + [self.cx, self.cy]

    def deproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return camera-frame points [m], shape [..., 3], of pixels, [..., 2], at depths z [m], [...]."""
        depth = np.asarray(depth, dtype=float)[..., None]
        slopes = (np.asarray(pixels, dtype=float) - [self.cx, self.cy]) / [self.fx, self.fy]
        return np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1) * depth

    def rays(self) -> np.ndarray:
        """Return directions of all pixel centers with z = 1, camera frame, shape [height, width, 3]."""
        columns, rows = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.deproject(np.stack([columns, rows], axis=-1), np.ones((self.height, self.width)))

    def resized(self, width: int, height: int) -> Intrinsics:
        """Return the intrinsics after the image has been resized to ``width`` x ``height``."""
        across, down = width / self.width, height / self.height
        return Intrinsics(
            width,
            height,
            self.fx * across,
            self.fy * down,
            (self.cx + 0.5) * across - 0.5,
            (self.cy + 0.5) * down - 0.5,
        )


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """A color image and the depth aligned to it from a camera. Unlike a ``Capture``, it may lack depth."""

    color: np.ndarray
    """RGB, uint8, shape [H, W, 3]."""
    depth: np.ndarray
    """Distance along the optical axis [m], float32, shape [H, W]; 0: no measurement."""
    intrinsics: Intrinsics
    """Intrinsics of both images."""
    time: float
    """Time at which the images were taken, ``time.monotonic`` [s]."""

    def capture(self) -> Capture:
        """Return the frame as a capture.

        Raises:
            FungraspError: depth is missing or implausible.
        """
        return Capture(self.color, self.depth, self.intrinsics)


@runtime_checkable
class RgbdCamera(Protocol):
    """A depth camera, opened by ``with camera:``, such as ``RealSenseCamera``."""

    def __enter__(self) -> Self:
        """Start the camera. Raises: FungraspError: it is missing or fails; the message says what to do."""
        ...

    def __exit__(self, *error: object) -> None:
        """Stop the camera."""
        ...

    def capture(self) -> Capture:
        """Take an image. Raises: FungraspError: none comes, or its depth is implausible."""
        ...


@dataclass(frozen=True, eq=False)
class Capture:
    """A color image and the depth aligned to it, checked."""

    color: np.ndarray
    """RGB, uint8, shape [H, W, 3]."""
    depth: np.ndarray
    """Distance along the optical axis [m], float32, shape [H, W]; 0: no measurement."""
    intrinsics: Intrinsics
    """Intrinsics of both images."""
    mask: np.ndarray | None = None
    """Pixels that show the object, bool, shape [H, W]; None if not given."""
    box: Box | None = None
    """Box around the object in the image [pixels]; None if not given."""
    point: Pixel | None = None
    """A pixel that shows the object; None if not given."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """Warnings about the files that it was read from."""

    def __post_init__(self) -> None:
        height, width = self.intrinsics.height, self.intrinsics.width
        _check_array("color image", self.color, np.uint8, (height, width, 3))
        _check_array("depth image", self.depth, np.float32, (height, width))
        if self.mask is not None:
            _check_array("object's mask", self.mask, np.bool_, (height, width))
            if not self.mask.any():
                raise FungraspError("the object's mask is empty: no pixel is marked")
        if self.box is not None:
            _check_box(self.box, width, height)
        if self.point is not None:
            _check_point(self.point, width, height)
        _check_range(self.depth)

    @property
    def measured(self) -> np.ndarray:
        """Pixels with depth, bool, shape [H, W]."""
        return self.depth > 0

    def points(self) -> np.ndarray:
        """Return the point at each pixel [m], camera frame, shape [H, W, 3]; NaN without depth."""
        depth = np.where(self.measured, self.depth, np.nan)
        return self.intrinsics.rays() * depth[..., None]

    def with_object(
        self, mask: np.ndarray | None = None, box: Box | None = None, point: Pixel | None = None
    ) -> Capture:
        """Return the capture with the object's mask, box and point replaced, checked."""
        return dataclasses.replace(self, mask=mask, box=box, point=point)

    def reduced(self, longest: int) -> Capture:
        """Return the capture with every n-th row and column, so that its longer side is at most ``longest``
        pixels; itself if it is small enough. Colors are averaged, depth is not."""
        lens = self.intrinsics
        stride = -(-max(lens.width, lens.height) // longest)
        if stride == 1:
            return self
        width, height = lens.width // stride, lens.height // stride
        blocks = (height, stride, width, stride)
        whole, middle = np.s_[: height * stride, : width * stride], stride // 2
        color = self.color[whole].reshape(*blocks, 3).mean(axis=(1, 3)).round().astype(np.uint8)
        point, box = self.point, self.box
        if point is not None:
            point = min(point[0] / stride, width - 1.0), min(point[1] / stride, height - 1.0)
        if box is not None:
            box = box[0] / stride, box[1] / stride, box[2] / stride, box[3] / stride
        return Capture(
            color,
            np.ascontiguousarray(self.depth[whole][middle::stride, middle::stride]),
            dataclasses.replace(lens, width=width * stride, height=height * stride).resized(width, height),
            None if self.mask is None else np.asarray(self.mask[whole].reshape(blocks).any(axis=(1, 3))),
            box,
            point,
            self.warnings,
        )


def _check_array(name: str, array: np.ndarray, dtype: type, shape: tuple[int, ...]) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        found = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise FungraspError(f"the {name} must be an array of {np.dtype(dtype).name}, not {found}")
    if array.shape != shape:
        raise FungraspError(
            f"the {name} has shape {list(array.shape)}, but the intrinsics are for one of {list(shape)}"
        )


def _check_box(box: Box, width: int, height: int) -> None:
    x0, y0, x1, y1 = box
    if not (math.isfinite(x0 + y0 + x1 + y1) and x0 < x1 and y0 < y1):
        raise FungraspError(f"the object's box must be x0,y0,x1,y1 with x0 < x1 and y0 < y1, not {box}")
    if x1 <= 0 or y1 <= 0 or x0 >= width or y0 >= height:
        raise FungraspError(f"the object's box {box} lies outside the image of {width} x {height} pixels")
    if x1 - x0 < 1 or y1 - y0 < 1:
        raise FungraspError(f"the object's box {box} is smaller than a pixel: it must be in pixels")


def _check_point(point: Pixel, width: int, height: int) -> None:
    u, v = point
    if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
        raise FungraspError(f"the object's point {point} lies outside the image of {width} x {height} pixels")


def _check_range(depth: np.ndarray) -> None:
    if not np.isfinite(depth).all() or (depth < 0).any():
        raise FungraspError(
            "the depth image has negative or non-finite values; write 0 where nothing was measured"
        )
    measured = depth[depth > 0]
    if not measured.size:
        raise FungraspError("the depth image is empty: no pixel has a measurement")
    middle = float(np.median(measured))
    if middle > DEPTH_LIMIT:
        raise FungraspError(f"the median depth is {middle:.4g} m: were millimeters taken for meters?")

"""What a depth camera saw: one color image, the depth aligned to it, and the lens; usual mistakes are found.

Camera frame: OpenCV (x right, y down, z forward) [m]. Pixels are ``[u v]``: column and row, and whole numbers
are pixel centers, so that the top left pixel is ``[0 0]`` and covers -0.5 to 0.5.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from fungrasp.errors import FungraspError

DEPTH_LIMIT = 20.0
"""Depth beyond this [m] is taken for a mistake of units: no depth camera for hands sees so far."""

Box = tuple[float, float, float, float]
"""``x0, y0, x1, y1`` [pixels]: left, top, right and bottom edge."""

Pixel = tuple[float, float]
"""``u, v`` [pixels]: column and row."""


def depth_noise(depth: np.ndarray) -> np.ndarray:
    """Standard deviation of a depth camera's error [m]. depth: [m]."""
    return 0.0025 + 0.002 * depth**2


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion."""

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

    @property
    def matrix(self) -> np.ndarray:
        """``K``: pixels times depth from camera-frame points, shape [3, 3]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels of camera-frame points. points: [m], shape [..., 3]. Returns shape [..., 2]; NaN for points
        that are not in front of the camera."""
        points = np.asarray(points, dtype=float)
        depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
        return points[..., :2] / depth * [self.fx, self.fy] + [self.cx, self.cy]

    def deproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Camera-frame points [m], shape [..., 3], of pixels, shape [..., 2], at depths z, shape [...]."""
        depth = np.asarray(depth, dtype=float)[..., None]
        slopes = (np.asarray(pixels, dtype=float) - [self.cx, self.cy]) / [self.fx, self.fy]
        return np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1) * depth

    def rays(self) -> np.ndarray:
        """Direction of every pixel's center with z = 1, camera frame, shape [height, width, 3]."""
        columns, rows = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.deproject(np.stack([columns, rows], axis=-1), np.ones((self.height, self.width)))

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same camera's intrinsics after its image has been resized to ``width`` x ``height``."""
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
class Capture:
    """One color image with the depth aligned to it, checked."""

    color: np.ndarray
    """RGB, uint8, shape [H, W, 3]."""
    depth: np.ndarray
    """Distance along the optical axis [m], float32, shape [H, W]; 0: no measurement."""
    intrinsics: Intrinsics
    """Intrinsics of the camera, the same for color and depth."""
    mask: np.ndarray | None = None
    """Which pixels show the object, bool, shape [H, W]; None if not given."""
    box: Box | None = None
    """Box around the object in the image [pixels]; None if not given."""
    point: Pixel | None = None
    """A pixel that shows the object; None if not given."""

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
        """Which pixels have a depth, bool, shape [H, W]."""
        return self.depth > 0

    def points(self) -> np.ndarray:
        """What each pixel shows [m], camera frame, shape [H, W, 3]; NaN where there is no depth."""
        depth = np.where(self.measured, self.depth, np.nan)
        return self.intrinsics.rays() * depth[..., None]

    def with_object(
        self, mask: np.ndarray | None = None, box: Box | None = None, point: Pixel | None = None
    ) -> Capture:
        """The same capture with the object's mask, box or point (see the fields), checked."""
        return dataclasses.replace(self, mask=mask, box=box, point=point)


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
        raise FungraspError(
            f"the depth is {middle:.4g} m in the middle of its range: were millimetres taken for metres?"
        )


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

SKIN_PART = (0.003, 0.02)
"""Parts of the image: less skin than the first, and more than the second once red and blue are swapped, look
like BGR."""


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


def looks_bgr(color: np.ndarray) -> bool:
    """Whether the image shows skin only once red and blue are swapped. A guess.

    Args:
        color: RGB, shape [H, W, 3] uint8.
    """
    return bool(_skin(color) < SKIN_PART[0] and _skin(color[..., ::-1]) > SKIN_PART[1])


def _skin(color: np.ndarray) -> float:
    """Part of the pixels that have the color of skin, light or dark."""
    red, green, blue = np.moveaxis(color[::2, ::2].astype(np.float32), -1, 0)
    total = red + green + blue + 1e-6
    r, g = red / total, green / total
    return float(np.mean((r > 0.37) & (r < 0.55) & (g > 0.26) & (g < 0.345) & (red > 50) & (red > green)))

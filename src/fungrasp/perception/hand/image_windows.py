"""Square windows of an image, turned and scaled, as the hand models take them.

Pixels are ``[u v]`` with whole numbers at pixel centres. A window's own coordinates run from 0 at its left or
top edge to 1 at its right or bottom edge.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from PIL import Image

from fungrasp.perception.io.capture import Box

PALM_OUTLINE = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])
"""Landmarks (models' order) that a window around known landmarks is made from: palm, thumb, near joints."""


@dataclass(frozen=True)
class Window:
    """A square window of an image, which may reach beyond the image."""

    centre: tuple[float, float]
    """Column and row of the centre [pixels]."""
    size: float
    """Length of an edge [pixels]."""
    angle: float = 0.0
    """Angle by which the window is turned, clockwise in the image [rad]."""

    def to_image(self, points: np.ndarray) -> np.ndarray:
        """Pixels of points in window coordinates. Both: shape [..., 2]."""
        return (np.asarray(points) - 0.5) * self.size @ self._rotation().T + self.centre

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors ``[x y z]`` in the window's axes (right, down, into the image) in the image's. Both: shape
        [..., 3]."""
        turned = np.array(vectors, dtype=float)
        turned[..., :2] = turned[..., :2] @ self._rotation().T
        return turned

    def cut(self, image: Image.Image, pixels: int) -> np.ndarray:
        """The window's content, black where it lies beyond the image.

        Args:
            image: RGB.
            pixels: edge of the result.

        Returns:
            0 to 1, float32, shape [pixels, pixels, 3].
        """
        shrink = max(1, int(self.size / pixels))
        left, top = (0, 0)
        if shrink > 1:
            reach = self.size * 0.75
            left, top = (max(0, math.floor(c - reach)) for c in self.centre)
            right = min(image.width, math.ceil(self.centre[0] + reach))
            bottom = min(image.height, math.ceil(self.centre[1] + reach))
            if right - left < shrink or bottom - top < shrink:
                return np.zeros((pixels, pixels, 3), dtype=np.float32)
            image = image.reduce(shrink, (left, top, right, bottom))
        # Pillow's coordinates have pixel centres at halves.
        step = self._rotation() * (self.size / pixels / shrink)
        corner = self.to_image(np.zeros(2)) + 0.5 - np.array([left, top])
        corner = corner / shrink
        data = (step[0, 0], step[0, 1], corner[0], step[1, 0], step[1, 1], corner[1])
        cut = image.transform((pixels, pixels), Image.Transform.AFFINE, data, Image.Resampling.BILINEAR)
        return np.asarray(cut, dtype=np.float32) / 255.0

    def _rotation(self) -> np.ndarray:
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[c, -s], [s, c]])


def window_of_palm(box: np.ndarray, wrist: np.ndarray, middle_mcp: np.ndarray) -> Window:
    """Window of the whole hand whose palm was detected, fingers up.

    Args:
        box: ``x0 y0 x1 y1`` of the palm [pixels], shape [4].
        wrist, middle_mcp: key points of the palm [pixels], shape [2].
    """
    width, height = box[2] - box[0], box[3] - box[1]
    angle = _upright(middle_mcp - wrist)
    up = np.array([math.sin(angle), -math.cos(angle)])
    centre = (box[:2] + box[2:]) / 2 + 0.5 * height * up
    return Window((float(centre[0]), float(centre[1])), 2.6 * float(max(width, height)), angle)


def window_of_landmarks(pixels: np.ndarray) -> Window:
    """Window of the whole hand whose landmarks are known, fingers up.

    pixels: shape [21, 2], models' order.
    """
    knuckles = (pixels[5] + pixels[13]) / 4 + pixels[9] / 2
    angle = _upright(knuckles - pixels[0])
    turn = Window((0.0, 0.0), 1.0, angle)._rotation()
    upright = pixels[PALM_OUTLINE] @ turn
    low, high = upright.min(axis=0), upright.max(axis=0)
    width, height = high - low
    centre = turn @ ((low + high) / 2 - [0.0, 0.1 * height])
    return Window((float(centre[0]), float(centre[1])), 2.0 * float(max(width, height)), angle)


def search_windows(width: int, height: int, near: Box | None) -> Iterator[Window]:
    """Windows in which palms are searched in turn: the image, around a box, its parts, the image turned.

    width, height: of the image [pixels].
    """
    middle = ((width - 1) / 2, (height - 1) / 2)
    whole = Window(middle, float(max(width, height)))
    yield whole
    if near is not None:
        centre = ((near[0] + near[2]) / 2, (near[1] + near[3]) / 2)
        yield Window(centre, 3.0 * max(near[2] - near[0], near[3] - near[1]))
    part = 0.6 * min(width, height)
    across, down = (
        np.linspace(part / 2, edge - part / 2, math.ceil(2 * edge / part) - 1) for edge in (width, height)
    )
    yield from (Window((float(u), float(v)), part) for v in down for u in across)
    for angle in (np.pi / 2, -np.pi / 2, np.pi):
        yield Window(whole.centre, whole.size, angle)


def _upright(direction: np.ndarray) -> float:
    """Angle of a window in which the direction points up."""
    return math.atan2(direction[0], -direction[1])

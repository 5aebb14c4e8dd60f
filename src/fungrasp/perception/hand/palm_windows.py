"""Palms in an image, and the square windows, rotated and scaled, that the hand models take.

Pixels are ``[u v]`` with whole numbers at pixel centers. Window coordinates run from 0 at the left or top
edge to 1 at the right or bottom edge.

The palm detector (input 192 x 192) is a single-shot detector with fixed anchors at the center of every cell:
two per cell of 8 pixels, six per cell of 16. Each anchor gives a score and 18 offsets in pixels from its
center: box center, width and height, then seven key points, of which 0 is the wrist and 2 the middle finger's
MCP.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from PIL import Image

from fungrasp.perception.io.capture import Box

DIM = 128  # 99th percentile of brightness, of 255, below which an image is underexposed.
# Landmarks (models' order) for a window around known landmarks: palm, thumb, near joints.
PALM_OUTLINE = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])


@dataclass(frozen=True)
class Window:
    """A square window of an image, which may reach beyond the image."""

    center: tuple[float, float]
    """Column and row of the center [pixels]."""
    size: float
    """Length of an edge [pixels]."""
    angle: float = 0.0
    """Clockwise rotation of the window in the image [rad]."""

    def to_image(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels of points in window coordinates. Both: shape [..., 2]."""
        return (np.asarray(points) - 0.5) * self.size @ self._rotation().T + self.center

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """Rotate vectors ``[x y z]`` from the window's axes (right, down, into the image) to the image's.
        Both: shape [..., 3]."""
        turned = np.array(vectors, dtype=float)
        turned[..., :2] = turned[..., :2] @ self._rotation().T
        return turned

    def cut(self, image: Image.Image, pixels: int) -> np.ndarray:
        """Return the window's content, 0 to 1, black beyond the image, float32, shape [pixels, pixels, 3].

        Args:
            image: RGB.
        """
        shrink = max(1, int(self.size / pixels))
        left, top = (0, 0)
        if shrink > 1:
            reach = self.size * 0.75
            left, top = (max(0, math.floor(c - reach)) for c in self.center)
            right = min(image.width, math.ceil(self.center[0] + reach))
            bottom = min(image.height, math.ceil(self.center[1] + reach))
            if right - left < shrink or bottom - top < shrink:
                return np.zeros((pixels, pixels, 3), dtype=np.float32)
            image = image.reduce(shrink, (left, top, right, bottom))
        # Pillow's coordinates have pixel centers at halves.
        step = self._rotation() * (self.size / pixels / shrink)
        corner = self.to_image(np.zeros(2)) + 0.5 - np.array([left, top])
        corner = corner / shrink
        data = (step[0, 0], step[0, 1], corner[0], step[1, 0], step[1, 1], corner[1])
        cut = image.transform((pixels, pixels), Image.Transform.AFFINE, data, Image.Resampling.BILINEAR)
        return np.asarray(cut, dtype=np.float32) / 255.0

    def _rotation(self) -> np.ndarray:
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[c, -s], [s, c]])


def exposed(color: np.ndarray) -> np.ndarray:
    """Brighten an underexposed image so that its 99th percentile is white; return others unchanged.

    color: RGB, uint8, shape [H, W, 3]; so is the result.
    """
    white = float(np.percentile(color[::4, ::4].max(axis=2), 99))
    if white >= DIM or white == 0:
        return color
    return np.clip(color * (255.0 / white), 0, 255).astype(np.uint8)


def window_of_palm(box: np.ndarray, wrist: np.ndarray, middle_mcp: np.ndarray) -> Window:
    """Return the window of the hand of a detected palm, with fingers up.

    Args:
        box: ``x0 y0 x1 y1`` of the palm [pixels], shape [4].
        wrist, middle_mcp: key points of the palm [pixels], shape [2].
    """
    width, height = box[2] - box[0], box[3] - box[1]
    angle = _upright(middle_mcp - wrist)
    up = np.array([math.sin(angle), -math.cos(angle)])
    center = (box[:2] + box[2:]) / 2 + 0.5 * height * up
    return Window((float(center[0]), float(center[1])), 2.6 * float(max(width, height)), angle)


def window_of_landmarks(pixels: np.ndarray) -> Window:
    """Return the window of a hand with known landmarks, with fingers up.

    pixels: shape [21, 2], models' order.
    """
    knuckles = (pixels[5] + pixels[13]) / 4 + pixels[9] / 2
    angle = _upright(knuckles - pixels[0])
    turn = Window((0.0, 0.0), 1.0, angle)._rotation()
    upright = pixels[PALM_OUTLINE] @ turn
    low, high = upright.min(axis=0), upright.max(axis=0)
    width, height = high - low
    center = turn @ ((low + high) / 2 - [0.0, 0.1 * height])
    return Window((float(center[0]), float(center[1])), 2.0 * float(max(width, height)), angle)


def search_windows(width: int, height: int, near: Box | None) -> Iterator[Window]:
    """Yield windows in which palms are searched, in this order: the image, around a box, its parts, the image
    rotated. width, height: size of the image [pixels]; near: box [pixels]."""
    middle = ((width - 1) / 2, (height - 1) / 2)
    whole = Window(middle, float(max(width, height)))
    yield whole
    if near is not None:
        center = ((near[0] + near[2]) / 2, (near[1] + near[3]) / 2)
        yield Window(center, 3.0 * max(near[2] - near[0], near[3] - near[1]))
    part = 0.6 * min(width, height)
    across, down = (
        np.linspace(part / 2, edge - part / 2, math.ceil(2 * edge / part) - 1) for edge in (width, height)
    )
    yield from (Window((float(u), float(v)), part) for v in down for u in across)
    for angle in (np.pi / 2, -np.pi / 2, np.pi):
        yield Window(whole.center, whole.size, angle)


def _upright(direction: np.ndarray) -> float:
    """Return the angle of a window in which the direction points up [rad]."""
    return math.atan2(direction[0], -direction[1])


DETECTOR_PIXELS = 192

ANCHOR_LAYERS = ((8, 2), (16, 6))  # Cell size [pixels] and anchors per cell.
OVERLAP = 0.3  # Overlap (intersection over union) beyond which boxes are one palm.


@dataclass(frozen=True, eq=False)
class Palm:
    """A detected palm; coordinates of the detector's window, 0 to 1."""

    box: np.ndarray
    """Corners ``x0 y0 x1 y1`` of the box, shape [4]."""
    points: np.ndarray
    """Key points, shape [7, 2]."""
    score: float
    """Probability that this is a palm, 0 to 1."""


def anchor_centers() -> np.ndarray:
    """Return the centers of the detector's anchors, 0 to 1, shape [2016, 2]."""
    layers = []
    for cell, copies in ANCHOR_LAYERS:
        count = DETECTOR_PIXELS // cell
        middle = (np.arange(count) + 0.5) / count
        columns, rows = np.meshgrid(middle, middle)
        layers.append(np.repeat(np.stack([columns.ravel(), rows.ravel()], axis=-1), copies, axis=0))
    return np.concatenate(layers)


def decode_palms(offsets: np.ndarray, logits: np.ndarray, threshold: float) -> list[Palm]:
    """Return palms from the detector's outputs, best first; overlapping ones are averaged by score.

    Args:
        offsets: [pixels of the detector], shape [2016, 18].
        logits: shape [2016].
        threshold: smallest score.
    """
    scores = 1.0 / (1.0 + np.exp(-np.clip(logits, -100.0, 100.0)))
    chosen = np.flatnonzero(scores >= threshold)
    chosen = chosen[np.argsort(-scores[chosen], kind="stable")]
    centers = anchor_centers()[chosen]
    values = offsets[chosen] / DETECTOR_PIXELS
    middle, half = centers + values[:, :2], values[:, 2:4] / 2
    boxes = np.concatenate([middle - half, middle + half], axis=1)
    points = centers[:, None] + values[:, 4:].reshape(-1, 7, 2)
    scores = scores[chosen]
    palms = []
    left = np.arange(len(chosen))
    while left.size:
        same = left[box_overlap(boxes[left[0]], boxes[left]) > OVERLAP]
        same = same if same.size else left[:1]
        weights = scores[same] / scores[same].sum()
        palms.append(
            Palm(weights @ boxes[same], np.tensordot(weights, points[same], 1), float(scores[left[0]]))
        )
        left = np.setdiff1d(left, same, assume_unique=True)
    return palms


def box_overlap(box: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return intersection over union of boxes, shape [N]. box: shape [4]; others: shape [N, 4]."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=1)
    union = np.prod(box[2:] - box[:2]) + np.prod(others[:, 2:] - others[:, :2], axis=1) - common
    return common / np.maximum(union, 1e-12)

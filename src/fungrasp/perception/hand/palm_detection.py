"""Where palms are in an image: the palm detector's boxes and key points.

The detector (input 192 x 192) is a single-shot one with a fixed anchor at the centre of every cell: two per
cell of 8 pixels, six per cell of 16. An anchor answers with a score and 18 offsets in pixels from its centre:
box centre, width and height, then seven key points, of which 0 is the wrist and 2 the middle finger's MCP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DETECTOR_PIXELS = 192

ANCHOR_LAYERS = ((8, 2), (16, 6))
"""Cell size [pixels] and anchors per cell."""

OVERLAP = 0.3
"""Boxes that overlap by more than this part of their union are one palm."""


@dataclass(frozen=True, eq=False)
class Palm:
    """A detected palm; coordinates of the detector's window, 0 to 1."""

    box: np.ndarray
    """Corners ``x0 y0 x1 y1`` of the box round the palm, shape [4]."""
    points: np.ndarray
    """Key points of the palm, shape [7, 2]."""
    score: float
    """Probability that this is a palm, 0 to 1."""


def anchor_centres() -> np.ndarray:
    """Centres of the detector's anchors, 0 to 1, shape [2016, 2]."""
    layers = []
    for cell, copies in ANCHOR_LAYERS:
        count = DETECTOR_PIXELS // cell
        middle = (np.arange(count) + 0.5) / count
        columns, rows = np.meshgrid(middle, middle)
        layers.append(np.repeat(np.stack([columns.ravel(), rows.ravel()], axis=-1), copies, axis=0))
    return np.concatenate(layers)


def decode_palms(offsets: np.ndarray, logits: np.ndarray, threshold: float) -> list[Palm]:
    """Palms from the detector's answers; overlapping answers are averaged, weighted by their scores.

    Args:
        offsets: [pixels of the detector], shape [2016, 18].
        logits: shape [2016].
        threshold: answers of lower score are dropped.

    Returns:
        Best first.
    """
    scores = 1.0 / (1.0 + np.exp(-np.clip(logits, -100.0, 100.0)))
    chosen = np.flatnonzero(scores >= threshold)
    chosen = chosen[np.argsort(-scores[chosen], kind="stable")]
    centres = anchor_centres()[chosen]
    values = offsets[chosen] / DETECTOR_PIXELS
    middle, half = centres + values[:, :2], values[:, 2:4] / 2
    boxes = np.concatenate([middle - half, middle + half], axis=1)
    points = centres[:, None] + values[:, 4:].reshape(-1, 7, 2)
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
    """Area common to two boxes over that of their union. box: shape [4]; others: [N, 4]; returns [N]."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=1)
    union = np.prod(box[2:] - box[:2]) + np.prod(others[:, 2:] - others[:, :2], axis=1) - common
    return common / np.maximum(union, 1e-12)

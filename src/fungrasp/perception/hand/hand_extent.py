"""Whether what was taken for a hand is as large as a hand, by the depth where it is seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fungrasp.perception.hand.detected_hand import DetectedHand

EXTENTS = (0.4, 1.2)
"""Least and largest extent of a hand's landmarks in the image, in hand lengths. Of 170 rendered hands, most
of them bent about an object, all were between 0.46 and 1.03."""


def length_at(pixels: np.ndarray, lengths: np.ndarray | None, otherwise: float) -> float:
    """How long a hand at some pixels is in the image [pixels].

    Args:
        pixels: shape [N, 2].
        lengths: ``hand_lengths``, whose median counts; None if depth is not known.
        otherwise: what is said if it is not known there.
    """
    if lengths is None:
        return otherwise
    height, width = lengths.shape
    u, v = np.rint(pixels).astype(int).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    found = lengths[v[inside], u[inside]]
    found = found[np.isfinite(found)]
    return float(np.median(found)) if found.size else otherwise


def possible(hand: DetectedHand, length: float) -> bool:
    """Whether the landmarks of a hand may extend so far. length: of a hand in the image [pixels]."""
    return EXTENTS[0] < hand.extent / length < EXTENTS[1]

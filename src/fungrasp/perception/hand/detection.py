"""A hand that a detector found, and which of many answers about one hand counts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fungrasp.perception.estimates import Side

HAND_LENGTH = 0.19
"""From wrist to fingertips of an adult [m]."""

EXTENTS = (0.4, 1.2)
"""Least and largest extent of a hand's landmarks in the image, in hand lengths. Of 170 rendered hands, most
of them bent about an object, all were between 0.46 and 1.03."""

CONFIRMED_HAND, CONFIRMED = 0.8, 0.05
"""If the first answer, one from the window around it and one from that window's mirror image are of higher
scores, and nearer to each other than this part of the hand's length, they are right: of 170 rendered captures
70 % have such, which are off by 7.7 pixels in the median of their landmarks, and 7.5 after more windows."""

SAME_ANSWER = 0.12
"""Answers whose landmarks are apart by more than this on average, in hand lengths, don't confirm each
other."""


@dataclass(frozen=True, eq=False)
class DetectedHand:
    """A hand in the image, joints in the order of ``HUMAN_JOINTS``."""

    pixels: np.ndarray
    """Landmarks [pixels], shape [21, 2]."""
    shape_camera: np.ndarray
    """Landmarks about the hand's middle [m], shape [21, 3], camera axes; size and depth are guesses of the
    model."""
    side: Side
    """Which hand of the person."""
    side_score: float
    """Probability of ``side``, 0.5 to 1."""
    score: float
    """Probability that this is a hand, 0 to 1."""
    others: tuple[DetectedHand, ...] = ()
    """What the models make of the same hand in other windows of the image; each may be the better answer."""
    spread: float | None = None
    """Standard deviation of a landmark, hidden or not, each way [pixels]; None: as MediaPipe's err, see
    ``SeenSettings``."""

    @property
    def box(self) -> np.ndarray:
        """``x0 y0 x1 y1`` around the landmarks [pixels], shape [4]."""
        return np.concatenate([self.pixels.min(axis=0), self.pixels.max(axis=0)])

    @property
    def extent(self) -> float:
        """Diagonal of that box [pixels]."""
        return float(np.linalg.norm(np.ptp(self.pixels, axis=0)))

    @property
    def right(self) -> float:
        """Probability that it is a right hand."""
        return self.side_score if self.side == "right" else 1.0 - self.side_score

    def distance(self, other: DetectedHand) -> float:
        """Mean distance of the landmarks of two hands [pixels]."""
        return float(np.linalg.norm(self.pixels - other.pixels, axis=1).mean())


def which_side(right: float) -> dict[str, Any]:
    """Fields of a detected hand that is a right one with some probability."""
    return {"side": "right" if right >= 0.5 else "left", "side_score": float(max(right, 1 - right))}


def hand_lengths(depth: np.ndarray, focal: float) -> np.ndarray:
    """How long a hand is in the image at the depth of each pixel [pixels], shape [H, W]; NaN without depth.

    depth: [m], shape [H, W], 0 where nothing was measured; focal: length [pixels].
    """
    return HAND_LENGTH * focal / np.where(depth > 0, depth, np.nan)


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


def confirms(first: DetectedHand, second: DetectedHand, length: float) -> bool:
    """Whether both answers are sure, and the same. length: of a hand in the image [pixels]."""
    sure = min(first.score, second.score) > CONFIRMED_HAND and first.side == second.side
    return sure and first.distance(second) < CONFIRMED * length


def settled(every: list[DetectedHand], last: list[DetectedHand], length: float) -> DetectedHand:
    """The answer that most others confirm, with the others, most confirmed first.

    Its score is the part of the last answers, weighted by their scores, that confirms it, and the score of
    its side what part of those agrees.

    Args:
        every: all answers about a hand.
        last: those of them, or others, that judge it.
        length: of a hand in the image [pixels].
    """

    def confirmed(hand: DetectedHand, by: list[DetectedHand]) -> np.ndarray:
        apart = np.array([hand.distance(other) for other in by])
        return np.exp(-np.square(apart / (SAME_ANSWER * length)))

    weights = np.array([hand.score for hand in every]) ** 2
    order = np.argsort([-(confirmed(hand, every) @ weights) for hand in every], kind="stable")
    best = every[order[0]]
    worth = np.array([hand.score for hand in last]) * confirmed(best, last)
    vote = float(np.average([hand.right for hand in last], weights=worth + 1e-9))
    others = tuple(every[i] for i in order[1:])
    return replace(best, score=float(worth.mean()), others=others, **which_side(vote))

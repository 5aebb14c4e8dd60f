"""Hands in a colour image: where they are, their 21 landmarks, their side, a rough shape in 3D.

Two models of MediaPipe (see hand_weights) are run by ``ai-edge-litert``: one finds palms, the other takes an
upright window of the hand and answers with landmarks, the probability that there is a hand, which hand it is,
and the landmarks' places in metres about the hand's middle. The window is then cut again around the landmarks
found, and the second answer counts.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from fungrasp.errors import FungraspError
from fungrasp.perception.capture import Box
from fungrasp.perception.estimates import Side
from fungrasp.perception.hand_crops import Window, window_of_landmarks, window_of_palm
from fungrasp.perception.hand_palms import DETECTOR_PIXELS, box_overlap, decode_palms
from fungrasp.perception.hand_weights import load_weights
from fungrasp.perception.quiet import without_small_talk

FROM_MODEL = np.array([0, *range(5, 21), *range(1, 5)])
"""Indices of the models' landmarks (thumb first) in the order of ``HUMAN_JOINTS``."""

LANDMARK_PIXELS = 224

SURE_PALM = 0.5
"""Palms of lower score are looked at only if no better one is there."""

FAINT_PALM = 0.25

SURE_HAND = 0.5
"""Windows with a lower probability of a hand show none."""

SAME_HAND = 0.5
"""Two answers whose boxes overlap by more than this part of their union are one hand."""


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

    @property
    def box(self) -> np.ndarray:
        """``x0 y0 x1 y1`` around the landmarks [pixels], shape [4]."""
        return np.concatenate([self.pixels.min(axis=0), self.pixels.max(axis=0)])


class HandDetector:
    """The two models, ready to run. Keeps the interpreters: one per thread of the caller."""

    def __init__(self, weights: Mapping[str, bytes] | None = None, threads: int = 2):
        """
        Args:
            weights: content of the model files "palm" and "landmarks"; by default those in the cache.
            threads: that run a model.

        Raises:
            FungraspError: the weights are not set up, or ai-edge-litert is not installed.
        """
        weights = load_weights() if weights is None else weights
        self._palm = _Model(weights["palm"], threads)
        self._landmarks = _Model(weights["landmarks"], threads)

    def detect(self, colour: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """All hands found.

        The whole image is searched first. If nothing is there, so are its parts, enlarged, and the image
        turned; the first of these that shows a hand counts.

        Args:
            colour: RGB, uint8, shape [H, W, 3].
            near: a box beside or around the hand, searched before other parts.

        Returns:
            Most probable first; empty if there is none.
        """
        image = Image.fromarray(colour)
        height, width = colour.shape[:2]
        for window, threshold in _search_windows(width, height, near):
            found = [
                hand
                for start in self._palms(image, window, threshold)
                if (hand := self._hand(image, start)) is not None
            ]
            if found:
                return _distinct(found)
        return []

    def _palms(self, image: Image.Image, window: Window, threshold: float) -> Iterator[Window]:
        offsets, logits = self._palm(window.cut(image, DETECTOR_PIXELS))
        for palm in decode_palms(offsets.reshape(-1, 18), logits.ravel(), threshold):
            points = window.to_image(palm.points)
            half = (palm.box[2:] - palm.box[:2]) / 2 * window.size
            middle = window.to_image((palm.box[:2] + palm.box[2:]) / 2)
            yield window_of_palm(np.concatenate([middle - half, middle + half]), points[0], points[2])

    def _hand(self, image: Image.Image, window: Window) -> DetectedHand | None:
        answer = None
        for _ in range(2):
            landmarks, presence, right, shape = self._landmarks(window.cut(image, LANDMARK_PIXELS))
            if presence.item() < SURE_HAND:
                return None
            pixels = window.to_image(landmarks.reshape(21, 3)[:, :2] / LANDMARK_PIXELS)
            answer = (pixels, window.turn(shape.reshape(21, 3)), right.item(), presence.item())
            window = window_of_landmarks(pixels)
        assert answer is not None
        pixels, shape, right, presence = answer
        return DetectedHand(
            pixels[FROM_MODEL],
            shape[FROM_MODEL],
            "right" if right >= 0.5 else "left",
            float(max(right, 1 - right)),
            float(np.clip(presence, 0.0, 1.0)),
        )


def choose_hand(
    hands: Sequence[DetectedHand], near: Box | None = None, side: Side | None = None
) -> tuple[DetectedHand, str]:
    """The hand that is meant.

    Args:
        hands: those found.
        near: box around the object, or around the hand [pixels].
        side: which hand it should be, if known.

    Returns:
        The hand of that side, if there is one, nearest to the box; without a box, the one largest in the
        image. And a sentence about what was left aside, empty if nothing was.

    Raises:
        FungraspError: there is no hand.
    """
    if not hands:
        raise FungraspError(
            "no hand was found in the image; it must be bare, in view, at least about 40 pixels wide and "
            "not seen from its edge"
        )
    fitting = [hand for hand in hands if side in (None, hand.side)] or list(hands)
    if near is None:
        best = max(fitting, key=lambda hand: float(np.prod(hand.box[2:] - hand.box[:2])))
        why = "largest one"
    else:
        best = min(fitting, key=lambda hand: _distance_to_box(hand, near))
        why = "one nearest to the box"
    notes = []
    if len(hands) > 1:
        if len(fitting) < len(hands):
            why = f"{side} hand" if len(fitting) == 1 else f"{side} hand that is the {why}"
        u, v = best.pixels.mean(axis=0)
        notes.append(f"{len(hands)} hands are in the image; the {why} was taken, at pixel {u:.0f}, {v:.0f}")
    if side is not None and best.side != side:
        notes.append(f"the hand looks like a {best.side} one, not a {side} one as was said")
    return best, "; ".join(notes)


def _distance_to_box(hand: DetectedHand, box: Box) -> float:
    beyond = np.maximum(np.maximum(np.array(box[:2]) - hand.pixels, hand.pixels - np.array(box[2:])), 0)
    return float(np.linalg.norm(beyond, axis=1).mean())


def _search_windows(width: int, height: int, near: Box | None) -> Iterator[tuple[Window, float]]:
    """Windows to search in turn, each with the score a palm needs there."""
    middle = ((width - 1) / 2, (height - 1) / 2)
    whole = Window(middle, float(max(width, height)))
    yield whole, SURE_PALM
    if near is not None:
        centre = ((near[0] + near[2]) / 2, (near[1] + near[3]) / 2)
        yield Window(centre, 3.0 * max(near[2] - near[0], near[3] - near[1])), SURE_PALM
    part = 0.6 * min(width, height)
    across, down = (
        np.linspace(part / 2, edge - part / 2, math.ceil(2 * edge / part) - 1) for edge in (width, height)
    )
    parts = [Window((float(u), float(v)), part) for v in down for u in across]
    yield from ((window, SURE_PALM) for window in parts)
    for angle in (np.pi / 2, -np.pi / 2, np.pi):
        yield Window(whole.centre, whole.size, angle), SURE_PALM
    yield from ((window, FAINT_PALM) for window in (whole, *parts))


def _distinct(hands: list[DetectedHand]) -> list[DetectedHand]:
    kept: list[DetectedHand] = []
    for hand in sorted(hands, key=lambda hand: -hand.score):
        boxes = np.array([other.box for other in kept]).reshape(-1, 4)
        if not (box_overlap(hand.box, boxes) > SAME_HAND).any():
            kept.append(hand)
    return kept


class _Model:
    """A model file in an interpreter; called with one image."""

    def __init__(self, content: bytes, threads: int):
        try:
            runtime: Any = importlib.import_module("ai_edge_litert.interpreter")
        except ImportError as error:
            raise FungraspError(
                "finding hands in images needs the package ai-edge-litert: pip install ai-edge-litert"
            ) from error
        with without_small_talk():
            self._interpreter = runtime.Interpreter(model_content=content, num_threads=threads)
            self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        # The runtime lists outputs in any order; their names tell it.
        outputs = sorted(self._interpreter.get_output_details(), key=lambda output: output["name"])
        self._outputs = [output["index"] for output in outputs]

    def __call__(self, image: np.ndarray) -> list[np.ndarray]:
        """Outputs in the order of their names. image: 0 to 1, float32, shape [S, S, 3]."""
        self._interpreter.set_tensor(self._input, image[None])
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(index)[0] for index in self._outputs]

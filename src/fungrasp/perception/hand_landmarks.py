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
from dataclasses import dataclass, replace
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

_TO_MODEL = np.argsort(FROM_MODEL)

LANDMARK_PIXELS = 224

SURE_PALM = 0.5
"""Palms of lower score are looked at only if no better one is there."""

FAINT_PALM = 0.25

SURE_HAND = 0.5
"""Windows with a lower probability of a hand show none, if another does."""

FAINT_HAND = 0.3
"""Where no window shows a hand for sure, the best one of at least this probability counts: palms are found in
many views of hands behind objects, of which the landmark model knows little."""

OTHER_WINDOWS = (
    *((angle, 1.3, mirrored) for angle in (0, 35, -35) for mirrored in (False, True)),
    (0, 1.0, True),
    (180, 1.2, False),
    (180, 1.2, True),
)
"""Windows in which a hand is looked at again: by how many degrees each is turned, how much larger it is, and
whether it is mirrored. Of 34 rendered captures seven first answers were wrong by more than 14 pixels, 24 in
the median; the best answers from such windows were wrong by 10."""

LOOKED_AT_AGAIN = 2
"""So many hands of an image are."""

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
    others: tuple[DetectedHand, ...] = ()
    """What the models make of the same hand in other windows of the image; each may be the better answer."""

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
        turned; the first of these that shows a hand counts, or the best that may show one.

        Args:
            colour: RGB, uint8, shape [H, W, 3].
            near: a box beside or around the hand, searched before other parts.

        Returns:
            Most probable first; empty if there is none.
        """
        image = Image.fromarray(colour)
        height, width = colour.shape[:2]
        faint: list[DetectedHand] = []
        for window, threshold in _search_windows(width, height, near):
            answers = [self._hand(image, start) for start in self._palms(image, window, threshold)]
            found = _distinct([hand for hand in answers if hand.score >= SURE_HAND])
            if found:
                first = [self._again(image, hand) for hand in found[:LOOKED_AT_AGAIN]]
                return first + found[LOOKED_AT_AGAIN:]
            if threshold >= SURE_PALM:
                faint += answers
        best = max(faint, key=lambda hand: hand.score, default=None)
        if best is None or best.score < FAINT_HAND:
            return []
        best = self._again(image, best)
        return [best] if best.score >= FAINT_HAND else []

    def _again(self, image: Image.Image, hand: DetectedHand) -> DetectedHand:
        """The hand with the answers from other windows around it.

        Its score is then the mean of all windows', 0 for those that show no hand, and the score of its side
        what part of them agrees.
        """
        window = window_of_landmarks(hand.pixels[_TO_MODEL])
        others = []
        for angle, scale, mirrored in OTHER_WINDOWS:
            turned = Window(window.centre, scale * window.size, window.angle + np.radians(angle))
            answer = self._look(image, turned, mirrored)
            if answer.score >= min(SURE_HAND, hand.score):
                others.append(answer)
        every = [hand, *others]
        right = [h.side_score if h.side == "right" else 1 - h.side_score for h in every]
        vote = float(np.average(right, weights=[h.score for h in every]))
        score = sum(h.score for h in every) / (1 + len(OTHER_WINDOWS))
        agreed = max(0.5, vote if hand.side == "right" else 1 - vote)
        return replace(hand, side_score=agreed, score=score, others=tuple(others))

    def _palms(self, image: Image.Image, window: Window, threshold: float) -> Iterator[Window]:
        offsets, logits = self._palm(window.cut(image, DETECTOR_PIXELS))
        for palm in decode_palms(offsets.reshape(-1, 18), logits.ravel(), threshold):
            points = window.to_image(palm.points)
            half = (palm.box[2:] - palm.box[:2]) / 2 * window.size
            middle = window.to_image((palm.box[:2] + palm.box[2:]) / 2)
            yield window_of_palm(np.concatenate([middle - half, middle + half]), points[0], points[2])

    def _hand(self, image: Image.Image, window: Window) -> DetectedHand:
        answer = self._look(image, window)
        if answer.score < FAINT_HAND:
            return answer
        again = self._look(image, window_of_landmarks(answer.pixels[_TO_MODEL]))
        return again if min(answer.score, again.score) >= SURE_HAND or again.score > answer.score else answer

    def _look(self, image: Image.Image, window: Window, mirrored: bool = False) -> DetectedHand:
        """What the landmark model says of a window, or of its mirror image."""
        cut = window.cut(image, LANDMARK_PIXELS)
        if mirrored:
            cut = np.ascontiguousarray(cut[:, ::-1])
        landmarks, presence, right, shape = self._landmarks(cut)
        points = landmarks.reshape(21, 3)[FROM_MODEL, :2] / LANDMARK_PIXELS
        shape, right = shape.reshape(21, 3)[FROM_MODEL], right.item()
        if mirrored:
            points, shape, right = points * [-1, 1] + [1, 0], shape * [-1, 1, 1], 1 - right
        score = float(np.clip(presence.item(), 0.0, 1.0))
        return DetectedHand(window.to_image(points), window.turn(shape), score=score, **_side(right))


def _side(right: float) -> dict[str, Any]:
    """Fields of a detected hand that is a right one with some probability."""
    return {"side": "right" if right >= 0.5 else "left", "side_score": float(max(right, 1 - right))}


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

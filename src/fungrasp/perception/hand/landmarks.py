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
from typing import Any

import numpy as np
from PIL import Image

from fungrasp.errors import FungraspError
from fungrasp.perception.estimates import Side
from fungrasp.perception.hand.crops import Window, window_of_landmarks, window_of_palm
from fungrasp.perception.hand.detection import (
    DetectedHand,
    confirms,
    length_at,
    possible,
    settled,
    which_side,
)
from fungrasp.perception.hand.model_weights import load_weights
from fungrasp.perception.hand.palm_detection import DETECTOR_PIXELS, box_overlap, decode_palms
from fungrasp.perception.io.capture import Box
from fungrasp.perception.io.native_output import without_small_talk

FROM_MODEL = np.array([0, *range(5, 21), *range(1, 5)])
"""Indices of the models' landmarks (thumb first) in the order of ``HUMAN_JOINTS``."""

_TO_MODEL = np.argsort(FROM_MODEL)

FINGER_BEYOND, THUMB_BEYOND, WRIST_BEYOND = (0.09, 0.13, -0.18), (0.08, 0.08, -0.16), 0.04
"""How far beyond the joints that data sets mean the models' landmarks are, after knuckles, as a part of the
bone that ends there; the wrist's toward the middle finger's knuckle, as a part of that way. Landmarks of tips
are on the nail, not at its end. From 178 rendered captures, whose visible landmarks it brings from 7.3 to 6.3
pixels and from 8.1 to 7.1; at knuckles and middle joints taken smaller than measured, as a rendered hand may
mislead."""


def _joints_of_landmarks() -> np.ndarray:
    matrix = np.eye(21)
    for finger in range(5):
        for joint, part in enumerate(THUMB_BEYOND if finger == 4 else FINGER_BEYOND, start=2 + 4 * finger):
            matrix[joint, [joint, joint - 1]] += [-part, part]
    matrix[0, [0, 9]] += [WRIST_BEYOND, -WRIST_BEYOND]
    return matrix


JOINTS_OF_LANDMARKS = _joints_of_landmarks()
"""Takes landmarks in the order of ``HUMAN_JOINTS`` to joints, shape [21, 21]."""

_LANDMARKS_OF_JOINTS = np.linalg.inv(JOINTS_OF_LANDMARKS)

LANDMARK_PIXELS = 224

SURE_PALM = 0.5
"""Palms of lower score are looked at only if no better one is there."""

FAINT_PALM = 0.1
"""Palms of lower score are none."""

FAINT_PALMS = 3
"""Where no hand is found for sure, so many palms are looked at in many windows: palms are seen in many views
of hands behind objects, of which the landmark model knows little."""

SURE_HAND = 0.5
"""Windows with a lower probability of a hand show none, if another does."""

FAINT_HAND = 0.18
"""Least score of a hand that many windows were cut for. In 40 rendered captures without a hand none had more
than 0.15."""

WINDOW_LENGTHS = 1.16
"""Edge of a window that a hand of known length is looked at in, in hand lengths. Hands fill it less than the
models were trained on, but one that was first seen at a wrong place is still inside."""

WINDOW_TURNS = np.radians(np.arange(0, 360, 45))
"""By how much such windows are turned [rad]."""

ABOUT_PALM = ((0.0, 0.0), (0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
"""Where the middles of such windows are if only a faint palm is known, from its own, in hand lengths; each is
then turned by half as many angles."""

CUT_AGAIN = 4
"""Around so many of the answers from such windows, the most probable ones, a window is cut, and mirrored."""

LOOKED_AT_AGAIN = 2
"""So many hands of an image are looked at in more windows."""

SAME_HAND = 0.5
"""Two answers whose boxes overlap by more than this part of their union are one hand."""


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
        """All hands found; see ``detect_with_depth``, which finds more of them."""
        return self.detect_with_depth(colour, None, near)

    def detect_with_depth(
        self, colour: np.ndarray, lengths: np.ndarray | None, near: Box | None = None
    ) -> list[DetectedHand]:
        """All hands found.

        The whole image is searched first. If nothing is there, so are its parts, enlarged, and the image
        turned; the first of these that shows a hand counts, or the best of all that may show one.

        Args:
            colour: RGB, uint8, shape [H, W, 3].
            lengths: ``hand_lengths`` of the image [pixels], shape [H, W]; None if depth is not known.
            near: a box beside or around the hand, searched before other parts.

        Returns:
            Most probable first; empty if there is none.
        """
        image = Image.fromarray(colour)
        height, width = colour.shape[:2]
        palms: list[tuple[float, Window]] = []
        for window in _search_windows(width, height, near):
            seen = self._palms(image, window)
            answers = [self._hand(image, start) for score, start in seen if score >= SURE_PALM]
            found = _distinct([hand for hand in answers if hand.score >= SURE_HAND])
            first = [self._again(image, hand, lengths) for hand in found[:LOOKED_AT_AGAIN]]
            first = [hand for hand in first if hand.score >= FAINT_HAND]
            if first:
                return first + found[LOOKED_AT_AGAIN:]
            palms += seen
        faint = [self._about(image, start, lengths) for start in _apart(palms)[:FAINT_PALMS]]
        best = max(faint, key=lambda hand: hand.score, default=None)
        return [best] if best is not None and best.score >= FAINT_HAND else []

    def _again(self, image: Image.Image, hand: DetectedHand, lengths: np.ndarray | None) -> DetectedHand:
        """The hand, if the windows around it confirm it, else what windows all round make of it."""
        window = _window_of(hand)
        length = length_at(hand.pixels, lengths, window.size / WINDOW_LENGTHS)
        if possible(hand, length):
            again = [self._look(image, window, mirrored) for mirrored in (False, True)]
            if all(confirms(hand, answer, length) for answer in again):
                return settled([hand, *again], again, length)
        middle = hand.pixels.mean(axis=0)
        return self._settle(image, [hand], [(middle, turn) for turn in WINDOW_TURNS], length)

    def _about(self, image: Image.Image, palm: Window, lengths: np.ndarray | None) -> DetectedHand:
        """What windows about a palm make of its hand. palm: the window that the hand should be in."""
        length = length_at(np.array([palm.centre]), lengths, palm.size / WINDOW_LENGTHS)
        centres = palm.centre + length * np.array(ABOUT_PALM)
        places = [(centre, turn) for centre in centres for turn in WINDOW_TURNS[::2]]
        return self._settle(image, [], places, length)

    def _settle(
        self,
        image: Image.Image,
        seen: list[DetectedHand],
        places: list[tuple[np.ndarray, float]],
        length: float,
    ) -> DetectedHand:
        """The answer that most others confirm, of those seen already and from more windows.

        Args:
            image: RGB.
            seen: answers.
            places: middles of windows [pixels], shape [2], and how they are turned [rad].
            length: of a hand in the image [pixels].
        """
        size = WINDOW_LENGTHS * length
        every = seen + [
            self._look(image, Window((float(u), float(v)), size, float(turn))) for (u, v), turn in places
        ]
        best = sorted(every, key=lambda answer: -answer.score)[:CUT_AGAIN]
        last = [
            self._look(image, _window_of(answer), mirrored) for answer in best for mirrored in (False, True)
        ]
        every += last
        return settled([answer for answer in every if possible(answer, length)] or every, last, length)

    def _palms(self, image: Image.Image, window: Window) -> list[tuple[float, Window]]:
        """Scores of palms in a window, and windows of their hands."""
        offsets, logits = self._palm(window.cut(image, DETECTOR_PIXELS))
        found = []
        for palm in decode_palms(offsets.reshape(-1, 18), logits.ravel(), FAINT_PALM):
            points = window.to_image(palm.points)
            half = (palm.box[2:] - palm.box[:2]) / 2 * window.size
            middle = window.to_image((palm.box[:2] + palm.box[2:]) / 2)
            box = np.concatenate([middle - half, middle + half])
            found.append((palm.score, window_of_palm(box, points[0], points[2])))
        return found

    def _hand(self, image: Image.Image, window: Window) -> DetectedHand:
        answer = self._look(image, window)
        if answer.score < FAINT_HAND:
            return answer
        again = self._look(image, _window_of(answer))
        return again if min(answer.score, again.score) >= SURE_HAND or again.score > answer.score else answer

    def _look(self, image: Image.Image, window: Window, mirrored: bool = False) -> DetectedHand:
        """What the landmark model says of a window, or of its mirror image."""
        cut = window.cut(image, LANDMARK_PIXELS)
        if mirrored:
            cut = np.ascontiguousarray(cut[:, ::-1])
        landmarks, presence, right, shape = self._landmarks(cut)
        points = JOINTS_OF_LANDMARKS @ landmarks.reshape(21, 3)[FROM_MODEL, :2] / LANDMARK_PIXELS
        shape, right = JOINTS_OF_LANDMARKS @ shape.reshape(21, 3)[FROM_MODEL], right.item()
        if mirrored:
            points, shape, right = points * [-1, 1] + [1, 0], shape * [-1, 1, 1], 1 - right
        score = float(np.clip(presence.item(), 0.0, 1.0))
        return DetectedHand(window.to_image(points), window.turn(shape), score=score, **which_side(right))


def _window_of(hand: DetectedHand) -> Window:
    """Window around the landmarks of an answer."""
    return window_of_landmarks((_LANDMARKS_OF_JOINTS @ hand.pixels)[_TO_MODEL])


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


def _search_windows(width: int, height: int, near: Box | None) -> Iterator[Window]:
    """Windows to search in turn."""
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


def _apart(palms: list[tuple[float, Window]]) -> list[Window]:
    """Windows of palms, best first, without those in the middle half of a better one."""
    kept: list[Window] = []
    for _, window in sorted(palms, key=lambda palm: -palm[0]):
        if all(math.dist(window.centre, other.centre) > 0.25 * other.size for other in kept):
            kept.append(window)
    return kept


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

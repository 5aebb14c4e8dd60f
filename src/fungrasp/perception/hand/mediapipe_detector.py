"""Hands in a color image by MediaPipe's models: 21 landmarks, the side, a rough shape in 3D.

Two models (see ``mediapipe_models``) are run: one finds palms, the other takes an upright window of the hand
and answers with landmarks, the probability that there is a hand, which hand it is, and the landmarks' places
in meters about the hand's middle. The window is then cut again around the landmarks found, and the second
answer counts.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from PIL import Image

from fungrasp.perception.hand.detected_hand import (
    CLEAR_LENGTH,
    DetectedHand,
    clear,
    length_at,
    possible,
    which_side,
)
from fungrasp.perception.hand.mediapipe_models import MediaPipeModel, load_weights, model_runtime
from fungrasp.perception.hand.palm_windows import (
    DETECTOR_PIXELS,
    Window,
    box_overlap,
    decode_palms,
    exposed,
    search_windows,
    window_of_landmarks,
    window_of_palm,
)
from fungrasp.perception.io.capture import Box

# Indices of the models' landmarks (thumb first) in the order of ``HUMAN_JOINTS``.
FROM_MODEL = np.array([0, *range(5, 21), *range(1, 5)])

_TO_MODEL = np.argsort(FROM_MODEL)

# How far beyond the joints that data sets mean the models' landmarks are, after knuckles, as a part of the
# bone that ends there; the wrist's toward the middle finger's knuckle, as a part of that distance. Landmarks
# of tips are on the nail, not at its end. From 178 rendered captures, whose visible landmarks it brings from
# 7.3 to 6.3 pixels and from 8.1 to 7.1; at knuckles and middle joints taken smaller than measured, as a
# rendered hand may mislead.
FINGER_BEYOND, THUMB_BEYOND, WRIST_BEYOND = (0.09, 0.13, -0.18), (0.08, 0.08, -0.16), 0.04


def _joints_of_landmarks() -> np.ndarray:
    matrix = np.eye(21)
    for finger in range(5):
        for joint, part in enumerate(THUMB_BEYOND if finger == 4 else FINGER_BEYOND, start=2 + 4 * finger):
            matrix[joint, [joint, joint - 1]] += [-part, part]
    matrix[0, [0, 9]] += [WRIST_BEYOND, -WRIST_BEYOND]
    return matrix


# Takes landmarks in the order of ``HUMAN_JOINTS`` to joints, shape [21, 21].
JOINTS_OF_LANDMARKS = _joints_of_landmarks()

_LANDMARKS_OF_JOINTS = np.linalg.inv(JOINTS_OF_LANDMARKS)

LANDMARK_PIXELS = 224  # Edge of the landmark model's input [pixels].
PALM_SCORE = 0.5  # Palms of lower score are looked at only if no better one is there.
LEAST_PALM_SCORE = 0.1  # Palms of lower score are none.
# Where no window shows a hand, so many palms of low score are looked at in many windows: palms are seen in
# many views of hands behind objects, of which the landmark model knows little.
LOW_SCORE_PALMS = 3
HAND_PRESENCE = 0.5  # Windows with a lower probability of a hand show none, if another does.
# Least score of a hand that many windows were cut for. In 69 images without a hand (52 of them rendered:
# tables and things with the color of skin) up to 0.40 was seen; of 52 rendered hands four had less than this,
# three of them off by 24 to 30 pixels in the median of their landmarks.
LEAST_HAND_SCORE = 0.45
LEAST_ANSWER = 0.18  # Around an answer of lower score no second window is cut.
# About a palm of low score no more windows are cut where the first ones, and then all turned and shifted
# ones, show a hand with no higher probability: of 30 palms that were none, 19 end so after four windows. Of
# two that are found there, none had less than 0.17 and 0.44.
FIRST_LOOK, SECOND_LOOK = 0.02, 0.1
# What overlaps by more than this part with what was looked at and was no hand is not looked at again.
REFUSED = 0.3
# So many windows are looked at in one image at most: hands that are found need 4 to 88, and an image without
# any is to take less than a second.
MOST_LOOKS = 90
# Edge of a window that a hand of known length is looked at in, in hand lengths. Hands fill it less than the
# models were trained on, but one that was first seen at a wrong place is still inside.
WINDOW_LENGTHS = 1.16
WINDOW_TURNS = np.radians(np.arange(0, 360, 45))  # Angles by which such windows are turned [rad].
# Where the middles of such windows are if only a palm of low score is known, from its own, in hand lengths;
# each is then turned by half as many angles.
WINDOW_OFFSETS = ((0.0, 0.0), (0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
# Around so many of the answers from such windows, the most probable ones, a window is cut, and mirrored.
CUT_AGAIN = 4
# Windows that are looked at where a hand is to be confirmed.
VERIFYING = 2 + len(WINDOW_TURNS) + 2 * CUT_AGAIN
# The same where only a palm of low score is known.
AROUND_PALM = len(WINDOW_OFFSETS) * len(WINDOW_TURNS) // 2 + 2 * CUT_AGAIN
MOST_VERIFIED = 2  # Largest number of hands of an image that are looked at in more windows.
SAME_HAND = 0.5  # Two answers whose boxes overlap by more than this part of their union are one hand.
# If the first answer, one from the window around it and one from that window's mirror image are of higher
# scores, and nearer to each other than this part of the hand's length, they are right: of 170 rendered
# captures 70 % have such, which are off by 7.7 pixels in the median of their landmarks, and 7.5 after more
# windows.
CONFIRMED_HAND, CONFIRMED = 0.8, 0.05
# Answers whose landmarks are apart by more than this on average, in hand lengths, don't confirm each other.
SAME_ANSWER = 0.12


class MediaPipeHandDetector:
    """The two models, ready to run. Keeps the interpreters: one per thread of the caller."""

    def __init__(self) -> None:
        """
        Raises:
            FungraspError: the weights are not set up, or ai-edge-litert is not installed.
        """
        model_runtime()  # Whoever lacks it is told before having fetched the weights.
        weights = load_weights()
        self._palm, self._landmarks = MediaPipeModel(weights["palm"]), MediaPipeModel(weights["landmarks"])
        self._looks = 0

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """All hands found; see ``detect_with_depth``, which finds more of them."""
        return self.detect_with_depth(color, None, near)

    def detect_with_depth(
        self, color: np.ndarray, lengths: np.ndarray | None, near: Box | None = None
    ) -> list[DetectedHand]:
        """All hands found.

        The whole image is searched first. If nothing is there, so are its parts, enlarged, and the image
        turned; the first of these that shows a hand counts, or the best of all that may show one.

        Args:
            color: RGB, uint8, shape [H, W, 3].
            lengths: ``hand_lengths`` of the image [pixels], shape [H, W]; None if depth is not known.
            near: a box beside or around the hand, searched before other parts.

        Returns:
            Most probable first; empty if there is none.
        """
        self._looks = 0
        image = Image.fromarray(exposed(color))
        height, width = color.shape[:2]
        palms: list[tuple[float, Window]] = []
        refused: list[DetectedHand] = []
        for window in search_windows(width, height, near):
            seen = self._palms(image, window)
            answers = [self._hand(image, start) for score, start in seen if score >= PALM_SCORE]
            found = _distinct([hand for hand in answers if hand.score >= HAND_PRESENCE], refused)
            verified = [
                self._verified(image, hand, lengths)
                for hand in found[:MOST_VERIFIED]
                if self._looks + VERIFYING <= MOST_LOOKS
            ]
            first = [hand for hand in verified if hand.score >= LEAST_HAND_SCORE]
            if first:
                return first + [hand for hand in found[MOST_VERIFIED:] if clear(hand, lengths)]
            refused += found[:MOST_VERIFIED]
            palms += seen
            if self._looks + VERIFYING > MOST_LOOKS:
                return []
        best: DetectedHand | None = None
        for start in _apart(palms)[:LOW_SCORE_PALMS]:
            if self._looks + AROUND_PALM > MOST_LOOKS:
                break
            hand = self._around_palm(image, start, lengths)
            if hand is not None and (best is None or hand.score > best.score):
                best = hand
        return [best] if best is not None and best.score >= LEAST_HAND_SCORE else []

    def _verified(self, image: Image.Image, hand: DetectedHand, lengths: np.ndarray | None) -> DetectedHand:
        """The hand, if the windows around it confirm it; else what windows all round make of it, of score 0
        if it is too small for that."""
        window = _window_of(hand)
        length = length_at(hand.pixels, lengths, window.size / WINDOW_LENGTHS)
        if possible(hand, length):
            again = [self._landmarks_in(image, window, mirrored) for mirrored in (False, True)]
            if all(confirms(hand, answer, length) for answer in again):
                return consensus([hand, *again], again, length)
        if not clear(hand, lengths):
            return replace(hand, score=0.0)
        middle = hand.pixels.mean(axis=0)
        turned = self._answers(image, [(middle, turn) for turn in WINDOW_TURNS], length)
        return self._consensus(image, [hand, *turned], length, lengths)

    def _around_palm(
        self, image: Image.Image, palm: Window, lengths: np.ndarray | None
    ) -> DetectedHand | None:
        """What windows about a palm make of its hand; None as soon as they show none. palm: the window that
        the hand should be in."""
        length = length_at(np.array([palm.center]), lengths, palm.size / WINDOW_LENGTHS)
        if length < CLEAR_LENGTH:
            return None
        centers = palm.center + length * np.array(WINDOW_OFFSETS)
        every: list[DetectedHand] = []
        for looked, least in ((centers[:1], FIRST_LOOK), (centers[1:], SECOND_LOOK)):
            places = [(center, turn) for center in looked for turn in WINDOW_TURNS[::2]]
            every += self._answers(image, places, length)
            if max(answer.score for answer in every) < least:
                return None
        return self._consensus(image, every, length, lengths)

    def _answers(
        self, image: Image.Image, places: list[tuple[np.ndarray, float]], length: float
    ) -> list[DetectedHand]:
        """What windows as large as a hand show.

        Args:
            image: RGB.
            places: middles of windows [pixels], shape [2], and how they are turned [rad].
            length: of a hand in the image [pixels].
        """
        size = WINDOW_LENGTHS * length
        return [
            self._landmarks_in(image, Window((float(u), float(v)), size, float(turn)))
            for (u, v), turn in places
        ]

    def _consensus(
        self, image: Image.Image, every: list[DetectedHand], length: float, lengths: np.ndarray | None
    ) -> DetectedHand:
        """The answer that most others confirm, of those seen already and from windows around the best; of
        score 0 where none is clear and of a hand's size.

        Args:
            image: RGB.
            length: of a hand in the image [pixels].
            lengths: the same by pixel, if depth is known.
        """
        best = sorted(every, key=lambda answer: -answer.score)[:CUT_AGAIN]
        last = [
            self._landmarks_in(image, _window_of(answer), mirrored)
            for answer in best
            for mirrored in (False, True)
        ]
        every = every + last
        sized = [answer for answer in every if possible(answer, length) and clear(answer, lengths)]
        if not sized:
            return replace(best[0], score=0.0)
        return consensus(sized, last, length)

    def _palms(self, image: Image.Image, window: Window) -> list[tuple[float, Window]]:
        """Scores of palms in a window, and windows of their hands."""
        offsets, logits = self._palm(window.cut(image, DETECTOR_PIXELS))
        found = []
        for palm in decode_palms(offsets.reshape(-1, 18), logits.ravel(), LEAST_PALM_SCORE):
            points = window.to_image(palm.points)
            half = (palm.box[2:] - palm.box[:2]) / 2 * window.size
            middle = window.to_image((palm.box[:2] + palm.box[2:]) / 2)
            box = np.concatenate([middle - half, middle + half])
            found.append((palm.score, window_of_palm(box, points[0], points[2])))
        return found

    def _hand(self, image: Image.Image, window: Window) -> DetectedHand:
        answer = self._landmarks_in(image, window)
        if answer.score < LEAST_ANSWER:
            return answer
        again = self._landmarks_in(image, _window_of(answer))
        return (
            again if min(answer.score, again.score) >= HAND_PRESENCE or again.score > answer.score else answer
        )

    def _landmarks_in(self, image: Image.Image, window: Window, mirrored: bool = False) -> DetectedHand:
        """What the landmark model says of a window, or of its mirror image."""
        self._looks += 1
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


def _apart(palms: list[tuple[float, Window]]) -> list[Window]:
    """Windows of palms, best first, without those in the middle half of a better one."""
    kept: list[Window] = []
    for _, window in sorted(palms, key=lambda palm: -palm[0]):
        if all(math.dist(window.center, other.center) > 0.25 * other.size for other in kept):
            kept.append(window)
    return kept


def _distinct(hands: list[DetectedHand], refused: list[DetectedHand]) -> list[DetectedHand]:
    """The hands, best first, without those that overlap with better ones or with what was refused."""
    kept: list[DetectedHand] = []
    for hand in sorted(hands, key=lambda hand: -hand.score):
        better, none = (_boxes(others) for others in (kept, refused))
        if (box_overlap(hand.box, better) > SAME_HAND).any() or (box_overlap(hand.box, none) > REFUSED).any():
            continue
        kept.append(hand)
    return kept


def _boxes(hands: list[DetectedHand]) -> np.ndarray:
    return np.array([hand.box for hand in hands]).reshape(-1, 4)


def confirms(first: DetectedHand, second: DetectedHand, length: float) -> bool:
    """Whether both detections have high scores and agree. length: of a hand in the image [pixels]."""
    sure = min(first.score, second.score) > CONFIRMED_HAND and first.side == second.side
    return sure and first.distance(second) < CONFIRMED * length


def consensus(every: list[DetectedHand], last: list[DetectedHand], length: float) -> DetectedHand:
    """The detection that most others confirm.

    Its score is the part of the last answers, weighted by their scores, that confirms it, and the score of
    its side what part of those agrees.

    Args:
        last: those of them, or others, that judge it.
        length: of a hand in the image [pixels].
    """

    def confirmed(hand: DetectedHand, by: list[DetectedHand]) -> np.ndarray:
        apart = np.array([hand.distance(other) for other in by])
        return np.exp(-np.square(apart / (SAME_ANSWER * length)))

    weights = np.array([hand.score for hand in every]) ** 2
    best = every[int(np.argmax([confirmed(hand, every) @ weights for hand in every]))]
    worth = np.array([hand.score for hand in last]) * confirmed(best, last)
    vote = float(np.average([hand.right for hand in last], weights=worth + 1e-9))
    return replace(best, score=float(worth.mean()), **which_side(vote))

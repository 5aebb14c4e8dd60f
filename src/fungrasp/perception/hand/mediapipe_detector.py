"""Hand detection in a color image by MediaPipe's models: 21 landmarks, side, approximate 3D shape.

One model (see ``mediapipe_models``) finds palms. The other takes an upright window of the hand and returns
landmarks, the probability of a hand, its side, and landmarks in meters about the hand's center. It runs again
on the window around these landmarks, and the second result counts.
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

# Distances of the models' landmarks beyond the joints of data sets, after knuckles, as fractions of the bone
# that ends there; for the wrist, toward the middle finger's knuckle. Landmarks of fingertips are on the nail,
# not at its end. From 178 rendered captures: the correction reduces errors of visible landmarks from 7.3 to
# 6.3 and from 8.1 to 7.1 pixels. Values at knuckles and middle joints are smaller than measured, because a
# rendered hand may mislead.
FINGER_BEYOND, THUMB_BEYOND, WRIST_BEYOND = (0.09, 0.13, -0.18), (0.08, 0.08, -0.16), 0.04


def _joints_of_landmarks() -> np.ndarray:
    matrix = np.eye(21)
    for finger in range(5):
        for joint, part in enumerate(THUMB_BEYOND if finger == 4 else FINGER_BEYOND, start=2 + 4 * finger):
            matrix[joint, [joint, joint - 1]] += [-part, part]
    matrix[0, [0, 9]] += [WRIST_BEYOND, -WRIST_BEYOND]
    return matrix


# Matrix that maps landmarks in the order of ``HUMAN_JOINTS`` to joints, shape [21, 21].
JOINTS_OF_LANDMARKS = _joints_of_landmarks()

_LANDMARKS_OF_JOINTS = np.linalg.inv(JOINTS_OF_LANDMARKS)

LANDMARK_PIXELS = 224  # Size of the landmark model's input [pixels].
PALM_SCORE = 0.5  # Score of palms below which they are examined only if there is no better one.
LEAST_PALM_SCORE = 0.1  # Smallest score of a palm.
# Number of palms of low score that are examined in many windows if no window shows a hand: palms are detected
# in many views of hands behind objects that the landmark model rarely saw in training.
LOW_SCORE_PALMS = 3
HAND_PRESENCE = 0.5  # Probability of a hand below which a window shows none, if another window shows one.
# Smallest score of a hand after many windows. 69 images without a hand (52 of them rendered: tables and
# things of skin color) had up to 0.40; of 52 rendered hands, four had less than this, three of them with a
# median landmark error of 24 to 30 pixels.
LEAST_HAND_SCORE = 0.45
LEAST_ANSWER = 0.18  # Smallest score of a result around which a second window is cut.
# Smallest probabilities of a hand in the first windows around a palm of low score, and in all rotated and
# shifted ones, for which more windows are cut: of 30 false palms, 19 end after four windows; two hands that
# are found this way had at least 0.17 and 0.44.
FIRST_LOOK, SECOND_LOOK = 0.02, 0.1
# Overlap with a rejected hand beyond which a hand is not examined again.
REFUSED = 0.3
# Largest number of windows per image: hands are found in 4 to 88, and an image without a hand should take
# less than a second.
MOST_LOOKS = 90
# Size of a window for a hand of known length, in hand lengths. Hands fill it less than in the models'
# training, but a hand that was first seen at a wrong place is still inside.
WINDOW_LENGTHS = 1.16
WINDOW_TURNS = np.radians(np.arange(0, 360, 45))  # Rotations of such windows [rad].
# Shifts of such windows from a palm of low score, in hand lengths; each has half of the rotations.
WINDOW_OFFSETS = ((0.0, 0.0), (0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
# Number of the most probable results around which a window and its mirror image are cut again.
CUT_AGAIN = 4
# Largest number of windows that confirm a hand.
VERIFYING = 2 + len(WINDOW_TURNS) + 2 * CUT_AGAIN
# Largest number of windows around a palm of low score.
AROUND_PALM = len(WINDOW_OFFSETS) * len(WINDOW_TURNS) // 2 + 2 * CUT_AGAIN
MOST_VERIFIED = 2  # Largest number of hands per image that are confirmed.
SAME_HAND = 0.5  # Overlap (intersection over union) beyond which two results are one hand.
# A hand is confirmed if it and the results from the window around it and from its mirror image have higher
# scores than the first and are closer than the second, in hand lengths: 70 % of 170 rendered captures, with a
# median landmark error of 7.7 pixels, and 7.5 after more windows.
CONFIRMED_HAND, CONFIRMED = 0.8, 0.05
# Mean distance between landmarks at which the agreement of two results is 1 / e, in hand lengths.
SAME_ANSWER = 0.12


class MediaPipeHandDetector:
    """The two models, ready to run. One detector per thread: the interpreters are kept."""

    def __init__(self) -> None:
        """
        Raises:
            FungraspError: the weights are not set up, or ai-edge-litert is not installed.
        """
        model_runtime()  # Before the weights, so that a missing runtime is reported first.
        weights = load_weights()
        self._palm, self._landmarks = MediaPipeModel(weights["palm"]), MediaPipeModel(weights["landmarks"])
        self._looks = 0

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """Detect hands without depth; ``detect_with_depth`` finds more of them."""
        return self.detect_with_depth(color, None, near)

    def detect_with_depth(
        self, color: np.ndarray, lengths: np.ndarray | None, near: Box | None = None
    ) -> list[DetectedHand]:
        """Detect hands, most probable first.

        The whole image is searched first. If it shows no hand, enlarged parts and the rotated image follow;
        the first window with a hand counts, or the best palm of low score.

        Args:
            color: RGB, uint8, shape [H, W, 3].
            lengths: ``hand_lengths`` of the image [pixels], shape [H, W]; None if depth is unknown.
            near: box beside or around the hand [pixels], searched before other parts.
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
        """Return the hand if the windows around it confirm it; otherwise the consensus of windows all around,
        with score 0 if the hand is too small for them."""
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
        """Return the consensus of windows around a palm; None if they show no hand. palm: hand's window."""
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
        """Return the results of windows of the size of a hand.

        Args:
            image: RGB.
            places: center [pixels], shape [2], and rotation [rad] of each window.
            length: length of a hand in the image [pixels].
        """
        size = WINDOW_LENGTHS * length
        return [
            self._landmarks_in(image, Window((float(u), float(v)), size, float(turn)))
            for (u, v), turn in places
        ]

    def _consensus(
        self, image: Image.Image, every: list[DetectedHand], length: float, lengths: np.ndarray | None
    ) -> DetectedHand:
        """Return the result that others confirm best, among given ones and those of windows around the best;
        with score 0 if none is clear and of a hand's size.

        Args:
            image: RGB.
            every: given results.
            length: length of a hand in the image [pixels].
            lengths: ``hand_lengths``, if depth is known.
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
        """Return the scores of palms in a window, and the windows of their hands."""
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
        """Run the landmark model on a window, or on its mirror image."""
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
    """Return the window around the landmarks of a result."""
    return window_of_landmarks((_LANDMARKS_OF_JOINTS @ hand.pixels)[_TO_MODEL])


def _apart(palms: list[tuple[float, Window]]) -> list[Window]:
    """Return the windows of palms, best first, without those in the central half of a better one."""
    kept: list[Window] = []
    for _, window in sorted(palms, key=lambda palm: -palm[0]):
        if all(math.dist(window.center, other.center) > 0.25 * other.size for other in kept):
            kept.append(window)
    return kept


def _distinct(hands: list[DetectedHand], refused: list[DetectedHand]) -> list[DetectedHand]:
    """Return hands, best first, without those that overlap with better ones or with rejected ones."""
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
    """Return whether two detections have high scores and agree. length: of a hand in the image [pixels]."""
    sure = min(first.score, second.score) > CONFIRMED_HAND and first.side == second.side
    return sure and first.distance(second) < CONFIRMED * length


def consensus(every: list[DetectedHand], last: list[DetectedHand], length: float) -> DetectedHand:
    """Return the detection that others confirm best.

    Its score is the mean of the last results' scores, weighted by agreement; the score of its side is the
    share of their votes.

    Args:
        every: detections to choose from.
        last: detections that vote.
        length: length of a hand in the image [pixels].
    """

    def confirmed(hand: DetectedHand, by: list[DetectedHand]) -> np.ndarray:
        apart = np.array([hand.distance(other) for other in by])
        return np.exp(-np.square(apart / (SAME_ANSWER * length)))

    weights = np.array([hand.score for hand in every]) ** 2
    best = every[int(np.argmax([confirmed(hand, every) @ weights for hand in every]))]
    worth = np.array([hand.score for hand in last]) * confirmed(best, last)
    vote = float(np.average([hand.right for hand in last], weights=worth + 1e-9))
    return replace(best, score=float(worth.mean()), **which_side(vote))

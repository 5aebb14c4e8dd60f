"""Hands detected in the color image, and the choice of hands that may hold the object."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.human_hand import joint_bends
from fungrasp.objects import ObjectModel
from fungrasp.perception.io.capture import Box, CameraFrame, Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, Side

HAND_LENGTH = 0.19  # Length of an adult's hand from wrist to fingertips [m].
# Length of a hand in the image below which the models' windows are blurred, so that some show hands in
# lenses, paws and parts of hands [pixels]. An adult's hand is then 36 pixels wide. A camera with 640 pixels
# and 80 degrees sees this length at the far end of the range, 0.9 m.
CLEAR_LENGTH = 80.0
# Probability of the landmark model's side below which the fingers' flexion overrules it.
UNDECIDED = 0.6
# Mean backward bend of the fingers' joints beyond which they belong to the other hand [rad].
BENT_BACK = np.radians(8.0)
# Backward bend that means wrong landmarks if the landmark model is confident of the side [rad].
IMPOSSIBLE = np.radians(20.0)
DISTRUST = 0.5  # Factor on the hand's score in that case.
MIRROR_X = np.array([-1.0, 1.0, 1.0])  # Reflection of x, which swaps left and right of the image.


@dataclass(frozen=True, eq=False)
class DetectedHand:
    """A hand in the image; joints in the order of ``HUMAN_JOINTS``."""

    pixels: np.ndarray
    """Landmarks [pixels], shape [21, 2]."""
    shape_camera: np.ndarray
    """Landmarks about the hand's center [m], camera axes, shape [21, 3]; the model guesses size and depth."""
    side: Side
    """Side of the hand."""
    side_score: float
    """Probability of ``side``, 0.5 to 1."""
    score: float
    """Probability that this is a hand, 0 to 1."""
    spread: float | None = None
    """Standard deviation of a landmark along each axis, hidden or not [pixels]; None for MediaPipe's, see
    ``fit_problem.LANDMARK_SPREAD``."""
    direction_spread: float | None = None
    """Standard deviation of bone directions in ``shape_camera`` [rad]; None as above."""

    @property
    def box(self) -> np.ndarray:
        """Box ``x0 y0 x1 y1`` around the landmarks [pixels], shape [4]."""
        return np.concatenate([self.pixels.min(axis=0), self.pixels.max(axis=0)])

    @property
    def extent(self) -> float:
        """Diagonal of the box [pixels]."""
        return float(np.linalg.norm(np.ptp(self.pixels, axis=0)))

    @property
    def length(self) -> float:
        """Length of a straight hand at the image scale of ``shape_camera`` [pixels]; the extent if that has
        no size."""
        pixels = self.pixels - self.pixels.mean(axis=0)
        shape = self.shape_camera[:, :2] - self.shape_camera[:, :2].mean(axis=0)
        size = float((shape**2).sum())
        return HAND_LENGTH * float((pixels * shape).sum()) / size if size > 0 else self.extent

    @property
    def right(self) -> float:
        """Probability of a right hand."""
        return self.side_score if self.side == "right" else 1.0 - self.side_score

    def distance(self, other: DetectedHand) -> float:
        """Return the mean distance between the landmarks of two hands [pixels]."""
        return float(np.linalg.norm(self.pixels - other.pixels, axis=1).mean())


class HandDetector(Protocol):
    """Finds hands in color images, such as ``MediaPipeHandDetector``."""

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """Detect hands in an RGB image, shape [H, W, 3]. near: box beside or around the hand [pixels]."""
        ...


@runtime_checkable
class DepthHandDetector(HandDetector, Protocol):
    """A detector that uses the size of hands in the image."""

    def detect_with_depth(
        self, color: np.ndarray, lengths: np.ndarray, near: Box | None = None
    ) -> list[DetectedHand]:
        """Detect hands with known depth. lengths: ``hand_lengths`` of the image [pixels], shape [H, W]."""
        ...


def find_hands(
    detector: HandDetector, capture: Capture | CameraFrame, near: Box | None = None
) -> list[DetectedHand]:
    """Return the hands found by a detector, with depth if it is a ``DepthHandDetector``.

    Hands of impossible size at the measured depth are dropped; without depth, none are.
    """
    lengths = hand_lengths(capture.depth, capture.intrinsics.fx)
    if isinstance(detector, DepthHandDetector):
        hands = detector.detect_with_depth(capture.color, lengths, near)
    else:
        hands = detector.detect(capture.color, near)
    return [hand for hand in hands if possible(hand, length_at(hand.pixels, lengths, otherwise=hand.extent))]


def hand_lengths(depth: np.ndarray, focal: float) -> np.ndarray:
    """Return the length of a hand at the depth of each pixel [pixels], shape [H, W]; NaN without depth.

    depth: [m], shape [H, W]; 0: not measured; focal: focal length [pixels].
    """
    return HAND_LENGTH * focal / np.where(depth > 0, depth, np.nan)


def which_side(right: float) -> dict[str, Any]:
    """Return the fields ``side`` and ``side_score`` for the probability of a right hand."""
    return {"side": "right" if right >= 0.5 else "left", "side_score": float(max(right, 1 - right))}


def choose_hand(
    hands: Sequence[DetectedHand], near: Box | None = None, side: Side | None = None
) -> tuple[DetectedHand, list[PerceptionWarning]]:
    """Choose one of several hands by box and side.

    Args:
        near: box around the object or the hand [pixels].
        side: side of the hand, if known.

    Returns:
        The hand of this side, if there is one, that is nearest to the box or, without a box, largest in the
        image; and warnings about the choice.

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
        best = largest_first(fitting)[0]
        choice = "largest one"
    else:
        best = min(fitting, key=lambda hand: _distance_to_box(hand, near))
        choice = "one nearest to the box"
    warnings = []
    if len(hands) > 1:
        if len(fitting) < len(hands):
            choice = f"{side} hand" if len(fitting) == 1 else f"{side} hand that is the {choice}"
        u, v = best.pixels.mean(axis=0).tolist()
        warnings.append(PerceptionWarning.of("several_hands", count=len(hands), choice=choice, u=u, v=v))
    if side is not None and best.side != side:
        warnings.append(PerceptionWarning.of("side_not_as_given", seen=best.side, given=side))
    return best, warnings


def largest_first(hands: Sequence[DetectedHand]) -> list[DetectedHand]:
    """Sort hands by the area of their boxes, largest first."""
    return sorted(hands, key=lambda hand: -float(np.prod(hand.box[2:] - hand.box[:2])))


def _distance_to_box(hand: DetectedHand, box: Box) -> float:
    beyond = np.maximum(np.maximum(np.array(box[:2]) - hand.pixels, hand.pixels - np.array(box[2:])), 0)
    return float(np.linalg.norm(beyond, axis=1).mean())


def settle_side(hand: DetectedHand, side: Side | None = None) -> tuple[DetectedHand, list[PerceptionWarning]]:
    """Return the hand with its probable side, and a warning if the side or the landmarks are uncertain.

    The landmark model recognizes the side from the image and sometimes fails for a hand behind an object. If
    the 3D landmarks are taken for a hand of the wrong side, its fingers bend backwards. A given side is kept.
    """
    if side is not None:
        return dataclasses.replace(hand, side=side), []
    shape = hand.shape_camera if hand.side == "right" else hand.shape_camera * MIRROR_X
    # Mean flexion of the joints of the four fingers [rad].
    bend = float(joint_bends(shape)[0][:4].mean())
    if hand.side_score < UNDECIDED and bend < -BENT_BACK:
        other: Side = "left" if hand.side == "right" else "right"
        warnings = [PerceptionWarning.of("side_from_fingers", seen=hand.side, taken=other)]
        return dataclasses.replace(hand, side=other), warnings
    if bend < -IMPOSSIBLE:
        return dataclasses.replace(hand, score=DISTRUST * hand.score), [
            PerceptionWarning.of("fingers_bent_backwards")
        ]
    return hand, []


# Smallest and largest extent of a hand's landmarks, in hand lengths: 170 rendered hands, most of them bent
# about an object, had 0.46 to 1.03.
EXTENTS = (0.4, 1.2)


def length_at(pixels: np.ndarray, lengths: np.ndarray | None, otherwise: float) -> float:
    """Return the length of a hand at some pixels [pixels]: the median of ``lengths`` there.

    Args:
        pixels: shape [N, 2].
        lengths: ``hand_lengths``; None if depth is unknown.
        otherwise: result if the length is unknown.
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
    """Return whether a hand's extent is possible. length: length of a hand in the image [pixels]."""
    return EXTENTS[0] < hand.extent / length < EXTENTS[1]


def clear(hand: DetectedHand, lengths: np.ndarray | None) -> bool:
    """Return whether a hand has enough pixels to be seen clearly.

    lengths: as in ``length_at``; without depth, the scale of ``shape_camera`` is used.
    """
    return length_at(hand.pixels, lengths, otherwise=hand.length) >= CLEAR_LENGTH


MOST = 2  # Largest number of hands that are fitted.
# Largest distance between the box around the object and the nearest joint of a hand that holds it [m]: joints
# of a touching finger are 6 to 11 mm from the surface, and located to 10 to 30 mm.
HOLDING = 0.05


@dataclass(frozen=True, eq=False)
class HandHypothesis:
    """A hand that may hold the object."""

    detected: DetectedHand
    """Detection with its probable side."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """Uncertainties in the choice."""


def hand_hypotheses(
    capture: Capture,
    hands: Sequence[DetectedHand],
    near: Box | None,
    side: Side | None,
    detector: HandDetector,
) -> list[HandHypothesis]:
    """Return the hands that may hold the object: one, if the object's place is known or only one hand fits;
    else the two largest of the side.

    Args:
        hands: hands that ``detector`` found; if there are none, the error says why.
        near: box around the object [pixels], if known.
        side: side of the hand, if known.

    Raises:
        FungraspError: there is no hand; the message gives a probable reason.
    """
    if not hands and (reason := _of_another_size(capture, near, detector)):
        raise FungraspError(f"no hand was found in the image; {reason}")
    if not hands:
        swapped = np.ascontiguousarray(capture.color[..., ::-1])
        if find_hands(detector, dataclasses.replace(capture, color=swapped), near):
            raise FungraspError(
                "no hand was found, but one is with red and blue swapped: was the image written as BGR?"
            )
    if not hands and (reason := _why_no_hand(capture)):
        raise FungraspError(f"no hand was found in the image; it is {reason}")
    chosen, warnings = choose_hand(hands, near, side)
    likely = [(chosen, warnings)]
    fitting = [hand for hand in hands if side in (None, hand.side)]
    if near is None and len(fitting) > 1:
        likely = [(hand, [_several(hand, len(hands))]) for hand in largest_first(fitting)[:MOST]]
    return [_settled(hand, warnings, side) for hand, warnings in likely]


def _why_no_hand(capture: Capture) -> str:
    """Return a probable reason why no hand is found, in words; empty if there is none."""
    color, depth, reasons = capture.color[::2, ::2], capture.depth, []
    if np.percentile(color.mean(axis=-1), 95) < 40:
        reasons.append("too dark: more light, or a longer exposure")
    elif (color.min(axis=-1) >= 250).mean() > 0.5:
        reasons.append("overexposed: less light, or a shorter exposure")
    # The data sheet of the RealSense D435i says 0.28 m for its full resolution.
    near = depth[(depth > 0) & (depth < 0.3)]
    if near.size > 0.1 * depth.size:
        reasons.append(f"too near: {np.median(near):.2f} m, the camera needs 0.3")
    return "; ".join(reasons)


def _of_another_size(capture: Capture, near: Box | None, detector: HandDetector) -> str:
    """Return a description of a detected hand of impossible size at its depth; empty if there is none."""
    lengths = hand_lengths(capture.depth, capture.intrinsics.fx)
    for hand in detector.detect(capture.color, near):
        length = length_at(hand.pixels, lengths, otherwise=hand.extent)
        if not possible(hand, length):
            u, v = hand.pixels.mean(axis=0)
            depth = HAND_LENGTH * capture.intrinsics.fx / length
            return (
                f"a candidate at pixel {u:.0f}, {v:.0f} is {hand.extent / length:.2g} times as long "
                f"as a hand is at {depth:.2g} m, the depth measured there ({EXTENTS[0]:g} to {EXTENTS[1]:g} "
                "are possible): are the depth's unit and the focal length right?"
            )
    return ""


def hands_elsewhere(
    capture: Capture, known: Sequence[DetectedHand], side: Side | None, detector: HandDetector
) -> list[HandHypothesis]:
    """Detect further hands after painting over those that do not hold the object: detectors stop at a clearly
    visible hand, which may be another person's. known: hands to paint over."""
    color, depth = capture.color.copy(), capture.depth.copy()
    ground = np.median(color.reshape(-1, 3), axis=0).astype(np.uint8)
    for hand in known:
        x0, y0, x1, y1 = np.clip(np.rint(hand.box), 0, None).astype(int)
        color[y0 : y1 + 1, x0 : x1 + 1], depth[y0 : y1 + 1, x0 : x1 + 1] = ground, 0.0
    found = find_hands(detector, CameraFrame(color, depth, capture.intrinsics, 0.0))
    # A hand that is found again beside its painted box is no other hand.
    others = [h for h in found if side in (None, h.side) and all(_apart(h, k) for k in known)]
    count = len(known) + len(others)
    return [_settled(hand, [_several(hand, count)], side) for hand in largest_first(others)[:MOST]]


def object_box(capture: Capture, model: ObjectModel | None, given: ObjectEstimate | None) -> Box | None:
    """Return the box around the object from box, point, mask or given pose [pixels]; None without any."""
    if capture.box is not None:
        return capture.box
    if capture.point is not None:
        u, v = capture.point
        return u - 1.0, v - 1.0, u + 1.0, v + 1.0
    if capture.mask is not None:
        rows, columns = np.nonzero(capture.mask)
        return float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max())
    if given is None or model is None:
        return None
    pixels = capture.intrinsics.project(transform_points(given.pose_camera_object, model.vertices))
    if not np.isfinite(pixels).all():
        return None
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def may_hold(hand: HandEstimate, obj: ObjectEstimate, vertices: np.ndarray) -> bool:
    """Return whether the object's pose is probably right and the hand is near the object.

    Args:
        hand: camera frame.
        obj: camera frame.
        vertices: vertices of the mesh [m], object frame, shape [V, 3].
    """
    if not (obj.accepted or obj.score > 0.5):
        return False
    surface = transform_points(obj.pose_camera_object, vertices)
    # Vertices of large triangles may all be far from the hand, so the box around them is used.
    low, high = surface.min(axis=0) - HOLDING, surface.max(axis=0) + HOLDING
    return bool(((hand.joints_camera > low) & (hand.joints_camera < high)).all(axis=1).any())


def _settled(hand: DetectedHand, warnings: Sequence[PerceptionWarning], side: Side | None) -> HandHypothesis:
    settled, more = settle_side(hand, side)
    return HandHypothesis(settled, (*warnings, *more))


def _several(hand: DetectedHand, count: int) -> PerceptionWarning:
    u, v = hand.pixels.mean(axis=0).tolist()
    return PerceptionWarning.of("several_candidates", count=count, u=u, v=v)


def _apart(hand: DetectedHand, other: DetectedHand) -> bool:
    return float(np.linalg.norm(hand.pixels.mean(axis=0) - other.pixels.mean(axis=0))) > 0.5 * other.extent

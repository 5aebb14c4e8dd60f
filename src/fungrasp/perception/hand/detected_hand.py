"""Hands that a detector found in the color image, and which of them may be the one that holds the object."""

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
# What is shorter in the image is blurred in the models' windows, some of which then show hands in lenses,
# paws and parts of hands [pixels]. An adult's hand is 36 pixels wide then. At the far end of the range, 0.9
# m, it is so long for a camera of 640 pixels and 80 degrees.
CLEAR_LENGTH = 80.0
# Below this part of its windows' votes the landmark model is overruled by how the fingers bend.
UNDECIDED = 0.6
# Fingers bent back by more, on average over their joints, are those of the other hand [rad].
BENT_BACK = np.radians(8.0)
# If the landmark model is confident of the side, fingers bent back by more say that its landmarks are wrong
# [rad].
IMPOSSIBLE = np.radians(20.0)
DISTRUST = 0.5  # Factor of the hand's score in that case.
MIRROR_X = np.array([-1.0, 1.0, 1.0])  # Reflection that swaps left and right of the image, by coordinate.


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
    spread: float | None = None
    """Standard deviation of a landmark, hidden or not, each way [pixels]; None: as MediaPipe's err, see
    ``fit_problem.LANDMARK_SPREAD``."""
    direction_spread: float | None = None
    """Standard deviation of the directions of bones in ``shape_camera`` [rad]; None: as above."""

    @property
    def box(self) -> np.ndarray:
        """``x0 y0 x1 y1`` around the landmarks [pixels], shape [4]."""
        return np.concatenate([self.pixels.min(axis=0), self.pixels.max(axis=0)])

    @property
    def extent(self) -> float:
        """Diagonal of that box [pixels]."""
        return float(np.linalg.norm(np.ptp(self.pixels, axis=0)))

    @property
    def length(self) -> float:
        """How long a straight hand of this scale is in the image [pixels], by ``shape_camera``; where it has
        no size, the extent."""
        pixels = self.pixels - self.pixels.mean(axis=0)
        shape = self.shape_camera[:, :2] - self.shape_camera[:, :2].mean(axis=0)
        size = float((shape**2).sum())
        return HAND_LENGTH * float((pixels * shape).sum()) / size if size > 0 else self.extent

    @property
    def right(self) -> float:
        """Probability that it is a right hand."""
        return self.side_score if self.side == "right" else 1.0 - self.side_score

    def distance(self, other: DetectedHand) -> float:
        """Mean distance of the landmarks of two hands [pixels]."""
        return float(np.linalg.norm(self.pixels - other.pixels, axis=1).mean())


class HandDetector(Protocol):
    """What finds hands in a color image; ``MediaPipeHandDetector`` is one."""

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """All hands found in an RGB image, shape [H, W, 3]; near: a box beside or around the hand."""
        ...


@runtime_checkable
class DepthHandDetector(HandDetector, Protocol):
    """A detector that makes use of how large hands are in the image."""

    def detect_with_depth(
        self, color: np.ndarray, lengths: np.ndarray, near: Box | None = None
    ) -> list[DetectedHand]:
        """``detect`` with known depth. lengths: ``hand_lengths`` of the image [pixels], shape [H, W]."""
        ...


def find_hands(
    detector: HandDetector, capture: Capture | CameraFrame, near: Box | None = None
) -> list[DetectedHand]:
    """All hands found in an image by a detector, which may be one that depth helps.

    What is not as large as a hand by the depth measured where it is seen is left out, whoever found it;
    nothing is where no depth is known.
    """
    lengths = hand_lengths(capture.depth, capture.intrinsics.fx)
    if isinstance(detector, DepthHandDetector):
        hands = detector.detect_with_depth(capture.color, lengths, near)
    else:
        hands = detector.detect(capture.color, near)
    return [hand for hand in hands if possible(hand, length_at(hand.pixels, lengths, otherwise=hand.extent))]


def hand_lengths(depth: np.ndarray, focal: float) -> np.ndarray:
    """How long a hand is in the image at the depth of each pixel [pixels], shape [H, W]; NaN without depth.

    depth: [m], shape [H, W], 0 where nothing was measured; focal: length [pixels].
    """
    return HAND_LENGTH * focal / np.where(depth > 0, depth, np.nan)


def which_side(right: float) -> dict[str, Any]:
    """Fields of a detected hand that is a right one with some probability."""
    return {"side": "right" if right >= 0.5 else "left", "side_score": float(max(right, 1 - right))}


def choose_hand(
    hands: Sequence[DetectedHand], near: Box | None = None, side: Side | None = None
) -> tuple[DetectedHand, list[PerceptionWarning]]:
    """The hand that is meant.

    Args:
        near: box around the object, or around the hand [pixels].

    Returns:
        The hand of that side, if there is one, nearest to the box; without a box, the one largest in the
        image. And warnings of the choice.

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
    """The hands by the area of their boxes in the image, largest first."""
    return sorted(hands, key=lambda hand: -float(np.prod(hand.box[2:] - hand.box[:2])))


def _distance_to_box(hand: DetectedHand, box: Box) -> float:
    beyond = np.maximum(np.maximum(np.array(box[:2]) - hand.pixels, hand.pixels - np.array(box[2:])), 0)
    return float(np.linalg.norm(beyond, axis=1).mean())


def settle_side(hand: DetectedHand, side: Side | None = None) -> tuple[DetectedHand, list[PerceptionWarning]]:
    """The hand with the side that it has.

    The landmark model tells the side from the picture, and is at times wrong about a hand behind an object.
    The same landmarks in 3D, taken for a hand of the other side, bend their fingers backwards.

    Returns:
        The hand, and a warning if the side was uncertain.
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


# Least and largest extent of a hand's landmarks in the image, in hand lengths. Of 170 rendered hands, most of
# them bent about an object, all were between 0.46 and 1.03.
EXTENTS = (0.4, 1.2)


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


def clear(hand: DetectedHand, lengths: np.ndarray | None) -> bool:
    """Whether a hand has enough pixels to be seen clearly.

    lengths: as in ``length_at``; where depth is not known, the hand's own scale counts.
    """
    return length_at(hand.pixels, lengths, otherwise=hand.length) >= CLEAR_LENGTH


MOST = 2  # So many hands of an image are looked at more closely.
# A hand with no joint so near to the object's surface [m] does not hold it: joints of a finger that touches
# are 6 to 11 mm from it, and estimated to 10 to 30 mm.
HOLDING = 0.05


@dataclass(frozen=True, eq=False)
class HandHypothesis:
    """A hand that may be the one that holds the object."""

    detected: DetectedHand
    """With the side that it has."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """What was uncertain in the choice."""


def hand_hypotheses(
    capture: Capture,
    hands: Sequence[DetectedHand],
    near: Box | None,
    side: Side | None,
    detector: HandDetector,
) -> list[HandHypothesis]:
    """The hands that may hold the object: one, where the object's place says which or only one is there; else
    the two largest of the side.

    Args:
        near: box around the object [pixels], if its place is known.
        detector: found them; where there are none, it is asked for one of another size.

    Raises:
        FungraspError: there is no hand; the message says what may be the reason.
    """
    if not hands and (reason := _of_another_size(capture, near, detector)):
        raise FungraspError(f"no hand was found in the image; {reason}")
    if not hands:
        swapped = np.ascontiguousarray(capture.color[..., ::-1])
        if find_hands(detector, dataclasses.replace(capture, color=swapped), near):
            raise FungraspError(
                "no hand was found in the image, but is with red and blue swapped: was it written as BGR?"
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
    """What may be the reason that no hand is found, in words; empty if nothing is known."""
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
    """What looks like a hand, but is not as large as one by the depth measured there; empty if nothing is."""
    lengths = hand_lengths(capture.depth, capture.intrinsics.fx)
    for hand in detector.detect(capture.color, near):
        length = length_at(hand.pixels, lengths, otherwise=hand.extent)
        if not possible(hand, length):
            u, v = hand.pixels.mean(axis=0)
            depth = HAND_LENGTH * capture.intrinsics.fx / length
            return (
                f"what looks like one at pixel {u:.0f}, {v:.0f} is {hand.extent / length:.2g} times as long "
                f"as a hand is at {depth:.2g} m, the depth measured there ({EXTENTS[0]:g} to {EXTENTS[1]:g} "
                "are possible): are the depth's unit and the focal length right?"
            )
    return ""


def hands_elsewhere(
    capture: Capture, known: Sequence[DetectedHand], side: Side | None, detector: HandDetector
) -> list[HandHypothesis]:
    """More hands, where those known are painted over: detectors stop at a hand that is easy to see, which may
    be somebody else's. Empty if there are none. known: hands that were found and don't hold the object."""
    color, depth = capture.color.copy(), capture.depth.copy()
    ground = np.median(color.reshape(-1, 3), axis=0).astype(np.uint8)
    for hand in known:
        x0, y0, x1, y1 = np.clip(np.rint(hand.box), 0, None).astype(int)
        color[y0 : y1 + 1, x0 : x1 + 1], depth[y0 : y1 + 1, x0 : x1 + 1] = ground, 0.0
    found = find_hands(detector, CameraFrame(color, depth, capture.intrinsics, 0.0))
    # One that is found again beside its painted place is no other hand.
    others = [h for h in found if side in (None, h.side) and all(_apart(h, k) for k in known)]
    count = len(known) + len(others)
    return [_settled(hand, [_several(hand, count)], side) for hand in largest_first(others)[:MOST]]


def object_box(capture: Capture, model: ObjectModel | None, given: ObjectEstimate | None) -> Box | None:
    """The box around the object [pixels]: the one that was given, that of its mask or point, or that of the
    object in the pose that it is said to have; None if nothing was said."""
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
    """Whether the object's pose is rather right than wrong and the hand is at it.

    Args:
        hand: camera frame.
        obj: the object's pose, camera frame.
        vertices: of its mesh, object frame [m], shape [V, 3].
    """
    if not (obj.accepted or obj.score > 0.5):
        return False
    surface = transform_points(obj.pose_camera_object, vertices)
    # Large triangles have their vertices far from the hand: what counts is the box they span.
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

"""Which hands of an image may be the one that holds the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.objects import ObjectModel
from fungrasp.perception.hand.detected_hand import (
    EXTENTS,
    HAND_LENGTH,
    DetectedHand,
    HandDetector,
    choose_hand,
    find_hands,
    hand_lengths,
    largest_first,
    length_at,
    possible,
    settle_side,
)
from fungrasp.perception.io.capture import Box, CameraFrame, Capture
from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate, PerceptionWarning, Side

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
        if find_hands(detector, replace(capture, color=swapped), near):
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

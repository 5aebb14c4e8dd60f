"""A hand from another program's file: size and distance are measured in the depth image.

Seen by one camera a hand may be small and near or large and far: every point may move along its ray, all by
the same factor. Depth at the skin tells that factor wherever the hand is seen. Where it is hidden, or the
landmarks are beside it, depth is of something else: the factor that most of the hand agrees on counts. A hand
may well be behind what is seen, but nothing is seen through it.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded
from fungrasp.grasps.human_hand import HAND_SIZE_SPREAD, hand_size
from fungrasp.perception.adapters.hand_file import hands_of, read_fields, turn_to
from fungrasp.perception.hand.detected_hand import DetectedHand, choose_hand, object_box
from fungrasp.perception.hand.fit_problem import joint_confidence
from fungrasp.perception.hand.hand_capsules import SURFACE_SAMPLES, in_front
from fungrasp.perception.hand.hand_measurements import HandMeasurements
from fungrasp.perception.io.capture import Capture
from fungrasp.perception.io.estimates import HandEstimate, Side

# Depths so near to each other [m] agree: thickness of the hand, errors of shape and camera.
AGREEMENT = 0.012
SEEN_THROUGH = 0.03  # What is measured so far behind the skin [m] shows that no hand is there.
SAMPLE_WEIGHT = 0.5  # Weight of a surface sample that agrees [logarithm of likelihood]; neighbors err alike.
THROUGH_WEIGHT = 1.0  # Weight of a sample that is seen through, against the hand.
LEAST_AGREEING = 0.3  # Part of the visible hand that must agree on a depth for full trust.
LANDMARK_SPREAD = 0.03  # Standard deviation of a landmark across the ray, as a part of the hand's extent.
SHAPE_SPREAD = 0.007  # Standard deviation of a joint along the ray against the rest of the hand [m].
HIDDEN = 1.4  # Factor on these for a joint where nothing agrees.

_log = logging.getLogger(__name__)


@guarded("hand file")
def read_hand_estimate(
    path: str | Path, capture: Capture, *, side: Side | None = None, hand: int | None = None
) -> HandEstimate:
    """Read a hand that HaMeR, WiLoR or another program found in the capture's color image.

    The file is JSON or ``.npz`` with named arrays; docs/adapters.md says which. Size and distance of the hand
    are not taken from it but measured in the depth image (see ``place_hand``), unless it says ``metric``.

    Args:
        capture: the image that the program saw, with its depth.
        side: which hand is meant, if the file has several.
        hand: which one, counted from 0; by default the one nearest to the capture's mask, box or
            point, or the largest.

    Returns:
        Joints in the camera frame, with covariances; a left hand is not mirrored.

    Raises:
        FungraspError: the file can't be read, lacks something, is not of this image or has no hand of that
            side; there is no depth at the hand.
    """
    fields = read_fields(path)
    hands = hands_of(fields, capture.intrinsics)
    if hand is not None:
        if not 0 <= hand < len(hands):
            raise FungraspError(f"{path} has {len(hands)} hands, counted from 0; there is no hand {hand}")
        hands = [hands[hand]]
    if not hands:
        raise FungraspError(f"{path} has no hand")
    if side is not None and all(one.side != side for one in hands):
        raise FungraspError(f"{path} has no {side} hand, only {hands[0].side} ones")
    chosen, warnings = choose_hand(hands, object_box(capture, None, None), side)
    for one in warnings:
        _log.warning("%s: %s", path, one)
    return place_hand(chosen, capture, keep_size=fields.flag("metric", False))


def place_hand(detected: DetectedHand, capture: Capture, *, keep_size: bool = False) -> HandEstimate:
    """The hand in meters.

    Args:
        detected: landmarks and shape, as ``hands_of`` gives them.
        capture: the same image with depth; its mask, if there is one, says what is not the hand.
        keep_size: the shape's size is known to be right: depth is used only to judge it.

    Returns:
        Joints in the camera frame; a left hand is not mirrored. The score is the file's, times the part of
        the visible hand that is not seen through, lowered where hardly anything agrees on a depth, where
        another depth is about as likely, and where the hand's size is not one of people.

    Raises:
        FungraspError: there is no depth where the hand is, or its landmarks don't fit its shape.
    """
    points = _of_given_size(detected, capture)
    samples, _ = SURFACE_SAMPLES.place(points, np.zeros((21, 3, 0)))
    size = hand_size(points)
    radius = SURFACE_SAMPLES.radius * size
    visible = in_front(samples, radius)
    measured = _measured(detected, capture, samples)
    known = visible & (measured > 0)
    if not known.any():
        raise FungraspError(
            "there is no depth where the hand is in the image: is it too near or too far for the camera, "
            "or is the depth not aligned to the color?"
        )
    factors = measured[known] / (samples - radius[:, None] * [0, 0, 1])[known, 2]
    factor, certainty = _common_factor(factors, float(points[:, 2].mean()), size)
    if keep_size:
        factor, certainty = 1.0, 1.0
    joints = points * factor
    off = measured - factor * (samples[:, 2] - radius)
    agreeing = known & (np.abs(off) < AGREEMENT)
    covariance = _covariance(joints, _seen_joints(agreeing))
    trust = _trust(off[known], agreeing.sum() / known.sum(), size * factor)
    score = detected.score * certainty * trust
    return HandEstimate(
        joints, detected.pixels, joint_confidence(covariance), covariance, detected.side, score
    )


def _of_given_size(detected: DetectedHand, capture: Capture) -> np.ndarray:
    """Joints [m], shape [21, 3], camera frame, of the size that the shape has: where it best meets the rays
    of its landmarks."""
    slopes = capture.intrinsics.deproject(detected.pixels, np.ones(21))
    shape = turn_to(slopes.mean(axis=0)).apply(detected.shape_camera)
    # (x + tx) = u (z + tz), likewise for y: linear in the translation.
    u, v = slopes[:, 0], slopes[:, 1]
    one, zero = np.ones(21), np.zeros(21)
    rows = np.concatenate([np.stack([one, zero, -u], axis=1), np.stack([zero, one, -v], axis=1)])
    values = np.concatenate([u * shape[:, 2] - shape[:, 0], v * shape[:, 2] - shape[:, 1]])
    translation = np.linalg.lstsq(rows, values, rcond=None)[0]
    points = shape + translation
    if not (np.isfinite(points).all() and points[:, 2].min() > 0.02):
        raise FungraspError(
            "the hand's landmarks in the image don't fit its shape: no place before the camera does"
        )
    return points


def _measured(detected: DetectedHand, capture: Capture, samples: np.ndarray) -> np.ndarray:
    """Depth at the samples' pixels [m], 0 where there is none or the object is, shape [P]."""
    pixels = capture.intrinsics.project(samples)
    depth = np.where(capture.depth > 0, capture.depth, np.nan)
    if capture.mask is not None:
        depth = np.where(capture.mask, np.nan, depth)
    seen = HandMeasurements(
        detected.pixels, detected.shape_camera, np.zeros((20, 3)), depth, capture.intrinsics, detected.score
    )
    return seen.measured(pixels)


def _common_factor(factors: np.ndarray, distance: float, size: float) -> tuple[float, float]:
    """What most of the factors agree on, given that hands have a size; and how much more likely that is than
    the next best, 0.5 to 1."""
    logs = np.log(factors)
    # By row the factor that is tried, by column how much farther the others see something.
    beyond = logs - logs[:, None]
    unit = distance * float(np.median(factors))
    near = np.abs(beyond) < AGREEMENT / unit
    through = beyond > SEEN_THROUGH / unit
    evidence = SAMPLE_WEIGHT * near.sum(axis=1) - THROUGH_WEIGHT * through.sum(axis=1)
    evidence -= 0.5 * ((logs + np.log(size)) / HAND_SIZE_SPREAD) ** 2
    best = int(np.argmax(evidence))
    others = np.abs(beyond[best]) > SEEN_THROUGH / unit
    lead = evidence[best] - evidence[others].max(initial=-np.inf)
    return float(np.exp(logs[near[best]].mean())), float(1 / (1 + np.exp(-lead)))


def _seen_joints(agreeing: np.ndarray) -> np.ndarray:
    """Joints beside which depth agrees with the hand, bool, shape [21]. agreeing: by sample, shape [P]."""
    seen = np.zeros(21, dtype=bool)
    seen[SURFACE_SAMPLES.near[agreeing]] = True
    seen[SURFACE_SAMPLES.far[agreeing]] = True
    return seen


def _covariance(joints: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Covariances of the joints [m^2], shape [21, 3, 3]: of the landmarks across the rays, of the shape along
    them."""
    extent = float(np.linalg.norm(np.ptp(joints, axis=0)))
    rays = joints / np.linalg.norm(joints, axis=1, keepdims=True)
    along = rays[:, :, None] * rays[:, None]
    across = (LANDMARK_SPREAD * extent) ** 2
    covariance = across * np.eye(3) + (SHAPE_SPREAD**2 + AGREEMENT**2 / 4 - across) * along
    return covariance * np.where(seen, 1.0, HIDDEN**2)[:, None, None]


def _trust(off: np.ndarray, agreeing: float, size: float) -> float:
    """How well depth and anatomy bear a hand out, 0 to 1.

    Args:
        off: how far behind the skin depth is [m], shape [K].
        size: of the hand, as a part of an adult's.
    """
    through = float(np.mean(off > SEEN_THROUGH))
    unusual = max(abs(np.log(size)) - 2 * HAND_SIZE_SPREAD, 0.0) / HAND_SIZE_SPREAD
    return (1 - through) * min(1.0, agreeing / LEAST_AGREEING) * float(np.exp(-0.5 * unusual**2))

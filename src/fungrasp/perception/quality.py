"""How well a perceived grasp agrees with its image, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.signed_distance import SignedDistanceGrid
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate
from fungrasp.perception.hand.contact_evidence import HandSurroundings, link_gaps
from fungrasp.perception.hand.hand_capsules import SURFACE_SAMPLES, in_front
from fungrasp.perception.io.capture import Capture

NEAR = 0.03
"""What is seen farther than this from where the skin should be [m] is something else."""

STEP = 2
"""Every so many rows and columns are looked at for the object."""

FARTHEST = 0.5
"""The object has no point farther from its origin [m]."""

OBJECT_NEAR = 0.015
"""What is seen farther than this from where the object's surface should be [m] is something else."""

OBJECT = 0.004
"""What is seen so near to the object's surface [m] is the object."""


@dataclass(frozen=True)
class PerceptionQuality:
    """Figures of one perceived grasp."""

    reprojection_px: float
    """Median distance between the landmarks seen and the hand's joints projected into the image [pixels]."""
    depth_residual_m: float
    """Median distance of the object's measured points from its mesh [m]; NaN if not known."""
    hand_residual_m: float
    """Median distance between the depth measured at the hand and its skin [m]; NaN where none is seen."""
    penetration_m: float
    """How deep the hand is in the object at the deepest [m]; soft pads that press give a few mm."""
    hand_score: float
    """Confidence that the hand is right, 0 to 1."""
    object_score: float
    """Confidence that the object's pose is right, 0 to 1."""


def measure_quality(
    capture: Capture, hand: HandEstimate, thing: ObjectEstimate, surface: SignedDistanceGrid
) -> PerceptionQuality:
    """The figures.

    Args:
        capture: the image.
        hand: as it was refined.
        thing: the object.
        surface: of the object, object's frame.
    """
    pose = thing.pose_camera_object
    off = np.linalg.norm(capture.intrinsics.project(hand.joints_camera) - hand.pixels, axis=1)
    surroundings = HandSurroundings(surface, pose)
    residual = thing.residual_m
    if not np.isfinite(residual):
        residual = _object_residual(capture, pose, surroundings)
    return PerceptionQuality(
        reprojection_px=float(np.nanmedian(off)),
        depth_residual_m=residual,
        hand_residual_m=_hand_residual(capture, hand.joints_camera, surroundings),
        penetration_m=max(0.0, -float(link_gaps(hand.joints_camera, surface, pose).min())),
        hand_score=hand.score,
        object_score=thing.score,
    )


def _object_residual(capture: Capture, pose: np.ndarray, surroundings: HandSurroundings) -> float:
    """Median distance from the surface of what is seen near to it [m]; NaN if there is nothing."""
    points = capture.points()[::STEP, ::STEP].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])]
    points = points[np.linalg.norm(points - pose[:3], axis=1) < FARTHEST]
    if not len(points):
        return float("nan")
    distance = np.abs(surroundings.object_distance(points)[0])
    near = distance < OBJECT_NEAR
    return float(np.median(distance[near])) if near.any() else float("nan")


def _hand_residual(capture: Capture, joints: np.ndarray, surroundings: HandSurroundings) -> float:
    """Median distance of the skin from what is seen at its pixels [m]; NaN if there is nothing."""
    points, _ = SURFACE_SAMPLES.place(joints, np.zeros((21, 3, 1)))
    pixels = np.rint(np.nan_to_num(capture.intrinsics.project(points), nan=-1.0)).astype(int)
    k = capture.intrinsics
    inside = np.all((pixels >= 0) & (pixels < [k.width, k.height]), axis=1)
    measured = np.zeros(len(points))
    measured[inside] = capture.depth[pixels[inside, 1], pixels[inside, 0]]
    seen = (measured > 0) & in_front(points, SURFACE_SAMPLES.radius)
    off = np.abs(points[:, 2] - SURFACE_SAMPLES.radius - measured)
    distance = surroundings.object_distance(k.deproject(pixels, measured))[0]
    seen &= (off < NEAR) & (distance > OBJECT)
    return float(np.median(off[seen])) if seen.any() else float("nan")

"""A metric hand from its landmarks and the depth image: an anatomical skeleton by robust least squares.

Landmarks say where joints are in the image; depth, how far the skin in front of them is and where no hand can
be; the landmark model's own 3D shape, roughly how bones point; anatomy, what lengths and angles are possible;
the object, once its pose is known, what fingers touch. Depth is trusted only where it agrees with the rest: a
joint behind the object is seen too near, one beside its landmark too far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.perception.estimates import HandEstimate
from fungrasp.perception.hand.detection import DetectedHand
from fungrasp.perception.hand.evidence import (
    Evidence,
    anatomy_evidence,
    depth_evidence,
    pixel_evidence,
    project,
    shape_evidence,
    silhouette_evidence,
)
from fungrasp.perception.hand.gauss_newton import damped_step, normal_equations, robust_weights
from fungrasp.perception.hand.initial_skeleton import (
    HandMeasurements,
    joint_confidence,
    joint_covariance,
    mirror_estimate,
    start,
)
from fungrasp.perception.hand.measurement_weights import SeenSettings
from fungrasp.perception.hand.object_contact import Surroundings, contact_evidence
from fungrasp.perception.hand.silhouette import Silhouettes
from fungrasp.perception.hand.skeleton import SIZE, Skeleton
from fungrasp.perception.hand.surface_samples import PROBES
from fungrasp.perception.io.capture import Capture


@dataclass(frozen=True)
class HandFitSettings(SeenSettings):
    """What the measurements are worth, stage by stage."""

    outlier_depths: tuple[tuple[float, float], ...] = ((0.06, 0.06), (0.02, 0.04), (0.008, 0.03))
    """How far in front of the skin something else is seen, and how far behind [m], one stage after the
    other."""
    held_outlier_depths: tuple[tuple[float, float], ...] = ((0.02, 0.03),)
    """The same in the stages after those, if the object is known: what it hides is left out."""
    iterations: int = 5
    """Of every stage."""


def fit_hand(
    detected: DetectedHand,
    capture: Capture,
    around: Surroundings | None = None,
    settings: HandFitSettings | None = None,
) -> HandEstimate:
    """The hand in metres.

    Args:
        detected: landmarks in the colour image.
        capture: the same image with depth.
        around: object and table, if their poses are known: fingers near them touch, nothing is inside.
        settings: what the measurements are worth.

    Returns:
        Joints in the camera frame; a left hand is not mirrored.

    Raises:
        FungraspError: there is no depth where the hand is.
    """
    problem = _Problem(HandMeasurements.of(detected, capture), settings or HandFitSettings())
    hand, turn = start(problem.seen), np.zeros(3)
    if around is not None and detected.side == "left":
        around = around.mirrored()
    stages = [(outlier, None) for outlier in problem.settings.outlier_depths]
    if around is not None:
        stages += [(outlier, around) for outlier in problem.settings.held_outlier_depths]
    for outlier, touched in stages:
        problem.look(hand)
        for _ in range(problem.settings.iterations):
            evidence = problem.evidence(hand, turn, outlier, touched)
            step = damped_step(*normal_equations(evidence, SIZE + 3))
            hand, turn = hand.moved(step[:SIZE]), turn + step[SIZE:]
    right = problem.estimate(hand, turn, around)
    return right if detected.side == "right" else mirror_estimate(right, detected.pixels)


def agreement(landmarks: Evidence, depth: Evidence) -> float:
    """How well the image agrees with a fitted hand, 0 to 1.

    The mean weight of the landmarks, times the part of the hand's visible flesh that is not seen through; 0
    where no depth is measured at any of it.
    """
    if not len(depth.residual):
        return 0.0
    through = np.mean(depth.residual < -np.asarray(depth.outlier))
    return float(robust_weights(landmarks).mean() * (1.0 - through))


class _Problem:
    """The measurements of one right hand, and what they say about a skeleton."""

    def __init__(self, seen: HandMeasurements, settings: HandFitSettings):
        self.seen, self.settings = seen, settings
        self.landmark_spread = seen.landmark_spread(settings.landmark_spread, settings.least_landmark_spread)

    def look(self, hand: Skeleton) -> None:
        """See where the background is, for a hand about there."""
        points, slopes = PROBES.place(*hand.joints_and_derivatives())
        pixels, _ = project(points, slopes, self.seen.intrinsics)
        settings = self.settings
        self._silhouettes = Silhouettes.around(
            self.seen.depth, pixels, points[:, 2], settings.background_levels, settings.background
        )

    def evidence(
        self,
        hand: Skeleton,
        turn: np.ndarray,
        outlier: tuple[float, float],
        around: Surroundings | None,
    ) -> list[Evidence]:
        """Landmarks, depth, then everything else known about the parameters of the hand and the turn of the
        landmark model's shape."""
        settings, intrinsics = self.settings, self.seen.intrinsics
        joints, jacobian = hand.joints_and_derivatives()
        points, slopes = PROBES.place(joints, jacobian)
        pixels, pixel_slopes = project(points, slopes, intrinsics)
        radius = PROBES.radius * np.exp(hand.size)
        thickness = settings.silhouette_inset * radius * intrinsics.fx / points[:, 2]
        measured = self.seen.measured(pixels)
        if around is not None:
            seen = intrinsics.deproject(pixels, measured)
            measured = np.where(around.object_distance(seen)[0] < settings.object_depth, 0.0, measured)
        directions = Rotation.from_rotvec(turn).apply(self.seen.directions)
        turn_prior = np.hstack([np.zeros((3, SIZE)), np.eye(3)]) / settings.shape_turn_spread
        found = [
            pixel_evidence(joints, jacobian, intrinsics, self.seen.pixels, self.landmark_spread),
            depth_evidence(points, slopes, radius, measured, settings.depth_spread, outlier),
            silhouette_evidence(
                self._silhouettes,
                pixels,
                pixel_slopes,
                points[:, 2],
                thickness,
                settings.silhouette_spread,
                settings.silhouette_outlier,
            ),
            shape_evidence(joints, jacobian, directions, settings.shape_spread),
            Evidence(turn / settings.shape_turn_spread, turn_prior),
            *anatomy_evidence(hand),
        ]
        if around is not None:
            found += contact_evidence(hand, joints, jacobian, around, settings.contact)
        return found

    def estimate(self, hand: Skeleton, turn: np.ndarray, around: Surroundings | None) -> HandEstimate:
        joints, jacobian = hand.joints_and_derivatives()
        evidence = self.evidence(hand, turn, self.settings.outlier_depths[-1], around)
        matrix, _ = normal_equations(evidence, SIZE + 3)
        covariance = joint_covariance(matrix, jacobian)
        return HandEstimate(
            joints,
            self.seen.pixels,
            joint_confidence(covariance),
            covariance,
            "right",
            self.seen.score * agreement(*evidence[:2]),
        )

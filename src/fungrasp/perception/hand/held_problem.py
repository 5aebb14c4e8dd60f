"""What the image, anatomy, the object and the table say about one guess of the hand that holds the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.perception.estimates import HandEstimate
from fungrasp.perception.hand.evidence import (
    Evidence,
    anatomy_evidence,
    depth_evidence,
    front_evidence,
    pixel_evidence,
    project,
    shape_evidence,
    silhouette_evidence,
)
from fungrasp.perception.hand.finger_overlap import overlap_evidence
from fungrasp.perception.hand.gauss_newton import damped_step, normal_equations, robust_weights
from fungrasp.perception.hand.hand_capsules import explained_part, flesh_evidence
from fungrasp.perception.hand.hand_pixels import HandView
from fungrasp.perception.hand.initial_skeleton import HandMeasurements, joint_confidence, joint_covariance
from fungrasp.perception.hand.measurement_weights import SeenSettings
from fungrasp.perception.hand.object_contact import contact_evidence
from fungrasp.perception.hand.silhouette import Silhouettes
from fungrasp.perception.hand.skeleton import SIZE, Skeleton
from fungrasp.perception.hand.surface_samples import PROBES


@dataclass(frozen=True)
class HeldSettings(SeenSettings):
    """What the measurements are worth once the object is known."""

    late_landmarks: float = 0.35
    """What a landmark's residual still counts when the fingers have been searched, and in the judgement."""
    hidden: float = 0.03
    """A joint so far behind what is seen there [m] is hidden."""
    hidden_landmarks: float = 0.5
    """What the residual of a hidden joint's landmark still counts when the fingers have been searched."""
    background_levels: int = 2
    """How many depths of the hand's parts are told apart for that."""
    point_spread: tuple[float, float, float] = (0.004, 0.008, 0.025)
    """Standard deviation of a measured point's distance from the skin [m]: of fingers, palm and arm."""
    points_worth: float = 85.0
    """All measured points count as so many: neighbours err alike."""
    front_spread: float = 0.016
    """Standard deviation of how far skin may be in front of what is seen there [m]."""
    front_outlier: float = 0.05
    """Skin farther in front [m] is likelier a fault of the depth."""
    front_slack: float = 0.004
    """Skin so little in front [m] is not."""
    overlap_spread: float = 0.002
    """Standard deviation of how deep fingers are in each other [m]."""
    judged: tuple[tuple[float, float], float] = ((0.02, 0.03), 0.02)
    """How far in front of and behind the skin something else is seen, and how far from it is no point of the
    hand [m], when guesses are compared."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters."""

    hand: Skeleton
    turn: np.ndarray
    """Of the landmark model's shape as a whole [rad], shape [3]."""


class HeldProblem:
    """One guess of a right hand, and what is seen of it."""

    def __init__(self, seen: HandMeasurements, view: HandView, settings: HeldSettings):
        self.seen, self.view, self.settings = seen, view, settings
        self._landmark_spread = seen.landmark_spread(settings.landmark_spread, settings.least_landmark_spread)

    def look(self, hand: Skeleton) -> None:
        """See where the background is, for a hand about there."""
        points, slopes = PROBES.place(*hand.joints_and_derivatives())
        pixels, _ = project(points, slopes, self.seen.intrinsics)
        settings = self.settings
        self._silhouettes = Silhouettes.around(
            self.view.depth, pixels, points[:, 2], settings.background_levels, settings.background
        )
        joints = hand.joints()
        seen = self.view.depth_at(self.seen.intrinsics.project(joints))
        self._hidden = joints[:, 2] - seen > settings.hidden

    def solve(
        self, fit: Fit, outlier: tuple[float, float], far: float, iterations: int, *, contact: bool
    ) -> Fit:
        """Improve a fit.

        Args:
            fit: where to begin.
            outlier: how far in front of the skin something else is seen, and how far behind [m].
            far: how far from the skin a measured point is none of the hand's [m].
            iterations: Gauss-Newton steps.
            contact: whether object and table are known to be right for this hand: the late stages.
        """
        for _ in range(iterations):
            evidence = self.evidence(fit, outlier, far, contact=contact, late=contact)
            step = damped_step(*normal_equations(evidence, SIZE + 3))
            fit = Fit(fit.hand.moved(step[:SIZE]), fit.turn + step[SIZE:])
        return fit

    def cost(self, fit: Fit, *, contact: bool = True) -> float:
        """What speaks against a fit: all residuals, limited by their outliers' bounds, squared."""
        evidence = self.evidence(fit, *self.settings.judged, contact=contact, late=True)
        return float(sum(_loss(block) for block in evidence))

    def evidence(
        self, fit: Fit, outlier: tuple[float, float], far: float, *, contact: bool, late: bool
    ) -> list[Evidence]:
        """Landmarks, depth, measured points, then everything else known about the parameters."""
        settings, lens, hand = self.settings, self.seen.intrinsics, fit.hand
        joints, jacobian = hand.joints_and_derivatives()
        points, slopes = PROBES.place(joints, jacobian)
        pixels, pixel_slopes = project(points, slopes, lens)
        radius = PROBES.radius * np.exp(hand.size)
        thickness = settings.silhouette_inset * radius * lens.fx / points[:, 2]
        measured = self.seen.measured(pixels)
        thing = self.view.around.object_distance(lens.deproject(pixels, measured))[0] < settings.object_depth
        directions = Rotation.from_rotvec(fit.turn).apply(self.seen.directions)
        turn_prior = np.hstack([np.zeros((3, SIZE)), np.eye(3)]) / settings.shape_turn_spread
        worth = settings.late_landmarks if late else 1.0
        landmark_spread = np.full(len(joints), self._landmark_spread)
        if late and self.seen.spread is None:
            landmark_spread /= worth * np.where(self._hidden, settings.hidden_landmarks, 1.0)
        many = np.sqrt(settings.points_worth / max(len(self.view.points), 1))
        spread = tuple(width / many for width in settings.point_spread)
        found = [
            pixel_evidence(joints, jacobian, lens, self.seen.pixels, landmark_spread),
            depth_evidence(
                points, slopes, radius, np.where(thing, 0.0, measured), settings.depth_spread, outlier
            ),
            flesh_evidence(hand, joints, jacobian, self.view.points, spread, far),
            front_evidence(
                points,
                slopes,
                radius + settings.front_slack,
                measured,
                settings.front_spread,
                settings.front_outlier,
            ),
            silhouette_evidence(
                self._silhouettes,
                pixels,
                pixel_slopes,
                points[:, 2],
                thickness,
                settings.silhouette_spread,
                settings.silhouette_outlier,
            ),
            shape_evidence(joints, jacobian, directions, settings.shape_spread / worth),
            Evidence(fit.turn / settings.shape_turn_spread, turn_prior),
            overlap_evidence(hand, joints, jacobian, settings.overlap_spread),
            *anatomy_evidence(hand),
        ]
        if contact:
            found += contact_evidence(hand, joints, jacobian, self.view.around, settings.contact)
        return found

    def estimate(self, fit: Fit) -> HandEstimate:
        """Joints with their covariances, and how well all that is seen agrees."""
        joints, jacobian = fit.hand.joints_and_derivatives()
        evidence = self.evidence(fit, *self.settings.judged, contact=True, late=True)
        matrix, _ = normal_equations(evidence, SIZE + 3)
        covariance = joint_covariance(matrix, jacobian)
        return HandEstimate(
            joints,
            self.seen.pixels,
            joint_confidence(covariance),
            covariance,
            "right",
            self.seen.score * self._agreement(fit, evidence),
        )

    def _agreement(self, fit: Fit, evidence: list[Evidence]) -> float:
        """How well the image agrees with a fitted hand, 0 to 1."""
        landmarks, depth = evidence[:2]
        if not len(depth.residual):
            return 0.0
        through = np.mean(depth.residual < -np.asarray(depth.outlier))
        explained = explained_part(fit.hand, self.view.points)
        return float(robust_weights(landmarks).mean() * (1.0 - through) * explained)


def _loss(block: Evidence) -> float:
    square = (block.residual**2).reshape(-1, block.group).sum(axis=1)
    return float(np.sum(square / (1.0 + square / np.square(block.outlier))))

"""The least-squares problem of a hand, for any evidence: image, object, joints of another estimator.

Unknowns are the parameters of a right hand's ``Skeleton`` and, with an image, a rotation of the shape that
the landmark model guesses. Each kind of evidence adds blocks of residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import gammainc

from fungrasp.perception.hand.hand_capsules import SURFACE_SAMPLES, explained_part
from fungrasp.perception.hand.hand_measurements import HandMeasurements, HandView
from fungrasp.perception.hand.image_evidence import (
    Silhouettes,
    depth_evidence,
    direction_evidence,
    front_evidence,
    landmark_evidence,
    point_evidence,
    project,
    silhouette_evidence,
)
from fungrasp.perception.hand.physical_evidence import (
    HandSurroundings,
    anatomy_evidence,
    contact_evidence,
    overlap_evidence,
)
from fungrasp.perception.hand.skeleton import (
    SIZE,
    HandEvidence,
    Skeleton,
    damped_step,
    normal_equations,
    robust_cost,
    robust_weights,
)
from fungrasp.perception.io.estimates import HandEstimate

TRUSTED_ERROR = 0.015  # Error of a joint [m]; its confidence is the probability of a smaller error.
# Factor from the covariance of least squares to that of the errors, as errors of neighboring measurements are
# correlated. Measured on rendered scenes with known truth.
COVARIANCE_FACTOR = 1.3


LANDMARK_SPREAD = 0.03  # Standard deviation of a landmark, as a fraction of the hand's extent in the image.
LEAST_LANDMARK_SPREAD = 2.0  # Smallest standard deviation of a landmark [pixels].
LATE_LANDMARKS = 0.35  # Factor on a landmark's residual after the search of fingers, and in the cost.
HIDDEN_BEHIND = 0.03  # Distance behind the measured depth beyond which a joint is hidden [m].
HIDDEN_LANDMARKS = 0.5  # Further factor on the residual of a hidden joint's landmark.
OBJECT_DEPTH = 0.004  # Distance from the object's surface within which measurements show the object [m].
BACKGROUND_LEVELS = 3  # Depth levels into which parts of the hand are sorted to find their background.
HELD_BACKGROUND_LEVELS = 2  # Depth levels if the object is known.
DIRECTION_SPREAD = 0.35  # Standard deviation of the landmark model's bone directions [rad].
TURN_SPREAD = 0.25  # Standard deviation of a rotation of all bone directions together [rad].


@dataclass(frozen=True)
class HandFitStage:
    """Settings of one stage of a fit."""

    depth_outlier: tuple[float, float] = (0.06, 0.06)
    """Distances in front of and behind the skin beyond which depth shows something else [m]."""
    point_outlier: float = 0.05
    """Distance from the skin beyond which a measured point does not show the hand [m]."""
    contact: bool = False
    """Whether contacts with object and table are used."""
    late: bool = False
    """Whether the fingers have been searched: landmarks, especially of hidden joints, then weigh less."""


@dataclass(frozen=True, eq=False)
class HandParameters:
    """Unknowns of the problem."""

    skeleton: Skeleton
    """Position, size, proportions and joint angles of the hand, camera frame."""
    turn: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Rotation vector of the landmark model's shape as a whole [rad], shape [3]."""


class HandFitProblem:
    """Evidence about a right hand, and its residuals for given parameters."""

    def __init__(
        self,
        *,
        seen: HandMeasurements | None = None,
        view: HandView | None = None,
        estimate: HandEstimate | None = None,
        surroundings: HandSurroundings | None = None,
    ):
        """
        Args:
            seen: measurements in the image, if there is one.
            view: view of a hand that holds a known object; needs ``seen``.
            estimate: joints with covariances from another estimator.
            surroundings: known object and table; those of ``view`` by default.
        """
        self.seen, self.view = seen, view
        self.surroundings = view.surroundings if view is not None else surroundings
        self.size = SIZE if seen is None else SIZE + 3
        if seen is not None:
            self._landmark_spread = seen.landmark_spread(LANDMARK_SPREAD, LEAST_LANDMARK_SPREAD)
        if estimate is not None:
            # W with W^T W the inverse covariance, shape [21, 3, 3].
            self._whitening = np.linalg.cholesky(np.linalg.inv(estimate.covariance)).transpose(0, 2, 1)
        self._estimate = estimate

    def find_background(self, skeleton: Skeleton) -> None:
        """Find background and hidden joints around an approximate hand."""
        assert self.seen is not None
        lens = self.seen.intrinsics
        points, slopes = SURFACE_SAMPLES.place(*skeleton.joints_and_derivatives())
        pixels, _ = project(points, slopes, lens)
        levels = BACKGROUND_LEVELS if self.view is None else HELD_BACKGROUND_LEVELS
        self._silhouettes = Silhouettes.around(self.seen.depth, pixels, points[:, 2], levels)
        if self.view is not None:
            joints = skeleton.joints()
            self._hidden = joints[:, 2] - self.view.depth_at(lens.project(joints)) > HIDDEN_BEHIND

    def solve(self, start: HandParameters, stage: HandFitStage, iterations: int) -> HandParameters:
        """Take Gauss-Newton steps from a start."""
        now = start
        for _ in range(iterations):
            evidence = self.evidence(now, stage)
            step = damped_step(*normal_equations(evidence, self.size))
            turn = now.turn + step[SIZE:] if self.size > SIZE else now.turn
            now = HandParameters(now.skeleton.moved(step[:SIZE]), turn)
        return now

    def cost(self, parameters: HandParameters, stage: HandFitStage) -> float:
        """Return the sum of squared residuals, each limited by its outlier bound."""
        return robust_cost(self.evidence(parameters, stage))

    def evidence(self, parameters: HandParameters, stage: HandFitStage) -> list[HandEvidence]:
        """Return all evidence: given joints, image (landmarks and depth first), anatomy, contact."""
        hand = parameters.skeleton
        joints, jacobian = hand.joints_and_derivatives()
        found = []
        if self._estimate is not None:
            found.append(_joint_evidence(self._estimate, self._whitening, joints, jacobian))
        if self.seen is not None:
            found += self._image_evidence(self.seen, parameters, joints, jacobian, stage)
        if self.view is not None:
            found.append(overlap_evidence(hand, joints, jacobian))
        found += anatomy_evidence(hand)
        if self.surroundings is not None and stage.contact:
            found += contact_evidence(hand, joints, jacobian, self.surroundings)
        return found

    def _image_evidence(
        self,
        seen: HandMeasurements,
        parameters: HandParameters,
        joints: np.ndarray,
        jacobian: np.ndarray,
        stage: HandFitStage,
    ) -> list[HandEvidence]:
        """Return the evidence of the image, landmarks and depth first."""
        lens, hand = seen.intrinsics, parameters.skeleton
        points, slopes = SURFACE_SAMPLES.place(joints, jacobian)
        pixels, pixel_slopes = project(points, slopes, lens)
        radius = SURFACE_SAMPLES.radius * np.exp(hand.size)
        measured = of_hand = seen.measured(pixels)
        weight = LATE_LANDMARKS if stage.late else 1.0
        landmark_spread = np.full(len(joints), self._landmark_spread)
        if stage.late and seen.spread is None:
            landmark_spread /= weight * np.where(self._hidden, HIDDEN_LANDMARKS, 1.0)
        shown = []
        if self.view is not None:
            distance = self.view.surroundings.object_distance(lens.deproject(pixels, measured))[0]
            of_hand = np.where(distance < OBJECT_DEPTH, 0.0, measured)
            shown = [
                point_evidence(hand, joints, jacobian, self.view.points, stage.point_outlier),
                front_evidence(points, slopes, radius, measured),
            ]
        bend = DIRECTION_SPREAD if seen.direction_spread is None else seen.direction_spread
        directions = Rotation.from_rotvec(parameters.turn).apply(seen.directions)
        turn_columns = np.hstack([np.zeros((3, SIZE)), np.eye(3)]) / TURN_SPREAD
        return [
            landmark_evidence(joints, jacobian, lens, seen.pixels, landmark_spread),
            depth_evidence(points, slopes, radius, of_hand, stage.depth_outlier),
            *shown,
            silhouette_evidence(
                self._silhouettes, pixels, pixel_slopes, points[:, 2], radius * lens.fx / points[:, 2]
            ),
            direction_evidence(joints, jacobian, directions, bend / weight),
            HandEvidence(parameters.turn / TURN_SPREAD, turn_columns),
        ]

    def joints(
        self, parameters: HandParameters, evidence: list[HandEvidence]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return joints [m], shape [21, 3], and their covariances [m^2], shape [21, 3, 3]. evidence: at these
        parameters."""
        joints, jacobian = parameters.skeleton.joints_and_derivatives()
        matrix, _ = normal_equations(evidence, self.size)
        # Inverting before selecting the skeleton's part accounts for the uncertain rotation.
        inverse = np.linalg.inv(matrix)[:SIZE, :SIZE]
        return joints, COVARIANCE_FACTOR * jacobian @ inverse @ jacobian.transpose(0, 2, 1)

    def agreement(self, parameters: HandParameters, evidence: list[HandEvidence]) -> float:
        """Return how well the image agrees with a fitted hand, 0 to 1: ``image_agreement``, times the
        fraction of known points that the hand explains. evidence: at these parameters."""
        landmarks, depth = evidence[:2]
        agreement = image_agreement(landmarks, depth)
        if self.view is None:
            return agreement
        return agreement * explained_part(parameters.skeleton, self.view.points)


def _joint_evidence(
    estimate: HandEstimate, whitening: np.ndarray, joints: np.ndarray, jacobian: np.ndarray
) -> HandEvidence:
    """Return residuals between the joints and those of another estimator."""
    # Whitened by each joint's covariance: unit variance, shape [21, 3].
    off = np.einsum("jab,jb->ja", whitening, joints - estimate.joints_camera)
    columns = (whitening @ jacobian).reshape(off.size, -1)
    return HandEvidence(off.ravel(), columns, outlier=6.0, group=3)


def image_agreement(landmarks: HandEvidence, depth: HandEvidence) -> float:
    """Return the mean weight of the landmarks, times the fraction of the hand's visible surface that no depth
    passes through; 0 without measured depth."""
    if not len(depth.residual):
        return 0.0
    through = np.mean(depth.residual < -np.asarray(depth.outlier))
    return float(robust_weights(landmarks).mean() * (1.0 - through))


def joint_confidence(covariance: np.ndarray) -> np.ndarray:
    """Return the probability that a joint's error is below ``TRUSTED_ERROR``, shape [21]. covariance: [m^2],
    shape [21, 3, 3]."""
    variance = np.trace(covariance, axis1=1, axis2=2) / 3
    return gammainc(1.5, TRUSTED_ERROR**2 / (2 * variance))

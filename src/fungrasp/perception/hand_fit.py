"""A metric hand from its landmarks and the depth image: an anatomical skeleton by robust least squares.

Landmarks say where joints are in the image, depth how far the skin in front of them is, the landmark
model's own 3D shape roughly how bones point, anatomy what lengths and angles are possible. Depth is trusted only where
it agrees with the rest: a joint behind the object or another finger is seen too near, one beside its landmark
too far.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import gammainc

from fungrasp.errors import FungraspError
from fungrasp.perception.capture import Capture, Intrinsics
from fungrasp.perception.estimates import HandEstimate
from fungrasp.perception.hand_evidence import (
    FAR_BONES,
    NEAR_BONES,
    PROBES,
    Evidence,
    anatomy_evidence,
    depth_evidence,
    pixel_evidence,
    project,
    shape_evidence,
    turn_derivatives,
)
from fungrasp.perception.hand_landmarks import DetectedHand
from fungrasp.perception.hand_skeleton import BASES, RADII, SIZE, WRIST_RADIUS, Skeleton
from fungrasp.perception.hand_solver import damped_step, normal_equations, robust_weights

TRUSTED_ERROR = 0.015
"""A joint's confidence is the probability that its error is smaller than this [m]."""


@dataclass(frozen=True)
class HandFitSettings:
    """What the measurements are worth."""

    landmark_spread: float = 0.03
    """Standard deviation of a landmark, as a part of the hand's extent in the image."""
    least_landmark_spread: float = 2.0
    """[pixels]"""
    depth_spread: float = 0.008
    """Standard deviation of depth at a point of the flesh [m]: camera, thickness, and that neighbours err
    alike."""
    outlier_depths: tuple[tuple[float, float], ...] = (
        (0.06, 0.06),
        (0.03, 0.05),
        (0.02, 0.04),
        (0.012, 0.03),
    )
    """How far in front of the skin something else is seen, and how far behind [m], one stage after the
    other."""
    iterations: int = 5
    """Of every stage."""
    shape_spread: float = 0.35
    """Standard deviation of the landmark model's bone directions [rad]."""
    shape_turn_spread: float = 0.25
    """Standard deviation of its turn as a whole [rad]."""


def fit_hand(
    detected: DetectedHand, capture: Capture, settings: HandFitSettings | None = None
) -> HandEstimate:
    """The hand in metres.

    Args:
        detected: landmarks in the colour image.
        capture: the same image with depth.
        settings: by default those the figures in the documentation were measured with.

    Returns:
        Joints in the camera frame; a left hand is not mirrored.

    Raises:
        FungraspError: there is no depth where the hand is.
    """
    settings = settings or HandFitSettings()
    if detected.side == "left":
        mirrored = fit_hand(
            _mirror_detected(detected, capture.intrinsics), _mirror_capture(capture), settings
        )
        return mirror_estimate(mirrored, detected.pixels)
    problem = _Problem(detected, capture, settings)
    hand = problem.start()
    turn = np.zeros(3)
    for outlier in settings.outlier_depths:
        for _ in range(settings.iterations):
            matrix, gradient = normal_equations(problem.evidence(hand, turn, outlier), SIZE + 3)
            step = limit_step(damped_step(matrix, gradient, 1e-3))
            hand, turn = hand.moved(step[:SIZE]), turn + step[SIZE:]
    return problem.estimate(hand, turn)


def limit_step(step: np.ndarray) -> np.ndarray:
    """A step shortened where it would leave what the derivatives know about: 5 cm, about 30 degrees."""
    largest = max(
        np.abs(step[:3]).max() / 0.05, np.abs(step[3:6]).max() / 0.5, np.abs(step[37:82]).max() / 0.5
    )
    return step / max(1.0, largest)


def joint_confidence(covariance: np.ndarray) -> np.ndarray:
    """Probability that a joint's error is below ``TRUSTED_ERROR``. covariance: [m^2], shape [21, 3, 3]."""
    variance = np.trace(covariance, axis1=1, axis2=2) / 3
    return gammainc(1.5, TRUSTED_ERROR**2 / (2 * variance))


def mirror_estimate(hand: HandEstimate, pixels: np.ndarray) -> HandEstimate:
    """The hand seen in a mirror that swaps left and right of the image. pixels: where its joints are seen."""
    flip = np.array([-1.0, 1.0, 1.0])
    return dataclasses.replace(
        hand,
        joints_camera=hand.joints_camera * flip,
        covariance=hand.covariance * flip[:, None] * flip,
        pixels=pixels,
        side="left" if hand.side == "right" else "right",
    )


class _Problem:
    """The measurements of one right hand."""

    def __init__(self, detected: DetectedHand, capture: Capture, settings: HandFitSettings):
        self.detected, self.settings = detected, settings
        self.intrinsics = capture.intrinsics
        self.depth = np.where(capture.depth > 0, capture.depth, np.nan)
        extent = float(np.linalg.norm(np.ptp(detected.pixels, axis=0)))
        self.landmark_spread = max(settings.least_landmark_spread, settings.landmark_spread * extent)
        # The models see the hand as if it were in the middle of the image.
        toward = self.intrinsics.deproject(detected.pixels.mean(axis=0), np.ones(()))
        axis = np.cross([0.0, 0.0, 1.0], toward / np.linalg.norm(toward))
        self.shape = Rotation.from_rotvec(axis).apply(detected.shape_camera)
        bones = self.shape[FAR_BONES] - self.shape[NEAR_BONES]
        self.directions = bones / np.maximum(np.linalg.norm(bones, axis=1), 1e-6)[:, None]

    def start(self) -> Skeleton:
        """A usual hand at the landmarks and the depth most of them agree on."""
        pixels, shape = self.detected.pixels, self.shape
        measured = self.measured(pixels)
        seen = measured > 0
        if not seen.any():
            raise FungraspError(
                "there is no depth where the hand is in the image: too near, too far, or not aligned?"
            )
        rough = float(np.median(measured[seen]))
        for _ in range(2):
            points = self.intrinsics.deproject(pixels, np.full(21, rough))
            scale = np.sqrt(np.var(points[:, :2], axis=0).sum() / np.var(shape[:, :2], axis=0).sum())
            offsets = scale * (shape[:, 2] - shape[:, 2].mean())
            radius = np.concatenate([[WRIST_RADIUS], RADII.ravel()])
            rough = _densest((measured + radius - offsets)[seen], 0.012)
        points = self.intrinsics.deproject(pixels, np.asarray(rough + offsets))
        palm = np.array([0, 1, 5, 9, 13])
        template = np.vstack([np.zeros(3), BASES[:4]])
        turn = Rotation.align_vectors(
            points[palm] - points[palm].mean(axis=0), template - template.mean(axis=0)
        )[0].as_matrix()
        hand = Skeleton.usual(points[0], turn)
        for _ in range(8):
            joints, jacobian = hand.joints_and_derivatives()
            near = Evidence(((joints - points) / 0.015).ravel(), jacobian.reshape(63, SIZE) / 0.015)
            matrix, gradient = normal_equations([near, *anatomy_evidence(hand)], SIZE)
            hand = hand.moved(limit_step(damped_step(matrix, gradient, 1e-3)))
        return hand

    def evidence(self, hand: Skeleton, turn: np.ndarray, outlier: tuple[float, float]) -> list[Evidence]:
        """Everything known, about the parameters of the hand and the turn of the landmark model's shape."""
        settings = self.settings
        joints, jacobian = hand.joints_and_derivatives()
        directions = Rotation.from_rotvec(turn).apply(self.directions)
        shape = shape_evidence(joints, jacobian, directions, settings.shape_spread)
        by_turn = turn_derivatives(directions, settings.shape_spread)
        shape = dataclasses.replace(shape, jacobian=np.hstack([shape.jacobian, by_turn]))
        prior = np.hstack([np.zeros((3, SIZE)), np.eye(3) / settings.shape_turn_spread])
        return [
            pixel_evidence(joints, jacobian, self.intrinsics, self.detected.pixels, self.landmark_spread),
            self.depth_evidence(hand, joints, jacobian, outlier),
            shape,
            Evidence(turn / settings.shape_turn_spread, prior),
            *anatomy_evidence(hand),
        ]

    def depth_evidence(
        self, hand: Skeleton, joints: np.ndarray, jacobian: np.ndarray, outlier: tuple[float, float]
    ) -> Evidence:
        points, slopes = PROBES.place(joints, jacobian)
        pixels, _ = project(points, slopes, self.intrinsics)
        radius = PROBES.radius * np.exp(hand.size)
        return depth_evidence(
            points, slopes, radius, self.measured(pixels), self.settings.depth_spread, outlier
        )

    def measured(self, pixels: np.ndarray) -> np.ndarray:
        """Median depth around each pixel [m], 0 where there is none. pixels: shape [P, 2]."""
        height, width = self.depth.shape
        around = np.arange(-1, 2)
        middle = np.rint(pixels).astype(int)
        columns, rows = middle[:, 0, None, None] + around, middle[:, 1, None, None] + around[:, None]
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        values = self.depth[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
        values = np.sort(np.where(inside, values, np.nan).reshape(len(pixels), -1), axis=1)
        count = np.isfinite(values).sum(axis=1)
        median = values[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
        return np.where(count >= 3, median, 0.0)

    def estimate(self, hand: Skeleton, turn: np.ndarray) -> HandEstimate:
        joints, jacobian = hand.joints_and_derivatives()
        evidence = self.evidence(hand, turn, self.settings.outlier_depths[-1])
        matrix, _ = normal_equations(evidence, SIZE + 3)
        inverse = np.linalg.inv(matrix)[:SIZE, :SIZE]
        covariance = jacobian @ inverse @ jacobian.transpose(0, 2, 1)
        pixels, depth = evidence[0], evidence[1]
        agreement = float(robust_weights(pixels).mean())
        through = float(np.mean(depth.residual < -depth.outlier)) if len(depth.residual) else 1.0
        confidence = joint_confidence(covariance)
        return HandEstimate(
            joints,
            self.detected.pixels,
            confidence,
            covariance,
            "right",
            float(np.clip(self.detected.score * agreement * (1 - through), 0.0, 1.0)),
        )


def _densest(values: np.ndarray, width: float) -> float:
    """Where values are densest: mean of those within ``width`` of the one with most others so near."""
    near = np.abs(values[:, None] - values) < width
    return float(values[near[near.sum(axis=1).argmax()]].mean())


def _mirror_detected(detected: DetectedHand, intrinsics: Intrinsics) -> DetectedHand:
    pixels = np.stack([intrinsics.width - 1 - detected.pixels[:, 0], detected.pixels[:, 1]], axis=1)
    shape = detected.shape_camera * np.array([-1.0, 1.0, 1.0])
    return dataclasses.replace(detected, pixels=pixels, shape_camera=shape, side="right")


def _mirror_capture(capture: Capture) -> Capture:
    intrinsics = dataclasses.replace(
        capture.intrinsics, cx=capture.intrinsics.width - 1 - capture.intrinsics.cx
    )
    return Capture(capture.colour, np.ascontiguousarray(capture.depth[:, ::-1]), intrinsics)

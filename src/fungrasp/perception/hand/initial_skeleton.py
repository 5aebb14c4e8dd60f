"""Where the fit of a hand begins: its measurements, as of a right hand, and a first skeleton."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import gammainc

from fungrasp.errors import FungraspError
from fungrasp.perception.estimates import HandEstimate
from fungrasp.perception.hand.detection import DetectedHand
from fungrasp.perception.hand.evidence import FAR_BONES, NEAR_BONES, Evidence, anatomy_evidence
from fungrasp.perception.hand.gauss_newton import damped_step, normal_equations
from fungrasp.perception.hand.skeleton import BASES, RADII, SIZE, WRIST_RADIUS, Skeleton
from fungrasp.perception.io.capture import Capture, Intrinsics

TRUSTED_ERROR = 0.015
"""A joint's confidence is the probability that its error is smaller than this [m]."""

COVARIANCE_FACTOR = 1.3
"""By which errors vary more than least squares believes: neighbouring measurements err alike. From made
scenes with known truth."""

DEEPEST = 0.16
"""From the nearest to the farthest joint of a hand [m]: now and then the landmark model says a quarter of a
metre."""

MIRROR_X = np.array([-1.0, 1.0, 1.0])
"""Reflection that swaps left and right of the image, by coordinate."""

_PALM_JOINTS = np.array([0, 1, 5, 9, 13])
_AGREEMENT = 0.012


@dataclass(frozen=True, eq=False)
class HandMeasurements:
    """What was seen of a hand, in the mirror image if it is a left one."""

    pixels: np.ndarray
    """Landmarks, shape [21, 2]."""
    shape: np.ndarray
    """Joints about the hand's middle [m], camera frame, shape [21, 3], as the landmark model guesses."""
    directions: np.ndarray
    """Unit vectors of ``BONES`` in that shape, shape [20, 3]."""
    depth: np.ndarray
    """[m], shape [H, W]; NaN: none."""
    intrinsics: Intrinsics
    score: float
    """Probability that this is a hand."""
    spread: float | None = None
    """Standard deviation of a landmark [pixels], if the detector knows it."""

    @classmethod
    def of(cls, detected: DetectedHand, capture: Capture) -> HandMeasurements:
        """Of a detected hand, mirrored if it is a left one."""
        intrinsics, pixels, shape = capture.intrinsics, detected.pixels, detected.shape_camera
        depth = np.where(capture.depth > 0, capture.depth, np.nan)
        if detected.side == "left":
            last = intrinsics.width - 1
            intrinsics = dataclasses.replace(intrinsics, cx=last - intrinsics.cx)
            pixels = pixels * [-1.0, 1.0] + [last, 0.0]
            shape, depth = shape * MIRROR_X, depth[:, ::-1]
        deep = float(np.ptp(shape[:, 2]))
        shape = shape * [1.0, 1.0, min(1.0, DEEPEST / max(deep, 1e-6))]
        # The landmark model sees every hand as if it were in the middle of the image.
        toward = intrinsics.deproject(pixels.mean(axis=0), np.ones(()))
        axis = np.cross([0.0, 0.0, 1.0], toward / np.linalg.norm(toward))
        shape = Rotation.from_rotvec(axis).apply(shape)
        bones = shape[FAR_BONES] - shape[NEAR_BONES]
        directions = bones / np.maximum(np.linalg.norm(bones, axis=1), 1e-6)[:, None]
        return cls(pixels, shape, directions, depth, intrinsics, detected.score, detected.spread)

    def landmark_spread(self, part: float, least: float) -> float:
        """Standard deviation of a landmark [pixels]: what the detector says, else a part of the hand's extent
        in the image; at least some pixels."""
        extent = float(np.linalg.norm(np.ptp(self.pixels, axis=0)))
        return max(least, part * extent if self.spread is None else self.spread)

    def measured(self, pixels: np.ndarray) -> np.ndarray:
        """Median depth around each pixel [m], 0 where there is hardly any. pixels: shape [P, 2]."""
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


def start(seen: HandMeasurements) -> Skeleton:
    """The landmark model's shape at the depth that most landmarks agree on.

    Raises:
        FungraspError: there is no depth where the hand is.
    """
    measured = seen.measured(seen.pixels)
    known = measured > 0
    if not known.any():
        raise FungraspError(
            "there is no depth where the hand is in the image: is it too near or too far for the camera, or "
            "is the depth not aligned to the colour?"
        )
    rough = float(np.median(measured[known]))
    radius = np.concatenate([[WRIST_RADIUS], RADII.ravel()])
    offsets = np.zeros(21)
    for _ in range(2):
        points = seen.intrinsics.deproject(seen.pixels, np.full(21, rough))
        wide = np.var(points[:, :2], axis=0).sum() / max(np.var(seen.shape[:, :2], axis=0).sum(), 1e-9)
        offsets = np.sqrt(wide) * (seen.shape[:, 2] - seen.shape[:, 2].mean())
        rough = _densest((measured + radius - offsets)[known])
    depth = np.maximum(rough + offsets, 0.1)
    return skeleton_through(seen.intrinsics.deproject(seen.pixels, depth), 0.015)


def skeleton_through(points: np.ndarray, spread: float, iterations: int = 8) -> Skeleton:
    """The skeleton of a right hand whose joints come nearest to given points.

    Args:
        points: [m], shape [21, 3].
        spread: standard deviation of the points [m]: how far anatomy may overrule them.
        iterations: Gauss-Newton steps.
    """
    template = np.vstack([np.zeros(3), BASES[:4]])
    placed = points[_PALM_JOINTS] - points[_PALM_JOINTS].mean(axis=0)
    turn = Rotation.align_vectors(placed, template - template.mean(axis=0))[0].as_matrix()
    hand = Skeleton.usual(points[0], turn)
    for _ in range(iterations):
        joints, jacobian = hand.joints_and_derivatives()
        near = Evidence(((joints - points) / spread).ravel(), jacobian.reshape(63, SIZE) / spread)
        hand = hand.moved(damped_step(*normal_equations([near, *anatomy_evidence(hand)], SIZE)))
    return hand


def joint_covariance(matrix: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Covariance of each joint [m^2], shape [21, 3, 3].

    Args:
        matrix: normal matrix; the first parameters are those of the skeleton.
        jacobian: derivatives of the joints by the skeleton's parameters, shape [21, 3, n].
    """
    size = jacobian.shape[-1]
    inverse = np.linalg.inv(matrix)[:size, :size]
    return COVARIANCE_FACTOR * jacobian @ inverse @ jacobian.transpose(0, 2, 1)


def joint_confidence(covariance: np.ndarray) -> np.ndarray:
    """Probability that a joint's error is below ``TRUSTED_ERROR``. covariance: [m^2], shape [21, 3, 3]."""
    variance = np.trace(covariance, axis1=1, axis2=2) / 3
    return gammainc(1.5, TRUSTED_ERROR**2 / (2 * variance))


def mirror_estimate(hand: HandEstimate, pixels: np.ndarray) -> HandEstimate:
    """The hand seen in a mirror that swaps left and right of the image. pixels: where its joints are seen."""
    return dataclasses.replace(
        hand,
        joints_camera=hand.joints_camera * MIRROR_X,
        covariance=hand.covariance * MIRROR_X[:, None] * MIRROR_X,
        pixels=pixels,
        side="left" if hand.side == "right" else "right",
    )


def _densest(values: np.ndarray) -> float:
    """Mean of the values near the one that most others are near."""
    near = np.abs(values[:, None] - values) < _AGREEMENT
    return float(values[near[near.sum(axis=1).argmax()]].mean())

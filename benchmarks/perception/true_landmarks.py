"""A detector of hands that gives the true joints with random errors, to measure the steps after it.

How well hands are found in pictures is another question, which rendered hands hardly answer.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.capture import Box, Intrinsics

SHAPE_NOISE = 0.01
"""Standard deviation of a joint's place in the detector's rough shape [m], each axis."""


class TrueLandmarks:
    """Finds one hand: the true right one, its landmarks shifted at random, each by itself."""

    def __init__(self, joints: np.ndarray, lens: Intrinsics, spread: float, rng: np.random.Generator):
        """
        Args:
            joints: the truth [m], camera frame, shape [21, 3].
            lens: of the image.
            spread: standard deviation of a landmark, each way [pixels of an image 640 wide].
            rng: decides the shifts.
        """
        spread *= lens.width / 640
        pixels = lens.project(joints) + spread * rng.normal(size=(21, 2))
        shape = joints - joints.mean(axis=0) + SHAPE_NOISE * rng.normal(size=(21, 3))
        # A landmark model sees every hand as if it were in the middle of the image.
        toward = lens.deproject(pixels.mean(axis=0), np.ones(()))
        axis = np.cross([0.0, 0.0, 1.0], toward / np.linalg.norm(toward))
        self._hand = DetectedHand(
            pixels, Rotation.from_rotvec(-axis).apply(shape), "right", 1.0, 1.0, spread=spread
        )

    def detect(self, color: np.ndarray, near: Box | None = None) -> list[DetectedHand]:
        """The hand, whatever the image; see ``perceive.Detector``."""
        return [self._hand]

"""Pose of a fixed camera from points that the hand has touched and the camera has seen.

Kabsch: the rotation and translation that minimize sum |X seen_k - touched_k|^2.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.robots.calibration.hand_eye import CameraCalibration

LEAST_POINTS = 4
"""Three would determine the answer; a fourth tells a bad one."""

LEAST_SPREAD = 0.05
"""Points whose second largest deviation from their mean is smaller lie about on a line [m]."""


def calibrate_from_points(seen: np.ndarray, touched: np.ndarray) -> CameraCalibration:
    """Find the camera.

    Args:
        seen: points in the camera frame [m], shape [K, 3], of the depth image.
        touched: the same points, world frame [m], shape [K, 3], from the arm's forward kinematics.

    Raises:
        FungraspError: too few points, about on a line, or not finite.
    """
    if seen.shape != touched.shape or seen.ndim != 2 or seen.shape[1:] != (3,) or len(seen) < LEAST_POINTS:
        raise FungraspError(
            f"calibration needs as many seen as touched points, {LEAST_POINTS} or more of 3 numbers, not "
            f"{list(seen.shape)} and {list(touched.shape)}"
        )
    if not (np.isfinite(seen).all() and np.isfinite(touched).all()):
        raise FungraspError("points of a calibration must be finite numbers")
    middle = touched.mean(axis=0)
    spread = np.linalg.svd(touched - middle, compute_uv=False) / np.sqrt(len(touched))
    if spread[1] < LEAST_SPREAD:
        raise FungraspError("the touched points lie about on a line: touch points all over the workspace")
    turn = Rotation.align_vectors(touched - middle, seen - seen.mean(axis=0))[0]
    place = middle - turn.apply(seen.mean(axis=0))
    missed = turn.apply(seen) + place - touched
    # Of 3 K numbers six are used up.
    variance = float(np.sum(missed**2)) / (3 * len(seen) - 6)
    # The camera is away from the points, so that their rotation's error moves it.
    rotation = np.sqrt(variance / len(seen)) * np.linalg.norm(1.0 / spread[:2])
    position = np.hypot(np.sqrt(3 * variance / len(seen)), rotation * np.linalg.norm(middle - place))
    return CameraCalibration(
        np.concatenate([place, turn.as_quat(scalar_first=True)]),
        float(np.sqrt(np.mean(np.sum(missed**2, axis=1)))),
        float(position),
        float(rotation),
    )

"""Which plane in the image is the table below hand and object: no wall, no side of the object.

Unlike ``segmentation.find_table``, which takes the largest plane, this one knows where the hand is.
"""

from __future__ import annotations

import numpy as np

from fungrasp.perception.capture import Capture

NO_TABLE = np.array([0.0, -1.0, 0.0, 50.0])
"""A plane so far below everything that it is none, for those who would else look for one."""

TRIES = 600
"""Planes that are tried."""

LEAST_PART = 0.05
"""Part of the image's points that a table makes up at least."""

BELOW = 0.03
"""No joint is lower under the table than this [m]: an estimated hand may be so wrong."""

REACH = 0.7
"""The hand's lowest joint is not higher above the table than this [m]."""

SMALLEST = 0.25
"""What is seen of a table is at least so long [m]; the plane of a box's side is not."""

STEP = 6
"""Every so many rows and columns are looked at, in an image of 640 columns."""


def table_under(capture: Capture, joints: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """The largest plane that can be the table under a hand (RANSAC).

    Args:
        capture: the image.
        joints: of the hand [m], camera frame, shape [21, 3].
        rng: chooses the planes that are tried.

    Returns:
        ``[nx ny nz d]``: ``n . x + d`` is the height above it [m], shape [4]; None if there is none.
    """
    step = max(1, STEP * capture.intrinsics.width // 640)
    points = capture.points()[::step, ::step].reshape(-1, 3)
    points = points[np.isfinite(points[:, 2]) & (points[:, 2] < 3.0)]
    if len(points) < 100:
        return None
    tolerance = 0.004 + 0.003 * points[:, 2] ** 2
    planes = _through(points[rng.integers(0, len(points), (TRIES, 3))])
    lowest = (joints @ planes[:, :3].T + planes[:, 3]).min(axis=0)
    planes = planes[(lowest > -BELOW) & (lowest < REACH)]
    if not len(planes):
        return None
    votes = (np.abs(points @ planes[:, :3].T + planes[:, 3]) < tolerance[:, None]).sum(axis=0)
    for best in np.argsort(-votes)[:20]:
        near = np.abs(points @ planes[best, :3] + planes[best, 3]) < tolerance
        if near.sum() < max(30.0, LEAST_PART * len(points)):
            return None
        if np.ptp(np.percentile(points[near], [5, 95], axis=0), axis=0).max() > SMALLEST:
            return _settled(planes[best], points, tolerance)
    return None


def _through(corners: np.ndarray) -> np.ndarray:
    """Planes through three points each, the camera above them; points in a line give none.

    corners: [m], shape [T, 3, 3]. Returns shape [P, 4].
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    offset = -np.einsum("ti,ti->t", normal, corners[:, 0])[:, None]
    kept = length[:, 0] > 1e-6
    planes = np.concatenate([normal, offset], axis=1)[kept] / length[kept]
    return planes * np.where(planes[:, 3:] < 0, -1.0, 1.0)


def _settled(plane: np.ndarray, points: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """The plane fitted by least squares to the points near it, a few times."""
    for width in (1.5, 1.0, 1.0):
        near = points[np.abs(points @ plane[:3] + plane[3]) < width * tolerance]
        middle = near.mean(axis=0)
        direction = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
        plane = np.append(direction, -direction @ middle)
        plane = plane if plane[3] > 0 else -plane
    return plane

"""Which plane in the image is the table: RANSAC over the measured points.

A plane is ``[nx ny nz d]`` with a unit normal, ``n . x + d`` the height above it [m]; the camera, at the
origin, is above it.
"""

from __future__ import annotations

import numpy as np

from fungrasp.perception.io.capture import Capture, depth_noise

NO_TABLE = np.array([0.0, -1.0, 0.0, 50.0])
"""A plane so far below everything that it is none, for those who would else look for one."""

TRIES = 600
"""Planes that are tried."""

FARTHEST = 3.0
"""No point farther away is on the table [m]."""

LEAST_POINTS = 100
"""Fewer don't tell a plane."""

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

PLANE_TOLERANCE = 1.6
"""Points so near to a plane [standard deviations of depth] belong to it."""


def table_under(capture: Capture, joints: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """The largest plane that can be the table under a hand (RANSAC): no wall, no side of the object.

    Args:
        capture: the image.
        joints: of the hand [m], camera frame, shape [21, 3].
        rng: chooses the planes that are tried.

    Returns:
        ``[nx ny nz d]``: ``n . x + d`` is the height above it [m], shape [4]; None if there is none.
    """
    points = _points(capture, FARTHEST)
    if len(points) < LEAST_POINTS:
        return None
    planes = planes_through(points[rng.integers(0, len(points), (TRIES, 3))])
    lowest = (joints @ planes[:, :3].T + planes[:, 3]).min(axis=0)
    planes = planes[(lowest > -BELOW) & (lowest < REACH)]
    if not len(planes):
        return None
    for best in np.argsort(-plane_votes(planes, points))[:20]:
        near = plane_members(planes[best], points)
        if near.sum() < max(30.0, LEAST_PART * len(points)):
            return None
        if np.ptp(np.percentile(points[near], [5, 95], axis=0), axis=0).max() > SMALLEST:
            return fitted_plane(planes[best], points)
    return None


def largest_plane(capture: Capture, rng: np.random.Generator, tries: int = 300) -> np.ndarray | None:
    """The largest plane in the image (RANSAC): the table, if nothing is known of the hand.

    Args:
        capture: the image.
        rng: chooses the planes that are tried.
        tries: how many.

    Returns:
        As ``table_under``; None if no plane makes up a tenth of the image.
    """
    points = _points(capture, 2.5)
    if len(points) < LEAST_POINTS:
        return None
    planes = planes_through(points[rng.integers(0, len(points), (tries, 3))])
    count = plane_votes(planes, points)
    if count.max(initial=0) < 0.1 * len(points):
        return None
    return fitted_plane(planes[count.argmax()], points)


def _points(capture: Capture, farthest: float) -> np.ndarray:
    """Some of the measured points, evenly spread in the image [m], shape [N, 3]."""
    step = max(1, STEP * capture.intrinsics.width // 640)
    points = capture.points()[::step, ::step].reshape(-1, 3)
    return points[np.isfinite(points[:, 2]) & (points[:, 2] < farthest)]


def plane_tolerance(depth: np.ndarray) -> np.ndarray:
    """How far a measured point may be from the plane that it belongs to [m], shape of ``depth`` [m]."""
    return PLANE_TOLERANCE * depth_noise(depth)


def planes_through(corners: np.ndarray) -> np.ndarray:
    """Planes through three points each; points in a line give none.

    Args:
        corners: [m], shape [T, 3, 3].

    Returns:
        Shape [P, 4], P <= T.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    # Not yet divided by the length: (n, d) of n . x + d = 0 through the first corner.
    offset = -np.einsum("ti,ti->t", normal, corners[:, 0])[:, None]
    kept = length[:, 0] > 1e-6
    planes = np.concatenate([normal, offset], axis=1)[kept] / length[kept]
    return planes * np.where(planes[:, 3:] < 0, -1.0, 1.0)


def plane_votes(planes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many points belong to each plane, shape [P]. planes: shape [P, 4]; points: [m], shape [N, 3]."""
    heights = points @ planes[:, :3].T + planes[:, 3]
    return (np.abs(heights) < plane_tolerance(points[:, 2])[:, None]).sum(axis=0)


def plane_members(plane: np.ndarray, points: np.ndarray, width: float = 1.0) -> np.ndarray:
    """Which points belong to a plane, shape [N] bool. width: in the tolerance."""
    return np.abs(points @ plane[:3] + plane[3]) < width * plane_tolerance(points[:, 2])


def fitted_plane(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The plane fitted by least squares to the points that belong to it, a few times, shape [4]."""
    for width in (1.5, 1.0, 1.0):
        near = points[plane_members(plane, points, width)]
        middle = near.mean(axis=0)
        direction = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
        plane = np.append(direction, -direction @ middle)
        plane = plane if plane[3] > 0 else -plane
    return plane

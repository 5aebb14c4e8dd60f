"""Table detection by RANSAC on measured points, and the world frame.

A plane is ``[nx ny nz d]`` with a unit normal: ``n . x + d`` is the height of a point above it [m]. The
camera, at the origin, is above it.

World frame: z up, table top at z = 0, origin below the object's center of mass. Seen through the camera, x
points right along the table and y away from the camera.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps.conversion import settled_pose
from fungrasp.objects import ObjectModel
from fungrasp.perception.io.capture import Capture, depth_noise

# Plane far below everything, which says that there is no table and none is to be searched.
NO_TABLE = np.array([0.0, -1.0, 0.0, 50.0])
TRIES = 600  # Number of sampled planes.
FARTHEST = 3.0  # Largest depth of the table's points [m].
LEAST_POINTS = 100  # Smallest number of points from which a plane is estimated.
LEAST_PART = 0.05  # Smallest fraction of the points that lie on the table.
BELOW = 0.03  # Largest depth of a joint below the table [m]: the error of an estimated hand.
REACH = 0.7  # Largest height of the hand's lowest joint above the table [m].
SMALLEST = 0.25  # Smallest extent of the visible table [m]; the side of a box is smaller.
STEP = 6  # Stride of rows and columns in an image 640 pixels wide.
PLANE_TOLERANCE = 1.6  # Largest distance of a point from its plane [standard deviations of depth].


def table_under(capture: Capture, joints: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """Find the largest plane close below a hand that is larger than the side of an object (RANSAC).

    Args:
        joints: points of the hand, or of the object [m], camera frame, shape [P, 3].

    Returns:
        Plane, camera frame, shape [4]; None if there is none.
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


def largest_plane(capture: Capture, rng: np.random.Generator) -> np.ndarray | None:
    """Find the largest plane in the image (RANSAC), if the hand is unknown.

    Returns:
        Plane, camera frame, shape [4]; None if fewer than a tenth of the points lie on it.
    """
    points = _points(capture, 2.5)
    if len(points) < LEAST_POINTS:
        return None
    planes = planes_through(points[rng.integers(0, len(points), (TRIES // 2, 3))])
    count = plane_votes(planes, points)
    if count.max(initial=0) < 0.1 * len(points):
        return None
    return fitted_plane(planes[count.argmax()], points)


def _points(capture: Capture, farthest: float) -> np.ndarray:
    """Return evenly spaced measured points [m], camera frame, shape [N, 3]. farthest: largest depth [m]."""
    step = max(1, STEP * capture.intrinsics.width // 640)
    points = capture.points()[::step, ::step].reshape(-1, 3)
    return points[np.isfinite(points[:, 2]) & (points[:, 2] < farthest)]


def plane_tolerance(depth: np.ndarray) -> np.ndarray:
    """Return the largest distance of measured points from their plane [m], shape of ``depth`` [m]."""
    return PLANE_TOLERANCE * depth_noise(depth)


def planes_through(corners: np.ndarray) -> np.ndarray:
    """Return planes through triples of points, shape [P, 4], P <= T; collinear triples are dropped.

    Args:
        corners: triples [m], shape [T, 3, 3].
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    # Normal and offset are normalized below.
    offset = -np.einsum("ti,ti->t", normal, corners[:, 0])[:, None]
    kept = length[:, 0] > 1e-6
    planes = np.concatenate([normal, offset], axis=1)[kept] / length[kept]
    return planes * np.where(planes[:, 3:] < 0, -1.0, 1.0)


def plane_votes(planes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Count the points on each plane, shape [P]. planes: shape [P, 4]; points: [m], shape [N, 3]."""
    tolerance = plane_tolerance(points[:, 2])
    # In chunks, because allocating large arrays is slow.
    parts = np.array_split(planes, 1 + len(planes) // 32)
    heights = (part[:, :3] @ points.T + part[:, 3:] for part in parts)
    return np.concatenate([np.count_nonzero(np.abs(one) < tolerance, axis=1) for one in heights])


def plane_members(plane: np.ndarray, points: np.ndarray, width: float = 1.0) -> np.ndarray:
    """Return which points lie on a plane, shape [N] bool. width: factor on the tolerance."""
    return np.abs(points @ plane[:3] + plane[3]) < width * plane_tolerance(points[:, 2])


def fitted_plane(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return a plane fitted to its points by repeated least squares, shape [4]."""
    for width in (1.5, 1.0, 1.0):
        near = points[plane_members(plane, points, width)]
        middle = near.mean(axis=0)
        direction = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
        plane = np.append(direction, -direction @ middle)
        plane = plane if plane[3] > 0 else -plane
    return plane


# Sine of the angle between optical axis and vertical below which the view gives no direction along the table;
# the upward direction of the image then counts as away from the camera.
STEEP = 0.3

Z = np.array([0.0, 0.0, 1.0])


def guessed_table(points: np.ndarray) -> np.ndarray:
    """Return a level plane below all points, for a level camera, camera frame, shape [4].

    Args:
        points: hand and object [m], camera frame, shape [P, 3].
    """
    return np.array([0.0, -1.0, 0.0, float(points[:, 1].max())])


def world_from_table(table: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return the pose of the camera in the world, shape [7].

    Args:
        table: plane with unit normal upwards, camera frame, shape [4].
        below: point above the world's origin [m], camera frame, shape [3].
    """
    up = table[:3] / np.linalg.norm(table[:3])
    away = Z - up * up[2]
    if np.linalg.norm(away) < STEEP:
        away = np.array([0.0, -1.0, 0.0])
        away = away - up * (up @ away)
    away = away / np.linalg.norm(away)
    turn = np.stack([np.cross(away, up), away, up])
    origin = below - up * (up @ below + table[3])
    quaternion = Rotation.from_matrix(turn).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([-turn @ origin, quaternion])


def put_down(model: ObjectModel, pose: np.ndarray) -> np.ndarray:
    """Return the pose of the object put down on its nearest stable face, world frame, shape [7]. Its center
    of mass stays above the same spot. pose: pose in the hand, world frame, shape [7]."""
    laid = settled_pose(pose, model)
    centers = [transform_points(each, model.center_of_mass[None])[0] for each in (pose, laid)]
    laid[:2] += (centers[0] - centers[1])[:2]
    return laid


def in_world(pose_world_camera: np.ndarray, pose_camera: np.ndarray) -> np.ndarray:
    """Return a camera-frame pose in the world frame, shape [7], with a unit quaternion and w >= 0."""
    pose = compose(pose_world_camera, pose_camera)
    quaternion = pose[3:] / np.linalg.norm(pose[3:])
    return np.concatenate([pose[:3], quaternion * (1.0 if quaternion[0] >= 0 else -1.0)])

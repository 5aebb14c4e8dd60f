"""Which plane in the image is the table: RANSAC over the measured points.

A plane is ``[nx ny nz d]`` with a unit normal, ``n . x + d`` the height above it [m]; the camera, at the
origin, is above it.

World frame: z up, the table top is z = 0, the origin below the object's center of mass. As one looks through
the camera, x points to the right along the table and y away from the camera.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import (
    compose,
    quaternion_conjugate,
    quaternion_multiply,
    rotate,
    transform_points,
)
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import settled_up
from fungrasp.perception.io.capture import Capture, depth_noise

# A plane so far below everything that it is none, for those who would else look for one.
NO_TABLE = np.array([0.0, -1.0, 0.0, 50.0])
TRIES = 600  # Planes that are tried.
FARTHEST = 3.0  # No point farther away is on the table [m].
LEAST_POINTS = 100  # Fewer don't tell a plane.
LEAST_PART = 0.05  # Part of the image's points that a table makes up at least.
BELOW = 0.03  # No joint is lower under the table than this [m]: an estimated hand may be so wrong.
REACH = 0.7  # The hand's lowest joint is not higher above the table than this [m].
SMALLEST = 0.25  # What is seen of a table is at least so long [m]; the plane of a box's side is not.
STEP = 6  # Every so many rows and columns are looked at, in an image of 640 columns.
PLANE_TOLERANCE = 1.6  # Points so near to a plane [standard deviations of depth] belong to it.


def table_under(capture: Capture, joints: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """The largest plane that can be the table under a hand (RANSAC): no wall, no side of the object.

    Args:
        joints: of the hand [m], camera frame, shape [21, 3].

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


def largest_plane(capture: Capture, rng: np.random.Generator) -> np.ndarray | None:
    """The largest plane in the image (RANSAC): the table, if nothing is known of the hand.

    Returns:
        As ``table_under``; None if no plane makes up a tenth of the image.
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
    tolerance = plane_tolerance(points[:, 2])
    # Few at a time: large arrays are slow to get from the system.
    parts = np.array_split(planes, 1 + len(planes) // 32)
    heights = (part[:, :3] @ points.T + part[:, 3:] for part in parts)
    return np.concatenate([np.count_nonzero(np.abs(one) < tolerance, axis=1) for one in heights])


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


# A camera that looks down more steeply, by the sine of the angle between its axis and the vertical, has no
# direction along the table; up in the image then counts as away.
STEEP = 0.3

Z = np.array([0.0, 0.0, 1.0])


def guessed_table(points: np.ndarray) -> np.ndarray:
    """A level plane below everything, for a camera that is held level.

    Args:
        points: of hand and object [m], camera frame, shape [P, 3].

    Returns:
        ``[nx ny nz d]``: ``n . x + d`` is the height above it [m], shape [4].
    """
    return np.array([0.0, -1.0, 0.0, float(points[:, 1].max())])


def world_from_table(table: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Pose of the camera in the world, shape [7].

    Args:
        table: ``[nx ny nz d]``, camera frame, unit normal upwards, shape [4].
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
    """The object let down: turned onto its nearest stable face, lying on the table, shape [7].

    Its center of mass stays above the same spot. pose: as it is held, world frame, shape [7]."""
    face_up = rotate(pose[3:], settled_up(model, rotate(quaternion_conjugate(pose[3:]), Z)))
    turn = Rotation.align_vectors(Z[None], face_up[None])[0].as_quat(scalar_first=True)
    laid = np.concatenate([np.zeros(3), quaternion_multiply(turn, pose[3:])])
    center = transform_points(pose, model.center_of_mass[None])[0]
    offset = center - transform_points(laid, model.center_of_mass[None])[0]
    lowest = transform_points(laid, model.vertices)[:, 2].min()
    return np.concatenate([[offset[0], offset[1], -lowest], laid[3:] / np.linalg.norm(laid[3:])])


def in_world(pose_world_camera: np.ndarray, pose_camera: np.ndarray) -> np.ndarray:
    """A pose of the camera frame in the world, shape [7], its quaternion of unit length and positive w."""
    pose = compose(pose_world_camera, pose_camera)
    quaternion = pose[3:] / np.linalg.norm(pose[3:])
    return np.concatenate([pose[:3], quaternion * (1.0 if quaternion[0] >= 0 else -1.0)])

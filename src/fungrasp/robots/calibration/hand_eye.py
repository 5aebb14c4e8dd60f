"""Pose of a fixed camera from a flat board that the hand holds in front of it, in several poses of the arm.

With P_i the pose of the palm in the world by forward kinematics, B that of the board on the palm, X that of
the camera in the world, and C_i that of the board in the camera, P_i B = X C_i. Shah's closed form (2013)
over the board poses of single images gives a start; then X and B minimize the distances of all corners in
the images,

    sum_ik rho(| project(X^-1 P_i B b_k) - u_ik |^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_from_rotation_vector,
    transform_points,
)
from fungrasp.perception import Intrinsics

LEAST_VIEWS = 5
"""Three would determine the answer; with fewer than five nothing would tell a bad one."""

LEAST_CORNERS = 6
"""An image with fewer corners is left out: its board pose is hardly determined."""

OUTLIER = 1.0
"""Distance in the image from which a corner counts less [pixels]: found corners are a tenth of that off."""

LARGEST_UNCERTAINTY = 0.01
"""A calibration whose camera position is less certain says nothing of use [m]."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board in one image."""

    palm: np.ndarray
    """Pose of the palm as the image was taken, world frame, shape [7]."""
    points: np.ndarray
    """Corners that were found, board frame, z = 0 [m], shape [K, 3]."""
    pixels: np.ndarray
    """Where they are in the image [pixels], shape [K, 2]."""


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Where a camera is."""

    pose_world_camera: np.ndarray
    """Camera (OpenCV: x right, y down, z forward) in the world, shape [7]."""
    residual: float
    """RMS distance of what was seen from where the answer has it [m]."""
    position_deviation: float
    """Standard deviation of the camera's position, as far as the data tell [m]."""
    rotation_deviation: float
    """Standard deviation of its rotation, likewise [rad]."""


def calibrate_from_board(views: Sequence[BoardView], intrinsics: Intrinsics) -> CameraCalibration:
    """Find the camera.

    Args:
        views: five or more, the palm turned about different axes.
        intrinsics: of the camera; its images without distortion.

    Raises:
        FungraspError: too few views, or views that do not determine the camera.
    """
    views = [view for view in views if len(view.points) >= LEAST_CORNERS]
    if len(views) < LEAST_VIEWS:
        raise FungraspError(
            f"only {len(views)} images show the board: calibration needs {LEAST_VIEWS} with {LEAST_CORNERS} "
            "corners or more"
        )
    boards = np.stack([board_pose(view, intrinsics) for view in views])
    camera, board = _closed_form(np.stack([view.palm for view in views]), boards)

    start = camera, board
    best, missed = _refined(start, views, intrinsics)
    pose = _moved(camera, best[:6])
    # Jackknife. What the arm's errors do to an image is common to its corners: whole views are left out.
    few = np.stack(
        [_refined(start, [*views[:i], *views[i + 1 :]], intrinsics, best)[0] for i in range(len(views))]
    )
    variance = (len(views) - 1) / len(views) * np.sum((few - few.mean(axis=0)) ** 2, axis=0)
    place, turn = (float(np.sqrt(variance[part].sum())) for part in (slice(0, 3), slice(3, 6)))
    if not place < LARGEST_UNCERTAINTY:
        raise FungraspError(
            f"the camera's position is uncertain by {100 * place:.1f} cm: take more images, the palm turned "
            "by 30 degrees and more about different axes"
        )
    depths = np.repeat(boards[:, 2], [2 * len(view.points) for view in views])
    residual = float(np.sqrt(2 * np.mean((missed * depths / intrinsics.fx) ** 2)))
    return CameraCalibration(pose, residual, place, turn)


def _refined(
    start: tuple[np.ndarray, np.ndarray],
    views: Sequence[BoardView],
    intrinsics: Intrinsics,
    changes: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of camera and board that fit the corners best, shape [12], and by how much they miss them
    [pixels]. start: poses of both. changes: to begin with."""
    focal, middle = [intrinsics.fx, intrinsics.fy], [intrinsics.cx, intrinsics.cy]

    def missed(parameters: np.ndarray) -> np.ndarray:
        x, b = _moved(start[0], parameters[:6]), _moved(start[1], parameters[6:])
        parts = []
        for view in views:
            seen = transform_points(compose(compose(invert(x), view.palm), b), view.points)
            # Behind the camera nothing is seen: a large error that leads back.
            depth = np.maximum(seen[:, 2:], 0.01)
            parts.append((seen[:, :2] / depth * focal + middle - view.pixels).ravel())
        return np.concatenate(parts)

    begin = np.zeros(12) if changes is None else changes
    # A centimeter and a hundredth of a radian move corners about as far.
    found = least_squares(missed, begin, loss="soft_l1", f_scale=OUTLIER, x_scale=0.01)
    return found.x, missed(found.x)


def board_pose(view: BoardView, intrinsics: Intrinsics) -> np.ndarray:
    """Pose of the board in the camera by the homography of its plane, shape [7]. Exact without noise."""
    rays = intrinsics.deproject(view.pixels, np.ones(len(view.pixels)))[:, :2]
    scale = np.abs(view.points[:, :2]).max()
    rows = []
    for (x, y), (u, v) in zip(view.points[:, :2] / scale, rays, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    h = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3) / [scale, scale, 1.0]
    h /= np.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1]))
    if h[2, 2] < 0:
        h = -h
    rotation = _nearest(np.stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])], axis=1))
    return np.concatenate([h[:, 2], Rotation.from_matrix(rotation).as_quat(scalar_first=True)])


def _closed_form(palms: np.ndarray, boards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera in the world and board on the palm, each of shape [7], from V palm poses in the world and board
    poses in the camera."""
    p, c = _matrices(palms), _matrices(boards)
    one = np.eye(3)
    # Rotations, row by row: (P x 1) vec(B) - (1 x C^T) vec(X) = 0.
    system = np.concatenate(
        [np.hstack([np.kron(one, ci.T), -np.kron(pi, one)]) for pi, ci in zip(p, c, strict=True)]
    )
    both = np.linalg.svd(system)[2][-1]
    camera, board = both[:9].reshape(3, 3), both[9:].reshape(3, 3)
    if np.linalg.det(camera) < 0:
        camera, board = -camera, -board
    camera, board = _nearest(camera), _nearest(board)
    # Positions: t_X - P t_B = t_P - X t_C.
    left = np.concatenate([np.hstack([one, -pi]) for pi in p])
    right = (palms[:, :3] - boards[:, :3] @ camera.T).ravel()
    places = np.linalg.lstsq(left, right, rcond=None)[0]
    turns = [Rotation.from_matrix(m).as_quat(scalar_first=True) for m in (camera, board)]
    return np.concatenate([places[:3], turns[0]]), np.concatenate([places[3:], turns[1]])


def _matrices(poses: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()


def _nearest(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix."""
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _moved(pose: np.ndarray, change: np.ndarray) -> np.ndarray:
    """A pose displaced by [m] and turned by a rotation vector [rad], world frame. change: shape [6]."""
    turn = np.concatenate([np.zeros(3), quaternion_from_rotation_vector(change[3:])])
    turned = compose(turn, np.concatenate([np.zeros(3), pose[3:]]))
    return np.concatenate([pose[:3] + change[:3], turned[3:]])

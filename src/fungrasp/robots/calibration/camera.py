"""Calibration of a fixed camera, from a flat board that the hand holds in front of it in several poses.

Let P_i be the palm poses in the world, by forward kinematics, B the board pose on the palm, X the camera
pose in the world, and C_i the board poses in the camera: P_i B = X C_i. Between two views, palm and board
turn by the same angle about axes that B maps onto each other (Park and Martin, 1994), which gives initial
values. Then X and B minimize the distances of all corners in the images,

    sum_ik rho(| project(X^-1 P_i B b_k) - u_ik |^2).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.geometry.poses import (
    compose,
    invert,
    quaternion_from_rotation_vector,
    rotation_vector,
    transform_points,
)
from fungrasp.perception import Intrinsics
from fungrasp.robots.device import import_client

LEAST_VIEWS = 5
"""Smallest number of views: three determine the camera, but fewer than five do not reveal bad results."""

LEAST_CORNERS = 6
"""Smallest number of corners in a view; fewer hardly determine the board pose."""

OUTLIER = 1.0
"""Distance in the image beyond which a corner has less weight [pixels]: detections are off by 0.1 pixels."""

LARGEST_UNCERTAINTY = 0.01
"""Standard deviation of the camera position beyond which a calibration is refused [m]."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board as OpenCV generates it."""

    columns: int = 7
    """Squares along x."""
    rows: int = 5
    """Squares along y."""
    square: float = 0.03
    """Side of a square, measured on the print [m]."""
    marker: float = 0.022
    """Side of a marker, measured on the print [m]."""
    dictionary: str = "DICT_4X4_50"
    """Dictionary of the markers (OpenCV's name)."""

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or not 0 < self.marker < self.square:
            raise FungraspError(
                "a board has 3 or more squares to each side, and markers smaller than its squares"
            )


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board in one image, with K detected corners."""

    palm: np.ndarray
    """Palm pose at the time of the image, world frame, shape [7]."""
    points: np.ndarray
    """Corners, board frame, z = 0 [m], shape [K, 3]."""
    pixels: np.ndarray
    """Corners in the image [pixels], shape [K, 2]."""


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Estimated pose of a camera."""

    pose_world_camera: np.ndarray
    """Pose of the camera (OpenCV: x right, y down, z forward), world frame, shape [7]."""
    residual: float
    """RMS distance between detected and predicted corners [m]."""
    position_deviation: float
    """Standard deviation of the camera's position, estimated from the data [m]."""
    rotation_deviation: float
    """Standard deviation of the camera's rotation, estimated from the data [rad]."""


def find_corners(color: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """Detect the inner corners of the board in an image, with OpenCV (extra ``calibration``).

    Args:
        color: RGB, uint8, shape [H, W, 3].

    Returns:
        corners, board frame [m], shape [K, 3], and image [pixels], shape [K, 2]; K = 0 without a board.

    Raises:
        RobotError: OpenCV is not installed.
        FungraspError: no such dictionary of markers.
    """
    cv2 = import_client("cv2", "calibration", "finding a calibration board")
    gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    if not hasattr(cv2.aruco, board.dictionary):
        raise FungraspError(f"OpenCV has no dictionary of markers '{board.dictionary}': try DICT_4X4_50")
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    size = board.columns, board.rows
    charuco = cv2.aruco.CharucoBoard(size, board.square, board.marker, dictionary)
    pixels, numbers, *_ = cv2.aruco.CharucoDetector(charuco).detectBoard(gray)
    if numbers is None or not len(numbers):
        return np.zeros((0, 3)), np.zeros((0, 2))
    points = np.asarray(charuco.getChessboardCorners(), dtype=float)[np.ravel(numbers)]
    return points, np.asarray(pixels, dtype=float).reshape(-1, 2)


def calibrate_from_board(views: Sequence[BoardView], intrinsics: Intrinsics) -> CameraCalibration:
    """Estimate the pose of the camera.

    Args:
        views: five or more, with the palm turned about different axes.
        intrinsics: of the camera, for images without distortion.

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
    start = _start(np.stack([view.palm for view in views]), boards)
    best, missed = _refined(start, views, intrinsics)
    # Jackknife over whole views, as an error of the arm shifts all corners of an image together.
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
    return CameraCalibration(_moved(start[0], best[:6]), residual, place, turn)


def board_pose(view: BoardView, intrinsics: Intrinsics) -> np.ndarray:
    """Return the board pose in the camera by the homography of its plane, shape [7]; exact without noise."""
    rays = intrinsics.deproject(view.pixels, np.ones(len(view.pixels)))[:, :2]
    scale = np.abs(view.points[:, :2]).max()
    rows = []
    for (x, y), (u, v) in zip(view.points[:, :2] / scale, rays, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    h = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3) / [scale, scale, 1.0]
    h *= np.copysign(1.0, h[2, 2]) / np.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1]))
    # SciPy takes the rotation nearest to a matrix.
    turn = Rotation.from_matrix(np.stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])], axis=1))
    return np.concatenate([h[:, 2], turn.as_quat(scalar_first=True)])


def save_calibration(path: str | Path, found: CameraCalibration, source: str) -> None:
    """Write a calibration as TOML, for ``tracker.calibration`` of a cell. source: origin, for people."""
    pose = ", ".join(f"{value:.7g}" for value in found.pose_world_camera)
    lines = [
        f"# Camera of a cell, from {source}. Name this file as 'calibration' under [tracker] of the cell.",
        f"pose_world_camera = [{pose}] # [m], wxyz",
        f"calibration_residual = {found.residual:.6g} # [m]",
        f"position_deviation = {found.position_deviation:.6g} # [m]",
        f"rotation_deviation = {found.rotation_deviation:.6g} # [rad]",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _start(palms: np.ndarray, boards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return initial poses of the camera in the world and of the board on the palm, shape [7] each. palms: in
    the world, shape [V, 7]; boards: in the camera, shape [V, 7]."""
    pairs = list(combinations(range(len(palms)), 2))
    of_palm, of_board = (
        np.array([rotation_vector(compose(invert(poses[i]), poses[j])[3:]) for i, j in pairs])
        for poses in (palms, boards)
    )
    with warnings.catch_warnings():
        # Turns about a single axis cause a warning here; the uncertainty of the result reveals them.
        warnings.simplefilter("ignore")
        board = Rotation.align_vectors(of_palm, of_board)[0].as_quat(scalar_first=True)
    # X = P_i B C_i^-1 for each view: mean of the rotations, then t_X - P_i t_B = t_P - X t_C for positions.
    left = Rotation.from_quat(palms[:, 3:], scalar_first=True)
    turned = Rotation.from_quat(boards[:, 3:], scalar_first=True)
    camera = (left * Rotation.from_quat(board, scalar_first=True) * turned.inv()).mean()
    system = np.concatenate([np.hstack([np.eye(3), -p]) for p in left.as_matrix()])
    right = (palms[:, :3] - camera.apply(boards[:, :3])).ravel()
    places = np.linalg.lstsq(system, right, rcond=None)[0]
    camera = np.concatenate([places[:3], camera.as_quat(scalar_first=True)])
    return camera, np.concatenate([places[3:], board])


def _refined(
    start: tuple[np.ndarray, np.ndarray],
    views: Sequence[BoardView],
    intrinsics: Intrinsics,
    changes: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes of camera and board that fit the corners best, shape [12], and the errors [pixels].
    start: initial poses of both; changes: initial changes."""
    focal, middle = [intrinsics.fx, intrinsics.fy], [intrinsics.cx, intrinsics.cy]

    def missed(parameters: np.ndarray) -> np.ndarray:
        x, b = _moved(start[0], parameters[:6]), _moved(start[1], parameters[6:])
        parts = []
        for view in views:
            seen = transform_points(compose(compose(invert(x), view.palm), b), view.points)
            # Points behind the camera get a large error that leads back.
            depth = np.maximum(seen[:, 2:], 0.01)
            parts.append((seen[:, :2] / depth * focal + middle - view.pixels).ravel())
        return np.concatenate(parts)

    begin = np.zeros(12) if changes is None else changes
    # A centimeter and a hundredth of a radian move corners about equally far.
    from scipy.optimize import least_squares

    found = least_squares(missed, begin, loss="soft_l1", f_scale=OUTLIER, x_scale=0.01)
    return found.x, missed(found.x)


def _moved(pose: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Move a pose. change: translation [m] and rotation vector [rad], world frame, shape [6]."""
    turn = np.concatenate([np.zeros(3), quaternion_from_rotation_vector(change[3:])])
    turned = compose(turn, np.concatenate([np.zeros(3), pose[3:]]))
    return np.concatenate([pose[:3] + change[:3], turned[3:]])

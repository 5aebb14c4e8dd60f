"""Finds a calibration board's corners in images, with OpenCV (extra ``calibration``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.robots.optional_packages import import_client


@dataclass(frozen=True)
class Board:
    """A ChArUco board as OpenCV generates it, or a checkerboard."""

    columns: int = 7
    """Squares along x."""
    rows: int = 5
    """Squares along y."""
    square: float = 0.03
    """Side of a square, measured on the print [m]."""
    marker: float = 0.022
    """Side of a marker, measured on the print [m]; 0: a checkerboard without markers, which must be seen
    whole."""
    dictionary: str = "DICT_4X4_50"
    """Of the markers (OpenCV's name)."""

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or not 0 <= self.marker < self.square:
            raise FungraspError(
                "a board has 3 or more squares to each side, and markers smaller than its squares"
            )


def find_corners(color: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """Inner corners of the board in an image.

    Args:
        color: RGB, uint8, shape [H, W, 3].
        board: what to look for.

    Returns:
        corners, board frame [m], shape [K, 3], and where they are [pixels], shape [K, 2]; K = 0 where the
        board was not found.

    Raises:
        RobotError: OpenCV is not installed.
        FungraspError: no such dictionary of markers.
    """
    cv2 = import_client("cv2", "calibration", "finding a calibration board")
    gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    nothing = np.zeros((0, 3)), np.zeros((0, 2))
    if board.marker == 0:
        inner = board.columns - 1, board.rows - 1
        there, pixels = cv2.findChessboardCornersSB(gray, inner)
        if not there:
            return nothing
        x, y = np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
        flat = board.square * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        return flat, pixels.reshape(-1, 2).astype(float)
    if not hasattr(cv2.aruco, board.dictionary):
        raise FungraspError(f"OpenCV has no dictionary of markers '{board.dictionary}': try DICT_4X4_50")
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    size = board.columns, board.rows
    charuco = cv2.aruco.CharucoBoard(size, board.square, board.marker, dictionary)
    pixels, numbers, *_ = cv2.aruco.CharucoDetector(charuco).detectBoard(gray)
    if numbers is None or not len(numbers):
        return nothing
    points = np.asarray(charuco.getChessboardCorners(), dtype=float)[np.ravel(numbers)]
    return points, np.asarray(pixels, dtype=float).reshape(-1, 2)

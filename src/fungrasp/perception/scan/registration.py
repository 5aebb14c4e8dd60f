"""Where the views of an object are to each other: turned about the table's normal and shifted along it.

The table gives each view its height and tilt, so that three numbers are left. What is printed on the table
under the object tells them: seen from above, two views of it are turned and shifted against each other, and
where they correlate best is found with the Fourier transform. The object itself does not tell: round ones
look alike all round, and different sides of others fit onto each other well enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares

from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.perception.scan.table_view import TableView

TOP_CELL, TOP_HALF = 0.004, 0.24
"""Cell and half the edge of the picture of the table from above [m]."""

ON_TABLE = 0.006
"""What is so near to the table's plane [m] is printed on it."""

FINEST = 0.012
"""Shades that change over more than about this way [m] are left out: light and shadow don't move with the
table."""

STEPS = np.radians(np.arange(-60.0, 61.0, 4.0))
"""Turns from one view to the next that are tried [rad]."""

CLOSER = np.radians(np.arange(-3.0, 3.1, 0.5))
"""Turns that are tried about the best of them [rad]."""

LEAST_OVERLAP = 0.15
"""Pictures overlap by this part of the smaller one at least."""


def view_from_above(view: TableView) -> tuple[np.ndarray, np.ndarray]:
    """The table's print seen from above, without light and shadow.

    Returns:
        Brightness less its surroundings, and where the table was seen, both shape [S, S]; rows along x and
        columns along y of the view's table frame, the middle at its origin.
    """
    size = 2 * int(TOP_HALF / TOP_CELL)
    along = (np.arange(size) - (size - 1) / 2) * TOP_CELL
    x, y = np.meshgrid(along, along, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(size * size)], axis=1)
    there = inverse_transform_points(view.pose_table_camera, points)
    pixels = view.capture.intrinsics.project(there)
    height, width = view.capture.depth.shape
    inside: np.ndarray = np.asarray(
        np.isfinite(pixels).all(axis=1)
        & (pixels >= 1).all(axis=1)
        & (pixels <= [width - 2, height - 2]).all(axis=1)
    )
    u, v = np.where(inside[:, None], np.nan_to_num(pixels), 0.0).T
    depth = view.depth[np.rint(v).astype(int), np.rint(u).astype(int)]
    height_off = np.abs(depth / np.maximum(there[:, 2], 1e-6) - 1.0) * np.abs(view.pose_table_camera[2])
    seen = (inside & (depth > 0) & (height_off < ON_TABLE)).reshape(size, size)
    gray = ndimage.map_coordinates(view.capture.color.mean(axis=-1), [v, u], order=1).reshape(size, size)
    wide = FINEST / TOP_CELL
    known = ndimage.gaussian_filter(seen.astype(float), wide)
    mean = ndimage.gaussian_filter(np.where(seen, gray, 0.0), wide) / np.maximum(known, 1e-3)
    return np.where(seen, gray - mean, 0.0), seen


def match_prints(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]
) -> tuple[float, np.ndarray, float]:
    """How the print of one view lies on that of another.

    Args:
        first, second: as ``view_from_above`` gives them.

    Returns:
        Turn [rad] and then shift [m], shape [2], that take the second onto the first, and how well they
        correlate there,
        -1 to 1.
    """
    spectra = _spectra(*first)
    best = max((_correlated(spectra, second, float(turn)) for turn in STEPS), key=lambda found: found[2])
    closer = (_correlated(spectra, second, float(best[0] + turn)) for turn in CLOSER)
    return max(closer, key=lambda found: found[2])


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Fourier transforms of a picture, of where it is seen, and of its square; padded to twice its edge."""

    image: np.ndarray
    seen: np.ndarray
    square: np.ndarray
    count: float
    """Pixels that are seen."""


def _spectra(image: np.ndarray, seen: np.ndarray) -> _Spectra:
    shape = (2 * len(image), 2 * len(image))
    image, known = np.where(seen, image, 0.0), seen.astype(float)
    image_spectrum, seen_spectrum, square_spectrum = (
        np.fft.rfft2(part, shape) for part in (image, known, image**2)
    )
    return _Spectra(image_spectrum, seen_spectrum, square_spectrum, float(known.sum()))


def _correlated(
    first: _Spectra, second: tuple[np.ndarray, np.ndarray], turn: float
) -> tuple[float, np.ndarray, float]:
    """The best shift of a turned picture, by correlation over where both are seen (Padfield, 2012)."""
    size = len(second[0])
    image, seen = (_turned(part.astype(float), turn) for part in second)
    other = _spectra(image, seen > 0.9)

    def correlation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.fft.irfft2(a * np.conj(b), (2 * size, 2 * size))

    overlap = correlation(first.seen, other.seen)
    squares = correlation(first.square, other.seen), correlation(first.seen, other.square)
    energy = np.sqrt(np.maximum(squares[0], 1e-6) * np.maximum(squares[1], 1e-6))
    enough = overlap > LEAST_OVERLAP * min(first.count, other.count)
    score = np.where(enough, correlation(first.image, other.image) / np.maximum(energy, 1e-3), -1.0)
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    away = [(k if k < size else k - 2 * size) for k in (int(row), int(column))]
    return turn, np.array(away) * TOP_CELL, float(score[row, column])


def _turned(image: np.ndarray, turn: float) -> np.ndarray:
    """A picture from above turned counter-clockwise about its middle (rows are x, columns y)."""
    c, s = np.cos(turn), np.sin(turn)
    # What is at p afterwards was at R^T p before.
    back = np.array([[c, s], [-s, c]])
    middle = (np.array(image.shape) - 1) / 2
    offset: Any = middle - back @ middle
    return ndimage.affine_transform(image, back, offset, order=1)


def refined(
    yaw: np.ndarray, shift: np.ndarray, pairs: Sequence[tuple[int, int, float, np.ndarray, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Turns and shifts of all views that meet those between pairs of them best.

    Args:
        yaw: first guesses [rad], shape [views].
        shift: [m], shape [views, 2].
        pairs: number of the first and the second view, turn [rad] and shift [m] of the second onto the
            first, and how well they correlate.
    """
    count = len(yaw)

    def residual(state: np.ndarray) -> np.ndarray:
        turns = np.append(0.0, state[: count - 1])
        places = np.concatenate([np.zeros((1, 2)), state[count - 1 :].reshape(-1, 2)])
        parts = []
        for i, k, turn, way, score in pairs:
            there = places[i] + _rotation(turns[i]) @ way
            angle = (turns[k] - turns[i] - turn + np.pi) % (2 * np.pi) - np.pi
            # A turn of 10 mrad moves what is 10 cm away as far as a shift of 1 mm.
            parts.append(score * np.append(0.1 * angle, places[k] - there) / 0.001)
        return np.concatenate(parts)

    start = np.concatenate([yaw[1:] - yaw[0], shift[1:].ravel()])
    found = np.asarray(least_squares(residual, start, loss="soft_l1").x)
    return np.append(0.0, found[: count - 1]), np.concatenate(
        [np.zeros((1, 2)), found[count - 1 :].reshape(-1, 2)]
    )


def turn_points(yaw: float, points: np.ndarray) -> np.ndarray:
    """Points turned about z. Both: shape [P, 3]."""
    turn = np.eye(3)
    turn[:2, :2] = _rotation(yaw)
    return points @ turn.T


def _rotation(yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])

"""The few directions in which light is sampled, and how what was found is averaged over pixels."""

from __future__ import annotations

import numpy as np

PATTERN = 4
"""Every second pixel of a square of this side takes a sample of its own; they are shared. Neighboring
squares take samples that lie between one another."""

_SAMPLES = PATTERN * PATTERN // 2
_TOWARDS = np.array([0, 5, 3, 6, 4, 1, 7, 2])
_AROUND = np.array([2, 7, 4, 1, 6, 3, 0, 5])

PASSES = (
    ((-2, -1, 0, 1), (1.0, 1.0, 1.0, 1.0)),
    ((-5, -2, 1, 4, 7), (1.0, 2.0, 3.0, 2.0, 1.0)),
)
"""How samples are averaged over neighbors: first over the pattern, so that it cancels, then wider; offsets of
rows and columns, and their weights."""


def sampled_pixels(height: int, width: int) -> np.ndarray:
    """Which pixels take a sample, row by row, shape [height * width] bool."""
    return (np.add.outer(np.arange(height), np.arange(width)) % 2 == 0).ravel()


def pixel_samples(pixels: np.ndarray, width: int) -> np.ndarray:
    """Which of ``DISC`` a pixel takes for a round light, and for the directions about a normal, as dense as
    their cosine with it. pixels: numbered row by row, shape [R]. Returns shape [R, 2]."""
    v, u = np.divmod(pixels, width)
    place = v % PATTERN * 2 + u % PATTERN // 2
    other = _SAMPLES * ((u // PATTERN + v // PATTERN) % 2)
    return np.stack([_TOWARDS[place] + other, _AROUND[place] + other], axis=-1)


def _spirals() -> np.ndarray:
    k = np.arange(_SAMPLES)
    radius = np.sqrt((np.concatenate([k + 0.25, k + 0.75])) / _SAMPLES)
    angle = np.concatenate([k, k + 0.5]) * np.pi * (3 - np.sqrt(5)) + np.repeat([0.0, np.pi / 2], _SAMPLES)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


DISC = _spirals()
"""Samples of the unit disc, shape [16, 2]."""


def axes_along(z: np.ndarray) -> np.ndarray:
    """Rotations whose third axis (column) is ``z`` (Duff et al. 2017). z: unit, shape [P, 3]. Returns [P, 3,
    3].
    """
    sign = np.where(z[:, 2] >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z[:, 2])
    b = z[:, 0] * z[:, 1] * a
    result = np.empty((len(z), 3, 3))
    result[:, 0, 0], result[:, 1, 0], result[:, 2, 0] = 1 + sign * z[:, 0] ** 2 * a, sign * b, -sign * z[:, 0]
    result[:, 0, 1], result[:, 1, 1], result[:, 2, 1] = b, sign + z[:, 1] ** 2 * a, -z[:, 1]
    result[:, :, 2] = z
    return result

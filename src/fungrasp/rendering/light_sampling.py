"""The few directions in which light is sampled, and the average over neighboring pixels of what was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

PATTERN = 4
"""Every second pixel of a square of this side takes a sample of its own; they are shared. Neighboring
squares take samples that lie between one another."""

_SAMPLES = PATTERN * PATTERN // 2
_TOWARDS = np.array([0, 5, 3, 6, 4, 1, 7, 2])
_AROUND = np.array([2, 7, 4, 1, 6, 3, 0, 5])

_NOWHERE = -9
_PASSES = (
    tuple((offset, 1) for offset in (-2, -1, 0, 1)),
    tuple(zip((-5, -2, 1, 4, 7), (1, 2, 3, 2, 1), strict=True)),
)


def sampled_pixels(height: int, width: int) -> np.ndarray:
    """Which pixels take a sample, row by row, shape [height * width] bool."""
    return (np.add.outer(np.arange(height), np.arange(width)) % 2 == 0).ravel()


def disc_sample(pixels: np.ndarray) -> np.ndarray:
    """Sample in the unit disc, as for a round light. pixels: (u, v), shape [P, 2]. Returns shape [P, 2]."""
    return _DISC[_sample(pixels, _TOWARDS)]


def hemisphere_sample(pixels: np.ndarray) -> np.ndarray:
    """Sample of the directions about z, as dense as their cosine with it. pixels: (u, v), shape [P, 2].
    Returns unit vectors, shape [P, 3]."""
    points = np.concatenate([_DISC, np.sqrt(1 - np.sum(_DISC**2, -1, keepdims=True))], axis=-1)
    return points[_sample(pixels, _AROUND)]


def _sample(pixels: np.ndarray, order: np.ndarray) -> np.ndarray:
    u, v = pixels.T
    return order[v % PATTERN * 2 + u % PATTERN // 2] + _SAMPLES * ((u // PATTERN + v // PATTERN) % 2)


def _spirals() -> np.ndarray:
    k = np.arange(_SAMPLES)
    radius = np.sqrt((np.concatenate([k + 0.25, k + 0.75])) / _SAMPLES)
    angle = np.concatenate([k, k + 0.5]) * np.pi * (3 - np.sqrt(5)) + np.repeat([0.0, np.pi / 2], _SAMPLES)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


_DISC = _spirals()


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


def average_over_neighbors(
    values: Sequence[np.ndarray],
    mask: np.ndarray,
    known: np.ndarray,
    surface: np.ndarray,
    distance: np.ndarray,
) -> list[np.ndarray]:
    """Average over the neighbors that see the same surface: first over the pattern, so that it cancels, then
    wider.

    Args:
        values: each of shape [H, W].
        mask: where the values are to be averaged, shape [H, W] bool.
        known: where they were sampled, shape [H, W] bool.
        surface: id of what is seen; a negative one is flat, shape [H, W].
        distance: of what is seen [m], shape [H, W].

    Returns:
        the averaged values, each of shape [H, W].
    """
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return list(values)
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    near_surface = surface[box]
    near_distance = np.where(near_surface >= 0, distance[box], 0).astype(np.float32)
    result = [value[box] for value in values]
    for sampled, kernel in zip((known[box], np.ones_like(known[box])), _PASSES, strict=True):
        result = _averaged(result, sampled, kernel, near_surface, near_distance)
    whole = [value.copy() for value in values]
    for full, part in zip(whole, result, strict=True):
        full[box] = np.where(mask[box], part, full[box])
    return whole


def _averaged(
    values: list[np.ndarray],
    known: np.ndarray,
    kernel: tuple[tuple[int, int], ...],
    surface: np.ndarray,
    distance: np.ndarray,
) -> list[np.ndarray]:
    pad = max(abs(offset) for offset, _ in kernel)
    height, width = surface.shape
    padded = [np.pad(value, pad) for value in values]
    near_surface = np.pad(np.where(known, surface, _NOWHERE), pad, constant_values=_NOWHERE)
    near_distance = np.pad(distance, pad)
    limit = 0.008 * distance + 1e-6
    weight = np.zeros((height, width), np.float32)
    sums = [np.zeros_like(weight) for _ in values]
    for dy, ky in kernel:
        for dx, kx in kernel:
            at = np.s_[pad + dy : pad + dy + height, pad + dx : pad + dx + width]
            same = (near_surface[at] == surface) & (np.abs(near_distance[at] - distance) <= limit)
            part = same * np.float32(kx * ky)
            weight += part
            for total, value in zip(sums, padded, strict=True):
                total += part * value[at]
    found = weight > 0
    weight[~found] = 1.0
    return [np.where(found, total / weight, value) for total, value in zip(sums, values, strict=True)]

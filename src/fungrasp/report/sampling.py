"""The few directions in which light is sampled, and how neighbouring pixels share what they found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

PATTERN = 4
"""Neighbouring pixels, this many in a row and a column, take different samples and share them."""

TOWARDS = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
"""Which sample of the key light a pixel of the pattern takes."""

AROUND = np.array([5, 13, 7, 15, 9, 1, 11, 3, 6, 14, 4, 12, 10, 2, 8, 0])
"""Which sample of the surroundings a pixel of the pattern takes."""

_PASSES = (
    tuple((offset, 1) for offset in (-2, -1, 0, 1)),
    tuple(zip((-5, -2, 1, 4, 7), (1, 2, 3, 2, 1), strict=True)),
)


def disc() -> np.ndarray:
    """Points spread evenly over the unit disc, shape [PATTERN ** 2, 2]."""
    count = PATTERN * PATTERN
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def hemisphere() -> np.ndarray:
    """Unit vectors about z, as dense as their cosine with it, shape [PATTERN ** 2, 3]."""
    points = disc()
    return np.concatenate([points, np.sqrt(1 - np.sum(points**2, -1, keepdims=True))], axis=-1)


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


def share(
    values: Sequence[np.ndarray], mask: np.ndarray, surface: np.ndarray, distance: np.ndarray
) -> list[np.ndarray]:
    """Average over the neighbours that see the same surface: first over the pattern, so that it cancels, then
    wider.

    Args:
        values: each of shape [H, W].
        mask: where the values are to be averaged, shape [H, W] bool.
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
    for kernel in _PASSES:
        result = _averaged(result, kernel, near_surface, near_distance)
    whole = [value.copy() for value in values]
    for full, part in zip(whole, result, strict=True):
        full[box] = np.where(mask[box], part, full[box])
    return whole


def _averaged(
    values: list[np.ndarray], kernel: tuple[tuple[int, int], ...], surface: np.ndarray, distance: np.ndarray
) -> list[np.ndarray]:
    pad = max(abs(offset) for offset, _ in kernel)
    height, width = surface.shape
    padded = [np.pad(value, pad) for value in values]
    near_surface, near_distance = np.pad(surface, pad, constant_values=-9), np.pad(distance, pad)
    limit = 0.008 * distance + 1e-6
    weight = np.zeros((height, width), np.float32)
    sums = [np.zeros_like(weight) for _ in values]
    for dy, ky in kernel:
        for dx, kx in kernel:
            at = np.s_[pad + dy : pad + dy + height, pad + dx : pad + dx + width]
            same = (near_surface[at] == surface) & (np.abs(near_distance[at] - distance) <= limit)
            share = same * np.float32(kx * ky)
            weight += share
            for total, value in zip(sums, padded, strict=True):
                total += share * value[at]
    return [
        np.where(weight > 0, total / np.maximum(weight, 1), value)
        for total, value in zip(sums, values, strict=True)
    ]

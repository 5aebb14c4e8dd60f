"""Where a part of the hand cannot be: at pixels that see something farther away than that part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

STEP = 2
"""Distances are looked at so many pixels apart: silhouettes are not known better."""

NOWHERE = -1e3
"""Distance to the background of a level that has none [pixels]."""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Distances in the image to the background of a hand, for parts of it at different depths."""

    corner: np.ndarray
    """Top left pixel ``[u v]`` of the part of the image that was looked at, shape [2]."""
    depths: np.ndarray
    """Parts nearer than this [m] belong to a level, ascending, shape [L]."""
    fields: np.ndarray
    """Distance into the background of each level, negative outside it [pixels], at every ``STEP``-th pixel,
    shape [L, h, w]."""

    @classmethod
    def around(
        cls,
        depth: np.ndarray,
        pixels: np.ndarray,
        parts: np.ndarray,
        levels: int,
        behind: float,
        margin: int = 40,
    ) -> Silhouettes:
        """Look at the image around a hand.

        Args:
            depth: of the image [m], shape [H, W]; NaN: none, taken for anything.
            pixels: of the hand's parts, shape [P, 2].
            parts: their depths [m], shape [P].
            levels: how many depths of parts are told apart.
            behind: what is farther than a part by this [m] is background to it.
            margin: looked at around the parts [pixels].
        """
        edge = np.array(depth.shape[::-1])
        low = np.clip(np.floor(pixels.min(axis=0)) - margin, 0, edge - 2).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)) + margin, low + 2, edge).astype(int)
        crop = depth[low[1] : high[1] : STEP, low[0] : high[0] : STEP]
        depths = np.quantile(parts, np.arange(1, levels + 1) / levels)
        return cls(low, depths, np.stack([_field(crop > limit + behind) for limit in depths]))

    def distance(self, pixels: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How deep each part is in the background.

        Args:
            pixels: shape [P, 2].
            parts: depths of the parts [m], shape [P].

        Returns:
            [pixels], shape [P], negative where it is not; its slope, shape [P, 2]; both 0 for parts beyond
            what was looked at.
        """
        level = np.minimum(np.searchsorted(self.depths, parts), len(self.depths) - 1)
        local = (pixels - self.corner) / STEP
        height, width = self.fields.shape[1:]
        inside = np.all((local >= 0) & (local < [width - 1, height - 1]), axis=1)
        local = np.where(inside[:, None], local, 0.0)
        cell = local.astype(int)
        x, y = (local - cell).T
        near = [self.fields[level, cell[:, 1] + i, cell[:, 0] + j] for i in (0, 1) for j in (0, 1)]
        top, bottom = near[0] + x * (near[1] - near[0]), near[2] + x * (near[3] - near[2])
        across = (1 - y) * (near[1] - near[0]) + y * (near[3] - near[2])
        value = np.where(inside, top + y * (bottom - top), 0.0)
        return value, np.stack([across, bottom - top], axis=1) * inside[:, None] / STEP


def _field(background: np.ndarray) -> np.ndarray:
    if not background.any():
        return np.full(background.shape, NOWHERE)
    inside, outside = (np.asarray(ndimage.distance_transform_edt(part)) for part in (background, ~background))
    return STEP * (inside - outside)

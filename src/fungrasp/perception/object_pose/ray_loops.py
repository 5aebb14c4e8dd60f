"""Which rays may meet an object in many poses, in compiled loops."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.compiling import compiled


@compiled
def count_rays(slopes: np.ndarray, middles: np.ndarray, least: np.ndarray, counts: np.ndarray) -> None:
    """Write how many rays pass the sphere round the object in each of H poses.

    Args:
        slopes: unit vectors along the rays from the camera's center, shape [R, 3].
        middles: of the spheres [m], camera frame, shape [H, 3].
        least: a ray that passes a sphere has its middle so far along it at least [m], shape [H].
        counts: int64, shape [H].
    """
    for h in range(len(middles)):
        count = np.int64(0)
        x, y, z, limit = middles[h, 0], middles[h, 1], middles[h, 2], least[h]
        for r in range(len(slopes)):
            if slopes[r, 0] * x + slopes[r, 1] * y + slopes[r, 2] * z >= limit:
                count += 1
        counts[h] = count


@compiled
def local_rays(
    slopes: np.ndarray,
    middles: np.ndarray,
    least: np.ndarray,
    directions: np.ndarray,
    axes: np.ndarray,
    pose: np.ndarray,
    ray: np.ndarray,
    local: np.ndarray,
) -> None:
    """Write pose and ray of each ray that passes a sphere, int64, shape [N], and its direction as the object
    sees it, float32, shape [N, 3].

    Args: as of ``count_rays``; directions: the rays, of any length, shape [R, 3]; axes: of the object, as
    columns, shape [H, 3, 3].
    """
    n = np.int64(0)
    for h in range(len(middles)):
        x, y, z, limit, a = middles[h, 0], middles[h, 1], middles[h, 2], least[h], axes[h]
        for r in range(len(slopes)):
            if slopes[r, 0] * x + slopes[r, 1] * y + slopes[r, 2] * z >= limit:
                u, v, w = directions[r, 0], directions[r, 1], directions[r, 2]
                pose[n], ray[n] = h, r
                for i in range(3):
                    local[n, i] = u * a[0, i] + v * a[1, i] + w * a[2, i]
                n += 1

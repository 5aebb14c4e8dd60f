"""Pinhole cameras: view rays, projection, and cameras that frame points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.media.ray_tracing import PixelRays


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with square pixels and the principal point in the middle of the image.

    Camera frame: OpenCV (x right, y down, z forward). The center of pixel (column u, row v) has image
    coordinates (u, v).
    """

    position: tuple[float, float, float]
    """Position of the camera [m], world frame."""
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point in the middle of the image [m], world frame."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction that points up in the image, world frame, of any length and not along the view."""
    fov_y: float = 35.0
    """Vertical field of view [degrees], between 0 and 180."""
    width: int = 640
    """Image width [pixels]."""
    height: int = 480
    """Image height [pixels]."""

    def __post_init__(self) -> None:
        numbers = np.asarray([*self.position, *self.target, *self.up, self.fov_y], dtype=float)
        if numbers.shape != (10,) or not np.isfinite(numbers).all():
            raise FungraspError("a camera's position, target and up are 3 finite numbers each")
        if not 0.0 < self.fov_y < 180.0:
            raise FungraspError(f"a camera's fov_y must lie between 0 and 180 degrees, not {self.fov_y}")
        if self.width < 1 or self.height < 1:
            raise FungraspError(f"a camera needs at least one pixel, not {self.width} x {self.height}")
        view = np.subtract(self.target, self.position)
        if np.linalg.norm(np.cross(view, self.up)) < 1e-9 * max(1.0, float(np.linalg.norm(view))):
            raise FungraspError("a camera's up must not be along its view, nor its target be its position")

    @property
    def focal(self) -> float:
        """Focal length [pixels], the same in x and y."""
        return 0.5 * self.height / float(np.tan(0.5 * np.radians(self.fov_y)))

    @property
    def rotation(self) -> np.ndarray:
        """Camera axes (right, down, forward) as columns, world frame, shape [3, 3]."""
        forward = np.subtract(self.target, self.position).astype(float)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward], axis=1)

    def directions(self, pixels: np.ndarray) -> np.ndarray:
        """Return unit view directions through image points, world frame, shape [..., 3]. pixels: (u, v),
        shape [..., 2]."""
        x = (pixels[..., 0] - 0.5 * (self.width - 1)) / self.focal
        y = (pixels[..., 1] - 0.5 * (self.height - 1)) / self.focal
        size = 1.0 / np.sqrt(x * x + y * y + 1.0)
        x, y = x * size, y * size
        result = np.empty((*x.shape, 3), x.dtype)
        for i, (right, down, forward) in enumerate(self.rotation.tolist()):
            result[..., i] = right * x + down * y + forward * size
        return result

    def rays(self) -> PixelRays:
        """Return the parameters for the ray tracer."""
        return _rays(self)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points to the image.

        Args:
            points: [m], world frame, shape [..., 3].

        Returns:
            pixels (u, v), shape [..., 2]; depth along the view [m], shape [...], negative behind the camera.
        """
        local = (np.asarray(points, dtype=float) - self.position) @ self.rotation
        depth = local[..., 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        center = 0.5 * np.array([self.width - 1, self.height - 1])
        return local[..., :2] / safe[..., None] * self.focal + center, depth


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> PixelRays:
    """Cache rays, because most cameras of a video are equal."""
    position = np.array(camera.position, dtype=float)
    return PixelRays(camera.width, camera.height, position, camera.focal, camera.directions)


def orbit_camera(
    target: Sequence[float],
    distance: float,
    azimuth: float,
    elevation: float,
    *,
    fov_y: float = 30.0,
    width: int = 640,
    height: int = 480,
) -> Camera:
    """Return a camera on a sphere around ``target``.

    Args:
        target: [m], world frame, length 3.
        distance: distance from the target [m].
        azimuth: azimuth of the camera seen from the target, from the world's x toward y [degrees].
        elevation: elevation of the camera above the horizontal [degrees], below 90.
    """
    a, e = np.radians(azimuth), np.radians(elevation)
    offset = distance * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    x, y, z = (float(v) for v in target)
    px, py, pz = (float(v) for v in np.add(target, offset))
    return Camera((px, py, pz), (x, y, z), fov_y=fov_y, width=width, height=height)


def fit_camera(
    points: np.ndarray,
    azimuth: float,
    elevation: float,
    *,
    width: int = 640,
    height: int = 480,
    margin: float = 1.12,
) -> Camera:
    """Return the nearest orbit camera that frames all points, centered.

    Args:
        points: [m], world frame, shape [P, 3].
        azimuth: as for ``orbit_camera`` [degrees].
        elevation: as for ``orbit_camera`` [degrees].
        margin: ratio of the image size to the size of the contents.
    """
    probe = orbit_camera((0.0, 0.0, 0.0), 1.0, azimuth, elevation, width=width, height=height)
    axes = probe.rotation
    local = np.asarray(points, dtype=float) @ axes
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    tangent = np.tan(0.5 * np.radians(probe.fov_y)) / margin * np.array([width / height, 1.0])
    reach = np.abs(local[:, :2] - middle[:2]) / tangent - (local[:, 2:] - middle[2])
    return orbit_camera(axes @ middle, float(reach.max()), azimuth, elevation, width=width, height=height)

"""Deterministic rendering of MuJoCo models on the CPU: ray traced and anti-aliased."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeVar

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.media.camera import Camera
from fungrasp.media.ray_tracing import NOTHING, TABLE, Look, RayTracer, SeenPoints, sun_direction, to_bytes
from fungrasp.media.surfaces import SurfaceMesh, drawn_geoms, geom_surface, linear, model_materials

__all__ = ["NOTHING", "TABLE", "Renderer", "Views", "render"]

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Views:
    """F images of H x W pixels. Depth and segmentation are those of the pixel centers."""

    color: np.ndarray
    """Colors, sRGB, shape [F, H, W, 3] uint8."""
    depth: np.ndarray
    """Distance along the camera's z [m], 0 for the backdrop, shape [F, H, W] float32."""
    segmentation: np.ndarray
    """Geom id, ``NOTHING`` (-1) or ``TABLE`` (-2) of each pixel, shape [F, H, W] int32."""


def render(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    camera: Camera | Sequence[Camera],
    *,
    look: Look | None = None,
    shadows: bool = True,
    antialias: int = 2,
    threads: int = 0,
) -> np.ndarray:
    """Render color images of a model in given states. Create a ``Renderer`` for repeated calls.

    Returns:
        sRGB, shape [F, H, W, 3] uint8 (F = 1 for a single state).
    """
    renderer = Renderer(model, look=look, shadows=shadows, antialias=antialias, threads=threads)
    return np.stack(list(renderer.stream(qpos, camera)))


class Renderer:
    """Renders the geoms of groups 0, 1 and 2 of a model, except planes, on a table top (the plane z = 0).
    Geoms are opaque, or invisible if their opacity is 0."""

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        look: Look | None = None,
        shadows: bool = True,
        antialias: int = 2,
        threads: int = 0,
    ):
        """
        Args:
            shadows: whether to cast shadows.
            antialias: n for n x n rays through the pixels on edges; 1 for none.
            threads: 0 for all CPUs; the result does not depend on it.

        Raises:
            FungraspError: ``antialias`` or ``threads`` is out of range.
        """
        if not 1 <= antialias <= 8:
            raise FungraspError(f"antialias must lie between 1 and 8, not {antialias}")
        if threads < 0:
            raise FungraspError(f"threads must not be negative, but is {threads}")
        self.model = model
        self._look, self._shadows, self._antialias = look or Look(), shadows, antialias
        self._threads = threads or os.cpu_count() or 1
        self._drawn = drawn_geoms(model)
        self._materials = model_materials(model)
        self._surfaces = {
            int(geom): geom_surface(model, int(geom), self._materials) for geom in np.flatnonzero(self._drawn)
        }

    def stream(
        self,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        *,
        geom_rgba: np.ndarray | None = None,
    ) -> Iterator[np.ndarray]:
        """Yield color images one by one, shape [H, W, 3] uint8. Only a few are in memory at a time.

        Args:
            qpos: joint positions, shape [F, nq] or [nq].
            camera: one for all frames or one per frame, all of one size. The first determines the position of
                the lamp.
            geom_rgba: sRGB and opacity (0 hides a geom), shape [ngeom, 4] or [F, ngeom, 4]; the model's
                colors and materials if None.

        Raises:
            FungraspError: an argument has the wrong shape or is not finite.
        """
        frames = self._frames(qpos, camera, geom_rgba)
        return (to_bytes(light) for light in self._each(self._light, frames))

    def views(
        self, qpos: np.ndarray, camera: Camera | Sequence[Camera], *, geom_rgba: np.ndarray | None = None
    ) -> Views:
        """Render images with depth and segmentation. Arguments and errors as for ``stream``."""
        seen = list(self._each(self._view, self._frames(qpos, camera, geom_rgba)))
        pictures, depths, segmentations = zip(*seen, strict=True)
        return Views(np.stack(pictures), np.stack(depths), np.stack(segmentations))

    def _light(self, frame: _Frame, points: SeenPoints | None = None) -> np.ndarray:
        """Return the linear light of a frame, shape [H, W, 3]."""
        rays = frame.camera.rays()
        points = points or frame.tracer.see(rays)
        return frame.tracer.picture(rays, points, shadows=self._shadows, antialias=self._antialias)

    def _view(self, frame: _Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return color, depth and segmentation of a frame."""
        points, camera = frame.tracer.see(frame.camera.rays()), frame.camera
        shape = (camera.height, camera.width)
        distance = np.where(points.surface == NOTHING, 0.0, points.distance)
        depth = (distance * (points.direction @ camera.rotation[:, 2])).astype(np.float32)
        # The indices NOTHING (-1) and TABLE (-2) select the last two elements.
        ids = np.array([*frame.geoms, TABLE, NOTHING], np.int32)[points.surface]
        return to_bytes(self._light(frame, points)), depth.reshape(shape), ids.reshape(shape)

    def _frames(
        self,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        geom_rgba: np.ndarray | None,
    ) -> Iterator[_Frame]:
        """Check the arguments and yield frames. Consecutive frames of one state share a tracer."""
        model = self.model
        qpos = np.atleast_2d(np.asarray(qpos, dtype=float))
        count = len(qpos)
        _check("qpos", qpos, (count, model.nq))
        cameras = [camera] * count if isinstance(camera, Camera) else list(camera)
        if count == 0 or len(cameras) != count:
            raise FungraspError(
                f"{len(cameras)} cameras were given for {count} frames; give one, or one each"
            )
        if len({(c.width, c.height) for c in cameras}) > 1:
            raise FungraspError("all cameras of a film must have the same number of pixels")
        colors = self._materials.colors if geom_rgba is None else np.asarray(geom_rgba, dtype=np.float32)
        colors = np.broadcast_to(colors, (count, *colors.shape)) if colors.ndim == 2 else colors
        _check("geom_rgba", colors, (count, model.ngeom, 4))
        look = replace(self._look, light=sun_direction(self._look, cameras[0].rotation))
        center = np.asarray(cameras[0].target[:2])

        def frames() -> Iterator[_Frame]:
            data, before = mujoco.MjData(model), None
            for i, view in enumerate(cameras):
                state = (qpos[i], colors[i])
                if before is None or not all(map(np.array_equal, state, before)):
                    geoms, surfaces = self._posed(data, *state)
                    tracer, before = RayTracer(surfaces, look, center), state
                yield _Frame(tracer, view, geoms)

        return frames()

    def _posed(
        self, data: mujoco.MjData, qpos: np.ndarray, colors: np.ndarray
    ) -> tuple[list[int], list[SurfaceMesh]]:
        """Return ids and surfaces of the visible geoms in a state."""
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        geoms = [geom for geom in self._surfaces if colors[geom, 3] > 0]
        surfaces = [
            replace(self._surfaces[g], color=linear(colors[g, :3])).moved(
                data.geom_xpos[g], data.geom_xmat[g].reshape(3, 3)
            )
            for g in geoms
        ]
        return geoms, surfaces

    def _each(self, function: Callable[[_Frame], _Result], frames: Iterator[_Frame]) -> Iterator[_Result]:
        """Yield results in the order of frames, computed by ``threads`` threads in the background."""
        with ThreadPoolExecutor(self._threads) as pool:
            begun = deque(pool.submit(function, frame) for frame in islice(frames, 2 * self._threads))
            while begun:
                result = begun.popleft().result()
                begun.extend(pool.submit(function, frame) for frame in islice(frames, 1))
                yield result


@dataclass(frozen=True)
class _Frame:
    """A state of the model with a camera."""

    tracer: RayTracer
    camera: Camera
    geoms: list[int]
    """Geom id of each surface."""


def _check(name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise FungraspError(f"{name} must have shape {shape}, not {values.shape}")
    if not np.isfinite(values).all():
        raise FungraspError(f"{name} has values that are not finite")

"""Pictures of MuJoCo models on the CPU: ray traced, softly lit, anti-aliased, the same bytes every time."""

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
    """What cameras see: F pictures of H x W pixels. Depth and segmentation are those of the pixels'
    centers.
    """

    color: np.ndarray
    """Pictures, sRGB, shape [F, H, W, 3] uint8."""
    depth: np.ndarray
    """Distance along the camera's z [m], 0 where nothing is seen, shape [F, H, W] float32."""
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
    """Color pictures of a model in given states; see ``Renderer``, which saves its preparations for more
    calls.

    Returns:
        sRGB, shape [F, H, W, 3] uint8 (F = 1 for a single state).
    """
    renderer = Renderer(model, look=look, shadows=shadows, antialias=antialias, threads=threads)
    return np.stack(list(renderer.stream(qpos, camera)))


class Renderer:
    """Draws the geoms of groups 0, 1 and 2 of a model, but planes, on a table top, the plane z = 0; all as if
    opaque, except those with an opacity of 0."""

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
            shadows: whether things shade one another.
            antialias: n for n x n rays through the pixels on edges; 1 for none.
            threads: 0 means all CPUs; the result does not depend on it.

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
        """Color pictures, one by one, shape [H, W, 3] uint8; no more than a few are held at once.

        Args:
            qpos: joint positions, shape [F, nq] or [nq].
            camera: one for all frames, or one each; all of one size. The first decides where the key light
                is.
            geom_rgba: sRGB and opacity (only whether it is 0 matters), shape [ngeom, 4] or [F, ngeom, 4];
                None for the model's colors and materials.

        Raises:
            FungraspError: an argument has the wrong shape, or is not finite.
        """
        frames = self._frames(qpos, camera, geom_rgba)
        return (to_bytes(light) for light in self._each(self._light, frames))

    def views(
        self, qpos: np.ndarray, camera: Camera | Sequence[Camera], *, geom_rgba: np.ndarray | None = None
    ) -> Views:
        """Pictures with depth and segmentation. Arguments and errors as ``stream``."""
        seen = list(self._each(self._view, self._frames(qpos, camera, geom_rgba)))
        pictures, depths, segmentations = zip(*seen, strict=True)
        return Views(np.stack(pictures), np.stack(depths), np.stack(segmentations))

    def _light(self, frame: _Frame, points: SeenPoints | None = None) -> np.ndarray:
        """Linear light of a frame, shape [H, W, 3]."""
        rays = frame.camera.rays()
        points = points or frame.tracer.see(rays)
        return frame.tracer.picture(rays, points, shadows=self._shadows, antialias=self._antialias)

    def _view(self, frame: _Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture, depth and segmentation of a frame."""
        points, camera = frame.tracer.see(frame.camera.rays()), frame.camera
        shape = (camera.height, camera.width)
        distance = np.where(points.surface == NOTHING, 0.0, points.distance)
        depth = (distance * (points.direction @ camera.rotation[:, 2])).astype(np.float32)
        # The last two of these are what NOTHING and TABLE take from the end of the array.
        ids = np.array([*frame.geoms, TABLE, NOTHING], np.int32)[points.surface]
        return to_bytes(self._light(frame, points)), depth.reshape(shape), ids.reshape(shape)

    def _frames(
        self,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        geom_rgba: np.ndarray | None,
    ) -> Iterator[_Frame]:
        """Check the arguments, then make the frames one by one; those of one state share their tracer."""
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
        """Ids and surfaces of the geoms that are seen in a state."""
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
        """Results for the frames in their order, ``threads`` of them worked on at once, also while the caller
        is busy with the last one."""
        with ThreadPoolExecutor(self._threads) as pool:
            begun = deque(pool.submit(function, frame) for frame in islice(frames, 2 * self._threads))
            while begun:
                result = begun.popleft().result()
                begun.extend(pool.submit(function, frame) for frame in islice(frames, 1))
                yield result


@dataclass(frozen=True)
class _Frame:
    """A state of the model and the camera that looks at it."""

    tracer: RayTracer
    camera: Camera
    geoms: list[int]
    """Geom id of each surface."""


def _check(name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise FungraspError(f"{name} must have shape {shape}, not {values.shape}")
    if not np.isfinite(values).all():
        raise FungraspError(f"{name} has values that are not finite")

"""Pictures of a MuJoCo model on the CPU: ray cast, softly lit, anti-aliased, the same bytes every time.

Each frame goes through the same steps: rays from the camera (left out where no geom's bounding sphere can be
seen), the table in closed form, a shadow and an occlusion ray from each pixel that needs them, with
directions that change over a 4 x 4 pattern and are averaged over it, and more rays through the pixels on
edges. The rays of a few frames are cast in one call on all threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.rendering.camera import Camera
from fungrasp.rendering.frame import NOTHING, TABLE, Frame, Scene
from fungrasp.rendering.model_rays import RayCaster, drawn_geoms
from fungrasp.rendering.shading import Look, linear, model_materials, sun_direction, to_bytes
from fungrasp.rendering.surfaces import mesh_surface

__all__ = ["NOTHING", "TABLE", "Renderer", "Views", "render"]

CHUNK = 8
"""Frames that are worked on at once."""

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Views:
    """What cameras see: F pictures of H x W pixels. Depth and segmentation are those of the pixels'
    centres.
    """

    colour: np.ndarray | None
    """sRGB, shape [F, H, W, 3] uint8, or None if not asked for."""
    depth: np.ndarray
    """Along the camera's z [m], 0 where nothing is seen, shape [F, H, W] float32."""
    segmentation: np.ndarray
    """Geom id, ``NOTHING`` (-1) or ``TABLE`` (-2), shape [F, H, W] int32."""


def render(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    camera: Camera | Sequence[Camera],
    *,
    mocap: np.ndarray | None = None,
    geom_rgba: np.ndarray | None = None,
    look: Look | None = None,
    shadows: bool = True,
    ground: bool = True,
    antialias: int = 2,
    threads: int = 0,
) -> np.ndarray:
    """Colour pictures of a model in given states; see ``Renderer``, which saves its preparations for more
    calls.

    Returns:
        sRGB, shape [F, H, W, 3] uint8 (F = 1 for a single state).
    """
    renderer = Renderer(
        model, look=look, shadows=shadows, ground=ground, antialias=antialias, threads=threads
    )
    return np.stack(list(renderer.stream(qpos, camera, mocap=mocap, geom_rgba=geom_rgba)))


class Renderer:
    """Draws the geoms of groups 0, 1 and 2 of a model, all as if opaque, except those with an opacity of
    0.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        look: Look | None = None,
        shadows: bool = True,
        ground: bool = True,
        antialias: int = 2,
        threads: int = 0,
    ):
        """
        Args:
            look: light, table top and backdrop.
            shadows: whether things shade one another.
            ground: draw the table top, the plane z = 0, instead of the model's planes.
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
        self._look, self._shadows, self._ground, self._antialias = look or Look(), shadows, ground, antialias
        self._threads = threads or os.cpu_count() or 1
        self._drawn = drawn_geoms(model, ground=ground)
        self._materials = model_materials(model)
        self._caster = RayCaster(
            model, max(CHUNK, 2 * self._threads), drawn=self._drawn, threads=self._threads
        )
        is_mesh = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & self._drawn
        surfaces = {int(m): mesh_surface(model, int(m)) for m in np.unique(model.geom_dataid[is_mesh])}
        self._meshes = {int(g): surfaces[int(model.geom_dataid[g])] for g in np.flatnonzero(is_mesh)}

    def stream(
        self,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        *,
        mocap: np.ndarray | None = None,
        geom_rgba: np.ndarray | None = None,
    ) -> Iterator[np.ndarray]:
        """Colour pictures, one by one, shape [H, W, 3] uint8; no more than a few are held at once.

        Args:
            qpos: joint positions, shape [F, nq] or [nq].
            camera: one for all frames, or one each; all of one size. The first decides where the key light
                is.
            mocap: poses of the mocap bodies, world frame, shape [F, nmocap, 7] or [nmocap, 7]; None for the
                model's.
            geom_rgba: sRGB and opacity (only whether it is 0 matters), shape [ngeom, 4] or [F, ngeom, 4];
                None for the model's colours and materials.

        Raises:
            FungraspError: an argument has the wrong shape, or is not finite.
        """
        job = self._job(qpos, camera, mocap, geom_rgba)
        return (to_bytes(light) for frames in self._chunks(job) for light in self._colours(frames))

    def views(
        self,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        *,
        mocap: np.ndarray | None = None,
        geom_rgba: np.ndarray | None = None,
        colour: bool = True,
    ) -> Views:
        """Pictures with depth and segmentation. Arguments and errors as ``stream``.

        Args:
            colour: False leaves out the colours, which take most of the time.
        """
        job = self._job(qpos, camera, mocap, geom_rgba)
        pictures, depths, segmentations = [], [], []
        for frames in self._chunks(job):
            for frame in frames:
                depths.append(frame.depth())
                segmentations.append(frame.points.geom.astype(np.int32).reshape(frame.shape))
            if colour:
                pictures += [to_bytes(light) for light in self._colours(frames)]
        return Views(np.stack(pictures) if colour else None, np.stack(depths), np.stack(segmentations))

    def _job(
        self,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        mocap: np.ndarray | None,
        geom_rgba: np.ndarray | None,
    ) -> _Job:
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
        if mocap is not None:
            mocap = np.asarray(mocap, dtype=float)
            mocap = np.broadcast_to(mocap, (count, *mocap.shape)) if mocap.ndim == 2 else mocap
            _check("mocap", mocap, (count, model.nmocap, 7))
        colours = self._materials.colours if geom_rgba is None else np.asarray(geom_rgba, dtype=np.float32)
        colours = np.broadcast_to(colours, (count, *colours.shape)) if colours.ndim == 2 else colours
        _check("geom_rgba", colours, (count, model.ngeom, 4))
        return _Job(qpos, cameras, mocap, colours)

    def _chunks(self, job: _Job) -> Iterator[list[Frame]]:
        """Frames whose pixels know what they see, a few at a time."""
        scene, directions, camera = None, None, None
        for start in range(0, len(job.qpos), CHUNK):
            span = slice(start, start + CHUNK)
            visible = self._drawn & (job.colours[span, :, 3] > 0)
            mocap = None if job.mocap is None else job.mocap[span]
            centres, rotations, boxes = self._caster.pose(job.qpos[span], mocap, visible)
            if scene is None:
                middle = np.asarray(job.cameras[0].target[:2])
                sun = sun_direction(self._look, job.cameras[0].rotation)
                scene = Scene(
                    self.model, self._look, self._materials, self._meshes, sun, middle, self._ground
                )
            frames = []
            for i, view in enumerate(job.cameras[span]):
                if directions is None or view != camera:
                    camera, directions = view, view.all_directions()
                colours = linear(job.colours[start + i, :, :3])
                frames.append(Frame(scene, view, directions, colours, centres[i], rotations[i], boxes[i]))
            hits = self._caster.cast(self._each(lambda f: (f.eye, f.first_rays()), frames))
            self._each(lambda pair: pair[0].see(pair[1]), list(zip(frames, hits, strict=True)))
            yield frames

    def _colours(self, frames: list[Frame]) -> list[np.ndarray]:
        if self._shadows:
            hits = self._caster.cast(self._each(Frame.light_rays, frames), normals=False)
            self._each(lambda pair: pair[0].receive(pair[1]), list(zip(frames, hits, strict=True)))
        else:
            self._each(lambda frame: frame.receive(None), frames)
        if self._antialias == 1:
            return self._each(lambda frame: frame.colour(None), frames)
        edges = self._caster.cast(self._each(lambda f: (f.eye, f.edge_rays(self._antialias)), frames))
        return self._each(lambda pair: pair[0].colour(pair[1]), list(zip(frames, edges, strict=True)))

    def _each(self, function: Callable[..., _Result], items: Sequence) -> list[_Result]:
        if len(items) == 1 or self._threads == 1:
            return [function(item) for item in items]
        with ThreadPoolExecutor(min(self._threads, len(items))) as pool:
            return list(pool.map(function, items))


@dataclass(frozen=True)
class _Job:
    """Checked arguments of a rendering of F frames."""

    qpos: np.ndarray
    cameras: list[Camera]
    mocap: np.ndarray | None
    colours: np.ndarray


def _check(name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise FungraspError(f"{name} must have shape {shape}, not {values.shape}")
    if not np.isfinite(values).all():
        raise FungraspError(f"{name} has values that are not finite")

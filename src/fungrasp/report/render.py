"""Pictures of a MuJoCo model on the CPU: ray cast, softly lit, anti-aliased, the same bytes every time.

Each frame goes through the same steps: first rays (skipped where no geom's bounding sphere can be seen), the table met
in closed form, one shadow and one occlusion ray per pixel that needs them with directions that change over a 4 x 4
pattern and are averaged over it, and more rays through the pixels on edges. The rays of all frames of a chunk are
cast in one call on all threads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.report.camera import Camera
from fungrasp.report.casting import RayCaster, hidden_geoms
from fungrasp.report.frame import NOTHING, TABLE, Frame, Scene
from fungrasp.report.shading import Look, Materials, linear, model_materials, sun_direction, to_bytes
from fungrasp.report.surfaces import mesh_surface

__all__ = ["NOTHING", "TABLE", "Views", "render", "render_stream", "render_views"]

CHUNK = 8
"""Frames that are worked on at once."""


@dataclass(frozen=True)
class Views:
    """What cameras see; F frames of H x W pixels."""

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
    """Colour pictures of a model in given states.

    Drawn are geoms of groups 0, 1 and 2 that have some opacity (all as if opaque).

    Args:
        qpos: joint positions, shape [F, nq] or [nq].
        camera: one for all frames, or one each; all of one size.
        mocap: poses of the mocap bodies, world frame, shape [F, nmocap, 7] or [nmocap, 7]; None for the model's.
        geom_rgba: sRGB and opacity, shape [ngeom, 4] or [F, ngeom, 4]; None for the model's colours and materials.
        look: light, table top and backdrop.
        shadows: whether things shade one another.
        ground: draw the table top, the plane z = 0, instead of the model's planes.
        antialias: n for n x n rays through pixels on edges; 1 for none.
        threads: 0 means all CPUs; the result does not depend on it.

    Returns:
        sRGB, shape [F, H, W, 3] uint8 (F = 1 for a single state).

    Raises:
        FungraspError: an argument has the wrong shape, or is not finite.
    """
    chunks = render_stream(
        model,
        qpos,
        camera,
        mocap=mocap,
        geom_rgba=geom_rgba,
        look=look,
        shadows=shadows,
        ground=ground,
        antialias=antialias,
        threads=threads,
    )
    return np.stack(list(chunks))


def render_stream(
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
) -> Iterator[np.ndarray]:
    """As ``render``, frame by frame (shape [H, W, 3] uint8), never holding more than a few."""
    job = _Job(model, qpos, camera, mocap, geom_rgba, look or Look(), shadows, ground, threads)
    if not 1 <= antialias <= 8:
        raise FungraspError(f"antialias must lie between 1 and 8, not {antialias}")
    for start in range(0, job.count, CHUNK):
        for frame in job.finished(start, antialias):
            yield to_bytes(frame)


def render_views(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    camera: Camera | Sequence[Camera],
    *,
    mocap: np.ndarray | None = None,
    geom_rgba: np.ndarray | None = None,
    look: Look | None = None,
    colour: bool = True,
    shadows: bool = True,
    ground: bool = True,
    antialias: int = 2,
    threads: int = 0,
) -> Views:
    """As ``render``, with depth and segmentation, which are those of the rays through the pixels' centres.

    Args:
        colour: False leaves out the colours, which take most of the time.
    """
    job = _Job(model, qpos, camera, mocap, geom_rgba, look or Look(), shadows, ground, threads)
    pictures, depths, segmentations = [], [], []
    for start in range(0, job.count, CHUNK):
        frames = job.seen(start)
        for frame in frames:
            camera_ = frame.camera
            shape = (camera_.height, camera_.width)
            along = frame.points.direction @ camera_.rotation[:, 2]
            distance = frame.points.distance
            depth = np.where(np.isinf(distance), 0.0, distance) * along
            depths.append(depth.astype(np.float32).reshape(shape))
            segmentations.append(frame.points.geom.astype(np.int32).reshape(shape))
        if colour:
            pictures += [to_bytes(light) for light in job.coloured(frames, antialias)]
    return Views(np.stack(pictures) if colour else None, np.stack(depths), np.stack(segmentations))


class _Job:
    """The checked arguments of a rendering, and its steps for a chunk of frames."""

    def __init__(
        self,
        model: mujoco.MjModel,
        qpos: np.ndarray,
        camera: Camera | Sequence[Camera],
        mocap: np.ndarray | None,
        geom_rgba: np.ndarray | None,
        look: Look,
        shadows: bool,
        ground: bool,
        threads: int,
    ):
        qpos = np.atleast_2d(np.asarray(qpos, dtype=float))
        self.count = count = len(qpos)
        _check("qpos", qpos, (count, model.nq))
        if count == 0:
            raise FungraspError("there is no state to render")
        self.cameras = [camera] * count if isinstance(camera, Camera) else list(camera)
        if len(self.cameras) != count:
            raise FungraspError(
                f"{len(self.cameras)} cameras were given for {count} frames; give one, or one each"
            )
        if len({(c.width, c.height) for c in self.cameras}) > 1:
            raise FungraspError("all cameras of a film must have the same number of pixels")
        if mocap is not None:
            mocap = np.broadcast_to(np.asarray(mocap, dtype=float), (count, model.nmocap, 7))
            _check("mocap", mocap, (count, model.nmocap, 7))
        materials = model_materials(model)
        if geom_rgba is not None:
            colours = np.asarray(geom_rgba, dtype=np.float32)
            _check("geom_rgba", colours, (model.ngeom, 4) if colours.ndim == 2 else (count, model.ngeom, 4))
            materials = Materials(colours, materials.specular, materials.shininess)
        colours = materials.colours
        self.colours = np.broadcast_to(linear(colours[..., :3]), (count, model.ngeom, 3))
        self.qpos, self.mocap = qpos, mocap
        self.shadows = shadows
        hidden = hidden_geoms(model, colours, ground=ground)
        self.caster = RayCaster(model, min(CHUNK, count), hidden=hidden, threads=threads)
        axes = self.cameras[0].rotation
        centres, _, radii = self.caster.pose(qpos[:1], None if mocap is None else mocap[:1])
        small = (radii > 0) & (radii < 0.6)
        middle = centres[0, small, :2].mean(0) if small.any() else np.zeros(2)
        is_mesh = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & ~hidden
        surfaces = {int(m): mesh_surface(model, int(m)) for m in np.unique(model.geom_dataid[is_mesh])}
        meshes = {int(g): surfaces[int(model.geom_dataid[g])] for g in np.flatnonzero(is_mesh)}
        sun = sun_direction(look, axes[:, 0], axes[:, 2])
        self.scene = Scene(model, look, materials, meshes, sun, middle, ground, shadows)

    def seen(self, start: int) -> list[Frame]:
        """Frames from ``start``, up to where each pixel knows its surface."""
        stop = min(start + CHUNK, self.count)
        mocap = None if self.mocap is None else self.mocap[start:stop]
        centres, rotations, radii = self.caster.pose(self.qpos[start:stop], mocap)
        frames = [
            Frame(
                self.scene, self.cameras[i], self.colours[i], centres[i - start], rotations[i - start], radii
            )
            for i in range(start, stop)
        ]
        for frame, hits in zip(frames, self._cast([(f.eye, f.first_rays()) for f in frames]), strict=True):
            frame.see(hits)
        return frames

    def coloured(self, frames: list[Frame], antialias: int) -> list[np.ndarray]:
        """The colours of frames that ``seen`` returned."""
        if self.shadows:
            rays = [f.light_rays() for f in frames]
            for frame, hits in zip(frames, self._cast(rays, normals=False), strict=True):
                frame.receive(hits)
        else:
            for frame in frames:
                frame.receive(None)
        if antialias == 1:
            return [frame.colour(None) for frame in frames]
        edges = self._cast([(f.eye, f.edge_rays(antialias)) for f in frames])
        return [frame.colour(hits) for frame, hits in zip(frames, edges, strict=True)]

    def finished(self, start: int, antialias: int) -> list[np.ndarray]:
        return self.coloured(self.seen(start), antialias)

    def _cast(self, rays: list[tuple[np.ndarray, np.ndarray]], normals: bool = True):
        return self.caster.cast([o for o, _ in rays], [d for _, d in rays], normals=normals)


def _check(name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise FungraspError(f"{name} must have shape {shape}, not {values.shape}")
    if not np.isfinite(values).all():
        raise FungraspError(f"{name} has values that are not finite")

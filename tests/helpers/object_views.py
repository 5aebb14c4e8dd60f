"""Rendered images of one object alone on a table, from all round, as they are made for a scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from benchmarks.synthetic_captures.capture_camera import posed_rays
from benchmarks.synthetic_captures.capture_scene import capture_table
from benchmarks.synthetic_captures.capture_settings import TYPICAL
from benchmarks.synthetic_captures.depth_cameras import DepthCamera, camera_depth
from benchmarks.synthetic_captures.depth_noise import ColorNoise, noisy_color
from benchmarks.synthetic_captures.painted_mesh import painted_object
from fungrasp.geometry.poses import transform_points
from fungrasp.media.camera import orbit_camera
from fungrasp.media.ray_tracing import NOTHING, Look, RayTracer
from fungrasp.media.surfaces import SurfaceMesh
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture, Intrinsics


def scan_table(center: np.ndarray, rng: np.random.Generator) -> SurfaceMesh:
    """A table top with a sheet of print on it under an object, by which a moved camera is found again.

    center: of the object [m], world frame, shape [3].
    """
    table = capture_table(center, 0.0, rng)
    assert table.texture is not None
    height, width = table.texture.shape[:2]
    # Blocks of 6 mm, light and dark, as lines of print and pictures are.
    cells = rng.uniform(0.25, 0.95, (height // 3 + 1, width // 3 + 1))
    print_ = np.repeat(np.repeat(cells, 3, axis=0), 3, axis=1)[:height, :width, None]
    return replace(table, texture=table.texture * 0.3 + 0.7 * print_)


def object_views(
    model: ObjectModel,
    count: int,
    rng: np.random.Generator,
    *,
    camera: DepthCamera | None = None,
    color_noise: ColorNoise | None = None,
    intrinsics: Intrinsics = TYPICAL,
    distance: float = 0.45,
    elevation: float = 35.0,
) -> tuple[list[Capture], trimesh.Trimesh]:
    """Views at equal angles about an object at rest, each a little off them.

    Args:
        model: the object.
        count: of views.
        rng: decides table, light and noise.
        camera: errors of depth; None: none.
        color_noise: errors of color; None: none.
        intrinsics: of the camera.
        distance: from the camera to the object's middle [m].
        elevation: of the camera above the table [degrees].

    Returns:
        The images, and the object's mesh as it stands: table frame, the table at z = 0.
    """
    pose = model.rest_pose(float(rng.uniform(0, 2 * np.pi)))
    painted = painted_object(model).moved(pose)
    center = painted.vertices.mean(axis=0)
    surfaces = [painted.surface(0.1, 20.0), scan_table(center, rng)]
    look = Look(light=(0.6, -0.5, 1.6), key=1.4, fill=1.0)
    tracer = RayTracer(surfaces, look)
    captures = []
    for i in range(count):
        eye = orbit_camera(
            center + rng.normal(size=3) * 0.008,
            distance * rng.uniform(0.95, 1.05),
            360.0 * i / count + rng.uniform(-3, 3),
            elevation + rng.uniform(-4, 4),
        )
        rotation = Rotation.from_matrix(eye.rotation).as_quat(scalar_first=True)
        rays = posed_rays(intrinsics, np.concatenate([eye.position, rotation]))
        points = tracer.see(rays)
        light = tracer.picture(rays, points)
        seen = np.where(points.surface == NOTHING, 0.0, points.distance)
        shape = (intrinsics.height, intrinsics.width)
        depth = (seen.reshape(shape) / np.linalg.norm(intrinsics.rays(), axis=-1)).astype(np.float32)
        if camera is not None:
            depth = camera_depth(depth, intrinsics, camera, rng, np.clip(light.mean(axis=-1), 0, None))
        color = noisy_color(light, color_noise or ColorNoise(0.0, 0.0, 0.0), rng)
        captures.append(Capture(color, depth, intrinsics))
    mesh = trimesh.Trimesh(transform_points(pose, model.vertices), model.faces, process=False)
    return captures, mesh

"""The camera of a test capture: where hand and object are seen, and turned from there for another look."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.synthetic_captures.capture_scene import CaptureScene, Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.painted_mesh import PaintedMesh
from fungrasp.geometry.poses import inverse_transform_points, rotation_matrix
from fungrasp.grasps import HumanGrasp
from fungrasp.media.camera import orbit_camera
from fungrasp.media.ray_tracing import PixelRays, RayTracer
from fungrasp.perception import Intrinsics

TRIES = 24
"""Cameras that are tried before the best so far is taken."""

TURNED = (15.0, 45.0)
"""By so much [degrees] another look at a grasp is turned about the vertical: what a person turns the hand, or
moves the camera, when asked for another one."""

_PROBE = 8


def posed_rays(intrinsics: Intrinsics, pose_world_camera: np.ndarray) -> PixelRays:
    """The rays of a camera at a pose, shape [7]."""
    rotation = rotation_matrix(pose_world_camera[3:])

    def directions(pixels: np.ndarray) -> np.ndarray:
        rays = intrinsics.deproject(pixels, np.ones(pixels.shape[:-1]))
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ rotation.T

    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    return PixelRays(intrinsics.width, intrinsics.height, pose_world_camera[:3], focal, directions)


def first_camera(
    grasp: HumanGrasp,
    painted: PaintedMesh,
    tracer: RayTracer,
    scene: CaptureScene,
    intrinsics: Intrinsics,
    azimuth: float,
    settings: CaptureSettings,
    rng: np.random.Generator,
) -> np.ndarray:
    """Pose of a camera that sees hand and object: the first that sees enough, else the best, shape [7]."""
    center = _middle(grasp, painted)

    def drawn(i: int) -> np.ndarray:
        return _orbit(
            center + rng.normal(size=3) * 0.015,
            rng.uniform(*settings.distance),
            azimuth + rng.normal() * 12 * (1 + i),
            rng.uniform(*settings.elevation),
            rng,
        )

    return _first_that_sees(drawn, grasp, tracer, scene, intrinsics, settings)


def turned_camera(
    first: np.ndarray,
    look: int,
    grasp: HumanGrasp,
    painted: PaintedMesh,
    tracer: RayTracer,
    scene: CaptureScene,
    intrinsics: Intrinsics,
    settings: CaptureSettings,
    rng: np.random.Generator,
) -> np.ndarray:
    """Pose of a camera turned from the first look's about the grasp, shape [7]."""
    center, side = _middle(grasp, painted), 1.0 if look % 2 else -1.0
    away = first[:3] - center
    distance = float(np.linalg.norm(away))
    azimuth = float(np.degrees(np.arctan2(away[1], away[0])))
    elevation = float(np.degrees(np.arcsin(away[2] / distance)))

    def drawn(_: int) -> np.ndarray:
        return _orbit(
            center + rng.normal(size=3) * 0.015,
            distance * rng.uniform(0.85, 1.15),
            azimuth + side * rng.uniform(*TURNED),
            float(np.clip(elevation + rng.normal() * 10, *settings.elevation)),
            rng,
        )

    return _first_that_sees(drawn, grasp, tracer, scene, intrinsics, settings)


def _middle(grasp: HumanGrasp, painted: PaintedMesh) -> np.ndarray:
    """Between the middles of hand and object [m], world frame, shape [3]."""
    held = painted.moved(grasp.object_pose).vertices
    return 0.5 * (grasp.hand_joints.mean(0) + np.clip(held.mean(0), *np.quantile(held, (0.2, 0.8), axis=0)))


def _orbit(
    center: np.ndarray, distance: float, azimuth: float, elevation: float, rng: np.random.Generator
) -> np.ndarray:
    """Pose of a camera that looks at a point [m], rolled a little, shape [7]. Angles in degrees."""
    camera = orbit_camera(tuple(center), distance, azimuth, elevation)
    roll = Rotation.from_euler("z", rng.normal() * 5, degrees=True)
    rotation = (Rotation.from_matrix(camera.rotation) * roll).as_quat(scalar_first=True)
    return np.concatenate([camera.position, rotation])


def _first_that_sees(
    drawn: Callable[[int], np.ndarray],
    grasp: HumanGrasp,
    tracer: RayTracer,
    scene: CaptureScene,
    intrinsics: Intrinsics,
    settings: CaptureSettings,
) -> np.ndarray:
    """The first of the poses drawn from which hand and object are seen, else the best, shape [7]."""
    probe = intrinsics.resized(intrinsics.width // _PROBE, intrinsics.height // _PROBE)
    best, most = np.zeros(7), -np.inf
    for i in range(TRIES):
        pose = drawn(i)
        seen = tracer.see(posed_rays(probe, pose), shaded=False).surface
        shown = [np.isin(seen, np.flatnonzero(scene.labels == k)).mean() for k in (Label.OBJECT, Label.HAND)]
        points = np.vstack([grasp.hand_joints, scene.arm_end])
        pixels = intrinsics.project(inverse_transform_points(pose, points))
        size = np.array([intrinsics.width, intrinsics.height])
        inside = np.all((pixels > 4) & (pixels < size - 5), axis=1)
        enough = min(shown[0] / settings.object_seen, shown[1] / settings.hand_seen, 1.0)
        score = enough + inside[:-1].mean() - 0.2 * inside[-1]
        if score > most:
            best, most = pose, score
        if score >= 2.0:
            break
    return best

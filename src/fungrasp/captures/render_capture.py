"""Rendered test captures: a human grasp as a depth camera would see it, and the truth about it.

They are for tests and demonstrations: the skin, the paint of objects, the room and the camera's errors are
made up. How well perception does on them says little about photographs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.captures.capture_scene import CaptureScene, Label, capture_scene
from fungrasp.captures.depth_cameras import DEPTH_CAMERAS, DepthCamera, camera_depth
from fungrasp.captures.depth_noise import ColorNoise, DepthNoise, noisy_color, noisy_depth
from fungrasp.captures.painted_mesh import PaintedMesh, painted_object
from fungrasp.captures.skin_and_sleeve import SKIN_TONES
from fungrasp.captures.varied_hand import vary_hand
from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.geometry.poses import compose, inverse_transform_points, invert, rotation_matrix
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture, Intrinsics
from fungrasp.rendering.camera import orbit_camera
from fungrasp.rendering.ray_tracing import NOTHING, PixelRays, RayTracer
from fungrasp.rendering.shading import Color

TRIES = 24
"""Cameras that are tried before the best so far is taken."""

TYPICAL = Intrinsics(640, 480, 615.0, 615.0, 321.5, 238.0)
"""A colour camera of the kind that is sold with a depth sensor for robots."""

_PROBE = 8


@dataclass(frozen=True)
class CaptureSettings:
    """What test captures look like."""

    intrinsics: Intrinsics = TYPICAL
    """Intrinsics of the typical camera; those of a capture differ by a few pixels."""
    intrinsics_spread: float = 8.0
    """Largest difference of focal length and optical axis from the typical ones [pixels]."""
    distance: tuple[float, float] = (0.4, 0.9)
    """Range of distances from the camera to the grasp [m]."""
    elevation: tuple[float, float] = (15.0, 65.0)
    """Range of elevations of the camera above the table, seen from the grasp [degrees]."""
    clutter: tuple[int, int] = (0, 5)
    """Fewest and most other objects on the table."""
    skin: tuple[Color, ...] = SKIN_TONES
    """Tones of skin, sRGB; another colour makes a glove."""
    object_seen: float = 0.012
    """Part of the image that must show the object, where a camera can be found that does."""
    hand_seen: float = 0.015
    """Part of the image that must show the hand, where a camera can be found that does."""
    missing: tuple[Label, ...] = ()
    """Labels that are taken out of the scene once the camera has found its place, to see what perception
    makes of that: ``HAND`` (with its sleeve) or ``OBJECT``."""
    proportions: float = 0.0
    """Standard deviation of the size of hands, and of the lengths of their fingers, as a part; their
    fingertips stay where they are."""
    skin_like: float = 0.0
    """Part of the clutter, and of the table tops, with colours that some skin has."""
    depth_noise: DepthNoise | tuple[DepthCamera, ...] | None = field(default_factory=DepthNoise)
    """Errors of the depth: simple ones, those of one of several kinds of cameras, drawn for each capture,
    or None for perfect depth."""
    color_noise: ColorNoise | None = field(default_factory=ColorNoise)
    """Noise of the color image; None for perfect color."""

    def __post_init__(self) -> None:
        for name in ("distance", "elevation", "clutter"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise FungraspError(f"captures: {name} must be a range from low to high, not {low} to {high}")
        if isinstance(self.depth_noise, tuple) and not self.depth_noise:
            raise FungraspError("captures: depth_noise must name at least one camera, or be None")
        if not 0 <= self.proportions <= 0.2:
            raise FungraspError(f"captures: proportions must be from 0 to 0.2, not {self.proportions}")
        if self.distance[0] < 0.2 or self.elevation[1] > 85:
            raise FungraspError("captures: the camera must be 0.2 m away or more, and at most 85 degrees up")


def camera_settings(camera: str = "mixed") -> CaptureSettings:
    """Captures as the cameras that people have give them: melted depth, wrong exposure, hands of all sizes.

    Args:
        camera: one of ``DEPTH_CAMERAS``, or "mixed", which draws one of them for each capture.

    Raises:
        UnknownNameError: there is no such camera.
    """
    if camera != "mixed" and camera not in DEPTH_CAMERAS:
        raise UnknownNameError("depth camera", camera, ("mixed", *DEPTH_CAMERAS))
    cameras = tuple(DEPTH_CAMERAS.values()) if camera == "mixed" else (DEPTH_CAMERAS[camera],)
    return CaptureSettings(
        proportions=0.07,
        skin_like=0.4,
        distance=(0.45, 0.9),
        object_seen=0.006,
        depth_noise=cameras,
        color_noise=ColorNoise(
            noise=3.0, blur=0.6, balance=0.08, exposure=(0.6, 3.0), motion=4.0, jpeg=(60, 95)
        ),
    )


@dataclass(frozen=True, eq=False)
class SyntheticCapture:
    """A rendered capture and the truth about it."""

    capture: Capture
    """The rendered image, its depth and intrinsics, without mask and box."""
    grasp: HumanGrasp
    """The human grasp that is rendered, world frame."""
    pose_world_camera: np.ndarray
    """Pose of the camera in the world frame, shape [7]."""
    labels: np.ndarray
    """What each pixel shows, see ``Label``, shape [H, W] uint8."""
    painted: PaintedMesh
    """The object with its colors, object frame."""

    @property
    def pose_camera_object(self) -> np.ndarray:
        """Pose of the object in the camera frame, shape [7]."""
        return compose(invert(self.pose_world_camera), self.grasp.object_pose)

    @property
    def joints_camera(self) -> np.ndarray:
        """Joints of the hand [m], camera frame, shape [21, 3]."""
        return inverse_transform_points(self.pose_world_camera, self.grasp.hand_joints)

    @property
    def object_mask(self) -> np.ndarray:
        """Pixels that show the object, shape [H, W] bool."""
        return self.labels == Label.OBJECT

    @property
    def hand_mask(self) -> np.ndarray:
        """Pixels that show skin, the bare forearm included, shape [H, W] bool."""
        return self.labels == Label.HAND


def render_captures(
    grasps: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    count: int,
    seed: int,
    settings: CaptureSettings | None = None,
) -> Iterator[SyntheticCapture]:
    """Captures of grasps, one by one: all grasps once in random order, then again from elsewhere.

    Args:
        grasps: of right hands.
        objects: by name, all those of the grasps.
        count: of captures.
        seed: decides everything; capture i is the same whatever the count.
        settings: cameras, clutter and noise.

    Raises:
        FungraspError: there are no grasps, or an object is missing.
    """
    if not len(grasps):
        raise FungraspError("there are no grasps to make captures of")
    for name in np.unique(grasps.object_name):
        if name not in objects:
            raise UnknownNameError("object", str(name), objects)
    for i in range(count):
        yield capture_at(i, grasps, objects, seed, settings)


def capture_at(
    index: int,
    grasps: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    seed: int,
    settings: CaptureSettings | None = None,
) -> SyntheticCapture:
    """One of the captures that ``render_captures`` gives, without the others. index: from 0 on."""
    turn, place = divmod(index, len(grasps))
    row = int(np.random.default_rng([seed, turn]).permutation(len(grasps))[place])
    grasp = grasps[row]
    return render_capture(
        grasp, objects[grasp.object_name], np.random.default_rng([seed, turn, row]), settings
    )


def render_capture(
    grasp: HumanGrasp,
    model: ObjectModel,
    rng: np.random.Generator,
    settings: CaptureSettings | None = None,
) -> SyntheticCapture:
    """One capture of a grasp of a right hand.

    Args:
        grasp: world frame.
        model: the object it holds.
        rng: decides camera, room, skin, light and noise.
        settings: cameras, clutter and noise.
    """
    settings = settings or CaptureSettings()
    painted = painted_object(model)
    if settings.proportions:
        grasp = replace(grasp, hand_joints=vary_hand(grasp, settings.proportions, rng), hand_qpos=None)
    intrinsics = _intrinsics(settings, rng)
    azimuth = float(rng.uniform(0, 360))
    clutter = int(rng.integers(settings.clutter[0], settings.clutter[1] + 1))
    towards = float(np.radians(azimuth))
    scene = capture_scene(
        grasp,
        painted,
        rng,
        tones=settings.skin,
        clutter=clutter,
        towards=towards,
        skin_like=settings.skin_like,
    )
    tracer = RayTracer(scene.surfaces, scene.look)
    pose = _camera(grasp, painted, tracer, scene, intrinsics, azimuth, settings, rng)
    if settings.missing:
        scene = scene.without(settings.missing)
        tracer = RayTracer(scene.surfaces, scene.look)
    rays, shape = posed_rays(intrinsics, pose), (intrinsics.height, intrinsics.width)
    points = tracer.see(rays)
    labels = np.append(scene.labels, np.uint8(Label.ROOM))[points.surface].reshape(shape)
    light = tracer.picture(rays, points)
    color = noisy_color(light, settings.color_noise or ColorNoise(0.0, 0.0, 0.0), rng)
    distance = np.where(points.surface == NOTHING, 0.0, points.distance).reshape(shape)
    depth = (distance / np.linalg.norm(intrinsics.rays(), axis=-1)).astype(np.float32)
    if isinstance(settings.depth_noise, DepthNoise):
        depth = noisy_depth(depth, intrinsics, settings.depth_noise, rng)
    elif settings.depth_noise is not None:
        camera = settings.depth_noise[int(rng.integers(len(settings.depth_noise)))]
        brightness = np.clip(light.mean(axis=-1), 0.0, None)
        depth = camera_depth(depth, intrinsics, camera, rng, brightness)
    return SyntheticCapture(Capture(color, depth, intrinsics), grasp, pose, labels, painted)


def posed_rays(intrinsics: Intrinsics, pose_world_camera: np.ndarray) -> PixelRays:
    """The rays of a camera at a pose, shape [7]."""
    rotation = rotation_matrix(pose_world_camera[3:])

    def directions(pixels: np.ndarray) -> np.ndarray:
        rays = intrinsics.deproject(pixels, np.ones(pixels.shape[:-1]))
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ rotation.T

    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    return PixelRays(intrinsics.width, intrinsics.height, pose_world_camera[:3], focal, directions)


def _camera(
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
    held = painted.moved(grasp.object_pose).vertices
    centre = 0.5 * (grasp.hand_joints.mean(0) + np.clip(held.mean(0), *np.quantile(held, (0.2, 0.8), axis=0)))
    probe = intrinsics.resized(intrinsics.width // _PROBE, intrinsics.height // _PROBE)
    best, most = np.zeros(7), -np.inf
    for i in range(TRIES):
        camera = orbit_camera(
            centre + rng.normal(size=3) * 0.015,
            rng.uniform(*settings.distance),
            azimuth + rng.normal() * 12 * (1 + i),
            rng.uniform(*settings.elevation),
        )
        roll = Rotation.from_euler("z", rng.normal() * 5, degrees=True)
        rotation = (Rotation.from_matrix(camera.rotation) * roll).as_quat(scalar_first=True)
        pose = np.concatenate([camera.position, rotation])
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


def _intrinsics(settings: CaptureSettings, rng: np.random.Generator) -> Intrinsics:
    typical = settings.intrinsics
    focal, cx, cy = settings.intrinsics_spread * rng.uniform(-1, 1, 3)
    return Intrinsics(
        typical.width,
        typical.height,
        typical.fx + focal,
        typical.fy + focal,
        typical.cx + cx,
        typical.cy + cy,
    )

"""Rendered test captures: a human grasp as a depth camera would see it, and the truth about it.

They are for tests and demonstrations: the skin, the paint of objects, the room and the camera's errors are
made up. How well perception does on them says little about photographs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.synthetic_captures.camera_errors import ColorNoise, camera_depth, noisy_color
from benchmarks.synthetic_captures.capture_scene import CaptureScene, Label, capture_scene
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.painted_mesh import PaintedMesh, mirrored_mesh, painted_object
from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    invert,
    rotation_matrix,
    transform_points,
)
from fungrasp.grasps import HumanGrasp, HumanGraspSet
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.media.camera import orbit_camera
from fungrasp.media.ray_tracing import NOTHING, PixelRays, RayTracer
from fungrasp.objects import ObjectModel, mirrored_name
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.hand.physical_evidence import link_gaps
from fungrasp.perception.io.estimates import Side

TRIES = 24
"""Cameras that are tried before the best so far is taken."""


@dataclass(frozen=True, eq=False)
class SyntheticCapture:
    """A rendered capture and the truth about it."""

    capture: Capture
    """The rendered image, its depth and intrinsics, without mask and box."""
    grasp: HumanGrasp
    """The human grasp that is rendered, world frame. Of a left hand: what ``mirror_pose`` makes of a grasp of
    a right one."""
    pose_world_camera: np.ndarray
    """Pose of the camera in the world frame, shape [7]."""
    labels: np.ndarray
    """What each pixel shows, see ``Label``, shape [H, W] uint8."""
    painted: PaintedMesh
    """The object with its colors, object frame."""
    side: Side = "right"
    """Which hand it is."""

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


def capture_at(
    index: int,
    grasps: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    seed: int,
    settings: CaptureSettings | None = None,
) -> SyntheticCapture:
    """One capture of a series: all grasps once in random order, then again from elsewhere.

    Args:
        index: of the capture, from 0 on.
        grasps: of right hands.
        objects: by name, all those of the grasps.
        seed: decides everything.
        settings: cameras, clutter and noise.
    """
    turn, place = divmod(index, len(grasps))
    row = int(np.random.default_rng([seed, turn]).permutation(len(grasps))[place])
    grasp = grasps[row]
    return render_capture(
        grasp, objects[grasp.object_name], np.random.default_rng([seed, turn, row]), settings
    )


def render_capture(
    grasp: HumanGrasp, model: ObjectModel, rng: np.random.Generator, settings: CaptureSettings | None = None
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
    if settings.hover:
        grasp = hovering(grasp, model, float(rng.uniform(*settings.hover)))
    intrinsics = _drawn_intrinsics(settings, rng)
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
    rays, shape = posed_rays(intrinsics, pose), (intrinsics.height, intrinsics.width)
    points = tracer.see(rays)
    labels = np.append(scene.labels, np.uint8(Label.ROOM))[points.surface].reshape(shape)
    light = tracer.picture(rays, points)
    distance = np.where(points.surface == NOTHING, 0.0, points.distance).reshape(shape)
    depth = (distance / np.linalg.norm(intrinsics.rays(), axis=-1)).astype(np.float32)
    side: Side = "right"
    if settings.left and rng.uniform() < settings.left:
        # Before the camera's errors: shadows of its projector stay on their side.
        light, depth, labels = (np.ascontiguousarray(image[:, ::-1]) for image in (light, depth, labels))
        grasp, pose, intrinsics = _reflected(grasp, pose, intrinsics)
        painted, side = mirrored_mesh(painted), "left"
    seen = _photographed(light, depth, intrinsics, settings, rng)
    return SyntheticCapture(seen, grasp, pose, labels, painted, side)


def _photographed(
    light: np.ndarray,
    depth: np.ndarray,
    intrinsics: Intrinsics,
    settings: CaptureSettings,
    rng: np.random.Generator,
) -> Capture:
    """What a camera with its errors makes of a scene.

    Args:
        light: linear, shape [H, W, 3].
        depth: true [m], 0 where there is nothing, shape [H, W] float32.
        intrinsics: of the camera.
        settings: its errors.
        rng: random numbers.
    """
    color = noisy_color(light, settings.color_noise or ColorNoise(0.0, 0.0, 0.0), rng)
    if settings.depth_noise:
        camera = settings.depth_noise[int(rng.integers(len(settings.depth_noise)))]
        brightness = np.clip(light.mean(axis=-1), 0.0, None)
        depth = camera_depth(depth, intrinsics, camera, rng, brightness)
    return Capture(color, depth, intrinsics)


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
    center = 0.5 * (grasp.hand_joints.mean(0) + np.clip(held.mean(0), *np.quantile(held, (0.2, 0.8), axis=0)))
    probe = intrinsics.resized(intrinsics.width // 8, intrinsics.height // 8)
    best, most = np.zeros(7), -np.inf
    for i in range(TRIES):
        camera = orbit_camera(
            tuple(center + rng.normal(size=3) * 0.015),
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


def posed_rays(intrinsics: Intrinsics, pose_world_camera: np.ndarray) -> PixelRays:
    """The rays of a camera at a pose, shape [7]."""
    rotation = rotation_matrix(pose_world_camera[3:])

    def directions(pixels: np.ndarray) -> np.ndarray:
        rays = intrinsics.deproject(pixels, np.ones(pixels.shape[:-1]))
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ rotation.T

    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    return PixelRays(intrinsics.width, intrinsics.height, pose_world_camera[:3], focal, directions)


def _reflected(
    grasp: HumanGrasp, pose: np.ndarray, lens: Intrinsics
) -> tuple[HumanGrasp, np.ndarray, Intrinsics]:
    """Grasp, pose of the camera in the world, shape [7], and its intrinsics in the scene reflected in the
    plane y = 0, whose image is turned round from left to right."""
    seen = replace(
        grasp,
        object_name=mirrored_name(grasp.object_name),
        object_pose=mirror_pose(grasp.object_pose),
        object_rest_pose=mirror_pose(grasp.object_rest_pose),
        hand_joints=mirror_points(grasp.hand_joints),
        hand_qpos=None,
    )
    # A point R p + t becomes S (R p + t), with S the world's reflection; X is that of the image.
    rotation = np.diag([1, -1, 1]) @ rotation_matrix(pose[3:]) @ np.diag([-1, 1, 1])
    turned = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
    mirrored = replace(lens, cx=lens.width - 1 - lens.cx)
    return seen, np.concatenate([mirror_points(pose[:3]), turned]), mirrored


def _drawn_intrinsics(settings: CaptureSettings, rng: np.random.Generator) -> Intrinsics:
    """Intrinsics that differ from the typical ones by a few pixels."""
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


LARGEST = 2.0
"""No hand and no finger is off by more than this many standard deviations."""

SKIN = 0.008
"""Half the thickness of a finger [m]."""


def vary_hand(grasp: HumanGrasp, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Joints of a hand of another size and with other lengths of its fingers.

    The hand is scaled about the middle of the fingertips that touch, so that they stay on the object to
    within their own spread; each finger is then longer or shorter from its knuckle on, and its tip is
    brought back by a shift of the joints between, that grows from the knuckle to the tip.

    Args:
        grasp: of a right hand, world frame.
        spread: standard deviation of both, as a part.
        rng: random numbers.

    Returns:
        [m], world frame, shape [21, 3].
    """
    joints = grasp.hand_joints
    tips = np.array([4, 8, 12, 16, 20])
    touching = grasp.link_contacts[[3, 6, 9, 12, 15]]
    center = joints[tips[touching] if touching.any() else tips].mean(axis=0)
    draw = np.clip(rng.normal(size=6), -LARGEST, LARGEST) * spread
    scaled = center + (1 + draw[0]) * (joints - center)
    for finger in range(5):
        chain = slice(1 + 4 * finger, 5 + 4 * finger)
        knuckle, tip = scaled[1 + 4 * finger], joints[4 + 4 * finger]
        longer = knuckle + (1 + 0.6 * draw[1 + finger]) * (scaled[chain] - knuckle)
        if touching[finger]:
            longer = longer + np.linspace(0, 1, 4)[:, None] * (tip - longer[3])
        scaled[chain] = longer
    # Not lower than it was where skin would be in the table.
    floor = min(float(joints[:, 2].min()), SKIN)
    scaled[:, 2] += max(0.0, floor - float(scaled[:, 2].min()))
    return scaled


FARTHEST = 0.3
"""A hand is taken away from an object by no more than this [m]: a gap of some centimeters needs less."""


def hovering(grasp: HumanGrasp, model: ObjectModel, gap: float) -> HumanGrasp:
    """The hand taken away from the object, along the line between their middles and upwards, until its skin
    is so far from the surface everywhere [m]; nothing is in contact."""
    joints = grasp.hand_joints
    away = (
        joints[[0, 5, 9, 13, 17]].mean(axis=0)
        - transform_points(grasp.object_pose, model.center_of_mass[None])[0]
    )
    # Over the table: downwards there is none.
    away[2] = max(float(away[2]), 0.5 * float(np.linalg.norm(away[:2])), 0.01)
    away /= np.linalg.norm(away)

    def nearest(way: float) -> float:
        return float(link_gaps(joints + way * away, model.signed_distance, grasp.object_pose).min())

    # A finger that has to pass the object first comes nearer: the last place of that gap counts.
    ways = np.linspace(0.0, FARTHEST, 601)
    near = np.array([nearest(way) < gap for way in ways])
    way = ways[min(int(np.flatnonzero(near)[-1]) + 1, len(ways) - 1)] if near.any() else 0.0
    return replace(
        grasp,
        hand_joints=joints + way * away,
        link_contacts=np.zeros_like(grasp.link_contacts),
        hand_qpos=None,
    )

"""Grasps as a depth camera would see them, made of balls: landmarks, depth and truth."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import load_human_grasps
from fungrasp.objects import ObjectModel, builtin_object
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.hand.detected_hand import DetectedHand

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)

FLESH = {0: 0.021, 17: 0.016} | {
    1 + 4 * f + k: r for f in range(5) for k, r in enumerate((10, 9.3, 8.4, 7.6))
}
FLESH = {joint: radius if radius < 1 else radius * 1e-3 for joint, radius in FLESH.items()}


@dataclass(frozen=True, eq=False)
class HandScene:
    capture: Capture
    joints: np.ndarray
    """Camera frame, shape [21, 3]."""
    model: ObjectModel
    pose_camera_object: np.ndarray
    table: np.ndarray

    def detected(self, rng: np.random.Generator, pixels: float = 5.0) -> DetectedHand:
        """What a landmark model says: noise of so many pixels per axis, 6 mm and 8 degrees in shape."""
        around = (self.joints - self.joints.mean(axis=0)) * rng.uniform(0.9, 1.1)
        turn = Rotation.from_rotvec(rng.normal(size=3) * np.radians(8))
        shape = turn.apply(around + rng.normal(size=(21, 3)) * 0.006)
        seen = CAMERA.project(self.joints) + rng.normal(size=(21, 2)) * pixels
        return DetectedHand(seen, shape, "right", 0.95, 0.95)


def hand_scene(row: int, rng: np.random.Generator) -> HandScene:
    """A built-in grasp seen from a random side, 0.5 to 0.7 m away."""
    grasps = load_human_grasps("builtin")
    grasp = grasps[row % len(grasps)]
    model = builtin_object(grasp.object_name)
    center = grasp.hand_joints.mean(axis=0)
    up, round_ = rng.uniform(0.5, 1.2), rng.uniform(0, 2 * np.pi)
    away = np.array([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    eye = center + rng.uniform(0.5, 0.7) * away
    right = np.cross(-away, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(-away, right), -away])
    quaternion = (Rotation.from_matrix(turn) * _rotation(grasp.object_pose)).as_quat(scalar_first=True)
    pose = np.concatenate([turn @ (grasp.object_pose[:3] - eye), quaternion])
    joints = (grasp.hand_joints - eye) @ turn.T
    normal = turn[:, 2]
    table = np.array([*normal, eye[2]])
    depth = _depth(joints, transform_points(pose, _surface(model, rng)), table)
    depth += rng.normal(size=depth.shape) * 0.0015
    depth[rng.random(depth.shape) < 0.02] = 0
    color = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    return HandScene(Capture(color, depth.astype(np.float32), CAMERA), joints, model, pose, table)


def _rotation(pose: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose[3:], scalar_first=True)


def _surface(model: ObjectModel, rng: np.random.Generator) -> np.ndarray:
    corners = model.vertices[model.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), 40_000, p=area / area.sum())]
    weights = rng.dirichlet(np.ones(3), len(chosen))
    return np.einsum("pc,pci->pi", weights, chosen)


def _depth(joints: np.ndarray, surface: np.ndarray, table: np.ndarray) -> np.ndarray:
    rays = CAMERA.rays()
    below = rays @ table[:3]
    depth = np.where(below < -1e-3, table[3] / np.maximum(-below, 1e-3), 2.0).clip(max=2.0)
    pixels = np.rint(CAMERA.project(surface)).astype(int)
    for du in (0, 1):
        for dv in (0, 1):
            u, v = pixels[:, 0] + du, pixels[:, 1] + dv
            inside = (u >= 0) & (u < CAMERA.width) & (v >= 0) & (v < CAMERA.height)
            np.minimum.at(depth, (v[inside], u[inside]), surface[inside, 2])
    for finger in range(5):
        chain = [0, *range(1 + 4 * finger, 5 + 4 * finger)]
        for near, far in itertools.pairwise(chain):
            for x in np.linspace(0, 1, 12):
                end = 0.75 if far % 4 == 0 else 1.0
                point = joints[near] + end * x * (joints[far] - joints[near])
                palm = 0.013 if near == 0 and x > 0.3 else FLESH[near]
                _ball(depth, rays, point, palm + x * (min(FLESH[far], palm) - palm))
    return depth


def _ball(depth: np.ndarray, rays: np.ndarray, center: np.ndarray, radius: float) -> None:
    u, v = np.rint(CAMERA.project(center)).astype(int)
    reach = int(np.ceil(CAMERA.fx * radius / center[2])) + 1
    part = np.s_[max(v - reach, 0) : max(v + reach, 0), max(u - reach, 0) : max(u + reach, 0)]
    aside = np.linalg.norm(rays[part][..., :2] * center[2] - center[:2], axis=-1)
    skin = center[2] - np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
    depth[part] = np.where(aside < radius, np.minimum(depth[part], skin), depth[part])

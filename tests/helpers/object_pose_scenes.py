"""Small depth images of an object on or above a table, in a crude hand, by the library's own rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from fungrasp.geometry.poses import compose, invert, quaternion_from_rotation_vector, transform_points
from fungrasp.grasps.human_hand import BONES
from fungrasp.objects import ObjectModel
from fungrasp.perception import Capture, HandEstimate, Intrinsics
from fungrasp.perception.object_pose.object_template import MeshRays

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
HERE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Scene:
    capture: Capture
    """Without a mask."""
    mask: np.ndarray
    pose: np.ndarray
    """Object in the camera frame."""
    table: np.ndarray
    """Plane, camera frame."""
    hand: HandEstimate


def looking_down(angle: float = 0.8, distance: float = 0.6) -> np.ndarray:
    """Camera in the world, 0.6 m from a point above the table's origin, shape [7]."""
    turn = quaternion_from_rotation_vector(np.array([np.pi / 2 + angle, 0.0, 0.0]) * -1.0)
    forward = np.array([0.0, np.cos(angle), -np.sin(angle)])
    return np.concatenate([np.array([0.0, 0.0, 0.06]) - distance * forward, turn])


def hand_joints(beside: np.ndarray) -> np.ndarray:
    """A hand whose fingertips are at a point, coming from the right, shape [21, 3]."""
    joints = np.zeros((21, 3))
    joints[0] = [0.17, 0.0, 0.05]
    for finger in range(5):
        for joint in range(4):
            away = [0.08, 0.06, 0.03, 0.0][joint]
            joints[1 + 4 * finger + joint] = [away, 0.018 * (finger - 2), 0.02 + 0.3 * away]
    return joints + beside


def scene(
    model: ObjectModel | trimesh.Trimesh,
    pose_world: np.ndarray,
    beside: np.ndarray,
    *,
    seed: int = 0,
    noise: float = 0.001,
) -> Scene:
    rng = np.random.default_rng(seed)
    world_camera = looking_down()
    camera_world = invert(world_camera)
    pose = compose(camera_world, pose_world)
    directions = CAMERA.rays().reshape(-1, 3)
    obj = MeshRays(model.vertices, model.faces).cast(pose[None], directions)[0]
    joints = hand_joints(beside)
    rods = [trimesh.creation.capsule(radius=0.008, segment=joints[list(bone)]) for bone in BONES]
    skin: Any = trimesh.util.concatenate(rods)
    flesh = MeshRays(skin.vertices, skin.faces).cast(camera_world[None], directions)[0]
    plane = np.append(transform_points(camera_world, np.array([[0.0, 0, 1]]))[0] - camera_world[:3], 0.0)
    plane[3] = world_camera[2]
    slope = directions @ plane[:3]
    table = np.where(slope < -1e-3, -plane[3] / slope, 3.0)
    depth = np.minimum(np.minimum(obj, flesh), np.minimum(table, 3.0))
    mask = (obj == depth).reshape(240, 320)
    depth = depth + noise * rng.normal(size=depth.shape)
    color = np.full((240, 320, 3), 120, np.uint8)
    camera_joints = transform_points(camera_world, joints)
    hand = HandEstimate(
        camera_joints,
        CAMERA.project(camera_joints),
        np.ones(21),
        np.tile(np.eye(3) * 1e-5, (21, 1, 1)),
        "right",
        0.9,
    )
    capture = Capture(color, depth.reshape(240, 320).astype(np.float32), CAMERA)
    return Scene(capture, mask, pose, plane, hand)

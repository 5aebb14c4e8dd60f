"""``python -m benchmarks.perception tracking``: a known object followed while a hand moves it.

The images are simple: object, hand and table are flat colors with noise; the depth is smoothed as a stereo
camera's is, if wanted. The hand moves with the object, which swings by some centimeters and tens of degrees.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage

from benchmarks.perception.measurements import RIGHT_MM
from fungrasp.cli.console import table, write_json
from fungrasp.core.provenance import machine
from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, rotate, transform_points
from fungrasp.grasps import HumanGrasp, load_human_grasps, load_objects
from fungrasp.grasps.human_hand import BONES
from fungrasp.objects import ObjectModel
from fungrasp.perception import Intrinsics
from fungrasp.perception.object_pose.known_object import MeshRays
from fungrasp.perception.object_pose.pose_error import add_s
from fungrasp.perception.object_pose.tracker import FOLLOWED, ObjectTracker
from fungrasp.perception.perceived import Stopwatch

LENS = Intrinsics(640, 480, 615.0, 615.0, 319.5, 239.5)
"""The camera of the images."""

IMAGES_PER_SECOND = 15.0
"""Of the camera."""

DISTANCE = 0.65
"""Of the camera from the object [m]."""

COLORS = np.array([[120, 95, 70], [205, 160, 135], [60, 110, 170]])
"""RGB of table, skin and object."""

NOISE = (6.0, 0.0015)
"""Standard deviation of colors, 0 to 255, and of depth [m]."""

SMOOTHED = 11
"""Pixels over which the smoothed depth is averaged: as wide as measured outlines of a stereo camera."""


@dataclass(frozen=True)
class Tracking:
    """Follow each object through images of its first grasp, which moves, with sharp and with smoothed
    depth."""

    grasps: str = "builtin"
    """A file of human grasps, or "builtin"."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; built-in objects need none."""
    images: int = 30
    """Images of each object."""
    json: Path | None = None
    """Write the numbers here (.json)."""

    def run(self) -> None:
        grasps = load_human_grasps(self.grasps)
        objects = load_objects(grasps, self.objects)
        rows = [("object", "depth", "ADD-S < 10 mm", "median [mm]", "followed", "median [s]", "CPU [s]")]
        results: list[dict[str, Any]] = []
        for name in sorted(objects):
            first = int(np.flatnonzero(grasps.object_name == name)[0])
            for smoothed in (1, SMOOTHED):
                found = measure_tracking(grasps[first], objects[name], self.images, smoothed=smoothed)
                results.append({"object": name, "smoothed": smoothed, **asdict(found)})
                rows.append(
                    (
                        name,
                        "sharp" if smoothed == 1 else f"{smoothed} px",
                        f"{found.right:.0%}",
                        f"{found.add_s_mm:.1f}",
                        f"{found.followed:.0%}",
                        f"{found.seconds:.3f}",
                        f"{found.cpu_seconds:.3f}",
                    )
                )
        if self.json is not None:
            write_json(self.json, {"machine": machine(), "images": self.images, "each": results})
        print(table(rows, left=(0, 1)))
        print(f"{self.images} images each; {machine()}")


@dataclass(frozen=True)
class TrackingResult:
    """How an object was followed through a sequence of images."""

    images: int
    """How many there were."""
    right: float
    """Part of them in which ADD-S was below ``RIGHT_MM``."""
    add_s_mm: float
    """ADD-S [mm], median."""
    followed: float
    """Part of the images in which the tracker said that it follows."""
    seconds: float
    """Wall time of an image [s], median."""
    cpu_seconds: float
    """Processor time of an image [s], median."""


def measure_tracking(
    grasp: HumanGrasp, model: ObjectModel, images: int, *, smoothed: int = 1, seed: int = 0
) -> TrackingResult:
    """Follow the object of a grasp that moves.

    Args:
        grasp: of a hand, world frame.
        model: the object.
        images: how many.
        smoothed: depth is the mean over so many pixels; 1: it is sharp.
        seed: decides the noise.
    """
    # Into the camera's frame: 0.65 m ahead, seen from half above.
    tilt = quaternion_from_rotation_vector(np.array([2.2, 0.0, 0.0]))
    place = np.array([0.0, 0.0, DISTANCE]) - rotate(tilt, grasp.object_pose[:3])
    camera_world = np.concatenate([place, tilt])
    rods = [trimesh.creation.capsule(radius=0.009, segment=grasp.hand_joints[list(bone)]) for bone in BONES]
    vertices = np.concatenate([np.asarray(rod.vertices) for rod in rods])
    starts = np.cumsum([0, *(len(rod.vertices) for rod in rods[:-1])])
    faces = np.concatenate([np.asarray(rod.faces) + start for rod, start in zip(rods, starts, strict=True)])
    hand, thing = MeshRays(vertices, faces), MeshRays(model.vertices, model.faces)
    rays = LENS.rays().reshape(-1, 3)
    rng = np.random.default_rng(seed)
    first = compose(camera_world, grasp.object_pose)
    tracker = ObjectTracker(model, LENS, first, seed=seed)
    surface = np.asarray(trimesh.sample.sample_surface(model.mesh, 2000, seed=0)[0])
    errors, scores, wall, cpu = [], [], [], []
    for i in range(images):
        motion = _motion(i / IMAGES_PER_SECOND, first[:3])
        truth = compose(motion, first)
        depths = np.stack(
            [
                np.full(len(rays), DISTANCE + 0.25),
                hand.cast(compose(motion, camera_world)[None], rays)[0],
                thing.cast(truth[None], rays)[0],
            ]
        )
        color = COLORS[depths.argmin(axis=0)] + NOISE[0] * rng.normal(size=(len(rays), 3))
        depth = ndimage.uniform_filter(depths.min(axis=0).reshape(LENS.height, LENS.width), smoothed)
        depth += NOISE[1] * rng.normal(size=depth.shape)
        image = np.clip(color, 0, 255).astype(np.uint8).reshape(*depth.shape, 3)
        watch = Stopwatch()
        with watch.stage("image"):
            found = tracker.update(image, depth.astype(np.float32))
        wall.append(watch.seconds["image"].wall)
        cpu.append(watch.seconds["image"].cpu)
        errors.append(1000 * float(add_s(surface, found.pose, truth)))
        scores.append(found.score)
    right = float(np.mean(np.array(errors) < RIGHT_MM))
    followed = float(np.mean(np.array(scores) >= FOLLOWED))
    medians = (float(np.median(values)) for values in (wall, cpu))
    return TrackingResult(images, right, float(np.median(errors)), followed, *medians)


def _motion(time: float, middle: np.ndarray) -> np.ndarray:
    """Motion in the camera frame at a time [s] about a point [m], shape [7]; none at time 0. Up to 0.2 m/s
    and 60 degrees/s."""
    shift = np.array([0.06 * np.sin(2 * time), 0.05 * np.sin(1.3 * time), 0.05 * (1 - np.cos(1.5 * time))])
    turn = np.array([0.5 * np.sin(1.1 * time), 0.3 * np.sin(1.7 * time), 0.8 * np.sin(0.9 * time)])
    quaternion = quaternion_from_rotation_vector(turn)
    moved = middle + shift - transform_points(np.concatenate([np.zeros(3), quaternion]), middle[None])[0]
    return np.concatenate([moved, quaternion])

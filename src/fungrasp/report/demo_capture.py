"""What is known about the image that ``fungrasp demo --from-image`` starts from."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import trimesh

from fungrasp.errors import FungraspError
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE
from fungrasp.perception.object_pose.pose_error import add, rotation_error
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.pipeline import perceive
from fungrasp.report.page_parts import Quantity

BUILTIN = "builtin"
"""Stands for the image that comes with the package."""


@dataclass(frozen=True, eq=False)
class DemoTruth:
    """What is known about the image because it was made."""

    object_name: str
    """Name of the built-in object."""
    task: str
    """What the grasp is for."""
    pose_camera_object: np.ndarray
    """Pose of the object in the camera frame, shape [7]."""
    joints_camera: np.ndarray
    """Joints of the hand [m], camera frame, shape [21, 3]."""


def demo_truth() -> DemoTruth:
    """The truth about the image in ``BUILTIN_CAPTURE``."""
    truth = json.loads((BUILTIN_CAPTURE / "truth.json").read_text())
    return DemoTruth(
        truth["object_name"],
        truth["task"],
        np.array(truth["pose_camera_object"]),
        np.array(truth["joints_camera"]),
    )


def true_errors(truth: DemoTruth, perceived: Perceived) -> list[Quantity]:
    """How far what was perceived is from the truth."""
    joints = 1e3 * np.linalg.norm(perceived.hand.joints_camera - truth.joints_camera, axis=1)
    pose = perceived.object.pose_camera_object
    points = np.asarray(trimesh.sample.sample_surface(perceived.object_model.mesh, 2000, seed=0)[0])
    apart = 1e3 * float(add(points, pose, truth.pose_camera_object))
    turned = float(np.degrees(rotation_error(pose, truth.pose_camera_object)))
    return [
        Quantity("Error of the joints", float(joints.mean()), "mm", "Mean of the 21 joints.", 12.0),
        Quantity("Error of the worst joint", float(joints.max()), "mm", "Usually one that is hidden."),
        Quantity("Error of the object", apart, "mm", "Mean distance of its points from the true ones.", 10.0),
        Quantity("Turn of the object", turned, "°", "Between its pose and the true one.", 10.0),
    ]


def perceive_image(
    folder: str, mesh: str | None, mass: float | None = None, task: str = "", seed: int = 0
) -> tuple[Perceived, list[Quantity]]:
    """What is in the image of a folder, or in the built-in one.

    Args:
        folder: of the capture, or ``BUILTIN``.
        mesh: a mesh file, or the name of a built-in object.
        mass: of the object [kg]; None takes a built-in object's own, or guesses it from the mesh.
        task: what the grasp is for.
        seed: the same seed gives the same grasp.

    Returns:
        what was perceived, and its errors where the truth is known.

    Raises:
        FungraspError: the folder or the mesh is bad, no hand is seen, or the hand models are not set up.
    """
    if folder == BUILTIN:
        if mesh is not None or mass is not None:
            raise FungraspError("the built-in image has its own object: --mesh and --mass need a folder")
        truth = demo_truth()
        seen = perceive(BUILTIN_CAPTURE, truth.object_name, task=task or truth.task, seed=seed)
        return seen, list(true_errors(truth, seen))
    if mesh is None:
        raise FungraspError(
            f"image {folder}: --mesh must say what is held: a mesh file, or a built-in object's name"
        )
    return perceive(folder, mesh, mass=mass, task=task, seed=seed), []

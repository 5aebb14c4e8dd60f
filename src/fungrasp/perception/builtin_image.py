"""The grasp in the image of a folder, or in the one that comes with the package, whose truth is known."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.perception.image_source import BUILTIN
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.pipeline import perceive


@dataclass(frozen=True, eq=False)
class BuiltinTruth:
    """What is known about the built-in image because it was made."""

    object_name: str
    """Name of the built-in object."""
    task: str
    """What the grasp is for."""
    pose_camera_object: np.ndarray
    """Pose of the object in the camera frame, shape [7]."""
    joints_camera: np.ndarray
    """Joints of the hand [m], camera frame, shape [21, 3]."""


def builtin_truth() -> BuiltinTruth:
    """The truth about the image in ``BUILTIN_CAPTURE``."""
    truth = json.loads((BUILTIN_CAPTURE / "truth.json").read_text())
    return BuiltinTruth(
        truth["object_name"],
        truth["task"],
        np.array(truth["pose_camera_object"]),
        np.array(truth["joints_camera"]),
    )


def perceive_folder(
    folder: str, mesh: str | None, mass: float | None = None, task: str = "", seed: int = 0
) -> Perceived:
    """What is in the image of a folder, or in the built-in one, whose object need not be said.

    Args:
        folder: of the capture, or ``BUILTIN``.
        mesh: a mesh file, or the name of a built-in object.
        mass: of the object [kg]; None takes a built-in object's own, or guesses it from the mesh.
        task: what the grasp is for.
        seed: the same seed gives the same grasp.

    Raises:
        FungraspError: the folder or the mesh is bad, no hand is seen, or the hand models are not set up.
    """
    if folder == BUILTIN:
        if mesh is not None or mass is not None:
            raise FungraspError("the built-in image has its own object: --mesh and --mass need a folder")
        truth = builtin_truth()
        return perceive(BUILTIN_CAPTURE, truth.object_name, task=task or truth.task, seed=seed)
    if mesh is None:
        raise FungraspError(
            f"image {folder}: --mesh must say what is held: a mesh file, or a built-in object's name"
        )
    return perceive(folder, mesh, mass=mass, task=task, seed=seed)

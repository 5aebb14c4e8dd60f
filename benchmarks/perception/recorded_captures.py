"""A validation set: images of a real camera in folders, each with what is known about it.

Each capture is a folder of its own (``rgb.png``, ``depth.png``, ``K.json``, if there is one ``mask.png``)
with a file ``truth.json``; all entries of that are optional::

    {"object": "mug.obj",                      mesh file beside the capture or one folder up, or a built-in
    one
     "object_pose_camera_wxyz": [x, y, z, qw, qx, qy, qz],          mesh in the camera frame [m]
     "joints_camera_m": [[x, y, z], ...],      21 joints, camera frame [m]; null or NaN: not known
     "visible_joint_pixels": [[u, v], ...],    21 joints [pixels]; null: hidden
     "side": "right",
     "held": true,                             false: the hand does not touch the object
     "table_plane_camera": [nx, ny, nz, d]}    n . x + d is the height above the table [m]
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.text_files import read_json
from fungrasp.objects import (
    ObjectModel,
    builtin_object,
    is_plain_shape,
    object_from_file,
    object_names,
    plain_shape,
)
from fungrasp.objects.resolved_object import colored_mesh
from fungrasp.perception import Capture
from fungrasp.perception.io.estimates import JOINTS
from fungrasp.perception.io.image_files import read_mask
from fungrasp.perception.io.scene_folders import LENS_FILE, read_folder

TRUTH = "truth.json"
"""File with what is known about a capture."""

RENDERED_MASK = "object_mask.png"
"""The object's pixels in a rendered capture."""

MASS = 0.1
"""Mass that meshes of a validation set get [kg]; poses do not depend on it."""


@dataclass(frozen=True, eq=False)
class RecordedCapture:
    """A capture of a real camera and what is known about it."""

    name: str
    """Name of its folder."""
    capture: Capture
    """The image with its depth and intrinsics, and the object's mask, if there is one."""
    model: ObjectModel | None
    """The object; None where no object is to be found."""
    colored: trimesh.Trimesh | None
    """Its mesh with the colors of its file, if it has any."""
    pose_camera_object: np.ndarray | None
    """True pose of the object in the camera frame, shape [7]."""
    joints_camera: np.ndarray | None
    """True joints of the hand [m], camera frame, shape [21, 3]; NaN: not known."""
    joint_pixels: np.ndarray | None
    """Joints that are seen [pixels], shape [21, 2]; NaN: hidden."""
    table: np.ndarray | None
    """Plane of the table ``[nx ny nz d]``, camera frame, shape [4]."""
    held: bool = True
    """Whether the hand holds the object; where it hovers no answer may be sure."""


def recorded_folders(folder: str | Path) -> list[Path]:
    """The captures of a validation set, by name.

    Raises:
        FungraspError: there are none.
    """
    found = sorted(path.parent for path in Path(folder).glob(f"*/{LENS_FILE}"))
    if not found:
        raise FungraspError(
            f"{folder} has no captures: each is a folder in it with rgb.png, depth.png, {LENS_FILE} and "
            f"{TRUTH}"
        )
    return found


def read_recorded(folder: str | Path) -> RecordedCapture:
    """Read one capture and its truth.

    Raises:
        FungraspError: a file can't be read, or an entry of the truth is not what it should be.
    """
    folder = Path(folder)
    path = folder / TRUTH
    truth = read_json(path, "truth of a capture") if path.is_file() else {}
    if not isinstance(truth, dict):
        raise FungraspError(f"{path} must hold an object with names, see docs/perceive.md")
    model, colored = _object(folder, truth.get("object"))
    pose = _numbers(path, truth, "object_pose_camera_wxyz", (7,))
    if pose is not None and not abs(float(np.linalg.norm(pose[3:])) - 1.0) < 0.01:
        raise FungraspError(f"{path}: the quaternion of object_pose_camera_wxyz must have length 1")
    if pose is not None and model is None:
        raise FungraspError(f'{path}: a pose without "object": name the mesh file or the built-in object')
    return RecordedCapture(
        folder.name,
        _with_mask(folder, read_folder(folder)),
        model,
        colored,
        pose,
        _numbers(path, truth, "joints_camera_m", (JOINTS, 3)),
        _numbers(path, truth, "visible_joint_pixels", (JOINTS, 2)),
        _numbers(path, truth, "table_plane_camera", (4,)),
        truth.get("held") is not False,
    )


def _with_mask(folder: Path, capture: Capture) -> Capture:
    """The capture with the mask that a rendered one has under another name, as it is not given away there."""
    path = folder / RENDERED_MASK
    if capture.mask is not None or not path.is_file():
        return capture
    mask = read_mask(path, capture.depth.shape)
    return capture.with_object(mask=mask) if mask.any() else capture


def _object(folder: Path, name: Any) -> tuple[ObjectModel | None, trimesh.Trimesh | None]:
    if name is None:
        return None, None
    for path in (folder / str(name), folder.parent / str(name)):
        # Unlike Path.is_file it takes a name of any length.
        if os.path.isfile(path):  # noqa: PTH113
            model = object_from_file(path, MASS)
            return model, colored_mesh(path, model)
    if is_plain_shape(str(name)):
        return plain_shape(str(name), MASS), None
    if str(name) in object_names():
        return builtin_object(str(name)), None
    raise FungraspError(
        f"{folder / TRUTH}: the object '{name}' is neither a mesh file in {folder} or {folder.parent}, nor a "
        "built-in object, nor a shape like box:60x28x30"
    )


def _numbers(path: Path, truth: dict[str, Any], name: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """An entry as an array; NaN for null within tables."""
    value = truth.get(name)
    if value is None:
        return None
    try:
        if len(shape) == 2:
            value = [[np.nan] * shape[1] if row is None else row for row in value]
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{path}: {name} must be numbers of shape {list(shape)}") from error
    if array.shape != shape or (len(shape) == 1 and not np.isfinite(array).all()):
        raise FungraspError(f"{path}: {name} must be numbers of shape {list(shape)}, not {list(array.shape)}")
    return array

"""Reading DexYCB's own folder layout (dex-ycb.github.io): sequences, labels, calibration.

::

    <root>/<subject>/<sequence>/meta.yml                     serials, num_frames, ycb_ids, ycb_grasp_ind,
    mano_sides, ... <root>/<subject>/<sequence>/<serial>/labels_000000.npz   pose_y, pose_m, joint_3d (camera
    frame) <root>/calibration/extrinsics_<name>/extrinsics.yml      camera poses and the pose of a tag that
    lies on the table <root>/calibration/mano_<name>/mano.yml                  betas
    <root>/models/<object>/textured_simple.obj

The tag's frame has x and y along the table and z up; it is our world frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import read_yaml

TAG = "apriltag"

TO_OUR_JOINTS = np.array([0, *range(5, 21), *range(1, 5)])
"""DexYCB's joints are wrist, thumb, index, middle, ring, little finger; ours have the thumb last."""


@dataclass(frozen=True)
class Sequence:
    """One recording of one grasp."""

    folder: Path
    """Folder of the recording."""
    frames: int
    """Number of frames, F."""
    serials: tuple[str, ...]
    """Cameras that have labels."""
    object_number: int
    """Number of the grasped object, a key of ``YCB_NAMES``."""
    grasped: int
    """Row of the grasped object in ``pose_y``."""
    side: str
    """"right" or "left"."""
    world_camera: Mapping[str, np.ndarray]
    """Camera frame to world frame by serial, shape [4, 4]."""
    betas: np.ndarray
    """Shape of the subject's hand, MANO coefficients, shape [10]."""


@dataclass(frozen=True)
class Track:
    """What the labels of one camera say over time, in the world frame. F frames."""

    object_matrix: np.ndarray
    """Grasped object, shape [F, 4, 4]; NaN where not labelled."""
    joints: np.ndarray
    """[m], our order, shape [F, 21, 3]; NaN where not labelled."""
    mano: np.ndarray
    """Rotation, 45 pose components, translation [m], camera frame, shape [F, 51]; NaN where not labelled."""
    world_camera: np.ndarray
    """shape [4, 4]."""


def sequence_folders(root: Path) -> list[Path]:
    """Folders with a ``meta.yml`` under ``<root>/<subject>``, sorted.

    Raises:
        FungraspError: no such folder, or none in it.
    """
    if not root.is_dir():
        raise FungraspError(f"the DexYCB folder {root} does not exist")
    folders = sorted(path.parent for path in root.glob("*/*/meta.yml"))
    if not folders:
        raise FungraspError(f"{root} holds no DexYCB sequence (<subject>/<sequence>/meta.yml)")
    return folders


def read_sequence(root: Path, folder: Path) -> Sequence:
    """Read a sequence's description and calibration.

    Raises:
        FungraspError: a file is missing or lacks a field.
    """
    path = folder / "meta.yml"
    meta = read_yaml(path)
    fields = ("serials", "num_frames", "ycb_ids", "ycb_grasp_ind", "mano_sides", "mano_calib", "extrinsics")
    serials, frames, ids, grasped, sides, shapes, extrinsics = (_field(path, meta, name) for name in fields)
    if not 0 <= int(grasped) < len(ids):
        raise FungraspError(f"{path}: ycb_grasp_ind is {grasped}, but there are {len(ids)} objects")
    present = tuple(str(serial) for serial in serials if (folder / str(serial)).is_dir())
    if not present:
        raise FungraspError(f"{folder} has no folder of any of its cameras {', '.join(map(str, serials))}")
    calibration = root / "calibration"
    mano_path = calibration / f"mano_{shapes[0]}" / "mano.yml"
    return Sequence(
        folder=folder,
        frames=int(frames),
        serials=present,
        object_number=int(ids[int(grasped)]),
        grasped=int(grasped),
        side=str(sides[0]),
        world_camera=_camera_poses(calibration / f"extrinsics_{extrinsics}" / "extrinsics.yml", present),
        betas=np.array(_field(mano_path, read_yaml(mano_path), "betas"), dtype=np.float64),
    )


def read_track(sequence: Sequence, serial: str) -> Track:
    """Read the labels of one camera, in the world frame.

    Raises:
        FungraspError: a label file is missing, unreadable or of the wrong shape.
    """
    world_camera = sequence.world_camera[serial]
    objects = np.full((sequence.frames, 4, 4), np.nan)
    joints = np.full((sequence.frames, 21, 3), np.nan)
    mano = np.full((sequence.frames, 51), np.nan)
    for frame in range(sequence.frames):
        path = sequence.folder / serial / f"labels_{frame:06d}.npz"
        pose_y, joint_3d, pose_m = _label(path)
        if pose_y.shape[0] <= sequence.grasped:
            raise FungraspError(
                f"{path}: field 'pose_y' has shape {pose_y.shape}, object {sequence.grasped} is missing"
            )
        if pose_y[sequence.grasped].any():
            objects[frame] = world_camera @ np.vstack([pose_y[sequence.grasped], [0, 0, 0, 1]])
        if pose_m.any() and not (joint_3d == -1).all():
            joints[frame] = joint_3d[TO_OUR_JOINTS] @ world_camera[:3, :3].T + world_camera[:3, 3]
            mano[frame] = pose_m
    return Track(objects, joints, mano, world_camera)


def _label(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    found = read_npz(path, "DexYCB label", ("pose_y", "joint_3d", "pose_m").__contains__)
    for name, shape in (("pose_y", (None, 3, 4)), ("joint_3d", (1, 21, 3)), ("pose_m", (1, 51))):
        if name not in found or found[name].dtype.kind not in "fiu":
            raise FungraspError(f"{path}: there is no field '{name}' of numbers")
        found[name] = found[name].astype(np.float64)
        actual = found[name].shape
        if len(actual) != len(shape) or any(w not in (None, a) for w, a in zip(shape, actual, strict=True)):
            expected = str(shape).replace("None", "objects")
            raise FungraspError(f"{path}: field '{name}' has shape {actual}, expected {expected}")
    return found["pose_y"], found["joint_3d"][0], found["pose_m"][0]


def _camera_poses(path: Path, serials: tuple[str, ...]) -> dict[str, np.ndarray]:
    poses = _field(path, read_yaml(path), "extrinsics")
    matrices = {}
    for name in (TAG, *serials):
        try:
            matrix = np.array(poses[name], dtype=np.float64).reshape(3, 4)
        except (KeyError, TypeError, ValueError) as error:
            raise FungraspError(f"{path}: no 3 by 4 pose of '{name}'") from error
        matrices[name] = np.vstack([matrix, [0, 0, 0, 1]])
    world_master = np.linalg.inv(matrices[TAG])
    return {serial: world_master @ matrices[serial] for serial in serials}


def _field(path: Path, content: Mapping[str, Any], name: str) -> Any:
    if name not in content:
        raise FungraspError(f"{path}: the field '{name}' is missing")
    return content[name]

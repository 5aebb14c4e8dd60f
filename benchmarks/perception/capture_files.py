"""Writing rendered captures to folders that perception reads, with the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from benchmarks.synthetic_captures.capture_scene import Label
from benchmarks.synthetic_captures.capture_settings import CaptureSettings
from benchmarks.synthetic_captures.painted_mesh import PaintedMesh
from benchmarks.synthetic_captures.render_capture import SyntheticCapture, capture_at
from fungrasp.core.files import atomic_path
from fungrasp.geometry.poses import rotation_matrix
from fungrasp.grasps import HumanGraspSet
from fungrasp.objects import ObjectModel, mirrored_name, mirrored_object
from fungrasp.perception.io.scene_folders import COLOR_FILE, DEPTH_FILE, LENS_FILE

TRUTH_FILE, LABELS_FILE, OBJECT_MASK_FILE = "truth.json", "labels.png", "object_mask.png"
"""What a photograph's folder would not have."""

MESH_FILE = "object.stl"
"""The object's mesh without colors [m]."""

HIDING = 0.025
"""What is farther in front of a joint than this [m] is not its own skin."""

DEPTH_UNIT = 0.001
"""Meters per unit of the written depth."""


def write_capture(synthetic: SyntheticCapture, folder: str | Path, model: ObjectModel | None = None) -> None:
    """Write what a camera would give, the painted mesh and the truth.

    That is ``rgb.png``, ``depth.png`` (16 bit, 1 mm), ``K.json``, ``<object>.ply``; ``truth.json``,
    ``labels.png`` and ``object_mask.png``, whose name keeps it from being taken for a mask given. The truth
    has the entries that ``benchmarks.perception`` reads of recorded captures, too.

    Args:
        synthetic: the capture.
        folder: where to write it.
        model: the object, a left hand's mirrored; its mesh without colors becomes ``object.stl``.

    Raises:
        FungraspError: the folder can't be written to.
    """
    folder, capture = Path(folder), synthetic.capture
    lens = capture.intrinsics
    _save_image(folder / COLOR_FILE, capture.color)
    _save_image(folder / DEPTH_FILE, np.round(capture.depth / DEPTH_UNIT).clip(0, 65535).astype(np.uint16))
    _save_image(folder / LABELS_FILE, synthetic.labels)
    _save_image(folder / OBJECT_MASK_FILE, np.where(synthetic.object_mask, 255, 0).astype(np.uint8))
    fields = {name: getattr(lens, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    _save_json(folder / LENS_FILE, {**fields, "depth_unit": DEPTH_UNIT})
    grasp = synthetic.grasp
    truth = {
        "object_name": str(grasp.object_name),
        "object_mass": float(grasp.object_mass),
        "task": str(grasp.task),
        "pose_world_camera": synthetic.pose_world_camera.tolist(),
        "object_pose": grasp.object_pose.tolist(),
        "object_rest_pose": grasp.object_rest_pose.tolist(),
        "hand_joints": grasp.hand_joints.tolist(),
        "link_contacts": grasp.link_contacts.tolist(),
        "held": bool(grasp.link_contacts.any()),
        "side": synthetic.side,
        "object_pose_camera_wxyz": synthetic.pose_camera_object.tolist(),
        "joints_camera_m": synthetic.joints_camera.tolist(),
        "visible_joint_pixels": _visible_joints(synthetic),
        "table_plane_camera": _table(synthetic),
        "labels": {label.name.lower(): int(label) for label in Label},
    }
    if model is not None:
        truth["object"] = MESH_FILE
        with atomic_path(folder / MESH_FILE) as path:
            trimesh.Trimesh(model.vertices, model.faces, process=False).export(path, file_type="stl")
    with atomic_path(folder / f"{grasp.object_name}.ply") as path:
        painted_mesh(synthetic.painted).export(path)
    # Last, so that a folder with it is whole.
    _save_json(folder / TRUTH_FILE, truth)


def render_set(
    folder: Path,
    human: HumanGraspSet,
    objects: Mapping[str, ObjectModel],
    index: int,
    seed: int,
    settings: CaptureSettings,
) -> None:
    """Render one capture of a validation set into a folder of its own, unless it is there."""
    place = folder / f"{seed}_{index:04d}"
    if (place / TRUTH_FILE).is_file():
        return
    known = capture_at(index, human, objects, seed, settings)
    # The grasp's row decides the object; of a left hand it is named after its mirror image.
    name = known.grasp.object_name
    model = objects[name] if known.side == "right" else mirrored_object(objects[mirrored_name(name)])
    write_capture(known, place, model)


def painted_mesh(painted: PaintedMesh) -> trimesh.Trimesh:
    """The same as a mesh with a color per vertex."""
    colors = np.round(255 * painted.colors).astype(np.uint8)
    return trimesh.Trimesh(painted.vertices, painted.faces, vertex_colors=colors, process=False)


def _visible_joints(synthetic: SyntheticCapture) -> list[list[float] | None]:
    """Pixels of the joints whose skin is seen; None for hidden ones."""
    lens, joints = synthetic.capture.intrinsics, synthetic.joints_camera
    seen: list[list[float] | None] = []
    for (u, v), joint in zip(lens.project(joints).tolist(), joints, strict=True):
        column, row = round(u), round(v)
        inside = 0 <= column < lens.width and 0 <= row < lens.height
        skin = inside and synthetic.hand_mask[row, column]
        # Another part of the hand may hide it.
        depth = float(synthetic.capture.depth[row, column]) if skin else 0.0
        seen.append([u, v] if skin and abs(depth - float(joint[2])) < HIDING else None)
    return seen


def _table(synthetic: SyntheticCapture) -> list[float]:
    """The table's plane ``[nx ny nz d]`` in the camera frame."""
    pose = synthetic.pose_world_camera
    return [*rotation_matrix(pose[3:])[2].tolist(), float(pose[2])]


def _save_image(path: Path, pixels: np.ndarray) -> None:
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary)


def _save_json(path: Path, content: Any) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")

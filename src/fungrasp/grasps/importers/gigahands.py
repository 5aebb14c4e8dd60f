"""Grasps from GigaHands (Fu et al., CVPR 2025; ivl.cs.brown.edu/research/gigahands.html)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.text_files import read_json
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.importers.motions import LARGEST, data_object, each, grasp_from_motion, numbers


def import_gigahands(root: str | Path) -> HumanGraspSet:
    """Import one grasp of the right hand from each sequence with a tracked object.

    The world's y axis points up.

    Args:
        root: folder with ``hand_poses/<session>/keypoints_3d_mano_align/<sequence>.json`` (joints of the
            left, then the right hand in each frame in which either is tracked), ``keypoints_3d/<sequence>/
            chosen_frames_right.json`` and ``_left`` beside it (these frames),
            ``object_poses/<scene>/<object>/<session>_<sequence>/pose/optimized_pose.json`` (rotations as
            transposed quaternions or rotation vectors) and ``object_meta/<scene>/<object>/<mesh>.obj``.

    Raises:
        FungraspError: no sequence can be used; the message is the first reason.
    """
    root = Path(root)

    def grasp(path: Path) -> HumanGrasp:
        scene, thing, sequence = path.parts[-5:-2]
        session, _, number = sequence.rpartition("_")
        if not number.isdecimal():
            raise FungraspError(f"{path}: the folder '{sequence}' is no <session>_<sequence>")
        folder, number = root / "hand_poses" / session, f"{int(number):03d}"
        right, left = (
            numbers(file, {"frames": read_json(file, "list of frames")}, "frames", (None,)).astype(int)
            for side in ("right", "left")
            for file in (folder / "keypoints_3d" / number / f"chosen_frames_{side}.json",)
        )
        seen = np.union1d(right, left)
        file = folder / "keypoints_3d_mano_align" / f"{number}.json"
        hands = numbers(file, {"joints": read_json(file, "file of joints", LARGEST)}, "joints")
        if hands.size != len(seen) * 2 * 21 * 3:
            raise FungraspError(f"{file}: joints of shape {hands.shape} in {len(seen)} frames of two hands")
        joints = dict(zip(seen.tolist(), hands.reshape(-1, 2, 21, 3)[:, 1], strict=True))
        tracked = read_json(path, "object poses", LARGEST)
        frames = sorted(map(str, tracked)) if isinstance(tracked, dict) else []
        poses = np.array([_pose(path, tracked[frame]) for frame in frames]).reshape(-1, 7)

        def right_hand(t: int) -> np.ndarray | None:
            frame = int(frames[t])
            return joints[frame] if frame in right else None

        mesh = data_object(root / "object_meta" / scene, thing)
        return grasp_from_motion(right_hand, poses, mesh, order="openpose", up="y")

    paths = sorted(root.glob("object_poses/*/*/*/pose/optimized_pose.json"))
    return HumanGraspSet.of(each(paths, grasp, f"{root}/object_poses holds no optimized_pose.json"))


def _pose(path: Path, fields: object) -> np.ndarray:
    turn = numbers(path, fields, "mesh_rotation").ravel()
    if turn.shape not in ((3,), (4,)):
        raise FungraspError(f"{path}: 'mesh_rotation' has {turn.size} numbers, expected 3 or 4")
    turned = (
        Rotation.from_rotvec(turn) if len(turn) == 3 else Rotation.from_quat(turn, scalar_first=True).inv()
    )
    place = numbers(path, fields, "mesh_translation").reshape(3)
    return np.concatenate([place, turned.as_quat(scalar_first=True)])

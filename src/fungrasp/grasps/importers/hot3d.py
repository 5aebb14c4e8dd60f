"""Grasps from HOT3D (Banerjee et al., CVPR 2025; facebookresearch.github.io/hot3d)."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.formats.checks import read_text
from fungrasp.core.formats.text_files import parse_json, read_json
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.importers.motions import (
    LARGEST,
    data_object,
    each,
    each_moved,
    grasp_from_motion,
    numbers,
    subtable,
)
from fungrasp.grasps.mano import ManoHand

RIGHT = "1"
"""Key of the right hand in ``hand_poses``."""

COLUMNS = [f"t_wo_{axis}[m]" for axis in "xyz"] + [f"q_wo_{part}" for part in "wxyz"]
"""Columns of an object's pose in ``dynamic_objects.csv``."""


def import_hot3d(root: str | Path, mano: str | Path, objects: str | Path) -> HumanGraspSet:
    """Import one grasp of each object that the right hand moves, from each sequence.

    Args:
        root: folder with a folder per sequence: ``dynamic_objects.csv``, ``mano_hand_pose_trajectory.jsonl``
            (15 principal components relative to the mean hand) and ``metadata.json`` (Aria glasses have a
            world with z up, Quest 3 one with y up).
        mano: folder of your MANO model.
        objects: folder of the object meshes, ``<object_uid>.glb``.

    Raises:
        FungraspError: no sequence can be used; the message is the first reason.
    """
    hand = ManoHand(mano)

    def grasps(folder: Path) -> list[HumanGrasp]:
        glasses = read_json(folder / "metadata.json", "metadata").get("headset") == "Aria"
        path = folder / "mano_hand_pose_trajectory.jsonl"
        lines = [parse_json(line, f"{path}") for line in read_text(path, "hand poses", LARGEST).splitlines()]
        hands = {
            line["timestamp_ns"]: line["hand_poses"][RIGHT] for line in lines if RIGHT in line["hand_poses"]
        }
        tracks: dict[str, dict[int, list[float]]] = {}
        for row in csv.DictReader(read_text(folder / "dynamic_objects.csv", "poses", LARGEST).splitlines()):
            pose = [float(row[column]) for column in COLUMNS]
            tracks.setdefault(row["object_uid"], {})[int(row["timestamp[ns]"])] = pose
        poses = {name: np.array(list(track.values())) for name, track in tracks.items()}

        def grasp(name: str) -> HumanGrasp:
            times = list(tracks[name])

            def joints(t: int) -> np.ndarray | None:
                fields = hands.get(times[t])
                if fields is None:
                    return None
                wrist = subtable(path, fields, "wrist_xform")
                turn = Rotation.from_quat(numbers(path, wrist, "q_wxyz", (4,)), scalar_first=True).as_rotvec()
                betas, pose = numbers(path, fields, "betas", (10,)), numbers(path, fields, "pose", (15,))
                return hand.joints(betas, turn, pose, numbers(path, wrist, "t_xyz", (3,)))

            up = "z" if glasses else "y"
            return grasp_from_motion(joints, poses[name], data_object(objects, name), up=up)

        return each_moved(poses, grasp, folder)

    folders = sorted(path.parent for path in Path(root).glob("*/dynamic_objects.csv"))
    none = f"{root} holds no sequence (<sequence>/dynamic_objects.csv)"
    return HumanGraspSet.of(each(folders, grasps, none))

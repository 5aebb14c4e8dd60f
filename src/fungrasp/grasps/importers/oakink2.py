"""Grasps from OakInk2 (Zhan et al., CVPR 2024; oakink.net/v2)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.grasps.from_arrays import as_pose
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.importers.motions import (
    data_object,
    each,
    each_moved,
    grasp_from_motion,
    numbers,
    subtable,
)
from fungrasp.grasps.mano import ManoHand


def import_oakink2(root: str | Path, mano: str | Path, objects: str | Path) -> HumanGraspSet:
    """Import one grasp of each object that the right hand moves, from each sequence.

    As in the data set's toolkit, the world's y axis points up, rotations of the hand are quaternions (wxyz)
    relative to the flat hand, and its translation is the position of the wrist.

    Args:
        root: folder ``anno_preview`` with a pickle per sequence.
        mano: folder of your MANO model.
        objects: folder ``align_ds`` with a folder per object, each with one mesh.

    Raises:
        FungraspError: no sequence can be used; the message is the first reason.
    """
    hand = ManoHand(mano)

    def grasps(path: Path) -> list[HumanGrasp]:
        fields = load_arrays_pickle(path)
        hands, things = subtable(path, fields, "raw_mano"), subtable(path, fields, "obj_transf")
        frames = [int(frame) for frame in numbers(path, fields, "mocap_frame_id_list", (None,))]

        def joints(t: int) -> np.ndarray:
            params = subtable(path, hands, frames[t])
            turns = Rotation.from_quat(
                numbers(path, params, "rh__pose_coeffs", (1, 16, 4))[0], scalar_first=True
            )
            vectors, betas = turns.as_rotvec(), numbers(path, params, "rh__betas", (1, 10))
            found = hand.joints(betas, vectors[0], vectors[1:], pca=False, flat_hand=True)
            return found - found[0] + numbers(path, params, "rh__tsl", (1, 3))

        def grasp(name: str) -> HumanGrasp:
            return grasp_from_motion(joints, poses[name], data_object(objects, name), up="y")

        poses = {}
        for name in things:
            matrices = [numbers(path, subtable(path, things, name), frame, (4, 4)) for frame in frames]
            poses[str(name)] = np.array([as_pose(matrix) for matrix in matrices])
        return each_moved(poses, grasp, path)

    return HumanGraspSet.of(each(sorted(Path(root).glob("*.pkl")), grasps, f"{root} holds no pickle"))

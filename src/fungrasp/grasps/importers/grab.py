"""Grasps from GRAB (Taheri et al., ECCV 2020; grab.is.tue.mpg.de)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.formats.mesh_file import read_mesh
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.importers.motions import data_object, each, grasp_from_motion, numbers, subtable
from fungrasp.grasps.mano import ManoHand


def import_grab(
    root: str | Path, mano: str | Path, objects: str | Path, subjects: str | Path | None = None
) -> HumanGraspSet:
    """Import one grasp of the right hand from each sequence.

    Args:
        root: folder with ``s1/mug_drink_1.npz`` and so on: world frame with z up, object rotations for row
            vectors, hand poses as 24 principal components relative to the flat hand.
        mano: folder of your MANO model.
        objects: folder of the object meshes, such as ``mug.ply``.
        subjects: folder to which ``vtemp``, the path of a subject's hand, is relative. None: the mean hand.

    Raises:
        FungraspError: no sequence can be used; the message is the first reason.
    """
    hand = ManoHand(mano)

    def grasp(path: Path) -> HumanGrasp:
        fields = load_arrays_pickle(path)
        right, thing = (subtable(path, fields, name) for name in ("rhand", "object"))
        params, pose = subtable(path, right, "params"), subtable(path, thing, "params")
        turns = Rotation.from_rotvec(-numbers(path, pose, "global_orient", (None, 3)))
        places = numbers(path, pose, "transl", (None, 3))
        template = None if subjects is None else read_mesh(Path(subjects) / str(right.get("vtemp")))[0]
        orient, moves = (numbers(path, params, name, (None, 3)) for name in ("global_orient", "transl"))
        fingers = numbers(path, params, "hand_pose", (None, 24))

        def joints(t: int) -> np.ndarray:
            return hand.joints([], orient[t], fingers[t], moves[t], flat_hand=True, template=template)

        name, _, task = path.stem.rpartition("_")[0].partition("_")
        poses = np.concatenate([places, turns.as_quat(scalar_first=True)], axis=1)
        return grasp_from_motion(joints, poses, data_object(objects, name), task=task)

    found = each(sorted(Path(root).glob("*/*.npz")), grasp, f"{root} holds no sequence (<subject>/*.npz)")
    return HumanGraspSet.of(found)

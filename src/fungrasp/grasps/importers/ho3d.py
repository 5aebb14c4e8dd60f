"""Grasps from HO-3D (Hampali et al., CVPR 2020; github.com/shreyashampali/ho3d)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.from_arrays import human_grasp
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.importers.motions import data_object, each, numbers
from fungrasp.grasps.importers.ycb import YCB_MASSES


def import_ho3d(root: str | Path, objects: str | Path, tilt: float = 0.0) -> HumanGraspSet:
    """Import one grasp per sequence, from the labeled frame nearest to the middle.

    The data set contains neither a table nor the vertical. The camera is assumed horizontal, or tilted by
    ``tilt``, and hand and object are placed 5 cm above the table.

    Args:
        root: folder with ``<sequence>/meta/0000.pkl`` and so on: OpenGL camera frame, y up.
        objects: folder of the YCB models, ``003_cracker_box/textured_simple.obj`` or ``003_cracker_box.obj``.
        tilt: downward tilt of the camera [rad].

    Raises:
        FungraspError: no sequence can be used; the message is the first reason.
    """
    upright = Rotation.from_euler("x", 0.5 * np.pi - tilt)

    def grasp(folder: Path) -> HumanGrasp:
        paths = sorted(folder.glob("*.pkl"))
        for path in sorted(paths, key=lambda path: abs(paths.index(path) - len(paths) // 2)):
            fields = load_arrays_pickle(path)
            if isinstance(fields, Mapping) and fields.get("handJoints3D") is not None:
                break
        else:
            raise FungraspError(f"{folder}: no frame has joints of a hand")
        joints = upright.apply(numbers(path, fields, "handJoints3D", (21, 3)))
        turn = upright * Rotation.from_rotvec(numbers(path, fields, "objRot").ravel())
        place = upright.apply(numbers(path, fields, "objTrans").ravel())
        name = str(fields.get("objName"))
        obj = data_object(objects, name, YCB_MASSES.get(name))
        pose = np.concatenate([place, turn.as_quat(scalar_first=True)])
        lowest = min(joints[:, 2].min(), transform_points(pose, obj.model.vertices)[:, 2].min())
        up = np.array([0.0, 0.0, 0.05 - lowest])
        pose[:3] += up
        return human_grasp(joints + up, obj, order="mano", object_pose=pose)

    none = f"{root} holds no sequence (<sequence>/meta/*.pkl)"
    return HumanGraspSet.of(each(sorted(Path(root).glob("*/meta")), grasp, none))

"""Human grasps from the label pickles of D-Grasp (Christen et al., CVPR 2022; github.com/christsa/dgrasp).

``dexycb_train_labels.pkl`` maps DexYCB's object numbers to dicts of arrays with one row per grasp. In
D-Grasp's simulation, ``final_ee`` contains 21 joints as in ``HUMAN_JOINTS``, ``final_contacts`` 16 links as
in ``HUMAN_LINKS``, and ``final_qpos`` the wrist position, then wrist and joint rotations as intrinsic XYZ
Euler angles in the same order of fingers. Poses are positions and wxyz quaternions; the world has z up, with
the table top at 0.5 m.

Object poses refer to D-Grasp's own meshes (``rsc/meshes_simplified``). Some of these are aligned with their
bounding box, unlike the YCB models of the same name.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.importers.ycb import YCB_NAMES, YCB_REST_HEIGHTS

TABLE_HEIGHT = 0.5
"""Height of D-Grasp's table top [m]."""

_OLDER = {"final_wpos": "final_ee", "final_obj": "final_obj_pos", "obj_w": "obj_w_stacked"}
"""Names in older files (grasps by ContactOpt and GraspTTA) and in current ones. Positions in older files are
relative to the resting object's origin, whose height is added, as in D-Grasp's ``runner_gtta.py``."""

_SIZES = {"final_ee": 63, "final_contacts": 16, "final_obj_pos": 7, "obj_pose_reset": 7, "final_qpos": 51}
_NEEDED = ("final_ee", "final_contacts", "final_obj_pos", "obj_pose_reset", "obj_w_stacked")


@guarded("label pickle")
def import_dgrasp(path: str | Path, table_height: float = TABLE_HEIGHT) -> HumanGraspSet:
    """Read a label pickle. It may contain arrays only; no code in it is executed.

    Args:
        path: ``.pkl`` file, by pickle or joblib.
        table_height: height of the labels' table top [m], which becomes z = 0.

    Raises:
        FungraspError: the file is not such a pickle, or a field is missing or invalid; the message names
            object and field.
    """
    labels = load_arrays_pickle(path)
    if not isinstance(labels, Mapping) or not all(isinstance(entry, Mapping) for entry in labels.values()):
        raise FungraspError(
            f"{path} is no D-Grasp label file: expected a dict of objects, each a dict of arrays"
        )
    sets = []
    for key, entry in labels.items():
        name = _object_name(path, key)
        try:
            sets.append(_one_object(name, entry, table_height))
        except FungraspError as error:
            raise FungraspError(f"{path}, object {key} ({name}): {error}") from error
    sets = [grasps for grasps in sets if len(grasps)]
    if not sets:
        raise FungraspError(f"{path} holds no grasps")
    return HumanGraspSet.concatenate(sets)


def _object_name(path: str | Path, key: Any) -> str:
    if isinstance(key, str) and not key.isdigit():
        return key
    if isinstance(key, int | str | np.integer) and int(key) in YCB_NAMES:
        return YCB_NAMES[int(key)]
    raise FungraspError(
        f"{path}: {key!r} is neither a name nor one of DexYCB's object numbers 1 to {len(YCB_NAMES)}"
    )


def _one_object(name: str, entry: Mapping[str, Any], table_height: float) -> HumanGraspSet:
    if "final_wpos" in entry:
        if name not in YCB_REST_HEIGHTS:
            raise FungraspError("its positions are relative to the object, whose height at rest is not known")
        entry = {_OLDER.get(field, field): value for field, value in entry.items()}
        entry.setdefault("obj_pose_reset", entry.get("final_obj_pos"))
        table_height = -YCB_REST_HEIGHTS[name]
    for field in _NEEDED:
        if field not in entry:
            raise FungraspError(f"field '{field}' is missing; found: {', '.join(sorted(map(str, entry)))}")
    masses = _numbers("obj_w_stacked", entry).reshape(-1)
    count = len(masses)
    arrays = {field: _numbers(field, entry) for field in _SIZES if field in entry}
    for field, array in arrays.items():
        if array.shape != (count, _SIZES[field]):
            raise FungraspError(
                f"field '{field}' has shape {array.shape}, expected ({count}, {_SIZES[field]})"
            )
    down = np.array([0.0, 0.0, table_height])
    for field in ("final_obj_pos", "obj_pose_reset", "final_qpos"):
        if field in arrays:
            arrays[field] = np.concatenate([arrays[field][:, :3] - down, arrays[field][:, 3:]], axis=1)
    return HumanGraspSet(
        object_name=np.full(count, name),
        object_mass=masses,
        object_pose=arrays["final_obj_pos"],
        object_rest_pose=arrays["obj_pose_reset"],
        hand_joints=arrays["final_ee"].reshape(count, 21, 3) - down,
        link_contacts=arrays["final_contacts"] > 0.5,
        hand_qpos=arrays.get("final_qpos"),
    )


def _numbers(field: str, entry: Mapping[str, Any]) -> np.ndarray:
    array = np.asarray(entry[field])
    if array.dtype.kind not in "biuf":
        raise FungraspError(f"field '{field}' holds {array.dtype}, expected numbers")
    return array.astype(np.float64)

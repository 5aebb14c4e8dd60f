"""Grasps from data sets of hands that move objects, as they are downloaded: GRAB and HO-3D. What they share,
``grasp_from_motion``, serves any other."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.mesh_file import read_mesh
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps.from_arrays import human_grasp
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.importers.ycb import YCB_MASSES
from fungrasp.grasps.mano import ManoHand
from fungrasp.objects import ObjectModel, object_from_mesh, resolve_object

MOVED = 0.01
"""How far an object has moved when it counts as grasped [m]."""

_log = logging.getLogger(__name__)


def grasp_from_motion(
    joints: ArrayLike | Callable[[int], ArrayLike],
    object_pose: np.ndarray,
    mesh: ObjectModel | str | Path,
    *,
    order: str = "fungrasp",
    moved: float = MOVED,
    task: str = "",
) -> HumanGrasp:
    """The grasp of the first frame in which the object has moved by more than ``moved`` [m].

    Args:
        joints: of a right hand [m], shape [T, 21, 3], world frame, z up; or a function of the frame's number.
        object_pose: of the object over time, shape [T, 7], same frame. It stands on the table at first: its
            lowest point then is the table's height.
        mesh: the object, as ``human_grasp`` takes it.
        order: of the joints, likewise.
        task: what the grasp is for.

    Raises:
        FungraspError: the object never moves, or the checks of ``human_grasp`` find something.
    """
    apart = np.linalg.norm(object_pose[:, :3] - object_pose[0, :3], axis=1)
    if not (apart > moved).any():
        raise FungraspError(f"the object never moves by {moved:g} m")
    frame = int(np.argmax(apart > moved))
    down = np.array(
        [0.0, 0.0, transform_points(object_pose[0], resolve_object(mesh).model.vertices)[:, 2].min()]
    )
    pose = np.concatenate([object_pose[frame, :3] - down, object_pose[frame, 3:]])
    hand = np.asarray(joints(frame) if callable(joints) else np.asarray(joints)[frame], dtype=float)
    return human_grasp(hand - down, mesh, order=order, object_pose=pose, task=task)


def import_grab(
    root: str | Path, mano: str | Path, objects: str | Path, subjects: str | Path | None = None
) -> HumanGraspSet:
    """One grasp of the right hand of each sequence of GRAB (Taheri et al., ECCV 2020; grab.is.tue.mpg.de).

    Args:
        root: folder with ``s1/mug_drink_1.npz`` and so on: world frame, z up; the object's rotation is one of
            row vectors; the hand's pose 24 principal components from the flat hand.
        mano: folder of your MANO model.
        objects: folder of the object meshes, ``mug.ply``.
        subjects: folder above that of the subjects' hands (``vtemp`` of the files); the mean hand if None.

    Raises:
        FungraspError: no sequence can be used; the first reason.
    """
    hand = ManoHand(mano)

    def grasp(path: Path) -> HumanGrasp:
        fields = load_arrays_pickle(path)
        right, thing = (_table(path, fields, name) for name in ("rhand", "object"))
        params, pose = _table(path, right, "params"), _table(path, thing, "params")
        turns = Rotation.from_rotvec(-_numbers(path, pose, "global_orient", 3))
        places = np.concatenate([_numbers(path, pose, "transl", 3), turns.as_quat(scalar_first=True)], axis=1)
        template = None if subjects is None else read_mesh(Path(subjects) / str(right.get("vtemp")))[0]
        orient, moves = _numbers(path, params, "global_orient", 3), _numbers(path, params, "transl", 3)
        fingers = _numbers(path, params, "hand_pose", 24)

        def joints(t: int) -> np.ndarray:
            return hand.joints([], orient[t], fingers[t], moves[t], flat_hand=True, template=template)

        name, _, task = path.stem.rpartition("_")[0].partition("_")
        return grasp_from_motion(joints, places, _mesh_file(Path(objects), name), task=task)

    return _each(sorted(Path(root).glob("*/*.npz")), grasp, f"{root} holds no sequence (<subject>/*.npz)")


def import_ho3d(root: str | Path, objects: str | Path, tilt: float = 0.0) -> HumanGraspSet:
    """One grasp of each sequence of HO-3D (Hampali et al., CVPR 2020), of its middle frame that is labeled.

    Its files know neither a table nor which way is up: the camera looks level, or down by ``tilt``, and the
    hand is so high that it clears the table by 5 cm.

    Args:
        root: folder with ``<sequence>/meta/0000.pkl`` and so on: camera frame of OpenGL, y up.
        objects: folder of the YCB models, ``003_cracker_box/textured_simple.obj`` or ``003_cracker_box.obj``.
        tilt: of the camera below level [rad].

    Raises:
        FungraspError: no sequence can be used; the first reason.
    """
    upright = Rotation.from_euler("x", 0.5 * np.pi - tilt)

    def grasp(folder: Path) -> HumanGrasp:
        for path in _from_the_middle(sorted(folder.glob("*.pkl"))):
            fields = load_arrays_pickle(path)
            if isinstance(fields, Mapping) and fields.get("handJoints3D") is not None:
                break
        else:
            raise FungraspError(f"{folder}: no frame has joints of a hand")
        joints = upright.apply(_numbers(path, fields, "handJoints3D", 3))
        turn = upright * Rotation.from_rotvec(_numbers(path, fields, "objRot", None).ravel())
        place = upright.apply(_numbers(path, fields, "objTrans", None).ravel())
        name = str(fields.get("objName"))
        obj = object_from_mesh(_mesh_file(Path(objects), name), YCB_MASSES.get(name), name)
        pose = np.concatenate([place, turn.as_quat(scalar_first=True)])
        lowest = min(joints[:, 2].min(), transform_points(pose, obj.vertices)[:, 2].min())
        up = np.array([0.0, 0.0, 0.05 - lowest])
        pose[:3] += up
        return human_grasp(joints + up, obj, order="mano", object_pose=pose)

    return _each(
        sorted(Path(root).glob("*/meta")), grasp, f"{root} holds no sequence (<sequence>/meta/*.pkl)"
    )


def _from_the_middle(paths: list[Path]) -> Iterator[Path]:
    middle = len(paths) // 2
    yield from sorted(paths, key=lambda path: abs(paths.index(path) - middle))


def _each(paths: list[Path], grasp: Callable[[Path], HumanGrasp], none: str) -> HumanGraspSet:
    """The grasps of all paths that can be used; the others are named in warnings."""
    found, problem = [], None
    for path in paths:
        try:
            found.append(grasp(path))
        except FungraspError as error:
            _log.warning("skipped %s: %s", path, error)
            problem = problem or error
    if not found:
        raise problem or FungraspError(none)
    return HumanGraspSet.of(found)


def _mesh_file(folder: Path, name: str) -> Path:
    files = [
        folder / name / "textured_simple.obj",
        *(folder / f"{name}.{kind}" for kind in ("ply", "stl", "obj")),
    ]
    return next((path for path in files if path.is_file()), files[-1])


def _table(path: Path, fields: Any, name: str) -> Mapping[str, Any]:
    value = fields.get(name) if isinstance(fields, Mapping) else None
    if not isinstance(value, Mapping):
        raise FungraspError(f"{path}: there is no field '{name}' of fields")
    return value


def _numbers(path: Path, fields: Mapping[str, Any], name: str, width: int | None) -> np.ndarray:
    """Finite numbers of a field, shape [T, width]; of any shape if the width is None."""
    array = np.asarray(fields.get(name, ""))
    if array.dtype.kind not in "fiu" or (width is not None and (array.ndim != 2 or array.shape[1] != width)):
        wanted = "numbers" if width is None else f"numbers of shape (frames, {width})"
        raise FungraspError(
            f"{path}: field '{name}' holds {array.dtype} of shape {array.shape}, expected {wanted}"
        )
    if not np.isfinite(array).all():
        raise FungraspError(f"{path}: field '{name}' is not finite")
    return array.astype(float)

"""Grasps from DexYCB (Chao et al., CVPR 2021; dex-ycb.github.io), one per sequence, after the object moves.

Files: ``<root>/<subject>/<sequence>/meta.yml`` (serials, num_frames, ycb_ids, ycb_grasp_ind, mano_sides);
``<sequence>/<serial>/labels_000000.npz`` (pose_y, pose_m, joint_3d; camera frame);
``<root>/calibration/extrinsics_<name>/extrinsics.yml`` (poses of the cameras and of a tag on the table);
``<root>/calibration/mano_<name>/mano.yml`` (betas); ``<root>/models/<object>/textured_simple.obj``. The tag's
frame is the world frame: x and y are along the table, and z is up.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import read_yaml
from fungrasp.grasps.contacts import link_contacts, surface_contacts
from fungrasp.grasps.from_arrays import as_pose
from fungrasp.grasps.human_grasp import HumanGrasp, HumanGraspSet
from fungrasp.grasps.human_hand import OPENPOSE, mirror_points, mirror_pose
from fungrasp.grasps.importers.motions import MOVED, data_object, each, moved_frames, numbers
from fungrasp.grasps.importers.ycb import YCB_MASSES, YCB_NAMES
from fungrasp.grasps.mano import ManoHand
from fungrasp.objects import mirrored_name

TAG = "apriltag"

MISFIT = 0.005
"""Largest distance between the label's and the MANO model's wrist [m]."""

_log = logging.getLogger(__name__)


def import_dexycb(
    root: str | Path,
    *,
    mano: str | Path | None = None,
    objects: str | Path | None = None,
    left_hands: Literal["skip", "mirror"] = "skip",
) -> HumanGraspSet:
    """Import one grasp per sequence. Warnings name unusable sequences.

    Args:
        root: folder with the subjects, ``calibration`` and ``models``.
        mano: folder of your MANO model. It adds joint rotations, and contacts follow from the hand's surface.
        objects: folder of meshes; by default DexYCB's own models.
        left_hands: skip left hands, or reflect their scenes; then names of objects end in "_mirrored".

    Raises:
        FungraspError: the folder does not contain DexYCB, or no sequence can be used.
    """
    root = Path(root)
    hands: dict[str, ManoHand] = {}

    def grasps(folder: Path) -> list[HumanGrasp]:
        path = folder / "meta.yml"
        meta = read_yaml(path)
        side = str(_field(path, meta, "mano_sides")[0])
        if side == "left" and left_hands == "skip":
            _log.info("%s: a left hand, skipped", folder)
            return []
        if mano is not None and side not in hands:
            hands[side] = ManoHand(mano, side)
        return [_grasp(root, path, meta, root / "models" if objects is None else objects, hands.get(side))]

    folders = sorted(path.parent for path in root.glob("*/*/meta.yml"))
    none = "no right hand; left hands can be mirrored"
    if not folders:
        none = "no DexYCB sequence (<subject>/<sequence>/meta.yml)"
    return HumanGraspSet.of(each(folders, grasps, f"{root} holds {none}"))


def _grasp(
    root: Path, path: Path, meta: Mapping[str, Any], objects: str | Path, hand: ManoHand | None
) -> HumanGrasp:
    """Return the grasp of one sequence. meta: content of the file ``path``."""
    fields = ("serials", "num_frames", "ycb_ids", "ycb_grasp_ind", "mano_sides", "mano_calib", "extrinsics")
    serials, frames, ids, grasped, sides, shapes, extrinsics = (_field(path, meta, name) for name in fields)
    grasped = int(grasped)
    if not 0 <= grasped < len(ids):
        raise FungraspError(f"{path}: ycb_grasp_ind is {grasped}, but there are {len(ids)} objects")
    if int(ids[grasped]) not in YCB_NAMES:
        raise FungraspError(f"{path}: unknown object number {ids[grasped]}")
    name, left = YCB_NAMES[int(ids[grasped])], sides[0] == "left"
    present = [str(serial) for serial in serials if (path.parent / str(serial)).is_dir()]
    if not present:
        raise FungraspError(
            f"{path.parent} has no folder of any of its cameras {', '.join(map(str, serials))}"
        )
    calibration = root / "calibration"
    mano_path = calibration / f"mano_{shapes[0]}" / "mano.yml"
    betas = np.array(_field(mano_path, read_yaml(mano_path), "betas"), dtype=np.float64)
    cameras = _camera_poses(calibration / f"extrinsics_{extrinsics}" / "extrinsics.yml", present)
    for serial, camera in cameras.items():
        labels = [path.parent / serial / f"labels_{frame:06d}.npz" for frame in range(int(frames))]
        poses, joints, params = map(np.array, zip(*(_label(label, grasped) for label in labels), strict=True))
        tracked = np.flatnonzero(poses.any(axis=(1, 2)))
        places = np.full((len(poses), 3), np.nan)
        places[tracked] = poses[tracked, :, 3]
        seen = params.any(axis=1) & ~(joints == -1).all(axis=(1, 2))
        moved = [frame for frame in moved_frames(places) if seen[frame]]
        if not moved:
            continue
        rest, held = (
            as_pose(camera @ np.vstack([poses[frame], [0, 0, 0, 1]])) for frame in (tracked[0], moved[0])
        )
        hand_joints = joints[moved[0]][OPENPOSE] @ camera[:3, :3].T + camera[:3, 3]
        obj = data_object(objects, name, YCB_MASSES[name]).model
        qpos = None
        if hand is None:
            contacts = link_contacts(hand_joints[None], held[None], obj.vertices, obj.faces)[0]
        else:
            surface, qpos = _mano(hand, betas, params[moved[0]], camera, hand_joints[0], left)
            contacts = surface_contacts(
                surface[None], hand.vertex_links, held[None], obj.vertices, obj.faces
            )[0]
        return HumanGrasp(
            object_name=mirrored_name(name) if left else name,
            object_mass=YCB_MASSES[name],
            object_pose=mirror_pose(held) if left else held,
            object_rest_pose=mirror_pose(rest) if left else rest,
            hand_joints=mirror_points(hand_joints) if left else hand_joints,
            link_contacts=contacts,
            hand_qpos=qpos,
        )
    raise FungraspError(f"the hand never moves the object by {MOVED} m in any camera's labels")


def _label(path: Path, grasped: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read the object's pose, shape [3, 4], joints [m], shape [21, 3], and MANO's parameters, shape [51]."""
    found = read_npz(path, "DexYCB label", ("pose_y", "joint_3d", "pose_m").__contains__)
    poses = numbers(path, found, "pose_y", (None, 3, 4))
    if len(poses) <= grasped:
        raise FungraspError(f"{path}: field 'pose_y' has shape {poses.shape}, object {grasped} is missing")
    joints, params = (numbers(path, found, n, s) for n, s in (("joint_3d", (1, 21, 3)), ("pose_m", (1, 51))))
    return poses[grasped], joints[0], params[0]


def _camera_poses(path: Path, serials: list[str]) -> dict[str, np.ndarray]:
    """Return the cameras' poses in the world, shape [4, 4] each, by serial."""
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


def _mano(
    hand: ManoHand, betas: np.ndarray, params: np.ndarray, camera: np.ndarray, wrist: np.ndarray, left: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices of the hand [m], world frame, shape [778, 3], and ``hand_qpos``, shape [51].

    wrist: position in the labels [m], world frame, shape [3].
    """
    from scipy.spatial.transform import Rotation

    joints, vertices, vectors = hand.posed(betas, params[:3], params[3:48], params[48:], pca=True)
    turn, shift = camera[:3, :3], camera[:3, 3]
    misfit = float(np.linalg.norm(turn @ joints[0] + shift - wrist))
    if misfit > MISFIT:
        raise FungraspError(
            f"the MANO model's wrist is {misfit * 1000:.0f} mm from the label's: is it the right model?"
        )
    rotations = Rotation.from_rotvec(vectors).as_matrix()
    rotations[0] = turn @ rotations[0]
    if left:
        # MANO's left hand is the right one reflected in x; the scene is reflected in y.
        across, scene = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
        rotations = np.concatenate([(scene @ rotations[0] @ across)[None], across @ rotations[1:] @ across])
        wrist = mirror_points(wrist)
    qpos = np.concatenate([wrist, Rotation.from_matrix(rotations).as_euler("XYZ").ravel()])
    return vertices @ turn.T + shift, qpos

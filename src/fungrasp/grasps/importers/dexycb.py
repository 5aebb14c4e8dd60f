"""Human grasps from DexYCB (Chao et al., CVPR 2021; dex-ycb.github.io) as it is downloaded, one for each
sequence: the first frame in which the object has moved by more than a threshold; the hand then carries it.

Layout: ``<root>/<subject>/<sequence>/meta.yml`` (serials, num_frames, ycb_ids, ycb_grasp_ind, mano_sides);
``<sequence>/<serial>/labels_000000.npz`` (pose_y, pose_m, joint_3d; camera frame);
``<root>/calibration/extrinsics_<name>/extrinsics.yml`` (camera poses, and the pose of a tag on the table);
``<root>/calibration/mano_<name>/mano.yml`` (betas); ``<root>/models/<object>/textured_simple.obj``. The tag's
frame has x and y along the table and z up; it is our world frame.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.mesh_file import read_mesh
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import read_yaml
from fungrasp.grasps.contacts import TRACKED_CONTACT_GAP, link_contacts, surface_contacts
from fungrasp.grasps.human_grasp import HumanGraspSet
from fungrasp.grasps.human_hand import OPENPOSE, mirror_points, mirror_pose
from fungrasp.grasps.importers.ycb import YCB_MASSES, YCB_NAMES
from fungrasp.grasps.mano import ManoHand
from fungrasp.objects import MIRRORED

TAG = "apriltag"


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
    """Grasped object, shape [F, 4, 4]; NaN where not labeled."""
    joints: np.ndarray
    """[m], our order, shape [F, 21, 3]; NaN where not labeled."""
    mano: np.ndarray
    """Rotation, 45 pose components, translation [m], camera frame, shape [F, 51]; NaN where not labeled."""
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
            joints[frame] = joint_3d[OPENPOSE] @ world_camera[:3, :3].T + world_camera[:3, 3]
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


MISFIT = 0.005
"""Largest distance between the wrist of the labels and that of the MANO model [m]."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DexYCBOptions:
    """How grasps are taken from DexYCB."""

    displacement: float = 0.01
    """How far the object has moved when it counts as grasped [m]."""
    left_hands: Literal["skip", "mirror"] = "skip"
    """Leave left hands out, or reflect the whole scene: the object's name then ends in "_mirrored"."""
    mano: Path | None = None
    """Folder of your MANO model: adds joint rotations and takes contacts from the hand's surface."""
    objects: Path | None = None
    """Folder of meshes <name>.obj; by default DexYCB's own models."""
    contact_tolerance: float = TRACKED_CONTACT_GAP
    """Gap between hand and object that still counts as contact [m]."""

    def __post_init__(self) -> None:
        if not self.displacement > 0:
            raise FungraspError(f"--displacement must be greater than 0, not {self.displacement}")


@dataclass(frozen=True)
class _Found:
    """A grasp in its own, not mirrored, scene."""

    name: str
    side: str
    object_matrix: np.ndarray
    rest_matrix: np.ndarray
    joints: np.ndarray
    surface: np.ndarray | None = None
    """MANO vertices [m], shape [778, 3], world frame."""
    rotations: np.ndarray | None = None
    """Wrist in the world frame and 15 joints, shape [16, 3, 3]."""


def import_dexycb(root: str | Path, options: DexYCBOptions | None = None) -> HumanGraspSet:
    """Take one grasp from each sequence. Sequences that can't be used are named in warnings.

    Args:
        root: folder with the subjects, ``calibration`` and ``models``.

    Raises:
        FungraspError: the folder is no DexYCB, or no sequence of it can be used.
    """
    root, options = Path(root), options or DexYCBOptions()
    hands: dict[str, ManoHand] = {}
    found: list[_Found] = []
    problem = None
    for folder in sequence_folders(root):
        try:
            sequence = read_sequence(root, folder)
            if sequence.side == "left" and options.left_hands == "skip":
                _log.info("%s: a left hand, skipped", folder)
                continue
            if options.mano is not None and sequence.side not in hands:
                hands[sequence.side] = ManoHand(options.mano, sequence.side)
            found.append(_grasp(sequence, options, hands.get(sequence.side)))
        except FungraspError as error:
            _log.warning("skipped %s: %s", folder.relative_to(root), error)
            problem = problem or error
    if not found:
        raise problem or FungraspError(f"{root} holds no right hand; left hands can be mirrored")
    contacts = _contacts(root, options, found, hands)
    return _grasp_set(found, contacts)


def write_mirrored_meshes(
    root: str | Path, options: DexYCBOptions, grasps: HumanGraspSet, folder: Path
) -> list[Path]:
    """Write ``<name>_mirrored.obj`` for every mirrored object of a grasp set.

    Raises:
        FungraspError: a mesh can't be read or written.
    """
    import trimesh

    paths = []
    for name in sorted({str(name) for name in grasps.object_name if name.endswith(MIRRORED)}):
        vertices, faces = _mesh(Path(root), options, name.removesuffix(MIRRORED))
        paths.append(folder / f"{name}.obj")
        with atomic_path(paths[-1]) as temporary:
            trimesh.Trimesh(mirror_points(vertices), faces[:, ::-1], process=False).export(temporary)
    return paths


def _grasp(sequence: Sequence, options: DexYCBOptions, hand: ManoHand | None) -> _Found:
    if sequence.object_number not in YCB_NAMES:
        raise FungraspError(f"{sequence.folder / 'meta.yml'}: unknown object number {sequence.object_number}")
    for serial in sequence.serials:
        track = read_track(sequence, serial)
        frame = grasp_frame(track, options.displacement)
        if frame is None:
            continue
        labeled = np.flatnonzero(np.isfinite(track.object_matrix[:, 0, 0]))
        surface, rotations = _mano_surface(sequence, track, frame, hand)
        return _Found(
            name=YCB_NAMES[sequence.object_number],
            side=sequence.side,
            object_matrix=track.object_matrix[frame],
            rest_matrix=track.object_matrix[labeled[0]],
            joints=track.joints[frame],
            surface=surface,
            rotations=rotations,
        )
    raise FungraspError(f"the hand never moves the object by {options.displacement} m in any camera's labels")


def grasp_frame(track: Track, displacement: float) -> int | None:
    """First frame with a labeled hand and the object more than ``displacement`` [m] from where it was first
    seen; None if there is none."""
    positions = track.object_matrix[:, :3, 3]
    labeled = np.flatnonzero(np.isfinite(positions[:, 0]))
    if not len(labeled):
        return None
    moved = np.linalg.norm(positions - positions[labeled[0]], axis=1) > displacement
    frames = np.flatnonzero(moved & np.isfinite(track.joints[:, 0, 0]))
    return int(frames[0]) if len(frames) else None


def _mano_surface(
    sequence: Sequence, track: Track, frame: int, hand: ManoHand | None
) -> tuple[np.ndarray | None, np.ndarray | None]:
    if hand is None:
        return None, None
    from scipy.spatial.transform import Rotation

    vertices, wrist, vectors = hand.pose(sequence.betas, track.mano[frame])
    turn, shift = track.world_camera[:3, :3], track.world_camera[:3, 3]
    misfit = float(np.linalg.norm(turn @ wrist + shift - track.joints[frame, 0]))
    if misfit > MISFIT:
        raise FungraspError(
            f"the MANO model's wrist is {misfit * 1000:.0f} mm from the label's: is it the right model?"
        )
    rotations = Rotation.from_rotvec(vectors).as_matrix()
    rotations[0] = turn @ rotations[0]
    return vertices @ turn.T + shift, rotations


def _contacts(
    root: Path, options: DexYCBOptions, found: list[_Found], hands: dict[str, ManoHand]
) -> np.ndarray:
    contacts = np.zeros((len(found), 16), dtype=bool)
    for name, side in sorted({(grasp.name, grasp.side) for grasp in found}):
        rows = [row for row, grasp in enumerate(found) if (grasp.name, grasp.side) == (name, side)]
        vertices, faces = _mesh(root, options, name)
        poses = _poses([found[row].object_matrix for row in rows])
        surfaces = [found[row].surface for row in rows]
        if any(surface is None for surface in surfaces):
            joints = np.stack([found[row].joints for row in rows])
            contacts[rows] = link_contacts(joints, poses, vertices, faces, options.contact_tolerance)
        else:
            points = np.stack([surface for surface in surfaces if surface is not None])
            links = hands[side].vertex_links
            contacts[rows] = surface_contacts(
                points, links, poses, vertices, faces, options.contact_tolerance
            )
    return contacts


def _grasp_set(found: list[_Found], contacts: np.ndarray) -> HumanGraspSet:
    left = np.array([grasp.side == "left" for grasp in found])
    joints = np.stack([grasp.joints for grasp in found])
    pose = _poses([grasp.object_matrix for grasp in found])
    rest = _poses([grasp.rest_matrix for grasp in found])
    qpos = [_qpos(grasp) for grasp in found]
    return HumanGraspSet(
        object_name=np.array([grasp.name + MIRRORED * (grasp.side == "left") for grasp in found]),
        object_mass=np.array([YCB_MASSES[grasp.name] for grasp in found]),
        object_pose=np.where(left[:, None], mirror_pose(pose), pose),
        object_rest_pose=np.where(left[:, None], mirror_pose(rest), rest),
        hand_joints=np.where(left[:, None, None], mirror_points(joints), joints),
        link_contacts=contacts,
        hand_qpos=None if any(row is None for row in qpos) else np.array(qpos),
    )


def _qpos(grasp: _Found) -> np.ndarray | None:
    if grasp.rotations is None:
        return None
    from scipy.spatial.transform import Rotation

    rotations, wrist = grasp.rotations, grasp.joints[0]
    if grasp.side == "left":
        # MANO's left hand is its right one reflected in x; the scene is reflected in y.
        across, scene = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
        rotations = np.concatenate([(scene @ rotations[0] @ across)[None], across @ rotations[1:] @ across])
        wrist = mirror_points(wrist)
    return np.concatenate([wrist, Rotation.from_matrix(rotations).as_euler("XYZ").ravel()])


def _poses(matrices: list[np.ndarray]) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    stack = np.stack(matrices)
    quaternions = Rotation.from_matrix(stack[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([stack[:, :3, 3], quaternions], axis=1)


def _mesh(root: Path, options: DexYCBOptions, name: str) -> tuple[np.ndarray, np.ndarray]:
    path = root / "models" / name / "textured_simple.obj"
    if options.objects is not None:
        path = options.objects / f"{name}.obj"
    return read_mesh(path)

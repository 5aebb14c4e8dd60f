"""Grasps and episodes for other programs: DexGraspBench's files, a URDF with joint trajectories."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.evaluation.six_directions import squeezed_fingers
from fungrasp.evaluation.trajectory import Trajectory
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.arm import export_hand
from fungrasp.hands.export import WRIST_JOINTS, write_hand_urdf
from fungrasp.objects import ObjectModel, check_objects, load_object

OPENED = 0.2
"""How far the fingers are from the grasp towards the open hand before they close, as DexGraspBench's own
conversions have it (0.9 of the angles of a hand that is open at zero) and a little more: share."""


def write_dexgraspbench(
    grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], folder: str | Path
) -> list[Path]:
    """Grasps as DexGraspBench reads them: for each a file with the poses before, in and after closing.

    Files are ``graspdata/<object>/<row>.npy``, a pickled dictionary each with ``obj_path``, ``obj_scale``,
    ``obj_pose`` [7] and ``pregrasp_qpos``, ``grasp_qpos``, ``squeeze_qpos`` [7 + M]: the pose of the palm
    (position, quaternion wxyz), then the joints [rad] in the order of ``hand.xml``, which is written beside
    them and goes into the benchmark's ``hand.xml_path``. Objects are in ``assets/<object>``.

    Args:
        grasps: of any hand that is found.
        objects: theirs, by name.
        folder: is made.

    Returns:
        the files of the grasps.

    Raises:
        FungraspError: an object is missing, or a file can't be written.
    """
    folder, hand = Path(folder), grasps.load_hand()
    check_objects(grasps.object_name.tolist(), objects)
    closed = hand.independent(grasps.joint_positions)
    opened = closed + OPENED * (hand.open_joints - closed)
    fingers = {"pregrasp": opened, "grasp": closed, "squeeze": squeezed_fingers(grasps, objects, hand)}
    written = []
    for name in sorted(set(grasps.object_name.tolist())):
        _write_object(objects[name], folder / "assets" / name)
    with atomic_path(folder / "hand.xml") as temporary:
        temporary.write_text(export_hand(hand))
    for row, name in enumerate(grasps.object_name.tolist()):
        qpos = {
            f"{when}_qpos": np.concatenate([grasps.wrist_pose[row], hand.all_joints(joints[row])])
            for when, joints in fingers.items()
        }
        about = {"obj_path": str(folder / "assets" / name), "obj_scale": 1.0}
        path = folder / "graspdata" / name / f"{row}.npy"
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            content = {**about, "obj_pose": grasps.object_pose[row], **qpos}
            np.save(stream, np.array(content, dtype=object), allow_pickle=True)
        written.append(path)
    return written


def _write_object(model: ObjectModel, folder: Path) -> None:
    """Mesh, convex pieces and mass, where DexGraspBench looks for them."""
    import trimesh

    volume = float(model.mesh.volume)
    meshes = {"mesh/simplified.obj": model.mesh}
    for number, piece in enumerate(model.pieces):
        solid = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
        meshes[f"urdf/meshes/convex_piece_{number:03d}.obj"] = solid
    for name, mesh in meshes.items():
        with atomic_path(folder / name) as temporary:
            mesh.export(str(temporary), "obj", include_normals=False, digits=9)
    with atomic_path(folder / "info/simplified.json") as temporary:
        info = {"mass": model.mass, "density": model.mass / volume, "scale": 1.0}
        temporary.write_text(json.dumps(info) + "\n")


def write_joint_trajectories(episodes: Sequence[Trajectory], folder: str | Path) -> list[Path]:
    """A URDF of the hand, whose wrist moves by six joints, and for each episode its joints over time.

    A trajectory is JSON of ROS's ``trajectory_msgs/JointTrajectory``: ``joint_names``, and ``points`` with
    ``positions`` [m, rad] and ``time_from_start``. Beside them are ``object`` and ``object_poses``, one for
    each point, shape [7], and whether it was a ``success``.

    Args:
        episodes: of one hand.
        folder: is made.

    Returns:
        the files of the trajectories.

    Raises:
        FungraspError: no episodes, several hands, or a file can't be written.
    """
    from scipy.spatial.transform import Rotation

    folder, hands = Path(folder), sorted({episode.hand for episode in episodes})
    if len(hands) != 1:
        raise FungraspError(f"a URDF is of one hand, not of {', '.join(hands) or 'none'}")
    hand = load_hand(hands[0])
    write_hand_urdf(hand, folder, free=True)
    for name in sorted({episode.object_name for episode in episodes}):
        try:
            model = load_object(name)
        except FungraspError:
            continue
        with atomic_path(folder / f"{name}.obj") as temporary:
            model.mesh.export(str(temporary), "obj", include_normals=False, digits=9)
    written = []
    for episode in episodes:
        palm = episode.palm_pose.astype(float)
        turns = Rotation.from_quat(palm[:, 3:], scalar_first=True).as_euler("XYZ")
        wrist = np.concatenate([palm[:, :3], np.unwrap(turns, axis=0)], axis=1)
        rows = np.concatenate([wrist, episode.joint_positions], axis=1)
        since = np.round(1e9 * (episode.times - episode.times[0]).astype(float)).astype(int)
        points = [
            {"positions": row, "time_from_start": {"sec": t // 10**9, "nanosec": t % 10**9}}
            for row, t in zip(rows.tolist(), since.tolist(), strict=True)
        ]
        content = {
            "joint_names": [*WRIST_JOINTS, *hand.joint_names],
            "points": points,
            "object": episode.object_name,
            "object_poses": episode.object_pose.tolist(),
            "success": episode.success,
        }
        use = "_use" if episode.is_use_test else ""
        path = folder / f"{episode.index:04d}_{episode.object_name}{use}.json"
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(content) + "\n")
        written.append(path)
    return written

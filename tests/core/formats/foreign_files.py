"""A good file of each kind that is read, and its reader: what ``fuzz`` damages."""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from odd_hands import claw
from PIL import Image

from benchmarks.perception.recorded_captures import TRUTH, read_recorded
from fungrasp.core.formats.mesh_file import read_colored_mesh
from fungrasp.core.jobs import PartStore
from fungrasp.evaluation import replay
from fungrasp.evaluation.result_files import read_result, write_result
from fungrasp.evaluation.trajectory import Trajectory
from fungrasp.grasps import RobotGraspSet, builtin_grasps, load_grasps, save_human_grasps, save_robot_grasps
from fungrasp.grasps.importers.dgrasp import import_dgrasp
from fungrasp.hands import load_hand
from fungrasp.hands.adding.add_hand import add_hand, check_hand_files
from fungrasp.objects import load_mesh
from fungrasp.perception.adapters import read_hand_estimate, read_object_pose
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.image_files import read_color, read_depth, read_mask
from fungrasp.perception.io.intrinsics_files import read_intrinsics
from fungrasp.policies.checkpoint.checkpoint_file import list_policies, load_policy, read_card
from fungrasp.task import Action

Reader = Callable[[Path], Any]
Kind = Callable[[Path], tuple[str, bytes, Reader]]
"""Gets an empty folder; gives the name of a file, its good bytes and its reader."""

LENS = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0, "depth_unit": 0.001}


def _urdf() -> str:
    names = ("palm", "index", "index_end", "thumb", "thumb_end")
    inertia = '<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>'
    links = [
        f'<link name="{name}"><inertial><mass value="0.05"/>{inertia}</inertial><collision><geometry>'
        '<cylinder radius="0.01" length="0.04"/></geometry></collision></link>'
        for name in names
    ]
    tree = [("palm", "index", "0 .03 .1"), ("index", "index_end", "0 0 .05")]
    tree += [("palm", "thumb", "0 .06 .03"), ("thumb", "thumb_end", "0 0 .05")]
    # The thumb's joints turn across the finger's: a hand, and no gripper.
    joints = [
        f'<joint name="{child}_joint" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}" rpy="0 0 0"/><axis xyz="{"1 0 0" if "thumb" in child else "0 1 0"}"/>'
        '<limit lower="0" upper="1.6" effort="1" velocity="1"/></joint>'
        for parent, child, place in tree
    ]
    return "\n".join(('<robot name="claw">', *links, *joints, "</robot>"))


def _saved(save: Callable[[io.BytesIO], Any]) -> bytes:
    stream = io.BytesIO()
    save(stream)
    return stream.getvalue()


def _image(array: np.ndarray, kind: str = "PNG") -> bytes:
    return _saved(lambda stream: Image.fromarray(array).save(stream, kind))


def _json(tree: Any) -> bytes:
    return json.dumps(tree).encode()


def _human(folder: Path) -> tuple[str, bytes, Reader]:
    save_human_grasps(folder / "good.npz", builtin_grasps().select([0, 1]))
    return "human.npz", (folder / "good.npz").read_bytes(), load_grasps


def _robot(folder: Path) -> tuple[str, bytes, Reader]:
    human, hand = builtin_grasps().select([0, 1]), load_hand("allegro")
    robot = RobotGraspSet(
        hand="allegro",
        joint_names=hand.joint_names,
        object_name=human.object_name,
        object_mass=human.object_mass,
        object_pose=human.object_pose,
        object_rest_pose=human.object_rest_pose,
        task=human.task,
        wrist_pose=human.object_pose,
        joint_positions=np.zeros((2, len(hand.joint_names))),
        keypoints=np.repeat(human.object_pose[:, None, :3], len(hand.keypoint_names), 1),
        link_contacts=np.zeros((2, len(hand.link_names)), bool),
    )
    save_robot_grasps(folder / "good.npz", robot)
    return "robot.npz", (folder / "good.npz").read_bytes(), load_grasps


def _hand(folder: Path) -> Path:
    """Files of a claw, as ``hands add`` writes them: the path of its hand.toml, beside claw.xml."""
    (folder / "bare").mkdir()
    (folder / "bare" / "claw.xml").write_text(claw())
    path, _ = add_hand(folder / "bare" / "claw.xml", folder, force=True)
    return path


def _hand_toml(folder: Path) -> tuple[str, bytes, Reader]:
    def read(path: Path) -> None:
        check_hand_files(path)
        load_hand(path)

    return "hand.toml", _hand(folder).read_bytes(), read


def _model(folder: Path, suffix: str) -> tuple[str, bytes, Reader]:
    model = _hand(folder).with_name("claw.xml").read_bytes()

    def read(path: Path) -> None:
        check_hand_files(path)
        if path.suffix == ".xml":
            load_hand(folder / "hand.toml")
        add_hand(path, folder / "out", force=True)

    return f"claw{suffix}", _urdf().encode() if suffix == ".urdf" else model, read


def _mesh(folder: Path, suffix: str) -> tuple[str, bytes, Reader]:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.04)
    data: Any = ball.export(file_type=suffix)

    def read(path: Path) -> None:
        load_mesh(path)
        read_colored_mesh(path)

    return f"x.{suffix}", data.encode() if isinstance(data, str) else bytes(data), read


def _image_file(folder: Path, suffix: str, kind: str) -> tuple[str, bytes, Reader]:
    pixels = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    return f"x.{suffix}", _image(pixels, kind), read_color


def _depth(folder: Path) -> tuple[str, bytes, Reader]:
    depth = _saved(lambda stream: np.save(stream, np.full((24, 32), 0.5)))
    return "depth.npy", depth, lambda path: read_depth(path, None)


def _mask(folder: Path) -> tuple[str, bytes, Reader]:
    return "mask.png", _image(np.full((24, 32), 255, np.uint8)), lambda path: read_mask(path, (24, 32))


def _lens(folder: Path) -> tuple[str, bytes, Reader]:
    return "lens.json", _json(LENS), lambda path: read_intrinsics(path, (64, 48))


def _policy(folder: Path) -> tuple[str, bytes, Reader]:
    smallest = min(list_policies().values(), key=lambda path: path.stat().st_size)

    def read(path: Path) -> None:
        read_card(path)
        load_policy(path)

    return "x.onnx", smallest.read_bytes(), read


def _labels(folder: Path) -> tuple[str, bytes, Reader]:
    poses = np.tile([0, 0, 0.6, 1, 0, 0, 0.0], (2, 1))
    part: dict[str, Any] = {name: np.zeros((2, 63)) for name in ("final_ee", "final_ee_rel")}
    part |= {name: np.zeros((2, 51)) for name in ("final_qpos", "final_pose", "qpos_reset")}
    part |= {name: np.zeros((2, 16)) for name in ("final_contacts", "contact")}
    part |= {"final_obj_pos": poses, "obj_pose_reset": poses, "obj_name": ["can"] * 2}
    part |= {name: np.ones((2, 1)) for name in ("obj_w_stacked", "obj_idx_stacked", "obj_type_stacked")}
    return "labels.pkl", pickle.dumps({3: part | {"obj_dim_stacked": np.ones((2, 3))}}), import_dgrasp


def _pose(folder: Path) -> tuple[str, bytes, Reader]:
    pose = np.eye(4)
    pose[2, 3] = 0.6
    return "pose.json", _json({"pose": pose.tolist(), "score": 0.9}), read_object_pose


def _hand_estimate(folder: Path) -> tuple[str, bytes, Reader]:
    joints = builtin_grasps()[0].hand_joints
    lens = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    capture = Capture(np.zeros((48, 64, 3), np.uint8), np.full((48, 64), 0.5, np.float32), lens)
    fields = {"version": 1, "source": "joints", "side": "right", "order": "fungrasp", "metric": True}
    fields |= {"joints": (joints - joints.mean(axis=0) + [0, 0, 0.5]).tolist()}
    fields |= {"pixels": [[32.0, 24.0]] * 21, "image_size": [64, 48]}
    return "hand.json", _json(fields), lambda path: read_hand_estimate(path, capture)


def _recording(folder: Path) -> tuple[str, bytes, Reader]:
    arrays = [np.zeros((3, size)) for size in (9, 7, 7, 4)]
    Trajectory(
        *("allegro", "can", 0.3, 0, True, "", np.arange(3.0), arrays[0], np.zeros(7), *arrays[1:]),
        link_contacts=np.zeros((3, 2), bool),
        phase=np.zeros(3, np.int8),
    ).save(folder / "good.npz")
    return "episode.npz", (folder / "good.npz").read_bytes(), lambda path: replay(path).phases


def _result(folder: Path) -> tuple[str, bytes, Reader]:
    write_result(folder / "rows.json", {"seed": 1}, [{"a": 1, "b": {"c": 0.5}}, {"a": 2, "d": "x"}])
    return "rows.json", (folder / "rows.json").read_bytes(), read_result


def _table(folder: Path) -> tuple[str, bytes, Reader]:
    _result(folder)
    return "rows.csv", (folder / "rows.csv").read_bytes(), lambda path: read_result(path.with_suffix(".json"))


def _partial(folder: Path) -> tuple[str, bytes, Reader]:
    store = PartStore(folder)
    store.save("x", {"success": np.ones(3, bool), "reason": np.array(["", "", "x"])})
    return "x.npz", (folder / "x.npz").read_bytes(), lambda path: PartStore(path.parent).load("x")


def _record(folder: Path) -> tuple[str, bytes, Reader]:
    arrays = {
        "palm_goal_world": np.zeros((2, 7)),
        "finger_targets": np.zeros((2, 3)),
        "lift": np.zeros(2, bool),
    }
    return "x.npz", _saved(lambda stream: np.savez(stream, **arrays)), Action.load  # pyright: ignore


def _capture(folder: Path) -> tuple[str, bytes, Reader]:
    (folder / "K.json").write_bytes(_json(LENS))
    for name, pixels in (
        ("rgb", np.zeros((48, 64, 3), np.uint8)),
        ("depth", np.full((48, 64), 500, np.uint16)),
    ):
        (folder / f"{name}.png").write_bytes(_image(pixels))
    joints = builtin_grasps()[0].hand_joints
    truth = {
        "object": "can",
        "object_pose_camera_wxyz": [0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0],
        "joints_camera_m": joints.tolist(),
        "visible_joint_pixels": [None, *joints[1:, :2].tolist()],
        "table_plane_camera": [0.0, 0.0, -1.0, 0.7],
    }
    return TRUTH, _json(truth), lambda path: read_recorded(path.parent)


KINDS: dict[str, Kind] = {
    "human-grasps": _human,
    "robot-grasps": _robot,
    "hand-toml": _hand_toml,
    "mjcf": partial(_model, suffix=".xml"),
    "urdf": partial(_model, suffix=".urdf"),
    **{f"mesh-{suffix}": partial(_mesh, suffix=suffix) for suffix in ("obj", "stl", "ply", "glb")},
    "image-png": partial(_image_file, suffix="png", kind="PNG"),
    "image-jpg": partial(_image_file, suffix="jpg", kind="JPEG"),
    "image-tif": partial(_image_file, suffix="tif", kind="TIFF"),
    "depth": _depth,
    "mask": _mask,
    "lens": _lens,
    "policy": _policy,
    "label-pickle": _labels,
    "object-pose": _pose,
    "hand-estimate": _hand_estimate,
    "recording": _recording,
    "result": _result,
    "result-table": _table,
    "partial-result": _partial,
    "record": _record,
    "capture": _capture,
}
"""By name."""

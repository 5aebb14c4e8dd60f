"""Data sets of hands that move objects, made here in their layouts; MediaPipe's landmarks."""

from __future__ import annotations

import csv
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import fungrasp
from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps import load_human_grasps, mediapipe_joints
from fungrasp.grasps.human_hand import MANO, OPENPOSE
from fungrasp.grasps.importers.gigahands import import_gigahands
from fungrasp.grasps.importers.grab import import_grab
from fungrasp.grasps.importers.ho3d import import_ho3d
from fungrasp.grasps.importers.hot3d import COLUMNS, import_hot3d
from fungrasp.grasps.importers.motions import grasp_from_motion
from fungrasp.grasps.importers.oakink2 import import_oakink2
from fungrasp.grasps.mano import TIP_VERTICES

TABLE = 0.8
"""Height of the table in the motions [m]."""


@pytest.fixture(scope="module")
def shown():
    """A built-in grasp, and its object as a file."""
    grasp = fungrasp.builtin_grasps()[36]
    model = fungrasp.load_object(grasp.object_name)
    return grasp, trimesh.Trimesh(model.vertices, model.faces, process=False)


def motion(grasp) -> tuple[np.ndarray, np.ndarray]:
    """Object poses and joints of five frames: at rest, then lifted; on a table of height ``TABLE``."""
    up = np.array([0.0, 0.0, 0.004, 0.012, 0.03])[:, None] * [0.0, 0.0, 1.0] + [0.3, -0.2, TABLE]
    poses = np.tile(grasp.object_rest_pose, (5, 1))
    poses[:, :3] += up
    shift = grasp.object_rest_pose[:3] - grasp.object_pose[:3]
    turn = Rotation.from_quat(grasp.object_rest_pose[3:], scalar_first=True)
    back = Rotation.from_quat(grasp.object_pose[3:], scalar_first=True).inv()
    joints = turn.apply(back.apply(grasp.hand_joints - grasp.object_pose[:3])) + grasp.object_pose[:3] + shift
    return poses, joints + up[:, None]


def held(grasp) -> np.ndarray:
    """Joints in the frame of the object."""
    return inverse_transform_points(grasp.object_pose, grasp.hand_joints)


def y_up(poses: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same in a world whose y axis points up."""
    turn = Rotation.from_euler("x", -0.5 * np.pi)
    turned = (turn * Rotation.from_quat(poses[:, 3:], scalar_first=True)).as_quat(scalar_first=True)
    places = np.concatenate([turn.apply(poses[:, :3]), turned], axis=1)
    return places, turn.apply(joints.reshape(-1, 3)).reshape(joints.shape)


def test_a_motion_gives_the_grasp_in_which_the_object_moves(shown, tmp_path):
    grasp, mesh = shown
    poses, joints = motion(grasp)
    mesh.export(tmp_path / "thing.ply")
    found = grasp_from_motion(joints, poses, tmp_path / "thing.ply", task="drink")
    np.testing.assert_allclose(held(found), held(grasp), atol=1e-6)
    # The fourth frame is the first that is more than 1 cm away, on a table that is now at zero.
    assert found.object_pose[2] - grasp.object_rest_pose[2] == pytest.approx(0.012, abs=1e-6)
    assert found.task == "drink" and found.object_name == "thing" and found.link_contacts.sum() >= 3
    with pytest.raises(FungraspError, match="no tracked hand moves"):
        grasp_from_motion(joints[:3], poses[:3], tmp_path / "thing.ply")
    with pytest.raises(FungraspError, match="no tracked hand moves"):
        grasp_from_motion(lambda frame: None, poses, tmp_path / "thing.ply")
    away = joints + np.array([0.0, 0.0, 0.04])
    with pytest.raises(FungraspError, match="does not touch the object when it moves"):
        grasp_from_motion(away, poses, tmp_path / "thing.ply")
    with pytest.raises(FungraspError, match="unknown axis 'Z'"):
        grasp_from_motion(joints, poses, tmp_path / "thing.ply", up="Z")
    with pytest.raises(FungraspError, match="order of openpose"):
        grasp_from_motion(joints[:, np.argsort(OPENPOSE)], poses, tmp_path / "thing.ply")


def mano_vertices(joints: np.ndarray) -> np.ndarray:
    """Of the model that ``write_mano`` writes: the first 16 are its joints."""
    scattered = np.empty((21, 3))
    scattered[MANO] = joints
    template = np.zeros((778, 3))
    template[:16], template[TIP_VERTICES] = scattered[:16], scattered[16:]
    return template


def write_mano(folder: Path, joints: np.ndarray) -> None:
    """A MANO model whose flat hand is this one, moved as one piece by the wrist."""
    regressor, weights = np.eye(16, 778), np.zeros((778, 16))
    weights[:, 0] = 1.0
    parents = np.array([2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14])
    model = {
        "v_template": mano_vertices(joints),
        "shapedirs": np.zeros((778, 3, 10)),
        "posedirs": np.zeros((778, 3, 135)),
        "J_regressor": regressor,
        "weights": weights,
        "hands_components": np.eye(45),
        "hands_mean": np.repeat([0.3, 0.0], [15, 30]),
        "kintree_table": np.stack([parents, np.arange(16)]),
    }
    (folder / "MANO_RIGHT.pkl").write_bytes(pickle.dumps(model))


def test_grab(shown, tmp_path, capsys):
    grasp, mesh = shown
    poses, joints = motion(grasp)
    # MANO turns a hand about its wrist.
    turn = Rotation.from_rotvec([0.4, -0.3, 1.1])
    rest = turn.inv().apply(joints[0] - joints[0, 0]) + np.array([0.1, 0.0, 0.02])
    write_mano(tmp_path, 1.1 * rest)
    (tmp_path / "grab" / "s1").mkdir(parents=True)
    (tmp_path / "people").mkdir()
    trimesh.Trimesh(mano_vertices(rest), [[0, 1, 2]], process=False).export(
        tmp_path / "people" / "s1_rhand.ply"
    )
    (tmp_path / "meshes").mkdir()
    mesh.export(tmp_path / "meshes" / "mug.ply")
    right = {
        "global_orient": np.tile(turn.as_rotvec(), (5, 1)).astype(np.float32),
        "hand_pose": np.zeros((5, 24), np.float32),
        "transl": (joints[:, 0] - rest[0]).astype(np.float32),
    }
    thing = {
        # Rotations of row vectors.
        "global_orient": -Rotation.from_quat(poses[:, 3:], scalar_first=True).as_rotvec(),
        "transl": poses[:, :3],
    }
    content = {"rhand": {"params": right, "vtemp": "people/s1_rhand.ply"}, "object": {"params": thing}}
    np.savez(tmp_path / "grab" / "s1" / "mug_drink_1.npz", n_frames=5, obj_name="mug", **content)  # type: ignore[arg-type]
    found = import_grab(tmp_path / "grab", tmp_path, tmp_path / "meshes", tmp_path)
    assert found.object_name.tolist() == ["mug"] and found.task.tolist() == ["drink"]
    np.testing.assert_allclose(held(found[0]), held(grasp), atol=1e-5)
    out = tmp_path / "out.npz"
    arguments = ["--mano", str(tmp_path), "--objects", str(tmp_path / "meshes"), "--subjects", str(tmp_path)]
    assert main(["grasps", "import", "grab", str(tmp_path / "grab"), "--out", str(out), *arguments]) == 0
    assert len(load_human_grasps(out)) == 1
    # The mean hand, a tenth larger, about the same wrist.
    larger = import_grab(tmp_path / "grab", tmp_path, tmp_path / "meshes").hand_joints[0]
    assert np.ptp(larger, axis=0).max() > 1.05 * np.ptp(joints[0], axis=0).max()
    np.savez(tmp_path / "grab" / "s1" / "mug_drink_1.npz", rhand=np.zeros(3))
    with pytest.raises(FungraspError, match="no field 'rhand' of fields"):
        import_grab(tmp_path / "grab", tmp_path, tmp_path / "meshes")
    with pytest.raises(FungraspError, match="holds no sequence"):
        import_grab(tmp_path / "meshes", tmp_path, tmp_path / "meshes")


def test_ho3d(shown, tmp_path):
    grasp, mesh = shown
    tilt = 0.5
    camera = Rotation.from_euler("x", 0.5 * np.pi - tilt)
    (tmp_path / "MC1" / "meta").mkdir(parents=True)
    (tmp_path / "models" / "025_mug").mkdir(parents=True)
    mesh.export(tmp_path / "models" / "025_mug" / "textured_simple.obj")
    scattered = np.empty((21, 3))
    scattered[MANO] = grasp.hand_joints
    turn = camera.inv() * Rotation.from_quat(grasp.object_pose[3:], scalar_first=True)
    shift = np.array([0.1, -0.1, -0.6])
    fields = {
        "objName": "025_mug",
        "objRot": turn.as_rotvec()[:, None],
        "objTrans": camera.inv().apply(grasp.object_pose[:3]) + shift,
        "handJoints3D": camera.inv().apply(scattered) + shift,
    }
    for frame, content in enumerate(({"handJoints3D": None}, {"handJoints3D": None}, fields)):
        (tmp_path / "MC1" / "meta" / f"{frame:04d}.pkl").write_bytes(pickle.dumps(content))
    found = import_ho3d(tmp_path, tmp_path / "models", tilt)
    np.testing.assert_allclose(held(found[0]), held(grasp), atol=1e-6)
    turned = Rotation.from_quat(found.object_pose[0, 3:], scalar_first=True)
    wanted = Rotation.from_quat(grasp.object_pose[3:], scalar_first=True)
    assert (turned.inv() * wanted).magnitude() < 1e-6
    assert found.hand_joints[..., 2].min() >= 0.05 - 1e-9 and found.object_mass[0] == 0.118
    (tmp_path / "MC1" / "meta" / "0002.pkl").write_bytes(pickle.dumps(fields | {"objRot": np.array(["a"])}))
    with pytest.raises(FungraspError, match="'objRot' holds"):
        import_ho3d(tmp_path, tmp_path / "models")


@pytest.fixture
def rest_hand(shown, tmp_path):
    """Rotation of the wrist in the motion, and the joints of the flat hand of the MANO model at
    ``tmp_path``."""
    joints = motion(shown[0])[1]
    turn = Rotation.from_rotvec([0.4, -0.3, 1.1])
    rest = turn.inv().apply(joints[0] - joints[0, 0]) + np.array([0.1, 0.0, 0.02])
    write_mano(tmp_path, rest)
    return turn, rest


@pytest.mark.parametrize("tensors", [False, True])
def test_oakink2(shown, tmp_path, rest_hand, caplog, tensors):
    grasp, mesh = shown
    poses, joints = y_up(*motion(grasp))
    turn = Rotation.from_euler("x", -0.5 * np.pi) * rest_hand[0]
    matrices = np.tile(np.eye(4), (5, 1, 1))
    matrices[:, :3, :3] = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
    matrices[:, :3, 3] = poses[:, :3]
    frames = range(100, 105)
    turns = np.tile([1.0, 0, 0, 0], (1, 16, 1))
    turns[0, 0] = turn.as_quat(scalar_first=True)
    as_written = pytest.importorskip("torch").tensor if tensors else np.array
    hands = {
        frame: {
            "rh__pose_coeffs": as_written(turns),
            "rh__betas": as_written(np.zeros((1, 10))),
            "rh__tsl": as_written(joints[None, t, 0]),
        }
        for t, frame in enumerate(frames)
    }
    fields = {
        "mocap_frame_id_list": list(frames),
        "obj_list": ["O02@0001", "O02@0002"],
        "raw_mano": hands,
        "obj_transf": {
            "O02@0001": dict(zip(frames, matrices, strict=True)),
            "O02@0002": dict.fromkeys(frames, np.eye(4)),
        },
    }
    (tmp_path / "anno_preview").mkdir()
    (tmp_path / "anno_preview" / "scene.pkl").write_bytes(pickle.dumps(fields))
    (tmp_path / "align_ds" / "O02@0001").mkdir(parents=True)
    mesh.export(tmp_path / "align_ds" / "O02@0001" / "model.obj")
    out, sources = tmp_path / "out.npz", [tmp_path / "anno_preview", "--objects", tmp_path / "align_ds"]
    arguments = ["oakink2", *sources, "--mano", tmp_path, "--out", out]
    assert main(["grasps", "import", *map(str, arguments)]) == 0
    found = load_human_grasps(out)
    assert found.object_name.tolist() == ["O02@0001"] and "skipped" not in caplog.text
    np.testing.assert_allclose(held(found[0]), held(grasp), atol=1e-5)
    assert fungrasp.load_objects(found, tmp_path / "align_ds")["O02@0001"].name == "O02@0001"
    fields["obj_transf"]["O02@0001"][103] = np.full((4, 4), np.nan)
    (tmp_path / "anno_preview" / "scene.pkl").write_bytes(pickle.dumps(fields))
    with pytest.raises(FungraspError, match="field '103' is not finite"):
        import_oakink2(tmp_path / "anno_preview", tmp_path, tmp_path / "align_ds")


@pytest.mark.parametrize("headset", ["Aria", "Quest3"])
def test_hot3d(shown, tmp_path, rest_hand, headset):
    grasp, mesh = shown
    poses, joints = motion(grasp)
    turn, rest = rest_hand
    if headset == "Quest3":
        poses, joints = y_up(poses, joints)
        turn = Rotation.from_euler("x", -0.5 * np.pi) * turn
    folder = tmp_path / "hot3d" / "P0003_c701bd11"
    folder.mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps({"headset": headset}))
    with (folder / "dynamic_objects.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["object_uid", "timestamp[ns]", *COLUMNS])
        for time, pose in enumerate(poses):
            rows.writerow(["106", time, *pose])
            rows.writerow(["265", time, *poses[0]])
    right = {"betas": [0.0] * 10, "pose": [-0.3] * 15}
    lines = [
        {"timestamp_ns": time, "hand_poses": {"1": right | {"wrist_xform": {"t_xyz": t, "q_wxyz": q}}}}
        for time, t in enumerate((joints[:, 0] - rest[0]).tolist())
        for q in [turn.as_quat(scalar_first=True).tolist()]
    ]
    lines[3] = {"timestamp_ns": 3, "hand_poses": {}}
    (folder / "mano_hand_pose_trajectory.jsonl").write_text("\n".join(map(json.dumps, lines)))
    (tmp_path / "assets").mkdir()
    mesh.export(tmp_path / "assets" / "106.glb")
    found = import_hot3d(tmp_path / "hot3d", tmp_path, tmp_path / "assets")
    assert found.object_name.tolist() == ["106"]
    np.testing.assert_allclose(held(found[0]), held(grasp), atol=1e-4)
    # The hand was not tracked in the fourth frame.
    assert found.object_pose[0, 2] - found.object_rest_pose[0, 2] == pytest.approx(0.03, abs=1e-5)
    (folder / "dynamic_objects.csv").write_text("object_uid,timestamp[ns]\n1,2\n")
    with pytest.raises(FungraspError, match=r"sequence .* makes no sense"):
        import_hot3d(tmp_path / "hot3d", tmp_path, tmp_path / "assets")


@pytest.mark.parametrize("vectors", [False, True])
def test_gigahands(shown, tmp_path, vectors):
    grasp, mesh = shown
    poses, joints = y_up(*motion(grasp))
    turns = Rotation.from_quat(poses[:, 3:], scalar_first=True)
    written = turns.as_rotvec() if vectors else turns.inv().as_quat(scalar_first=True)
    hands = tmp_path / "hand_poses" / "p001-tea"
    pose = tmp_path / "object_poses" / "0_tea" / "mug_scan" / "p001-tea_0007" / "pose"
    for folder in (hands / "keypoints_3d" / "007", hands / "keypoints_3d_mano_align", pose):
        folder.mkdir(parents=True)
    (tmp_path / "object_meta" / "0_tea" / "mug_scan").mkdir(parents=True)
    mesh.export(tmp_path / "object_meta" / "0_tea" / "mug_scan" / "mug.obj")
    tracked = {
        f"{frame:06d}": {"mesh_rotation": turn, "mesh_translation": [place]}
        for frame, (turn, place) in enumerate(zip(written.tolist(), poses[:, :3].tolist(), strict=True))
    }
    (pose / "optimized_pose.json").write_text(json.dumps(tracked))
    # No hand was seen in the second frame, and only the left one in the third.
    for side, frames in (("left", [0, 2, 3]), ("right", [0, 3, 4])):
        (hands / "keypoints_3d" / "007" / f"chosen_frames_{side}.json").write_text(json.dumps(frames))
    both = np.zeros((4, 2, 21, 3))
    both[:, 1, OPENPOSE] = joints[[0, 2, 3, 4]]
    file = hands / "keypoints_3d_mano_align" / "007.json"
    file.write_text(json.dumps(both.reshape(4, 42, 3).tolist()))
    found = import_gigahands(tmp_path)
    assert found.object_name.tolist() == ["mug_scan"]
    np.testing.assert_allclose(held(found[0]), held(grasp), atol=1e-5)
    assert found.object_pose[0, 2] - found.object_rest_pose[0, 2] == pytest.approx(0.012, abs=1e-5)
    file.write_text(json.dumps(both[:3].tolist()))
    with pytest.raises(FungraspError, match=r"007.json: joints of shape \(3, 2, 21, 3\) in 4 frames"):
        import_gigahands(tmp_path)


def test_landmarks_of_mediapipe_get_a_place(shown):
    grasp, _ = shown
    camera = np.array([[600.0, 0, 320], [0, 610, 240], [0, 0, 1]])
    hand = Rotation.from_rotvec([0.5, 2.0, 0.3]).apply(grasp.hand_joints - grasp.hand_joints.mean(axis=0))
    hand += [0.06, -0.03, 0.55]
    pixels = hand[:, :2] / hand[:, 2:] * [600, 610] + [320, 240]
    world = 0.85 * (hand - hand.mean(axis=0))
    ordered = np.argsort(OPENPOSE)
    # Without depth the hand is as large as its world landmarks, and as much nearer.
    near = mediapipe_joints(pixels[ordered], world[ordered], camera)
    np.testing.assert_allclose(near, 0.85 * hand, atol=0.003)
    depth = np.zeros((480, 640), np.float32)
    row, column = np.rint(pixels[:, ::-1]).astype(int).T
    depth[row, column] = hand[:, 2] - 0.009
    # An object hides three fingertips.
    depth[row[[4, 8, 12]], column[[4, 8, 12]]] -= 0.06
    np.testing.assert_allclose(
        mediapipe_joints(pixels[ordered], world[ordered], camera, depth), hand, atol=0.006
    )
    with pytest.raises(FungraspError, match="normalized"):
        mediapipe_joints(pixels[ordered] / 640, world[ordered], camera)
    with pytest.raises(FungraspError, match="at 0 of the 21"):
        mediapipe_joints(pixels[ordered], world[ordered], camera, np.zeros((480, 640)))

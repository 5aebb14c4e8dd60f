"""Grasps and episodes for other programs: what they read is the grasp that was written."""

from __future__ import annotations

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from recorded_episodes import HAND, episode

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.grasp_export import write_dexgraspbench, write_joint_trajectories
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import builtin_grasps, load_objects, save_robot_grasps
from fungrasp.hands import load_hand
from fungrasp.hands.export import WRIST_JOINTS, write_hand_urdf
from fungrasp.retargeting import retarget


@pytest.fixture(scope="module")
def grasps():
    human = builtin_grasps()[:2]
    return retarget(human, load_objects(human), "allegro", "angle-copy")


def read_urdf(path) -> mujoco.MjModel:
    """MuJoCo's reader, which by default joins links that can't move."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    return spec.compile()


def test_dexgraspbench_reads_the_grasps(grasps, tmp_path):
    objects = load_objects(grasps)
    for row, path in enumerate(write_dexgraspbench(grasps, objects, tmp_path)):
        grasp, model = grasps[row], objects[grasps[row].object_name]
        found = np.load(path, allow_pickle=True).item()
        assert found["obj_scale"] == 1.0 and np.allclose(found["obj_pose"], grasp.object_pose)
        # The hand as the benchmark has it: carried by a free joint, its joints behind it.
        spec = mujoco.MjSpec.from_file(str(tmp_path / "hand.xml"))
        whole = mujoco.MjSpec()
        whole.worldbody.add_frame().attach_body(spec.worldbody, "child-", "").add_freejoint()
        m = whole.compile()
        data = mujoco.MjData(m)
        assert m.nq == len(found["grasp_qpos"]) == len(found["pregrasp_qpos"]) == len(found["squeeze_qpos"])
        data.qpos[:] = found["grasp_qpos"]
        mujoco.mj_kinematics(m, data)
        tip = load_hand("allegro").fingers["thumb"].tip
        expected = grasp.keypoints[-1]
        assert np.allclose(data.site(f"child-{tip}").xpos, expected, atol=1e-5)
        moved = found["squeeze_qpos"] - found["grasp_qpos"]
        assert np.allclose(moved[:7], 0) and np.abs(moved[7:]).max() > 0.01
        info = json.loads((tmp_path / "assets" / model.name / "info/simplified.json").read_text())
        assert info["mass"] / info["density"] == pytest.approx(model.mesh.volume)
        pieces = list((tmp_path / "assets" / model.name / "urdf/meshes").iterdir())
        assert len(pieces) == len(model.pieces)


@pytest.mark.parametrize("name", ["allegro", "inspire", "faive", "shadow", "leap"])
def test_a_urdf_moves_as_the_hand(name, tmp_path):
    hand, rng = load_hand(name), np.random.default_rng(0)
    m = read_urdf(write_hand_urdf(hand, tmp_path, free=True))
    data = mujoco.MjData(m)
    low, high = hand.joint_limits.T
    joints = hand.all_joints(hand.independent(rng.uniform(low, high)))
    wrist = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    for joint, value in zip((*WRIST_JOINTS, *hand.joint_names), (*wrist, *joints), strict=True):
        data.qpos[m.joint(joint).qposadr[0]] = value
    mujoco.mj_kinematics(m, data)
    place, turn = data.body(hand.palm).xpos, data.body(hand.palm).xquat
    own = mujoco.MjData(hand.model)
    own.qpos[:] = joints
    mujoco.mj_kinematics(hand.model, own)
    mujoco.mj_comPos(hand.model, own)
    mujoco.mj_comPos(m, data)
    bodies = [finger.links[-1] for finger in hand.fingers.values()]
    # Frames may lie elsewhere in a link; its center of mass is where it was.
    expected = transform_points(
        np.concatenate([place, turn]), np.array([own.body(body).xipos for body in bodies])
    )
    assert np.allclose(place, wrist[:3], atol=1e-6)
    assert np.allclose([data.body(body).xipos for body in bodies], expected, atol=1e-5)
    assert m.body_mass.sum() == pytest.approx(hand.model.body_mass.sum(), rel=1e-3)


def test_a_trajectory_puts_the_palm_where_it_was(tmp_path):
    one = episode()
    turn = one.palm_pose[:, 3:] / np.linalg.norm(one.palm_pose[:, 3:], axis=1, keepdims=True)
    one = replace(one, palm_pose=np.concatenate([one.palm_pose[:, :3], turn], axis=1))
    (path,) = write_joint_trajectories([one], tmp_path)
    found = json.loads(path.read_text())
    m = read_urdf(tmp_path / "inspire.urdf")
    data = mujoco.MjData(m)
    rows = np.array([point["positions"] for point in found["points"]])
    assert np.allclose(rows[:, 6:], one.joint_positions) and (tmp_path / "mug.obj").is_file()
    for row, pose in zip(rows, one.palm_pose, strict=True):
        for joint, value in zip(found["joint_names"], row, strict=True):
            data.qpos[m.joint(joint).qposadr[0]] = value
        mujoco.mj_kinematics(m, data)
        here = data.body(HAND.palm)
        assert np.allclose(here.xpos, pose[:3], atol=1e-5) and abs(here.xquat @ pose[3:]) > 1 - 1e-6
    assert found["points"][1]["time_from_start"] == {"sec": 0, "nanosec": pytest.approx(2e7, abs=100)}


def test_the_commands_write_them(grasps, tmp_path, capsys):
    save_robot_grasps(tmp_path / "robot.npz", grasps)
    episode().save(tmp_path / "0003_mug.npz")
    grasp, out = ["export", str(tmp_path / "robot.npz"), "--format", "dexgraspbench"], str(tmp_path / "bench")
    assert main([*grasp, "--out", out]) == 0
    motion = ["export", str(tmp_path / "0003_mug.npz"), "--format", "urdf"]
    assert main([*motion, "--out", str(tmp_path / "urdf")]) == 0
    said = capsys.readouterr().out
    assert "2 grasps" in said and "1 joint trajectories" in said
    with pytest.raises(FungraspError, match="of one hand"):
        write_joint_trajectories([episode(), replace(episode(), hand="shadow")], tmp_path / "x")

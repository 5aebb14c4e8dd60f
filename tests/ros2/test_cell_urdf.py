"""The URDF of a cell: its frames are where fungrasp has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from fungrasp.geometry.poses import compose, invert
from fungrasp.hands import load_hand
from fungrasp.hands.arm import Mount, mount
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.kinematics.arm_model import ArmKinematics
from fungrasp_ros2.cell_urdf import cell_urdf

MOUNT = Mount((0.01, -0.02, 0.156, 0.7071068, 0.0, 0.0, 0.7071068), 0.04, 0.15)


def cell_with(hand: str) -> RobotCell:
    cell = load_cell("ur5e-allegro")
    base = (-0.5, 0.1, 0.3, 0.9238795, 0.0, 0.0, 0.3826834)
    return replace(cell, hand=hand, mount=MOUNT, arm=replace(cell.arm, pose_world_base=base))


def frames(text: str, joints: dict[str, float]) -> dict[str, np.ndarray]:
    """Pose of every link in the world: forward kinematics from the file alone."""
    tree = ET.fromstring(text)
    poses = {"world": np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])}
    waiting = list(tree.iter("joint"))
    while waiting:
        joint = next(j for j in waiting if j.find("parent").get("link") in poses)
        waiting.remove(joint)
        origin, name = joint.find("origin"), joint.get("name")
        turn = np.zeros(4)
        roll, pitch, yaw = map(float, origin.get("rpy").split())
        mujoco.mju_euler2Quat(turn, np.array([roll, pitch, yaw]), "XYZ")
        pose = compose(
            poses[joint.find("parent").get("link")],
            np.array([*map(float, origin.get("xyz").split()), *turn]),
        )
        if joint.get("type") == "revolute":
            mimic = joint.find("mimic")
            angle = joints.get(name, 0.0)
            if mimic is not None:
                angle = (
                    float(mimic.get("offset")) + float(mimic.get("multiplier")) * joints[mimic.get("joint")]
                )
            axis = np.array([*map(float, joint.find("axis").get("xyz").split())])
            spin = np.zeros(4)
            mujoco.mju_axisAngle2Quat(spin, axis, angle)
            pose = compose(pose, np.array([0.0, 0.0, 0.0, *spin]))
        poses[joint.find("child").get("link")] = pose
    return poses


@pytest.mark.parametrize("name", ["allegro", "inspire", "leap", "shadow", "faive"])
def test_links_are_where_the_model_has_them(name: str, tmp_path: Path) -> None:
    cell, hand = cell_with(name), load_hand(name)
    text = cell_urdf(cell, hand, tmp_path)
    spec = mount(hand, cell.arm.model, cell.mount)
    base = spec.worldbody.first_body()
    base.pos, base.quat = cell.arm.pose_world_base[:3], cell.arm.pose_world_base[3:]
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    arm = rng.uniform(-1.5, 1.5, 6)
    fingers = hand.all_joints(rng.uniform(*hand.independent(hand.joint_limits.T)))
    joints = dict(zip((model.joint(i).name for i in range(6)), arm, strict=True))
    joints |= dict(zip(hand.joint_names, fingers, strict=True))
    for joint, angle in joints.items():
        data.joint(joint).qpos = angle
    mujoco.mj_kinematics(model, data)
    poses = frames(text, joints)
    for body in range(1, model.nbody):
        expected = np.array([*data.xpos[body], *data.xquat[body]])
        apart = compose(invert(expected), poses[model.body(body).name])
        assert np.abs(apart[:3]).max() < 1e-5 and abs(abs(apart[3]) - 1) < 1e-6, model.body(body).name
    for kind in ("link", "joint"):
        names = [one.get("name") for one in ET.fromstring(text).findall(kind)]
        assert len(set(names)) == len(names)
    palm = compose(invert(ArmKinematics(cell, hand).palm_pose(arm)), poses["fungrasp_palm"])
    assert np.abs(palm[:3]).max() < 1e-5 and abs(abs(palm[3]) - 1) < 1e-6


def test_an_engine_loads_the_file_with_its_adapter_and_limits(tmp_path: Path) -> None:
    cell, hand = cell_with("inspire"), load_hand("inspire")
    path = tmp_path / "lab.urdf"
    path.write_text(cell_urdf(cell, hand, tmp_path / "meshes"))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.njnt == 6 + len(hand.joint_names)
    assert model.joint("elbow_joint").range.tolist() == pytest.approx([-3.14159, 3.14159], abs=1e-4)
    tree = ET.parse(path)
    cylinders = [(c.get("radius"), c.get("length")) for c in tree.iter("cylinder")]
    assert ("0.04", "0.15") in cylinders
    assert {"world", "tool0", "fungrasp_palm"} <= {link.get("name") for link in tree.iter("link")}

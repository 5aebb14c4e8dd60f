"""Models as URDF: what reads one moves as the model does."""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from fungrasp.hands import load_hand
from fungrasp.hands.export import model_urdf


@pytest.mark.parametrize("name", ["inspire", "shadow"])
def test_a_urdf_moves_as_the_hand(name, tmp_path):
    """Read by MuJoCo, which by default joins links that can't move."""
    hand, rng = load_hand(name), np.random.default_rng(0)
    robot = model_urdf(hand.name, hand.model, tmp_path)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").rpartition("/")[2])
    (tmp_path / "hand.urdf").write_text(ElementTree.tostring(robot, encoding="unicode"))
    spec = mujoco.MjSpec.from_file(str(tmp_path / "hand.urdf"))
    spec.compiler.fusestatic = False
    m = spec.compile()
    joints = hand.all_joints(hand.independent(rng.uniform(*hand.joint_limits.T)))
    data, own = mujoco.MjData(m), mujoco.MjData(hand.model)
    for joint, value in zip(hand.joint_names, joints, strict=True):
        data.qpos[m.joint(joint).qposadr[0]] = value
    own.qpos[:] = joints
    for model, state in ((m, data), (hand.model, own)):
        mujoco.mj_kinematics(model, state)
        mujoco.mj_comPos(model, state)
    # Frames may lie elsewhere in a link; its center of mass is where it was.
    for finger in hand.fingers.values():
        body = finger.links[-1]
        assert np.allclose(data.body(body).xipos, own.body(body).xipos, atol=1e-5)
    assert m.body_mass.sum() == pytest.approx(hand.model.body_mass.sum(), rel=1e-3)

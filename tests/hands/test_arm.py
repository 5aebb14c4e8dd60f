"""The UR5e: the reference's kinematics, masses and limits; a hand on its flange."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fungrasp.geometry.poses import compose, rotate
from fungrasp.hands import hand_files, load_hand
from fungrasp.hands.arm import (
    FLANGE_SITE,
    MOUNTING_GAP,
    arm_files,
    arm_spec,
    mount,
    mounting_pose,
)

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared"
REFERENCE = SHARED / "reference" / "arms" / "ur5e.urdf"
HOME = np.array([0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0])
HANDS = sorted(hand_files())


def reference_model() -> mujoco.MjModel:
    if not REFERENCE.is_file():
        pytest.skip(f"{REFERENCE} is not here")
    spec = mujoco.MjSpec.from_file(str(REFERENCE))
    for geom in list(spec.geoms):
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.compiler.fusestatic = False
    return spec.compile()


@cache
def mounted(name: str) -> mujoco.MjModel:
    return mount(load_hand(name)).compile()


def body_pose(data: mujoco.MjData, name: str) -> np.ndarray:
    body = data.model.body(name).id
    return np.concatenate([data.xpos[body], data.xquat[body]])


def inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    """In the body's frame [kg m2], shape [3, 3]."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(model.body_inertia[body]) @ rotation.T


def test_arms_are_no_hands():
    assert list(arm_files()) == ["ur5", "ur5e"]
    assert "ur5e" not in hand_files() and "arms" not in hand_files()


def test_forward_kinematics_is_that_of_the_reference():
    reference, ours = reference_model(), arm_spec("ur5e").compile()
    names = [reference.joint(j).name for j in range(reference.njnt)]
    assert names == [ours.joint(j).name for j in range(ours.njnt)]
    np.testing.assert_allclose(ours.jnt_range, reference.jnt_range, atol=1e-6)
    a, b = mujoco.MjData(reference), mujoco.MjData(ours)
    rng = np.random.default_rng(0)
    for _ in range(100):
        b.qpos[:] = a.qpos[:] = rng.uniform(*reference.jnt_range.T)
        mujoco.mj_kinematics(reference, a)
        mujoco.mj_kinematics(ours, b)
        for body in range(1, ours.nbody):
            name = ours.body(body).name
            np.testing.assert_allclose(b.body(name).xpos, a.body(name).xpos, atol=1e-4)
            np.testing.assert_allclose(b.body(name).xmat, a.body(name).xmat, atol=1e-4)
        np.testing.assert_allclose(b.site(FLANGE_SITE).xpos, a.body("ee_link").xpos, atol=1e-4)
        # The reference's flange frame has x pointing out of the flange, tool0 has z.
        np.testing.assert_allclose(
            b.site(FLANGE_SITE).xmat.reshape(3, 3)[:, 2],
            a.body("ee_link").xmat.reshape(3, 3)[:, 0],
            atol=1e-4,
        )


def test_masses_and_torque_limits_are_those_of_the_reference():
    reference, ours = reference_model(), arm_spec("ur5e").compile()
    for body in range(1, ours.nbody):
        other = reference.body(ours.body(body).name)
        assert ours.body_mass[body] == pytest.approx(other.mass[0])
        np.testing.assert_allclose(
            inertia(ours, body), inertia(reference, reference.body(ours.body(body).name).id), atol=1e-9
        )
        np.testing.assert_allclose(ours.body_ipos[body], other.ipos, atol=1e-9)
    efforts = {
        joint.get("name"): float(limit.get("effort", "nan"))
        for joint in ElementTree.parse(REFERENCE).iter("joint")
        if (limit := joint.find("limit")) is not None
    }
    for actuator in range(ours.nu):
        limit = efforts[ours.actuator(actuator).name]
        assert ours.actuator_forcerange[actuator].tolist() == [-limit, limit]


@pytest.mark.parametrize("name", HANDS)
def test_a_mounted_hand_keeps_its_names_and_kinematics(name):
    hand, model = load_hand(name), mounted(name)
    joints = [model.joint(j).name for j in range(model.njnt)]
    assert joints[6:] == list(hand.joint_names)
    assert [model.actuator(a).name for a in range(model.nu)] == [*joints[:6], *hand.actuators]
    alone, together = mujoco.MjData(hand.model), mujoco.MjData(model)
    rng = np.random.default_rng(0)
    together.qpos[:6] = HOME
    together.qpos[6:] = alone.qpos[:] = rng.uniform(-0.5, 1.0, hand.model.nq)
    mujoco.mj_kinematics(hand.model, alone)
    mujoco.mj_kinematics(model, together)
    for body in (link for links in hand.links for link in links):
        expected = alone.body(hand.palm).xmat.reshape(3, 3).T @ (
            alone.body(body).xpos - alone.body(hand.palm).xpos
        )
        palm = together.body(hand.palm)
        found = palm.xmat.reshape(3, 3).T @ (together.body(body).xpos - palm.xpos)
        np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("name", HANDS)
def test_fingers_point_out_of_the_flange_and_nothing_touches_the_arm(name):
    hand, model = load_hand(name), mounted(name)
    data = mujoco.MjData(model)
    data.qpos[:6] = HOME
    mujoco.mj_forward(model, data)
    flange = np.concatenate([data.site(FLANGE_SITE).xpos, data.body("wrist_3_link").xquat])
    expected, found = compose(flange, mounting_pose(hand)), body_pose(data, hand.palm)
    np.testing.assert_allclose(found[:3], expected[:3], atol=1e-5)
    assert abs(found[3:] @ expected[3:]) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(rotate(mounting_pose(hand)[3:], hand.palm_fingers), [0, 0, 1], atol=1e-6)
    arm_bodies = set(range(1, model.body("wrist_3_link").id + 1))
    for contact in data.contact:
        bodies = {int(model.geom_bodyid[g]) for g in contact.geom}
        assert not bodies & arm_bodies, [model.body(b).name for b in bodies]


def test_the_palm_begins_at_the_flange():
    hand, model = load_hand("allegro"), mounted("allegro")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    flange = data.site(FLANGE_SITE)
    lowest = np.inf
    for geom in np.flatnonzero(model.geom_bodyid == model.body(hand.palm).id):
        corners = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * model.geom_size[geom]
        points = data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
        lowest = min(lowest, ((points - flange.xpos) @ flange.xmat.reshape(3, 3)[:, 2]).min())
    assert lowest == pytest.approx(MOUNTING_GAP, abs=1e-6)


def test_the_arm_holds_the_hand_against_gravity():
    model = mounted("allegro")
    data = mujoco.MjData(model)
    data.qpos[:6] = data.ctrl[:6] = HOME
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos[:6] - HOME).max() < 0.01
    assert np.abs(data.actuator_force[:6]).max() < 150.0

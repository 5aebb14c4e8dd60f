"""What ``hands show`` says, and what ``hands export`` writes."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fungrasp.hands import hand_files, load_hand
from fungrasp.hands.arm import export_hand
from fungrasp.hands.export import self_contained_xml
from fungrasp.hands.hand import Finger
from fungrasp.hands.hand_description import contact_points, describe_hand

HANDS = sorted(hand_files())

TETRAHEDRON = "v 0 0 0\nv 40 0 0\nv 0 30 0\nv 0 0 20\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
WITH_MESH = """<mujoco><asset><mesh file="t.obj" scale="0.001 0.001 0.001"/></asset><worldbody>
<body name="a" pos="0 0 0.3"><joint name="j"/>
<geom name="g" type="mesh" mesh="t" pos="0.1 0 0" euler="10 20 30"/></body>
</worldbody></mujoco>"""


def test_a_link_is_touched_at_its_far_end():
    assert contact_points(Finger("index", ("a", "b", "c"), ("a", "b", "c"), "tip")) == ("b", "c", "tip")
    assert contact_points(Finger("index", ("a", "b"), ("a", "s"), "tip")) == ("s", "tip")
    assert contact_points(Finger("thumb", ("a",), ("a",), "tip")) == ("tip",)


@pytest.mark.parametrize("name", HANDS)
def test_a_description_is_json_and_names_what_is_in_the_model(name):
    hand = load_hand(name)
    told = json.loads(json.dumps(describe_hand(hand), allow_nan=False))
    model = mujoco.MjModel.from_xml_string(export_hand(hand))
    bodies = {model.body(i).name for i in range(model.nbody)}
    sites = {model.site(i).name for i in range(model.nsite)}
    assert told["palm"] in bodies
    for finger in told["fingers"].values():
        assert len(finger["contact_points"]) == len(finger["links"])
        assert (
            set(finger["links"]) <= bodies
            and {*finger["joints"], *finger["contact_points"]} <= bodies | sites
        )
        assert finger["contact_points"][-1] == finger["tip"] and finger["tip"] in sites
    assert [joint["name"] for joint in told["joints"]] == list(hand.joint_names)
    independent = [joint["name"] for joint in told["joints"] if joint["independent"]]
    assert independent == [actuator["joint"] for actuator in told["actuators"]]
    coupled = [joint["name"] for joint in told["joints"] if not joint["independent"]]
    assert sorted(coupling["joint"] for coupling in told["couplings"]) == sorted(coupled)
    assert told["mass"] == pytest.approx(sum(model.body_mass))
    assert set(told["links"]) == set(hand.link_names)


@pytest.mark.parametrize("name", HANDS)
def test_an_exported_hand_moves_as_the_hand(name):
    hand = load_hand(name)
    exported = mujoco.MjModel.from_xml_string(export_hand(hand))
    assert [exported.joint(j).name for j in range(exported.njnt)] == list(hand.joint_names)
    assert [exported.actuator(a).name for a in range(exported.nu)] == list(hand.actuators)
    np.testing.assert_allclose(exported.jnt_range, hand.model.jnt_range, atol=1e-5)
    np.testing.assert_allclose(exported.actuator_forcerange, hand.model.actuator_forcerange, rtol=1e-5)
    np.testing.assert_allclose(exported.eq_data, hand.model.eq_data, atol=1e-5)
    np.testing.assert_allclose(exported.body_mass, hand.model.body_mass, rtol=1e-5)
    a, b = mujoco.MjData(hand.model), mujoco.MjData(exported)
    rng = np.random.default_rng(0)
    for _ in range(10):
        a.qpos[:] = b.qpos[:] = rng.uniform(-0.5, 1.5, hand.model.nq)
        mujoco.mj_kinematics(hand.model, a)
        mujoco.mj_kinematics(exported, b)
        np.testing.assert_allclose(b.xpos, a.xpos, atol=1e-5)
        np.testing.assert_allclose(b.site_xpos, a.site_xpos, atol=1e-5)
        np.testing.assert_allclose(b.geom_xpos, a.geom_xpos, atol=1e-5)


def test_mesh_files_become_part_of_the_text(tmp_path: Path):
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    (tmp_path / "m.xml").write_text(WITH_MESH)
    spec = mujoco.MjSpec.from_file(str(tmp_path / "m.xml"))
    text = self_contained_xml(spec)
    original, alone = spec.compile(), mujoco.MjModel.from_xml_string(text)
    assert "t.obj" not in text
    a, b = mujoco.MjData(original), mujoco.MjData(alone)
    for model, data in ((original, a), (alone, b)):
        mujoco.mj_kinematics(model, data)

    def corners(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        points = data.geom_xpos[0] + model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T
        return points[np.lexsort(points.round(4).T)]

    np.testing.assert_allclose(corners(alone, b), corners(original, a), atol=1e-6)
    np.testing.assert_allclose(alone.body_mass, original.body_mass, rtol=1e-4)

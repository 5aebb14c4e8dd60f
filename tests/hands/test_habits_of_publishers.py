"""``hands add`` on what publishers of hands do and the project's own descriptions do not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from odd_hands import added, odd_hand

from fungrasp.core.errors import FungraspError
from fungrasp.hands.adding.add_hand import check_hand_files

CAPSULE = re.compile(r'<geom fromto="[^"]*"/>')
"""The shape of a link of ``odd_hand``."""


def with_meshes(text: str, lift: float = 0.0) -> str:
    """Links with a mesh in place of their capsules. lift: of the mesh from its joint [m]."""
    mesh = trimesh.creation.capsule(height=0.02, radius=0.008, count=[8, 8])
    mesh.apply_translation([0.0, 0.0, lift - mesh.bounds[0, 2]])
    vertices = mesh.vertices
    numbers = " ".join(f"{value:.6g}" for value in vertices.ravel())
    large = " ".join(f"{value:.6g}" for value in (1e3 * vertices).ravel())
    assets = f'<asset><mesh name="m" vertex="{numbers}"/><mesh name="large" vertex="{large}"/></asset>'
    text = CAPSULE.sub('<geom type="mesh" mesh="m"/>', text)
    return text.replace("<worldbody>", f"{assets}<worldbody>", 1)


def test_angles_may_count_from_another_pose(tmp_path: Path):
    """The same hand, all of whose joints stand at 0.5 rad where ours stand at zero."""

    def moved(match: re.Match) -> str:
        low, high = (float(value) + 0.5 for value in match[1].split())
        return f'range="{low} {high}" ref="0.5"'

    plain, _ = added(tmp_path / "plain", odd_hand())
    hand, _ = added(tmp_path / "moved", re.sub(r'range="([^"]*)"', moved, odd_hand()))
    np.testing.assert_allclose(hand.joint_limits, plain.joint_limits, atol=1e-6)
    np.testing.assert_allclose(hand.model.body_quat, plain.model.body_quat, atol=1e-6)
    np.testing.assert_allclose(hand.palm_fingers, plain.palm_fingers, atol=1e-6)


def test_the_zero_pose_may_be_a_fist(tmp_path: Path):
    """Every finger joint is bent by 1.5 rad at zero and straight at the lower end of its range."""
    fist = 'quat="0.731689 0 0.681639 0" '
    text = odd_hand().replace('range="-0.1 1.5"', 'range="-1.5 0"')
    text = re.sub(r'(<body name="[abcdz][23]" )', rf"\1{fist}", text)
    text = re.sub(r'(<body name="[abcd]1" )', rf"\1{fist}", text)
    hand, said = added(tmp_path, text)
    np.testing.assert_allclose(hand.palm_fingers, [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(hand.palm_normal, [1, 0, 0], atol=1e-6)
    assert not any("as far to either side" in message for message in said)


def test_shapes_for_pictures_are_used_where_none_collides(tmp_path: Path):
    text = odd_hand(mass=False).replace(
        '<geom type="capsule"', '<geom contype="0" conaffinity="0" type="capsule"'
    )
    hand, said = added(tmp_path, text)
    plain, _ = added(tmp_path / "plain", odd_hand(mass=False))
    assert any("its visual shapes are taken" in message for message in said)
    assert not any("no geometry" in message or "the mass of" in message for message in said)
    assert hand.model.body_mass.sum() == pytest.approx(plain.model.body_mass.sum())
    np.testing.assert_allclose(hand.model.geom_size, plain.model.geom_size)


def test_bodies_without_names_keep_their_meshes(tmp_path: Path):
    text = re.sub(r'<body name="[abcd][123]"', "<body", with_meshes(odd_hand()))
    _, said = added(tmp_path, text)
    assert not any("no geometry" in message for message in said)


def test_one_mesh_may_lack_its_scale(tmp_path: Path):
    text = with_meshes(odd_hand())
    start = text.index('<body name="b3"')
    text = text[:start] + text[start:].replace('mesh="m"', 'mesh="large"', 1)
    hand, said = added(tmp_path, text)
    assert any("the mesh of 'b3' is up to 36 m large: taken to be in millimeters" in m for m in said)
    radius = hand.model.geom_rbound[hand.model.geom_bodyid == hand.model.body("b3").id]
    assert 0.005 < radius.max() < 0.03


def test_shapes_far_from_their_joints_are_refused(tmp_path: Path):
    """Meshes in the frame of the whole hand."""
    with pytest.raises(FungraspError, match="in the frame of the whole hand") as refused:
        added(tmp_path, with_meshes(odd_hand(), lift=0.06))
    assert "mm long" not in str(refused.value)


def test_a_center_of_mass_in_other_units_is_not_believed(tmp_path: Path):
    text = odd_hand()
    hand, said = added(tmp_path, re.sub(r'<inertial pos="0 0 [^"]*"', '<inertial pos="0 0 2.2"', text))
    assert any(
        re.search(r"center of mass lies far outside the shapes of .*'a1 \(217\d mm\)'", m) for m in said
    )
    assert np.abs(hand.model.body_ipos).max() < 0.1
    # A hand that someone writes is told.
    wrong = re.sub(
        r'(name="a1".*?<inertial pos="0 0 )[^"]*', r"\g<1>0.5", hand.model_path.read_text(), flags=re.S
    )
    hand.model_path.write_text(wrong)
    assert any("far outside the shapes of 'a1" in finding.message for finding in check_hand_files(hand.path))
    with pytest.raises(FungraspError, match="the center of mass of body 'a1' is 22 m: is it in meters"):
        added(tmp_path, re.sub(r'<inertial pos="0 0 [^"]*"', '<inertial pos="0 0 22"', text))


def motors(text: str, elements: list[str]) -> str:
    return text.replace("</mujoco>", f"<actuator>{''.join(elements)}</actuator></mujoco>")


JOINTS = [f"{letter}{i}_j" for letter in "abcdz" for i in (1, 2, 3)] + [f"{letter}_s" for letter in "abcdz"]


def test_motors_tell_their_torque_by_gear_and_control(tmp_path: Path):
    hand, said = added(
        tmp_path, motors(odd_hand(), [f'<motor joint="{j}" gear="0.6" ctrlrange="-1 1"/>' for j in JOINTS])
    )
    assert hand.actuators["a1_j"].force_limit == pytest.approx(0.6)
    assert not any("no torque limit" in message or "motors move" in message for message in said)


def test_joints_without_a_motor_are_named(tmp_path: Path):
    """The last joints have springs only."""
    driven = [j for j in JOINTS if "3_j" not in j]
    _, said = added(tmp_path, motors(odd_hand(), [f'<position joint="{j}"/>' for j in driven]))
    (words,) = (message for message in said if "motors move" in message)
    assert words.startswith("15 motors move 20 joints, none of them 'a3_j', 'b3_j', 'c3_j', 'd3_j', 'z3_j'")


def test_a_tendon_over_several_joints_is_one_motor(tmp_path: Path):
    """Its force has a lever that is not known: no torque limit follows from it."""
    text = re.sub(
        r'(<body name="([abcdz][123])"[^>]*>)', r'\1<site name="\2_s" pos="0.006 0 0.01"/>', odd_hand()
    )
    ropes = [
        f'<spatial name="{k}_t"><site site="{k}1_s"/><site site="{k}2_s"/><site site="{k}3_s"/></spatial>'
        for k in "abcdz"
    ]
    text = text.replace("</mujoco>", f"<tendon>{''.join(ropes)}</tendon></mujoco>")
    pulls = [f'<motor tendon="{k}_t" ctrlrange="-30 0" forcerange="-30 0"/>' for k in "abcdz"]
    _, said = added(tmp_path, motors(text, pulls))
    assert any(message.startswith("5 motors move 20 joints") for message in said)
    assert any("no torque limit" in message for message in said)


def test_a_thumb_that_cannot_move_is_named(tmp_path: Path):
    text = re.sub(r'<joint name="z[^>]*/>', "", odd_hand()).replace('name="z1"', 'name="thumb_base"')
    with pytest.raises(FungraspError, match="the thumb 'thumb_base' has no joint"):
        added(tmp_path, text)

"""``hands add``: hands with what foreign models lack or have too much of become hands that pass the check."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from hand_references import FOLDER
from odd_hands import added, claw, odd_hand

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand, load_hand
from fungrasp.hands.adding.add_hand import add_hand
from fungrasp.hands.adding.couplings import GivenCoupling
from fungrasp.hands.adding.shape_fitting import Box, Capsule, fit_boxes, fit_capsule, mesh_points
from fungrasp.hands.collisions import self_collision_depth, self_contact_words
from fungrasp.hands.kinematics import HandKinematics, partly_closed

CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "three fingers": {"fingers": 2},
    "four fingers": {"fingers": 3},
    "left": {"left": True},
    "ball joints": {"ball": True},
    "arm before the palm": {"arm": True},
    "palm elsewhere": {"palm_place": 'pos="0.1 0.2 -0.3" euler="0.3 1 2"', "first_sibling": True},
    "no collision": {"collision": False},
    "no masses": {"mass": False},
    "no limits": {"limits": False},
    "equalities": {"coupled": "equality"},
    "tendons": {"coupled": "tendon"},
    "all at once": {
        "left": True,
        "arm": True,
        "collision": False,
        "mass": False,
        "coupled": "tendon",
        "palm_place": 'pos="0.1 0 0" euler="1 0 2"',
    },
}


@pytest.mark.parametrize("case", CASES)
def test_parts_are_found_without_names(tmp_path: Path, case: str):
    options = CASES[case]
    hand, _ = added(tmp_path, odd_hand(**{"fingers": 4, **options}))
    count = options.get("fingers", 4)
    names = ("index", "middle", "ring", "pinky")[:count]
    links = {name: (f"{k}1", f"{k}2", f"{k}3") for name, k in zip(names, "abcd", strict=False)}
    assert {name: finger.links for name, finger in hand.fingers.items()} == {
        **links,
        "thumb": ("z1", "z2", "z3"),
    }
    assert hand.palm == "p"
    assert hand.side == ("left" if options.get("left") else "right")
    np.testing.assert_allclose(hand.palm_fingers, [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(hand.palm_normal, [1, 0, 0], atol=1e-6)
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    tip = data.site("index_tip").xpos
    side = -1.0 if options.get("left") else 1.0
    np.testing.assert_allclose(tip, [0, 0.035 * side, 0.09 + 0.045 + 0.03 + 0.019], atol=0.01)
    assert not {"u", "v", "shoulder"} & {hand.model.body(i).name for i in range(hand.model.nbody)}
    limits = hand.joint_limits
    assert np.all(np.isfinite(limits)) and np.all(limits[:, 0] < limits[:, 1])
    assert np.all(hand.model.dof_armature > 0) and np.all(hand.model.dof_damping > 0)
    assert 0.1 < hand.model.body_mass.sum() < 2.0
    middle = hand.all_joints(limits[[hand.joint_names.index(j) for j in hand.actuators]].mean(axis=1))
    assert self_collision_depth(hand.model, middle[None])[0] < 0.005


def test_ball_joints_become_three_hinges(tmp_path: Path):
    hand, messages = added(tmp_path, odd_hand(ball=True))
    assert {f"a_ball_{letter}" for letter in "xyz"} <= set(hand.joint_names)
    assert any("ball joint 'a_ball' became three hinges" in message for message in messages)


@pytest.mark.parametrize(("coupled", "slope", "constant"), [("equality", 0.8, 0.1), ("tendon", 1.0, 0.0)])
def test_couplings_are_kept(tmp_path: Path, coupled: str, slope: float, constant: float):
    hand, _ = added(tmp_path, odd_hand(coupled=coupled))
    assert "a3_j" not in hand.actuators
    matrix, offset = hand.coupling
    row, column = hand.joint_names.index("a3_j"), list(hand.actuators).index("a2_j")
    assert matrix[row, column] == pytest.approx(slope) and offset[row] == pytest.approx(constant)


def test_coupling_by_option(tmp_path: Path):
    hand, _ = added(tmp_path, odd_hand(), couplings=(GivenCoupling("a3_j", 0.9, "a2_j"),))
    assert "a3_j" not in hand.actuators
    with pytest.raises(FungraspError, match="--couple: unknown joint"):
        added(tmp_path, odd_hand(), couplings=(GivenCoupling("a3_k", 0.9, "a2_j"),))


def test_a_joint_may_follow_a_later_one(tmp_path: Path):
    """With slope 1, both have the same row in the coupling matrix."""
    follows = GivenCoupling("a2_j", 1.0, "a3_j", offset=0.2)
    hand, messages = added(tmp_path, odd_hand(), couplings=(follows,))
    assert "a3_j" in hand.actuators and "a2_j" not in hand.actuators
    assert any("a3_j -0.10 to 1.30, not -0.10 to 1.50" in message for message in messages)


def test_mirrored_file_gives_the_mirrored_hand(tmp_path: Path):
    right, _ = added(tmp_path / "r", odd_hand())
    left, _ = added(tmp_path / "l", odd_hand(left=True))
    ends = []
    for hand in (right, left):
        data = mujoco.MjData(hand.model)
        mujoco.mj_kinematics(hand.model, data)
        ends.append(np.array([data.site(f"{name}_tip").xpos for name in hand.fingers]))
    np.testing.assert_allclose(ends[1], ends[0] * [1, -1, 1], atol=1e-4)


def test_same_bytes_and_no_overwriting(tmp_path: Path):
    file = tmp_path / "odd.xml"
    file.write_text(odd_hand(collision=False))
    first, _ = add_hand(file, tmp_path / "a")
    second, _ = add_hand(file, tmp_path / "b")
    for name in ("hand.toml", "odd.xml"):
        assert (first.parent / name).read_bytes() == (second.parent / name).read_bytes()
    with pytest.raises(FungraspError, match="--force"):
        add_hand(file, tmp_path / "a")
    with pytest.raises(FungraspError, match="would be overwritten"):
        add_hand(file, tmp_path, "odd", force=True)


def test_what_cannot_be_decided_is_asked_for(tmp_path: Path):
    with pytest.raises(FungraspError, match="--thumb BODY"):
        added(tmp_path, odd_hand(fingers=1))
    hand, _ = added(tmp_path, odd_hand(fingers=1), thumb="z2", side="right")
    assert list(hand.fingers) == ["index", "thumb"]
    with pytest.raises(FungraspError, match="--palm"):
        added(tmp_path, odd_hand(), palm="q")
    with pytest.raises(FungraspError, match="--thumb: unknown body"):
        added(tmp_path, odd_hand(), thumb="zz")
    hand, _ = added(tmp_path, odd_hand(), fingers={"index": "b1", "middle": "c1", "thumb": "z1"})
    assert hand.fingers["index"].links[0] == "b1" and len(hand.fingers) == 3
    hand, _ = added(tmp_path, odd_hand(), normal=(0.0, 0.2, 1.0), side="left")
    assert hand.side == "left"


def test_meshes_are_fitted_and_kept_for_pictures(tmp_path: Path):
    (tmp_path / "meshes").mkdir()
    capsule = trimesh.creation.capsule(height=0.03, radius=0.008)
    capsule.apply_translation([0, 0, 0.02 - capsule.bounds.mean(axis=0)[2]])
    capsule.export(tmp_path / "meshes" / "link.stl")
    text = odd_hand(collision=False).replace(
        "<worldbody>", '<asset><mesh name="link" file="link.stl"/></asset><worldbody>'
    )
    text = text.replace("<compiler ", '<compiler meshdir="meshes" ')
    for body in ("a3", "b3", "c3", "d3", "z3"):
        text = text.replace(
            f'<body name="{body}" pos="0 0 0.03">',
            f'<body name="{body}" pos="0 0 0.03"><geom type="mesh" mesh="link"/>',
        )
    hand, messages = added(tmp_path, text)
    assert any("shapes of 5 links" in message for message in messages)
    geoms = [g for g in range(hand.model.ngeom) if hand.model.geom_bodyid[g] == hand.model.body("a3").id]
    kinds = {int(hand.model.geom_type[g]): g for g in geoms}
    assert set(kinds) == {mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_CAPSULE}
    assert hand.model.geom_size[kinds[mujoco.mjtGeom.mjGEOM_CAPSULE], 0] == pytest.approx(0.008, abs=5e-4)
    assert hand.model.geom_contype[kinds[mujoco.mjtGeom.mjGEOM_MESH]] == 0


def test_urdf_with_mimic_and_package_paths(tmp_path: Path):
    (tmp_path / "my_hand" / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.02, 0.09, 0.08)).export(tmp_path / "my_hand" / "meshes" / "palm.stl")
    (tmp_path / "my_hand" / "urdf").mkdir()
    mesh = '<mesh filename="package://my_hand/meshes/palm.stl"/>'
    parts = [f'<link name="p"><visual><geometry>{mesh}</geometry></visual></link>']
    limit = '<limit lower="0" upper="1.4" effort="0" velocity="1"/>'
    spots = {"a": (0.035, 0.0), "b": (0.0, 0.0), "c": (-0.035, 0.0), "z": (0.05, -0.06)}
    for letter, (y, z) in spots.items():
        for i in (1, 2, 3):
            parent = "p" if i == 1 else f"{letter}{i - 1}"
            turned = ' rpy="-0.9 0.4 -1.9"' if letter == "z" and i == 1 else ""
            place = f"0 {y} {0.05 + z}" if i == 1 else "0 0 0.035"
            mimic = f'<mimic joint="{letter}2_j" multiplier="1.1"/>' if i == 3 else ""
            parts.append(
                f'<link name="{letter}{i}"/><joint name="{letter}{i}_j" type="revolute">'
                f'<origin xyz="{place}"{turned}/><parent link="{parent}"/><child link="{letter}{i}"/>'
                f'<axis xyz="0 1 0"/>{limit}{mimic}</joint>'
            )
    file = tmp_path / "my_hand" / "urdf" / "hand.urdf"
    file.write_text(f'<robot name="h">{"".join(parts)}</robot>')
    path, findings = add_hand(file, tmp_path / "out")
    hand = load_hand(path)
    assert not any("no file is found" in finding.message for finding in findings)
    assert len(hand.actuators) == 8 and len(hand.joint_names) == 12
    assert hand.fingers["thumb"].links == ("z1", "z2", "z3")
    assert hand.joint_limits[hand.joint_names.index("a3_j")][1] <= 1.4 + 1e-6


def test_command_says_what_it_did_and_what_comes_next(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    (tmp_path / "odd.xml").write_text(odd_hand(collision=False))
    assert main(["hands", "add", str(tmp_path / "odd.xml"), "--out", str(tmp_path / "hand")]) == 0
    out, err = capfd.readouterr()
    assert "a right hand, palm 'p'" in out and "hand.toml: 0 errors" in out
    assert "next: fungrasp retarget --hand" in out and err == ""
    assert main(["hands", "add", str(tmp_path / "none.xml")]) == 2


def test_fitted_capsule_and_boxes():
    mesh = trimesh.creation.capsule(height=0.05, radius=0.01)
    points = mesh_points(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    capsule = fit_capsule(points, np.array([0.3, 0.1, 1.0]))
    assert np.abs(capsule.distance(points)).max() < 5e-4
    box = trimesh.creation.box((0.02, 0.06, 0.1))
    (found,) = fit_boxes(np.asarray(box.vertices), np.asarray(box.faces), np.eye(3))
    np.testing.assert_allclose(found.half, [0.01, 0.03, 0.05], atol=1e-6)
    assert Box(np.zeros(3), np.ones(3), np.eye(3)).distance(np.array([[2.0, 0, 0], [0, 0, 0]])).tolist() == [
        1,
        -1,
    ]
    assert Capsule(np.zeros(3), np.zeros(3), 1.0).distance(np.array([[0.0, 0, 3]])).tolist() == [2]


@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the reference hand models are not in {FOLDER}")
@pytest.mark.parametrize(
    "name", ["schunk_svh_right.urdf", "ability_right.urdf", "faive_hand.xml", "leap_right.urdf"]
)
def test_reference_hands(tmp_path: Path, name: str):
    path, findings = add_hand(FOLDER / name, tmp_path / "out", "added")
    assert not [f.message for f in findings if f.severity == "error"]
    hand = load_hand(path)
    assert hand.side == "right" and len(hand.fingers) == (4 if "leap" in name else 5)
    assert any("no file is found" in finding.message for finding in findings)


def tips(hand: Hand, joints: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.all_joints(joints)
    mujoco.mj_kinematics(hand.model, data)
    return np.array([data.site(finger.tip).xpos for finger in hand.fingers.values()])


@pytest.mark.parametrize("turns", ["1 1 1", "1 -1 1", "-1 -1 -1"])
def test_a_symmetric_claw_needs_no_answer(tmp_path: Path, turns: str):
    hand, messages = added(tmp_path, claw(turns=turns))
    assert list(hand.fingers) == ["index", "middle", "thumb"]
    assert any("alike" in message and "--thumb" in message for message in messages)
    np.testing.assert_allclose(hand.palm_fingers, [0, 0, 1], atol=1e-6)
    # The palm faces the thumb, whatever the signs of the joints.
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    assert data.site(hand.fingers["thumb"].tip).xpos @ hand.palm_normal > 0.03
    chosen, _ = added(tmp_path, claw(turns=turns), thumb="f1b")
    assert chosen.fingers["thumb"].links == ("f1a", "f1b")


@pytest.mark.parametrize(
    ("low", "high", "turns"), [(-1.5, 1.5, "1 -1 1"), (0, 1.5, "1 1 1"), (-1.5, 0, "-1 -1 -1")]
)
def test_hands_start_partly_closed_towards_the_object(tmp_path: Path, low: float, high: float, turns: str):
    hand, _ = added(tmp_path, claw(low=low, high=high, turns=turns))
    kinematics = HandKinematics(hand, 5)
    spread = [
        np.ptp(tips(hand, partly_closed(kinematics, share)), axis=0)[:2].max() for share in (0, 0.1, 0.2)
    ]
    assert spread[0] > spread[1] > spread[2]


def test_angles_without_units_are_radians_where_they_must_be(tmp_path: Path):
    hand, messages = added(tmp_path, claw(low=0, high=1.5, turns="1 1 1", degrees=True))
    np.testing.assert_allclose(hand.joint_limits, [[0, 1.5]] * 6)
    assert any("taken as radians" in message for message in messages)


def test_one_of_several_hands_is_chosen(tmp_path: Path):
    one = odd_hand().split("<worldbody>")[1].split("</worldbody>")[0]
    other = one.replace('name="', 'name="other_')
    text = odd_hand().replace("</worldbody>", f"{other}</worldbody>")
    with pytest.raises(FungraspError, match=r"several bodies carry fingers: 'p', 'other_p'.*--palm"):
        added(tmp_path, text)
    hand, _ = added(tmp_path, text, palm="other_p")
    assert hand.palm == "other_p" and len(hand.fingers) == 5


def test_things_beside_the_hand_are_left_out(tmp_path: Path):
    door = """<body name="door" pos="1 0 0"><joint name="hinge" axis="0 0 1" range="0 1"/>
      <geom type="box" size="0.1 0.1 0.1"/><body name="latch"><joint name="turn" axis="1 0 0" range="0 1"/>
      <geom type="box" size="0.02 0.02 0.02"/></body></body>"""
    hand, _ = added(tmp_path, odd_hand().replace("<worldbody>", f"<worldbody>{door}", 1))
    assert hand.palm == "p" and "hinge" not in hand.joint_names


def test_couplings_count_from_the_reference_pose(tmp_path: Path):
    """Both joints stand at 0.4 in the file: MuJoCo couples what is beyond that."""
    text = claw(low=0, high=1.5, turns="1 1 1").replace('_j"', '_j" ref="0.4"')
    ties = "".join(f'<joint joint1="f{k}b_j" joint2="f{k}a_j" polycoef="0 0.5 0 0 0"/>' for k in range(3))
    hand, _ = added(tmp_path, text.replace("</mujoco>", f"<equality>{ties}</equality></mujoco>"))
    matrix, offset = hand.coupling
    row = hand.joint_names.index("f0b_j")
    # In the new model angles count from the file's pose.
    assert offset[row] == pytest.approx(0.0) and matrix[row].max() == pytest.approx(0.5)
    np.testing.assert_allclose(hand.joint_limits[hand.joint_names.index("f0a_j")], [-0.4, 1.1])


def test_links_that_penetrate_are_named_with_the_reason(tmp_path: Path):
    hand, _ = added(tmp_path, claw(low=-1.5, high=1.5))
    closed = hand.all_joints(partly_closed(HandKinematics(hand, 5), 0.9))
    assert not self_contact_words(hand.model, np.zeros((2, 6)))
    (words,) = self_contact_words(hand.model, np.stack([0 * closed, closed]))
    assert words.startswith("1 of 2 grasps collide with themselves") and "(rows 1; " in words
    # Thick fingers meet at the zero pose already.
    spec = hand.spec()
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            geom.size[0] = 0.05
    (words,) = self_contact_words(spec.compile(), np.zeros((1, 6)))
    assert "by their shapes" in words and "<exclude body1=" in words

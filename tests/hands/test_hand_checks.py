"""The checker: every fault is found in a small hand that has it; the small hand without faults has none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from odd_hands import odd_hand

from fungrasp.hands import hand_files, load_hand
from fungrasp.hands.adding.add_hand import check_hand_files
from fungrasp.hands.findings import Finding, finger_of
from fungrasp.hands.kinematics import HandKinematics


def finger(name: str, y: float) -> str:
    return f"""
    <body name="{name}_a" pos="0 {y} 0.1">
      <joint name="{name}_j1"/><geom name="{name}_a" fromto="0 0 0.015 0 0 0.03"/>
      <body name="{name}_b" pos="0 0 0.045">
        <joint name="{name}_j2"/><geom name="{name}_b" fromto="0 0 0.015 0 0 0.03"/>
        <site name="{name}_tip" pos="0 0 0.03"/>
      </body>
    </body>"""


MJCF = f"""<mujoco>
  <compiler angle="radian"/>
  <default><joint axis="0 1 0" range="0 1.5"/><geom type="capsule" size="0.008"/></default>
  <worldbody>
    <body name="palm">
      <geom name="palm" type="box" size="0.01 0.04 0.04" pos="0 0 0.04"/>
      {finger("index", 0.03)}
      {finger("thumb", -0.03)}
    </body>
  </worldbody>
  <equality><joint joint1="index_j2" joint2="index_j1" polycoef="0 1 0 0 0"/></equality>
</mujoco>"""

TOML = """name = "small"
model = "small.xml"
palm = "palm"
[palm_frame]
fingers = [0.0, 0.0, 1.0]
normal = [1.0, 0.0, 0.0]
[fingers.index]
links = ["index_a", "index_b"]
tip = "index_tip"
[fingers.thumb]
links = ["thumb_a", "thumb_b"]
tip = "thumb_tip"
[actuators]
kp = 1.0
kd = 0.1
force_limit = 0.5
"""

INERTIA = '<inertia ixx="1e-5" iyy="1e-5" izz="4e-6" ixy="0" ixz="0" iyz="0"/>'
INERTIAL = f'<inertial><mass value="0.02"/>{INERTIA}</inertial>'
LIMIT = '<limit lower="0" upper="1.5" effort="1" velocity="1"/>'
BOX = '<collision><geometry><box size="0.01 0.01 0.02"/></geometry></collision>'


def urdf_finger(name: str, y: float) -> str:
    return f"""
  <link name="{name}_a">{INERTIAL}{BOX}</link>
  <link name="{name}_b">{INERTIAL}{BOX}</link>
  <joint name="{name}_j1" type="revolute"><origin xyz="0 {y} 0.1"/>
    <parent link="palm"/><child link="{name}_a"/><axis xyz="0 1 0"/>{LIMIT}</joint>
  <joint name="{name}_j2" type="revolute"><origin xyz="0 0 0.04"/>
    <parent link="{name}_a"/><child link="{name}_b"/><axis xyz="0 1 0"/>{LIMIT}</joint>"""


URDF = f"""<robot name="small">
  <mujoco><compiler fusestatic="false"/></mujoco>
  <link name="palm">{INERTIAL}{BOX}</link>{urdf_finger("index", 0.03)}{urdf_finger("thumb", -0.03)}
</robot>"""


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def write(folder: Path, mjcf: str = MJCF, toml: str = TOML) -> Path:
    (folder / "small.xml").write_text(mjcf)
    (folder / "hand.toml").write_text(toml)
    return folder / "hand.toml"


def said(findings: list[Finding], told: str) -> bool:
    """Whether there is a finding like ``told``: its severity, and a pattern of its words."""
    severity, _, pattern = told.partition(": ")
    return any(f.severity == severity and re.search(pattern, f.message) for f in findings)


def faults(findings: list[Finding]) -> list[Finding]:
    return [f for f in findings if f.severity != "note"]


@pytest.mark.parametrize("name", sorted(hand_files()))
def test_our_hands_have_no_errors(name):
    assert [f.message for f in check_hand_files(hand_files()[name]) if f.severity == "error"] == []


def test_a_sound_hand_has_no_faults(tmp_path):
    toml = write(tmp_path)
    assert faults(check_hand_files(toml)) == []
    assert check_hand_files(tmp_path) == check_hand_files(toml)
    assert load_hand(toml).name == "small"


def test_a_bare_model_is_checked_by_adding_it(tmp_path):
    file = tmp_path / "odd.xml"
    file.write_text(odd_hand())
    findings = check_hand_files(file)
    assert not [f for f in findings if f.severity == "error"]
    assert said(findings, "note: a right hand, palm 'p'") and said(findings, "warning: no torque limit")
    assert "fungrasp hands add" in findings[-1].message and list(tmp_path.iterdir()) == [file]
    file.write_text(MJCF)
    assert said(check_hand_files(file), "error: carries a gripper: its 4 joints are all parallel")


def test_a_body_may_be_a_tip(tmp_path):
    mjcf = changed(MJCF, '<site name="index_tip" pos="0 0 0.03"/>', '<body name="index_tip" pos="0 0 0.03"/>')
    assert faults(check_hand_files(write(tmp_path, mjcf))) == []
    hand = load_hand(tmp_path)
    assert hand.fingers["index"].tip == "index_tip"
    at = HandKinematics(hand, 1)
    at.update(None, np.zeros((1, len(hand.actuators))))
    np.testing.assert_allclose(at.points(at.body_points(("index_tip",)))[0, 0], [0, 0.03, 0.175], atol=1e-9)


def test_a_side_against_the_order_of_the_fingers_is_mentioned(tmp_path):
    findings = check_hand_files(write(tmp_path, toml='side = "right"\n' + TOML))
    assert said(findings, "warning: seen from the palm, this is a left hand")


PALM = '<body name="palm">'
INDEX = '<body name="index_a" pos="0 0.03 0.1">'
JOINT = '<joint name="index_j1"/>'
SHAPE = 'fromto="0 0 0.015 0 0 0.03"/>'


def joint(attributes: str) -> str:
    return f'<joint name="index_j1" {attributes}/>'


def inertial(mass: str, diagonal: str) -> str:
    return f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{diagonal}"/>'


def follows(joint: str, driver: str) -> str:
    return f'<joint joint1="{joint}" joint2="{driver}" polycoef="0 1 0 0 0"/></equality>'


TENDON = """<tendon><fixed name="t">
  <joint joint="thumb_j1" coef="1"/><joint joint="thumb_j2" coef="1"/>
</fixed></tendon>"""
MESH = '<collision><geometry><mesh filename="package://x/a.stl"/></geometry></collision>'


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (JOINT, joint('range="1.5 0"'), "error: 'index_j1' has its limits swapped"),
        (JOINT, joint('range="1 1"'), "error: 'index_j1' has no limits"),
        (JOINT, joint('range="0 90"'), "error: 'index_j1 0 to 90' has limits beyond -pi to pi"),
        (JOINT, joint('limited="false"'), "error: 'index_j1' has no valid limits"),
        (JOINT, joint('type="ball" range="0 1"'), "error: does not compile: .*joint"),
        (JOINT, joint('type="slide"'), "error: 'index_j1' slides"),
        ('angle="radian"', 'angle="degree"', "error: taken as radians"),
        (JOINT, joint('pos="0.012 0.5 0"'), "warning: 'index_a' is 12.0 mm off"),
        (PALM, '<geom name="base" fromto="0 0 -1 0 0 -0.9"/>' + PALM, "error: palm is fused with the world"),
        (PALM, PALM + '<joint name="wrist"/>', "error: moves on the joint 'wrist'"),
        (PALM, PALM + "<freejoint/>", "error: does not compile: "),
        (
            '<compiler angle="radian"/>',
            '<compiler angle="radian" fusestatic="true"/>',
            "error: 'palm' is fused",
        ),
        ("0 1 0 0 0", "0 1 0.5 0 0", "error: 'index_j2' follows a curve"),
        ("0 1 0 0 0", "0.1 2 0 0 0", "warning: couplings exceed the limits of 'index_j2 by index_j1'"),
        ("0 1 0 0 0", "0.1 0 0 0 0", "warning: slope 0"),
        ("</equality>", follows("index_j1", "index_j2"), "error: couplings form a loop"),
        (
            "</equality>",
            follows("index_j2", "thumb_j1"),
            "error: 'index_j2' to 'thumb_j1' repeats or contradicts",
        ),
        (
            "</mujoco>",
            TENDON + "</mujoco>",
            "warning: tendon 't' moves 'thumb_j1' and 'thumb_j2' .*only 'fungrasp hands add' does this",
        ),
        (INDEX, INDEX + inertial("0", "0 0 0"), "error: does not compile: .*'index_a'"),
        (
            INDEX,
            INDEX + inertial("1", "1e-5 1e-5 1e-4"),
            "error: the inertia of 'index_a' is physically impossible",
        ),
        (INDEX, INDEX + inertial("0.1", "1 1 1"), "error: the inertia of 'index_a' is physically impossible"),
        (
            '<geom name="index_a" fromto="0 0 0.015 0 0 0.03"/>',
            "",
            "error: does not compile: .*'index_a'",
        ),
        (
            '<geom name="index_b" fromto="0 0 0.015 0 0 0.03"/>',
            '<geom name="index_b" fromto="0 0 0.015 0 0 0.03" contype="0" conaffinity="0"/>',
            "error: no collision shape on the link 'index_b'",
        ),
        (
            'size="0.01 0.04 0.04" pos="0 0 0.04"',
            'size="0.01 0.04 0.06" pos="0 0 0.06"',
            "error: 'palm' and 'index_a' .* at the zero pose",
        ),
        (
            INDEX,
            '<body name="index_a" pos="0 0.03 0.1" quat="0 1 0 0">',
            "error: 'palm' and 'index_b'.* overlap",
        ),
        (INDEX, '<body name="index_a" pos="0 0.03 1.1">', "error: 1.19 m large"),
        (
            '<site name="index_tip" pos="0 0 0.03"/>',
            '<site name="index_tip"/>',
            "error: 'index_b' and 'index_tip' are at the same point",
        ),
    ],
)
def test_faults_of_an_mjcf(tmp_path, old, new, told):
    findings = check_hand_files(write(tmp_path, changed(MJCF, old, new)))
    assert said(findings, told), findings


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('palm = "palm"', 'palm = "plam"', "error: unknown body of small.xml 'plam'. Did you mean 'palm'"),
        ('tip = "index_tip"', 'tip = "index_top"', "error: unknown site or body of small.xml 'index_top'"),
        (
            'tip = "index_tip"',
            'tip = "thumb_tip"',
            "error: 'thumb_tip' is on the body 'thumb_b', not on the last",
        ),
        ('["index_a", "index_b"]', '["index_b", "index_a"]', "error: list links from base to tip"),
        ('["index_a", "index_b"]', '["index_a", "thumb_b"]', "error: 'thumb_b' does not hang on 'index_a'"),
        ('["index_a", "index_b"]', "[]", "error: finger 'index' needs 'links'"),
        ("fingers.index", "fingers.indx", "error: unknown finger 'indx'. Did you mean 'index'"),
        (
            'tip = "index_tip"',
            'tip = "index_tip"\njoints = ["index_a", "x"]',
            "error: site or body of small.xml 'x'",
        ),
        ('tip = "index_tip"', 'tip = "index_tip"\njoints = ["index_a"]', "error: 2 links and 1 joints"),
        ("[fingers.thumb]", "[fingers.pinky]", "error: no thumb"),
        ("force_limit = 0.5", "", "error: actuators.force_limit for joint"),
        ("normal = [1.0, 0.0, 0.0]", "normal = [-1.0, 0.0, 0.0]", "error: out of the back of the hand"),
        (
            "fingers = [0.0, 0.0, 1.0]",
            "fingers = [0.0, 1.0, 0.0]",
            "error: palm_frame.fingers is 90 degrees off",
        ),
        ("fingers = [0.0, 0.0, 1.0]", "fingers = [1.0, 0.0, 0.0]", "warning: perpendicular"),
        ("normal = [1.0, 0.0, 0.0]", "normal = [2.0, 0.0, 0.0]", "error: must be a unit vector"),
        ('model = "small.xml"', 'model = "big.xml"', "error: big.xml does not exist"),
        ('palm = "palm"', "palm = 3", "error: 'palm' must be a text, not 3"),
        ('model = "small.xml"', 'model = ["small.xml"]', "error: 'model' must be a text"),
        (
            'name = "small"',
            'name = "small"\nactuators = 3\n[rest]',
            "error: 'actuators' must be a table|not valid",
        ),
        ('links = ["index_a", "index_b"]', "links = [1, [2]]", "error: must be a text, not 1"),
        ("[fingers.index]", "[index]", "error: a hand needs a thumb and at least one more finger"),
        ('name = "small"', "", "error: the field 'name' is missing"),
        ('name = "small"', "name = small", "error: not valid TOML"),
    ],
)
def test_faults_of_a_toml(tmp_path, old, new, told):
    findings = check_hand_files(write(tmp_path, toml=changed(TOML, old, new)))
    assert said(findings, told), findings


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('<mujoco><compiler fusestatic="false"/></mujoco>', "", "error: 'palm' is fused with the world"),
        ('<parent link="index_a"/>', '<parent link="indexa"/>', "error: URDF joint parent or child missing"),
        ('lower="0" upper="1.5"', 'lower="1.5" upper="0"', "error: 'index_j1' has its limits swapped"),
        (LIMIT, "", "error: 'index_j1' has no limits"),
        (LIMIT, LIMIT + '<mimic joint="none"/>', "error: none"),
        (LIMIT, LIMIT + '<mimic joint="thumb_j1" multiplier="0"/>', "warning: slope 0"),
        (LIMIT, LIMIT + '<mimic joint="thumb_j1" multiplier="3"/>', "warning: 'index_j1 by thumb_j1'"),
        (BOX, MESH, "error: 'package://x/a.stl'"),
        ("<robot", "<rabbit", "error: not valid XML|no element|root"),
        ("</robot>", '<link name="${radius}"/></robot>', "error: xacro"),
    ],
)
def test_faults_of_a_hand_with_a_urdf(tmp_path, old, new, told):
    write(tmp_path, toml=TOML.replace("small.xml", "small.urdf").replace('_tip"', '_end"'))
    ends = "".join(
        f'<link name="{finger}_end"/><joint name="{finger}_end" type="fixed"><origin xyz="0 0 0.04"/>'
        f'<parent link="{finger}_b"/><child link="{finger}_end"/></joint>'
        for finger in ("index", "thumb")
    )
    text = URDF.replace("</robot>", ends + "</robot>")
    (tmp_path / "small.urdf").write_text(text)
    assert faults(check_hand_files(tmp_path)) == []
    (tmp_path / "small.urdf").write_text(changed(text, old, new))
    findings = check_hand_files(tmp_path)
    assert said(findings, told), findings


def test_it_goes_on_after_a_missing_mesh(tmp_path):
    mesh = changed(MJCF, "<worldbody>", '<asset><mesh name="m" file="lost.obj"/></asset><worldbody>')
    mesh = changed(mesh, '<geom name="index_a" fromto="0 0 0.015 0 0 0.03"/>', '<geom type="mesh" mesh="m"/>')
    mesh = changed(mesh, '<joint name="thumb_j1"/>', '<joint name="thumb_j1" range="2 1"/>')
    findings = check_hand_files(write(tmp_path, mesh))
    assert said(findings, "error: no file is found for the mesh 'lost.obj'")
    assert said(findings, "error: 'thumb_j1' has its limits swapped")
    assert not said(findings, "error: the mass of|the inertia of|no collision shape")


@pytest.mark.parametrize(
    ("name", "content", "pattern"),
    [
        ("none.xml", None, "does not exist"),
        ("hand.txt", "x", "must be a .toml"),
        ("hand.xml", "<html/>", "neither a URDF"),
        ("hand.xml", "<mujoco><nonsense/></mujoco>", "MuJoCo cannot read"),
        ("hand.xml", "<mujoco/>", "no joints"),
    ],
)
def test_files_that_are_no_hands(tmp_path, name, content, pattern):
    if content is not None:
        (tmp_path / name).write_text(content)
    findings = check_hand_files(tmp_path / name)
    assert said(findings, f"error: {pattern}"), findings
    assert not any("\n" in f.message for f in faults(findings))


def test_mujoco_writes_no_log_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.urdf").write_text(changed(URDF, 'upper="1.5"', 'upper="0"'))
    check_hand_files(tmp_path / "small.urdf")
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "finger"),
    [
        ("rh_ffproximal", "index"),
        ("R_ring_mcp", "ring"),
        ("little_distal", "pinky"),
        ("rh_thbase", "thumb"),
        ("string_pulley", None),
    ],
)
def test_fingers_are_known_by_their_names(name, finger):
    assert finger_of(name) == finger

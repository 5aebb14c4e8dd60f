"""``hands add`` and ``hands check`` on what descriptions by other makers have and ours don't."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from odd_hands import added, odd_hand
from scipy.spatial import KDTree

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.mesh_file import read_mesh
from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.adding.add_hand import add_hand, check_hand_files, parse_couplings
from fungrasp.hands.adding.shape_fitting import coarse
from fungrasp.objects import load_object
from fungrasp.task.protocol import LiftProtocol
from fungrasp.task.start_pose import StartPoses


def on_flange(text: str) -> str:
    """The hand of ``odd_hand`` on a body half a meter behind its palm."""
    return text.replace('<body name="p" >', '<body name="flange"><body name="p" pos="0 0 0.5">').replace(
        "</worldbody>", "</body></worldbody>"
    )


def test_a_palm_whose_origin_is_far_starts_as_far_from_the_object(tmp_path: Path):
    """The flange is nearer to the object's other side than to the hand where starts count from it."""
    (tmp_path / "near").mkdir()
    near, said = added(tmp_path / "near", odd_hand())
    assert not any("the origin of the palm" in message for message in said)
    far, said = added(tmp_path, on_flange(odd_hand()), palm="flange")
    assert any("the origin of the palm 'flange' lies 0.59 m from the bases" in message for message in said)
    model = load_object("can", 0.3)
    obj = np.array([[0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]])
    grasp = np.array([[-0.05, 0.0, 0.3, 0.0, 0.0, 1.0, 0.0]])
    from_palm = {"near": np.zeros(3), "far": np.array([0.0, 0.0, 0.5])}
    tips = []
    for name, hand in (("near", near), ("far", far)):
        at_palm = np.array([[*from_palm[name], 1.0, 0.0, 0.0, 0.0]])
        wrist = compose(grasp, invert(at_palm))
        count = len(hand.joint_names)
        grasps = RobotGraspSet(
            object_name=np.array(["can"]),
            object_mass=np.array([0.3]),
            object_pose=obj,
            object_rest_pose=obj,
            hand=hand.name,
            joint_names=hand.joint_names,
            wrist_pose=wrist,
            joint_positions=np.zeros((1, count)),
            keypoints=np.zeros((1, len(hand.keypoint_names), 3)),
            link_contacts=np.zeros((1, len(hand.links)), dtype=bool),
        )
        fingers = np.zeros((1, len(hand.actuators)))
        start, target = StartPoses(hand, [model]).facing(
            grasps, np.zeros(1, dtype=int), obj, LiftProtocol.start_distance, fingers, np.zeros(1)
        )
        np.testing.assert_allclose(target, wrist)
        tips.append(compose(start, at_palm)[0, :3] - obj[0, :3])
    distance = np.linalg.norm(tips, axis=1)
    # The palm's own frame begins 9 cm before the bases, and the place that counts 15 cm.
    assert distance[0] == pytest.approx(0.30) and 0.2 < distance[1] < 0.30


def test_a_link_may_have_its_shapes_on_bodies_that_belong_to_it(tmp_path: Path):
    """Universal joints: the named link is a bare cross, the shapes are on the body behind its second axis."""
    hand, _ = added(tmp_path, odd_hand())
    text = hand.model_path.read_text()
    body = re.search(r'<body name="b2".*?>', text)
    assert body is not None
    split = (
        f'{body[0].replace("b2", "cross")}<inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/>'
    )
    split += '<joint name="turn" axis="1 0 0" range="-0.1 0.1"/><body name="b2">'
    text = text.replace(body[0], split)
    end = text.index("</body>", text.index('<body name="b3"'))
    end = text.index("</body>", end + 1)
    hand.model_path.write_text(text[:end] + "</body>" + text[end:])
    toml = hand.path.read_text().replace('"b2"', '"cross"')
    hand.path.write_text(toml + '"turn" = { kp = 1.0, kd = 0.03, force_limit = 0.3 }\n')
    assert not [f.message for f in check_hand_files(hand.path) if "no collision shape" in f.message]


def test_fingers_on_the_world_get_a_palm(tmp_path: Path):
    text = odd_hand().replace('<body name="p" >', "").replace("</body></worldbody>", "</worldbody>")
    (tmp_path / "bare.xml").write_text(text)
    findings = check_hand_files(tmp_path / "bare.xml")
    assert any("fingers stand on the world" in finding.message for finding in findings)
    hand, said = added(tmp_path, text)
    assert hand.palm == "palm" and len(hand.fingers) == 5
    assert any("5 fingers stand on the world" in message for message in said)
    assert added(tmp_path, text, palm="world")[0].palm == "palm"
    # The shapes of the world are the palm's.
    assert hand.model.geom_bodyid[0] == hand.model.body("palm").id


def test_a_link_called_world_may_be_the_palm(tmp_path: Path):
    box = '<collision><geometry><box size="0.01 0.01 0.02"/></geometry></collision>'
    parts = [f'<link name="world">{box}</link>']
    for letter, place in {"a": "0 0.03 0.05", "b": "0 0 0.05", "z": "0 0.05 -0.02"}.items():
        for i in (1, 2):
            turn = ' rpy="-0.9 0.4 -1.9"' if letter == "z" and i == 1 else ""
            parts.append(
                f'<link name="{letter}{i}">{box}</link><joint name="{letter}{i}_j" type="revolute">'
                f'<origin xyz="{place if i == 1 else "0 0 0.035"}"{turn}/>'
                f'<parent link="{"world" if i == 1 else f"{letter}1"}"/><child link="{letter}{i}"/>'
                '<axis xyz="0 1 0"/><limit lower="0" upper="1.4" effort="1" velocity="1"/></joint>'
            )
    hand, said = added(tmp_path, f'<robot name="h">{"".join(parts)}</robot>', ".urdf", side="right")
    assert hand.palm == "palm" and len(hand.fingers) == 3
    assert any("3 fingers stand on the link 'world'" in message for message in said)


def renamed(text: str, prefix: str) -> str:
    """All names with a prefix, references too."""
    return re.sub(r'((?:name|joint1|joint2)=")', rf"\g<1>{prefix}", text)


def middle_thumb(prefix: str) -> str:
    """Two fingers and a thumb that stands between them."""
    text = renamed(odd_hand(fingers=2), prefix).replace('pos="0.015 0.04 0.03"', 'pos="0.015 0.0235 0.03"')
    return re.sub(r'xyaxes="[^"]*"', 'xyaxes="0.7 0 -0.7 0 1 0"', text)


def test_the_side_is_that_of_the_names_below_the_palm(tmp_path: Path):
    """A robot with two hands, more of whose bodies are called right."""
    left = middle_thumb("left_").split("<worldbody>")[1].split("</worldbody>")[0]
    right = renamed(odd_hand(arm=True), "right_").split("<worldbody>")[1]
    head = odd_hand().split("<worldbody>")[0]
    hand, said = added(tmp_path, f"{head}<worldbody>{left}{right}", palm="left_p")
    assert hand.side == "left"
    assert any("taken as a left hand by its names" in message for message in said)
    # On a left hand the first finger lies on the other side.
    assert hand.fingers["index"].links[0] == "left_b1"


def test_a_side_that_contradicts_the_hand_is_doubted(tmp_path: Path):
    hand, said = added(tmp_path, odd_hand(left=True), side="right")
    assert hand.side == "right"
    assert any("stands where that of a left hand does; --side right is taken" in message for message in said)
    _, said = added(tmp_path, middle_thumb("left_"), side="right")
    assert any("the names say left hand; --side right is taken" in message for message in said)
    _, said = added(tmp_path, odd_hand(left=True), side="left")
    assert not any("--side" in message for message in said)


def with_torques(torques: dict[str, float]) -> str:
    limits = "".join(
        f'<motor joint="{joint}" forcelimited="true" forcerange="-{torque} {torque}"/>'
        for joint, torque in torques.items()
    )
    return odd_hand().replace("</mujoco>", f"<actuator>{limits}</actuator></mujoco>")


def test_torque_limits_are_judged_by_the_hand(tmp_path: Path):
    """A strong thumb is believed in a hand whose other limits are sound; a slip of a factor of 100 is not."""
    sound = {f"{letter}{i}_j": 0.5 for letter in "abcdz" for i in (1, 2)}
    hand, said = added(tmp_path, with_torques(sound | {"z1_j": 3.3}))
    assert hand.actuators["z1_j"].force_limit == pytest.approx(3.3)
    hand, said = added(tmp_path, with_torques(sound | {"z1_j": 60.0}))
    assert hand.actuators["z1_j"].force_limit < 2
    assert any(re.search(r"changed \[N m\]: z1_j 60 to 0\.\d+;", message) for message in said)
    hand, said = added(tmp_path, with_torques(dict.fromkeys(sound, 30.0)))
    assert hand.actuators["a1_j"].force_limit < 2
    assert any(
        "implausible torque limits were changed" in message and "and 4 more" in message for message in said
    )


def test_a_coupling_may_have_an_offset(tmp_path: Path):
    (given,) = parse_couplings(("a3_j=0.3+1.1*a2_j",))
    hand, said = added(tmp_path, odd_hand(), couplings=(given,))
    matrix, offset = hand.coupling
    row, column = hand.joint_names.index("a3_j"), list(hand.actuators).index("a2_j")
    assert matrix[row, column] == pytest.approx(1.1) and offset[row] == pytest.approx(0.3)
    # The driver turns as far as the one that it drives keeps its limits, -0.1 to 1.5.
    low, high = hand.joint_limits[hand.joint_names.index("a2_j")]
    assert low == pytest.approx(-0.1) and high == pytest.approx((1.5 - 0.3) / 1.1)
    assert any("a2_j -0.10 to 1.09, not -0.10 to 1.50" in message for message in said)
    assert parse_couplings(("j-2=1.0*j-1+3",)) == (("j-2", 1.0, "j-1+3", 0.0),)
    assert parse_couplings(("m = -0.7 - 1e-1*p",)) == (("m", -0.1, "p", -0.7),)
    with pytest.raises(FungraspError, match=r"OFFSET\+SLOPE\*DRIVER"):
        parse_couplings(("a=0.5+b",))


def with_rods(text: str, offset: float = 0.008) -> str:
    """The links a1 and a2 of ``odd_hand`` tied by a crossed rod on the palm, so that a2 follows a1."""
    rod = (
        f'<body name="rod" pos="{offset} 0.035 0.09"><joint name="rod_j" axis="0 1 0" range="-3 3"/>'
        f'<geom size="0.002" fromto="0 0 0.004 {-2 * offset} 0 0.041" contype="0" conaffinity="0" '
        'mass="0.01"/>'
        "</body>"
    )
    text = text.replace('<body name="a1"', f'{rod}<body name="a1"', 1)
    close = f'<connect name="loop" body1="rod" body2="a2" anchor="{-2 * offset} 0 0.045"/>'
    return text.replace("</mujoco>", f"<equality>{close}</equality></mujoco>")


def test_a_closed_loop_is_solved_into_couplings(tmp_path: Path):
    hand, said = added(tmp_path, with_rods(odd_hand()))
    assert list(hand.fingers) == ["index", "middle", "ring", "pinky", "thumb"]
    assert hand.fingers["index"].links == ("a1", "a2", "a3")
    assert not {"a2_j", "rod_j"} & set(hand.actuators) and "a1_j" in hand.actuators
    assert any("closed loop 'loop' was solved into couplings to 'a1_j'" in message for message in said)
    # The rod's end stays at its place on a2 where the hand moves.
    data = mujoco.MjData(hand.model)
    low, high = hand.joint_limits[hand.joint_names.index("a1_j")]
    assert low == pytest.approx(-0.1) and high > 0.9
    gaps = []
    for angle in np.linspace(low, high, 8):
        joints = np.zeros(len(hand.actuators))
        joints[list(hand.actuators).index("a1_j")] = angle
        data.qpos[:] = hand.all_joints(joints)
        mujoco.mj_kinematics(hand.model, data)
        ends = [
            data.body(name).xpos + data.body(name).xmat.reshape(3, 3) @ point
            for name, point in (("rod", [-0.016, 0, 0.045]), ("a2", [-0.008, 0, 0]))
        ]
        gaps.append(np.linalg.norm(ends[0] - ends[1]))
    assert max(gaps) < 0.004


def test_a_loop_with_several_motions_is_refused_in_a_line(tmp_path: Path):
    """The rod stands on another finger, so that two joints move it."""
    text = with_rods(odd_hand())
    rod = re.search(r'<body name="rod".*?</body>', text)
    assert rod is not None
    text = text.replace(rod[0], "").replace('<body name="b2"', rod[0] + '<body name="b2"', 1)
    with pytest.raises(
        FungraspError, match=r"the closed loop 'loop' leaves its \d joints \d degrees of freedom"
    ) as said:
        added(tmp_path, text)
    assert "--couple" in str(said.value) and "\n" not in str(said.value)
    # What the user ties is left alone.
    ties = parse_couplings(
        ("a2_j=1.0*a1_j", "rod_j=1.0*a1_j", "a1_j=1.0*b1_j", "a_s=1.0*b1_j", "b_s=1.0*b1_j")
    )
    assert "a2_j" not in added(tmp_path, text, couplings=ties)[0].actuators


def test_grippers_are_said_to_be_grippers(tmp_path: Path):
    jaw = '<body name="{0}" pos="0 {1} 0.05"><joint name="{0}_j" {2}/>'
    jaw += '<geom fromto="0 0 0 0 0 0.05" mass="0.1"/>{3}</body>'
    frame = '<mujoco><default><geom type="capsule" size="0.008"/></default><worldbody><body name="base">'
    frame += '<geom type="box" size="0.03 0.05 0.03" mass="0.3"/>{}</body></worldbody>{}</mujoco>'

    def gripper(joint: str, rest: str = "", tips: str = "") -> str:
        jaws = [
            jaw.format(name, y, joint, tips.format(name)) for name, y in (("left", 0.04), ("right", -0.04))
        ]
        return frame.format("".join(jaws), rest)

    sliding = gripper('type="slide" axis="0 1 0" range="0 0.04"')
    with pytest.raises(FungraspError, match=r"'left_j', 'right_j' slides, as in a gripper"):
        added(tmp_path, sliding)
    turning = 'axis="1 0 0" range="-1 1"'
    tie = '<equality><joint joint1="left_j" joint2="right_j" polycoef="0 -1 0 0 0"/></equality>'
    with pytest.raises(FungraspError, match="gripper: one motor moves its 2 joints"):
        added(tmp_path, gripper(turning, tie))
    tip = (
        '<body name="{0}_tip" pos="0 0 0.05"><joint name="{0}_k" axis="1 0 0" range="-1 1"/>'
        '<geom fromto="0 0 0 0 0 0.03" mass="0.1"/></body>'
    )
    with pytest.raises(FungraspError, match="gripper: its 4 joints are all parallel"):
        added(tmp_path, gripper(turning, tips=tip))
    one = frame.format(jaw.format("mover", 0.0, turning, ""), "")
    with pytest.raises(FungraspError, match="there is only one chain of joints, up to 'mover'"):
        added(tmp_path, one)


def test_a_frame_that_the_check_contradicts_ends_in_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "odd.xml").write_text(odd_hand())
    arguments = ["hands", "add", str(tmp_path / "odd.xml"), "--out", str(tmp_path / "out"), "--side", "right"]
    assert main([*arguments, "--normal", "-1", "0", "0"]) == 2
    said = capsys.readouterr().err
    assert "palm_frame.normal (--normal) points out of the back of the hand" in said
    assert not (tmp_path / "out").exists()


def test_fingers_that_are_bent_at_zero_are_no_contradiction(tmp_path: Path):
    """Straight at the lower limit; from zero, which is the fist, the middle pose lies backwards."""
    text = odd_hand()
    for letter in "abcdz":
        for i, length in ((1, 0.045), (2, 0.03)):
            name = f"{letter}{i + 1}"
            text = text.replace(
                f'<body name="{name}" pos="0 0 {length}">'
                f'<joint name="{name}_j" axis="0 1 0" range="-0.1 1.5"/>',
                f'<body name="{name}" pos="0 0 {length}" euler="0 1.4 0">'
                f'<joint name="{name}_j" axis="0 1 0" range="-1.5 0.1"/>',
            )
    assert text.count("euler") == 10
    hand, _ = added(tmp_path, text)
    assert not [f.message for f in check_hand_files(hand.path) if "palm_frame" in f.message]


def test_overlaps_are_said_once_for_a_pair_of_fingers(tmp_path: Path):
    hand, _ = added(tmp_path, odd_hand())
    # Thick links of two fingers lie in each other.
    text = hand.model_path.read_text()
    for name in ("a1", "a2", "a3", "b1", "b2", "b3"):
        text = re.sub(
            rf'(<body name="{name}".*?<geom size=")0.008', r"\g<1>0.0145", text, count=1, flags=re.DOTALL
        )
    hand.model_path.write_text(text)
    findings = [f.message for f in check_hand_files(hand.path) if "overlap" in f.message]
    assert len(findings) == 1
    assert "'a1' and 'b1'" in findings[0] and "'a3' and 'b3'" in findings[0] and "up to 6" in findings[0]


@pytest.mark.parametrize("closed", [True, False])
def test_fine_meshes_keep_their_shape(closed: bool):
    """Clustering of vertices has crumpled thin walls, and opened them."""
    # A bowl with a wall of 2 mm.
    outer = trimesh.creation.icosphere(subdivisions=5, radius=0.02)
    bowl = trimesh.boolean.difference(
        [
            outer,
            trimesh.creation.icosphere(subdivisions=5, radius=0.018),
            trimesh.creation.box(
                (0.1, 0.1, 0.02), transform=trimesh.transformations.translation_matrix([0, 0, 0.02])
            ),
        ],
        engine="manifold",
    )
    faces = bowl.faces if closed else np.delete(bowl.faces, 7, axis=0)
    vertices, triangles = coarse(
        np.asarray(bowl.vertices)[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    )
    assert len(faces) > 10000 and len(triangles) <= 4000
    mesh = trimesh.Trimesh(vertices, triangles)
    assert mesh.is_watertight
    there, back = (trimesh.sample.sample_surface(m, 40000, seed=0)[0] for m in (mesh, bowl))
    distances = KDTree(back).query(there)[0], KDTree(there).query(back)[0]
    # Samples lie up to 1 mm apart.
    assert max(d.max() for d in distances) < (0.002 if closed else 0.003)


def with_collada(folder: Path, data: str) -> str:
    """``odd_hand`` with one mesh, in a .dae file of this content."""
    (folder / "link.dae").write_text(data)
    text = odd_hand().replace("<worldbody>", '<asset><mesh name="m" file="link.dae"/></asset><worldbody>')
    return text.replace(
        '<body name="a3" pos="0 0 0.03">', '<body name="a3" pos="0 0 0.03"><geom type="mesh" mesh="m"/>'
    )


def test_meshes_that_cannot_be_read_say_why(tmp_path: Path):
    """A file is there, and what reads its format may not be."""
    _, said = added(tmp_path, with_collada(tmp_path, "<COLLADA/>"))
    assert not any("no file is found" in message for message in said)
    (reason,) = [message for message in said if "the mesh 'link.dae' can't be read" in message]
    assert find_spec("collada") is not None or 'pip install ".[collada]"' in reason


@pytest.mark.parametrize(
    ("asset", "size"),
    [
        ('<unit meter="0.001"/><up_axis>Z_UP</up_axis>', (0.01, 0.012, 0.03)),
        ('<unit meter="0.001"/><up_axis>Y_UP</up_axis>', (0.01, 0.03, 0.012)),
        (
            '<authoring_tool>MeshLab</authoring_tool><unit meter="0.001"/><up_axis>Y_UP</up_axis>',
            (0.01, 0.012, 0.03),
        ),
    ],
)
def test_collada_is_read_with_its_unit_and_axis(tmp_path: Path, asset: str, size: tuple[float, float, float]):
    pytest.importorskip("collada", reason="pycollada is not installed")
    box = trimesh.creation.box((10, 12, 30))
    places = " ".join(f"{value:g}" for value in np.asarray(box.vertices).ravel())
    corners = " ".join(str(corner) for corner in np.asarray(box.faces).ravel())
    content = f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
      <asset>{asset}</asset><library_geometries><geometry id="g"><mesh>
      <source id="p"><float_array id="a" count="24">{places}</float_array>
      <technique_common><accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
      <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
      <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
      <triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p></triangles>
      </mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node>
      <instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
      <scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
    _, said = added(tmp_path, with_collada(tmp_path, content))
    assert any("unit and the up axis that its .dae names" in message for message in said)
    vertices, _ = read_mesh(tmp_path / "link.dae")
    np.testing.assert_allclose(np.ptp(vertices, axis=0), size, atol=1e-6)


def test_the_folder_of_meshes_may_lie_above(tmp_path: Path):
    (tmp_path / "assets" / "more").mkdir(parents=True)
    (tmp_path / "mjcf").mkdir()
    trimesh.creation.box((0.01, 0.01, 0.02)).export(tmp_path / "assets" / "more" / "link.stl")
    text = odd_hand().replace(
        "<worldbody>", '<asset><mesh name="m" file="more/link.stl"/></asset><worldbody>'
    )
    text = text.replace("<compiler ", '<compiler meshdir="assets" ')
    text = text.replace(
        '<body name="a3" pos="0 0 0.03">', '<body name="a3" pos="0 0 0.03"><geom type="mesh" mesh="m"/>'
    )
    _, said = added(tmp_path / "mjcf", text)
    assert not any("no file is found" in message for message in said)


FOREIGN = Path(__file__).parents[3] / "shared" / "data" / "foreign" / "hands"

REFUSED = {
    "mimic-of-fixed": "index is 26 mm long.*mimics .index_proximal_joint., which is fixed: it is held",
    "mimic-of-missing": "mimics 'motor_not_here', which is no other joint: .*--couple 'index_distal_joint=",
    "names-contradict": "'index_1 by 6.28 rad'.*no joint of a finger turns so far",
    "wide-limits": "no joint of a finger turns so far; write its true limits",
}
"""Hands of others that are refused, with their reason."""

SAID = {
    "equality-curve": "follows a curve: replaced by the best line, with an error of up to 0.23 rad",
    "mesh-in-mm": "taken to be in millimeters",
    "motor-wheels": "turns by more than one revolution and carries no other body",
    "small-degree-limits": "taken as degrees",
    "stand": "'stand .1.35 m.' is fixed to the palm, but too far",
    "tendon-pair-limits": "lets 'index_1', 'index_2' move apart, and no motor",
    "inertia-huge": "is physically impossible",
}
MASS = {
    "mesh-density": 0.560,
    "mesh-geom-mass": 0.600,
    "total-mass": 1.0,
    "inertia-huge": 1.2,
    "motor-wheels": 0.54,
}
"""[kg], of the file; 0.48 for the others but two."""


@pytest.mark.skipif(not FOREIGN.is_dir(), reason="needs the hands of others in ../shared/data/foreign")
@pytest.mark.parametrize("name", sorted(path.name for path in FOREIGN.glob("*")))
def test_hands_of_others_are_right_or_refused(tmp_path: Path, capfd, name: str):
    files = [*(FOREIGN / name).rglob("*.urdf"), *(FOREIGN / name).rglob("hand.xml")]
    if name in REFUSED:
        with pytest.raises(FungraspError, match=REFUSED[name]):
            add_hand(files[0], tmp_path / "h", "h")
        assert not (tmp_path / "h").exists()
        return
    path, findings = add_hand(files[0], tmp_path / "h", "h")
    assert capfd.readouterr().err == ""
    assert not [f.message for f in findings if f.severity == "error"]
    said = " ".join(finding.message for finding in findings)
    assert re.search(SAID.get(name, ""), said)
    hand = load_hand(path)
    side = "left" if name == "mirrored-scale" else "right"
    assert hand.side == side and list(hand.fingers) == ["index", "middle", "ring", "thumb"]
    for finger, parts in hand.fingers.items():
        assert all(finger in link for link in parts.links) or name == "mirrored-scale"
    np.testing.assert_allclose(hand.palm_fingers, [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(hand.palm_normal, [1, 0, 0], atol=1e-6)
    mass = MASS.get(name, 0.48 if name != "inertia-unbalanced" else 0.408)
    assert hand.model.body_mass.sum() == pytest.approx(mass, abs=2e-3)
    assert np.ptp(hand.model.jnt_range, axis=1).max() < 2.5


def test_what_is_no_hand_is_refused_with_the_number(tmp_path: Path):
    """Masses in grams; a palm of a meter; nothing is written."""
    grams = odd_hand().replace(
        '<body name="p" >', '<body name="p" ><inertial pos="0 0 0" mass="228" diaginertia="1 1 1"/>'
    )
    with pytest.raises(FungraspError, match=r"weighs 22[89].* kg, not 0.01 to 5 kg"):
        added(tmp_path, grams)
    large = odd_hand().replace(
        '<body name="p" >', '<body name="p" ><geom type="box" size="0.5 0.5 0.5" mass="0.1"/>'
    )
    with pytest.raises(FungraspError, match=r"is 1\.\d* m large, more than 0.5 m"):
        added(tmp_path, large)
    assert not (tmp_path / "out").exists()


def test_the_palm_is_asked_for_before_meshes_are_read(tmp_path: Path, monkeypatch):
    two = renamed(odd_hand(), "a_").split("<worldbody>")[1].split("</worldbody>")[0]
    text = odd_hand().replace("</worldbody>", f"{two}</worldbody>")
    monkeypatch.setattr("fungrasp.hands.adding.model_file._take_meshes", lambda *_: pytest.fail("too late"))
    with pytest.raises(FungraspError, match="choose the palm with --palm"):
        added(tmp_path, text)

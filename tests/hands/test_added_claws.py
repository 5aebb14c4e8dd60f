"""``hands add``: fingers alike around a center, several hands in a file, angles without units, references."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from claws import claw
from odd_hands import odd_hand

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand, load_hand
from fungrasp.hands.adding.add_hand import Answers, add_hand
from fungrasp.hands.collisions import self_contact_words
from fungrasp.hands.kinematics import HandKinematics, partly_closed


def added(folder: Path, text: str, **answers) -> tuple[Hand, list[str]]:
    (folder / "odd.xml").write_text(text)
    path, findings = add_hand(folder / "odd.xml", folder / "out", answers=Answers(**answers), force=True)
    return load_hand(path), [finding.message for finding in findings]


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
    words = self_contact_words(hand.model, np.stack([0 * closed, closed]))
    assert words and "in 50 % of the grasps" in words[0] and "the pose of the grasp is the reason" in words[0]
    # Thick fingers meet at the zero pose already.
    spec = hand.spec()
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            geom.size[0] = 0.05
    words = self_contact_words(spec.compile(), np.zeros((1, 6)))
    assert any("at the zero pose already" in line and "<exclude body1=" in line for line in words)

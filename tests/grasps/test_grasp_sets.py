"""Grasp sets in memory: checks, rows, selections, joining."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import (
    HumanGrasp,
    HumanGraspSet,
    RobotGrasp,
    RobotGraspSet,
    builtin_grasps,
    load_grasps,
)
from fungrasp.hands import load_hand
from fungrasp.retargeting import retarget


def same(a, b) -> None:
    assert type(a) is type(b)
    for name in a.FIELDS:
        left, right = getattr(a, name), getattr(b, name)
        assert (left is None) == (right is None), name
        if left is not None:
            assert left.dtype.kind == right.dtype.kind
            np.testing.assert_array_equal(left, right, err_msg=name)
    if isinstance(a, RobotGraspSet):
        assert (a.hand, a.joint_names) == (b.hand, b.joint_names)
        assert set(a.extra) == set(b.extra)
        for name, value in a.extra.items():
            np.testing.assert_array_equal(value, b.extra[name])


def test_one_grasp_is_a_row(human_grasps, robot_grasps):
    humans, robots = human_grasps(4), robot_grasps(4)
    human, robot = humans[-1], robots[1]
    assert isinstance(human, HumanGrasp) and isinstance(robot, RobotGrasp)
    assert human.object_name == "object 1" and human.task == "task 3"
    np.testing.assert_array_equal(human.hand_joints, humans.hand_joints[3])
    np.testing.assert_array_equal(robot.joint_positions, robots.joint_positions[1])
    assert robot.extra["count"] == 1 and robot.joint_names == ("one", "two") and robot.task == ""
    assert [grasp.task for grasp in humans] == ["task 0", "task 1", "task 2", "task 3"]
    with pytest.raises(IndexError):
        humans[4]


@pytest.mark.parametrize("kind", ["human_grasps", "robot_grasps"])
def test_a_slice_is_a_set(kind, request):
    grasps = request.getfixturevalue(kind)(5)
    for which in (slice(1, 3), [1, 2], np.arange(5) % 3 > 0):
        same(grasps[which][:2], grasps.select([1, 2]))
    same(grasps[::-2], grasps.select([4, 2, 0]))
    assert len(grasps[5:]) == 0


@pytest.mark.parametrize("kind", ["human_grasps", "robot_grasps"])
def test_parts_joined_are_the_whole(kind, request):
    grasps = request.getfixturevalue(kind)(5)
    odd = np.arange(5) % 2 == 1
    parts = [grasps.select(odd), grasps.select([]), grasps.select(np.flatnonzero(~odd))]
    assert [len(part) for part in parts] == [2, 0, 3]
    joined = type(grasps).concatenate(parts)
    same(joined.select(np.argsort([1, 3, 0, 2, 4])), grasps)
    same(grasps.select(slice(1, 3)), grasps.select([1, -3]))


def test_selection_mistakes(human_grasps):
    grasps = human_grasps(3)
    for wrong, words in (([3], "outside"), ([True], "1 rows"), ([0.5], "float"), (2, "indices")):
        with pytest.raises(FungraspError, match=words):
            grasps.select(wrong)


def test_joining_keeps_what_all_have(human_grasps, robot_grasps):
    joined = HumanGraspSet.concatenate([human_grasps(2), human_grasps(2, hand_qpos=None)])
    assert joined.hand_qpos is None and len(joined) == 4
    first = robot_grasps(2)
    joined = RobotGraspSet.concatenate([first, robot_grasps(2, extra={"quality": np.zeros(2)})])
    assert set(joined.extra) == {"quality"}
    with pytest.raises(FungraspError, match="different hand: claw and paw"):
        RobotGraspSet.concatenate([first, robot_grasps(2, hand="paw")])
    with pytest.raises(FungraspError, match="no grasp sets"):
        RobotGraspSet.concatenate([])
    with pytest.raises(FungraspError, match="'keypoints' has shapes"):
        RobotGraspSet.concatenate([first, robot_grasps(1, keypoints=np.zeros((1, 4, 3)))])


def test_almost_unit_quaternions_are_made_unit(human_grasps):
    pose = human_grasps(3).object_pose
    pose[:, 3:] *= 1.0005
    fixed = human_grasps(3, object_pose=pose).object_pose
    np.testing.assert_allclose(np.linalg.norm(fixed[:, 3:], axis=1), 1, atol=1e-15)


def put(array, row, value):
    array = array.copy()
    array[row] = value
    return array


@pytest.mark.parametrize(
    ("field", "spoil", "words"),
    [
        ("object_mass", lambda a: put(a, 1, 0.0), "'object_mass', row 1 must be greater than 0: 0"),
        ("object_mass", lambda a: put(a, 1, np.nan), "row 1 is not finite"),
        ("object_mass", lambda a: a[:, None], r"shape \(3, 1\), expected \(N,\) with N = 3"),
        ("object_mass", lambda a: a.astype(str), "holds <U.*, expected numbers"),
        ("object_pose", lambda a: put(a, (2, 3), 2.0), "row 2 has a quaternion"),
        ("object_pose", lambda a: np.zeros((3, 7)), r"quaternion .* not of length 1: 0 \(and 2 more rows\)"),
        ("object_rest_pose", lambda a: put(a, (0, 0), np.inf), "'object_rest_pose', row 0 is not finite"),
        ("object_rest_pose", lambda a: a[:2], r"shape \(2, 7\), expected \(N, 7\) with N = 3"),
        ("hand_joints", lambda a: a[:, :20], r"shape \(3, 20, 3\), expected \(N, 21, 3\)"),
        ("hand_joints", lambda a: a * 1000, "row 0 is not a hand in m;"),
        ("hand_joints", lambda a: put(a, 1, 0.1), "row 1 has joints that coincide"),
        ("hand_joints", lambda a: put(a, 2, a[2] + 1.0), "row 2 is far from the object"),
        ("link_contacts", lambda a: a.astype(float), "holds float64, expected true/false"),
        ("object_name", lambda a: np.arange(3), "holds int64, expected text"),
        ("object_name", lambda a: np.array(["a", "../b", "c"]), "row 1 must be a plain name, not '../b'"),
        ("object_name", lambda a: np.array(["a", "b", ""]), "row 2 must be a plain name"),
        ("object_name", lambda a: np.array(["a", "b\nc", "d"]), r"row 1 must be a plain name, not 'b\\nc'"),
        ("task", lambda a: np.array(["", " ", "d"]), "row 1 must be a plain text, not ' '"),
        ("hand_qpos", lambda a: a[:, :50], r"shape \(3, 50\), expected \(N, 51\)"),
        ("task", lambda a: a[:1], r"'task' has shape \(1,\)"),
    ],
)
def test_spoiled_human_sets_are_named(human_grasps, field, spoil, words):
    good = getattr(human_grasps(3), field)
    with pytest.raises(FungraspError, match=words) as caught:
        human_grasps(3, **{field: spoil(good)})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hand": ""}, "'hand' is empty"),
        ({"joint_names": ("one",)}, "joint_positions.*M = 1"),
        ({"joint_names": ("one", "one")}, "twice"),
        ({"extra": {"x": np.zeros(2)}}, r"'extra/x' has shape \(2,\), expected \(3, ...\)"),
        ({"extra": {"x": np.array(["a"] * 3)}}, "'extra/x' holds"),
        ({"wrist_pose": np.array([[5.0, 0, 0, 1, 0, 0, 0]] * 3)}, "wrist_pose', row 0 is far"),
    ],
)
def test_spoiled_robot_sets_are_named(robot_grasps, changes, words):
    with pytest.raises(FungraspError, match=words):
        robot_grasps(3, **changes)


@pytest.mark.parametrize("kind", ["human_grasps", "robot_grasps"])
def test_single_grasps_make_the_set_again_and_carry_their_objects(kind, request, tmp_path):
    from fungrasp.objects import load_object

    model = load_object("mug")
    grasps = replace(request.getfixturevalue(kind)(3), objects={"mug": model})
    again = type(grasps).of(list(grasps))
    same(again, grasps)
    assert again.objects == grasps[1:].objects == grasps[0].objects == {"mug": model}
    assert again.digest == replace(grasps, objects={}).digest
    heavier = replace(grasps, objects={"mug": load_object("mug", 2 * model.mass)})
    with pytest.raises(FungraspError, match="'mug' stands for different objects"):
        type(grasps).concatenate([grasps, heavier])
    grasps.save(tmp_path / "set.npz")
    same(load_grasps(tmp_path / "set.npz"), grasps)


def test_joints_are_found_by_name(robot_grasps):
    robots = robot_grasps(2)
    one, two = robots.joint_positions[0].tolist()
    assert robots[0].joint_dict() == {"one": one, "two": two}
    np.testing.assert_array_equal(robots[0].joints_in_order(["two", "one"]), [two, one])
    np.testing.assert_array_equal(robots.joints_in_order(["two"]), robots.joint_positions[:, 1:])
    with pytest.raises(FungraspError, match=r"unknown joint 'tow'\. Did you mean 'two'"):
        robots[0].joints_in_order(["tow"])


def test_a_grasp_becomes_a_model_of_other_programs(tmp_path):
    human = builtin_grasps()[:1]
    grasp = retarget(human, hand="allegro", progress=False)[0]
    model = grasp.to_mjspec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
    mujoco.mj_kinematics(model, data)
    hand = load_hand("allegro")
    palm = data.body(hand.palm)
    np.testing.assert_allclose([*palm.xpos, *palm.xquat], grasp.wrist_pose, atol=1e-9)
    tip = hand.keypoint_names.index("ff_tip_centre")
    np.testing.assert_allclose(data.site("ff_tip_centre").xpos, grasp.keypoints[tip], atol=1e-6)
    assert grasp.to_urdf(tmp_path / "hand.urdf") == grasp.joint_dict()
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.urdf"))
    assert {written.joint(i).name for i in range(written.njnt)} == set(grasp.joint_names)

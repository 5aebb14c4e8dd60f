"""Files of human grasps in other conventions: recognised, explained, converted."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    inverse_transform_points,
    invert,
    quaternion_multiply,
    rotate,
    rotation_matrix,
)
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_human_grasps, load_objects, save_human_grasps
from fungrasp.grasps.anatomy import grouped
from fungrasp.grasps.conversion import Convention, mend_below_table
from fungrasp.grasps.diagnosis import checked_grasps, diagnosis
from fungrasp.grasps.human_hand import ORDERS
from fungrasp.grasps.scene_checks import rows_in_words
from fungrasp.objects.object_variants import scaled_object
from fungrasp.retargeting import retarget

HALF = np.sqrt(0.5)

FORTH = [0, 1, 2, 4, 5, 6, 3]
"""A wxyz pose written as xyzw."""


def fields(grasps: HumanGraspSet) -> dict[str, Any]:
    return {name: getattr(grasps, name) for name in grasps.FIELDS if getattr(grasps, name) is not None}


def foreign(kind: str) -> dict[str, Any]:
    """The built-in grasps as others would write them."""
    arrays = fields(builtin_grasps())
    if kind in ORDERS:
        arrays["hand_joints"] = arrays["hand_joints"][:, np.argsort(ORDERS[kind])]
    if kind in ("mm", "cm"):
        scale = {"mm": 1000.0, "cm": 100.0}[kind]
        arrays["hand_joints"] = arrays["hand_joints"] * scale
        for name in ("object_pose", "object_rest_pose"):
            arrays[name] = arrays[name] * ([scale] * 3 + [1.0] * 4)
    if kind == "left":
        arrays["hand_joints"] = arrays["hand_joints"] * [1, -1, 1]
    poses = ("object_pose", "object_rest_pose")
    if kind == "xyzw":
        arrays |= {name: arrays[name][:, FORTH] for name in poses}
    if kind == "transposed":
        arrays |= {name: arrays[name] * [1, 1, 1, 1, -1, -1, -1] for name in poses}
    if kind == "inverted":
        arrays |= {name: invert(arrays[name]) for name in poses}
    if kind == "object in mm":
        arrays |= {name: arrays[name] * ([1000.0] * 3 + [1.0] * 4) for name in poses}
    if kind == "joints in object":
        arrays["hand_joints"] = inverse_transform_points(arrays["object_pose"], arrays["hand_joints"])
    turns = {"y up": [HALF, -HALF, 0.0, 0.0], "z down": [0.0, -1.0, 0.0, 0.0]}
    if kind in turns:
        turn = np.array(turns[kind])
        arrays["hand_joints"] = rotate(turn, arrays["hand_joints"])
        for name in poses:
            turned = quaternion_multiply(turn, arrays[name][:, 3:])
            arrays[name] = np.concatenate([rotate(turn, arrays[name][:, :3]), turned], axis=1)
    if kind == "high table":
        up = np.array([0.0, 0.0, 0.7])
        arrays["hand_joints"] = arrays["hand_joints"] + up
        arrays |= {name: arrays[name] + [0, 0, 0.7, 0, 0, 0, 0] for name in poses}
    if kind == "wrist relative":
        arrays["hand_joints"] = arrays["hand_joints"] - arrays["hand_joints"][:, :1]
    if kind == "shuffled":
        arrays["hand_joints"] = arrays["hand_joints"][:, np.random.default_rng(0).permutation(21)]
    return arrays


def turned(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same scenes, each turned by another angle about the vertical: what turns stand for shows."""
    angle = np.linspace(0.6, 2.4, len(arrays["object_name"]))
    turn = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    result = dict(arrays) | {"hand_joints": rotate(turn[:, None], arrays["hand_joints"])}
    for name in ("object_pose", "object_rest_pose"):
        rotation = quaternion_multiply(turn, arrays[name][:, 3:])
        result[name] = np.concatenate([rotate(turn, arrays[name][:, :3]), rotation], axis=1)
    result.pop("hand_qpos", None)
    return result


@pytest.mark.parametrize("count", [120, 20])
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("transposed", "--rotation transposed"),
        ("inverted", "--pose world-in-object"),
        ("object in mm", "--object-unit mm"),
        ("joints in object", "--joints-frame object"),
        ("y up", "--up y"),
        ("high table", "--table-height 0.7"),
        ("xyzw", "--quaternion xyzw"),
    ],
)
def test_what_fingers_and_table_tell_has_a_remedy_that_works(
    tmp_path, capsys, monkeypatch, kind, options, count
):
    right = turned(fields(builtin_grasps().select(np.arange(0, 120, 120 // count)[:count])))
    rows: dict[str, Any] = right
    monkeypatch.setitem(globals(), "builtin_grasps", lambda: HumanGraspSet(**rows))
    arrays = foreign(kind)
    np.savez(tmp_path / "x.npz", **arrays)
    _, out = run(capsys, "check", tmp_path / "x.npz")
    assert f"fungrasp grasps convert {tmp_path / 'x.npz'} {options} --out" in out
    run(capsys, "convert", tmp_path / "x.npz", *options.split(), "--out", tmp_path / "y.npz")
    found = load_human_grasps(tmp_path / "y.npz")
    np.testing.assert_allclose(found.hand_joints, right["hand_joints"], atol=1e-6)
    np.testing.assert_allclose(
        rotation_matrix(found.object_pose[:, 3:]), rotation_matrix(right["object_pose"][:, 3:]), atol=1e-6
    )
    np.testing.assert_allclose(found.object_pose[:, :3], right["object_pose"][:, :3], atol=1e-6)
    with pytest.raises(FungraspError, match=r"fit only if .*Convention\("):
        checked_grasps(arrays, load_objects(found), read=True)


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("wrist relative", "relative to the wrist: the wrist position in the world is missing"),
        ("shuffled", "in no known order"),
    ],
)
def test_what_has_no_remedy_is_refused_with_its_reason(tmp_path, capsys, kind, reason):
    np.savez(tmp_path / "x.npz", **foreign(kind))
    out = run(capsys, "check", tmp_path / "x.npz")[1]
    assert reason in out and "to convert" not in out and "--mirror" not in out
    with pytest.raises(FungraspError, match=reason):
        load_human_grasps(tmp_path / "x.npz")


def run_command(capsys, *arguments: object) -> tuple[int, str]:
    try:
        status = main([*map(str, arguments)])
    except SystemExit as ended:
        status = int(ended.code or 0)
    captured = capsys.readouterr()
    return status, captured.out + captured.err


def run(capsys, *arguments: object) -> tuple[int, str]:
    return run_command(capsys, "grasps", *arguments)


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        ("openpose", "--joint-order openpose"),
        ("mano", "--joint-order mano"),
        ("mm", "--unit mm"),
        ("cm", "--unit cm"),
        ("left", "--side left"),
        ("z down", "--up -z"),
    ],
)
def test_other_conventions_are_refused_on_loading_with_their_remedy(tmp_path, capsys, kind, option):
    arrays = foreign(kind)
    np.savez(tmp_path / "x.npz", **arrays)
    with pytest.raises(FungraspError, match=f"grasps 0, 1, 2.*convert .*x.npz {option} --out"):
        load_human_grasps(tmp_path / "x.npz")
    status, out = run(capsys, "check", tmp_path / "x.npz")
    assert status == 1 and f"to convert: fungrasp grasps convert {tmp_path / 'x.npz'} {option} " in out
    status, out = run(capsys, "convert", tmp_path / "x.npz", *option.split(), "--out", tmp_path / "y.npz")
    assert status == 0
    if kind != "left":
        found = load_human_grasps(tmp_path / "y.npz")
        np.testing.assert_allclose(found.hand_joints, builtin_grasps().hand_joints, atol=1e-9)
        np.testing.assert_allclose(found.object_pose, builtin_grasps().object_pose, atol=1e-9)


def test_good_grasps_are_not_complained_about(tmp_path, capsys, caplog):
    save_human_grasps(tmp_path / "x.npz", builtin_grasps())
    status, out = run(capsys, "check", tmp_path / "x.npz")
    assert status == 0 and out.endswith("120 usable grasps\n") and out.count("\n") == 1
    load_human_grasps(tmp_path / "x.npz")
    assert not caplog.records


@pytest.mark.parametrize("how", ["keep", "lift", "drop"])
def test_hands_below_the_table(how):
    grasps = builtin_grasps().select([0, 1, 2])
    down = np.zeros((3, 1, 3))
    down[1, 0, 2] = grasps.hand_joints[1, :, 2].min() + 0.03
    sunk = replace(grasps, hand_joints=grasps.hand_joints - down)
    found = mend_below_table(sunk, how)
    if how == "drop":
        np.testing.assert_array_equal(found.hand_joints, sunk.hand_joints[[0, 2]])
    else:
        lowest = found.hand_joints[..., 2].min(axis=1)
        assert lowest[1] == pytest.approx(-0.03 if how == "keep" else 0.0, abs=1e-12)
        rise = found.object_pose[:, 2] - sunk.object_pose[:, 2]
        np.testing.assert_allclose(rise, [0, 0.03 * (how == "lift"), 0], atol=1e-12)


def test_repeated_findings_are_one_line():
    findings = [
        f"grasp {i} (can): the bone from a to b is {90 + i} mm long, not 30 to 60 mm" for i in range(9)
    ]
    assert grouped([*findings, "grasp 2 (can): thumb_ip is bent 99 degrees, not 80"]) == [
        findings[0] + "; likewise in grasps 1, 2, 3, 4, 5, 6 and 2 more",
        "grasp 2 (can): thumb_ip is bent 99 degrees, not 80",
    ]
    assert rows_in_words(np.array([3])) == "grasp 3"
    assert diagnosis({"hand_joints": np.zeros((0, 21, 3))}, {}).remarks == ()


def test_selecting_grasps(tmp_path, capsys, robot_grasps):
    from fungrasp.grasps import load_robot_grasps, save_robot_grasps

    extra = {"force_closure_residual": np.array([0.3, 0.1, np.nan, 0.2]), "other": np.arange(4.0)}
    save_robot_grasps(tmp_path / "r.npz", robot_grasps(4, extra=extra))
    _, out = run(capsys, "select", tmp_path / "r.npz", "--best", "0.5", "--out", tmp_path / "s.npz")
    assert "2 of 4 grasps" in out
    np.testing.assert_array_equal(load_robot_grasps(tmp_path / "s.npz").extra["other"], [1, 3])
    _, out = run(
        capsys, "select", tmp_path / "r.npz", "--by", "othr", "--best", "0.5", "--out", tmp_path / "s"
    )
    assert "Did you mean 'other'?" in out
    save_robot_grasps(tmp_path / "r.npz", robot_grasps(4, extra={}))
    _, out = run(capsys, "select", tmp_path / "r.npz", "--best", "0.5", "--out", tmp_path / "s")
    assert "Known: none. 'fungrasp retarget' writes the static quality" in out
    _, out = run(capsys, "select", "builtin", "--objects", "mug", "--out", tmp_path / "m.npz")
    assert set(load_human_grasps(tmp_path / "m.npz").object_name) == {"mug"}
    _, out = run(capsys, "select", "builtin", "--rows", "0::3", "1", "--out", tmp_path / "m.npz")
    assert out.endswith("41 of 120 grasps\n")
    first = builtin_grasps().select([0, 1, 3])
    np.testing.assert_array_equal(load_human_grasps(tmp_path / "m.npz").hand_joints[:3], first.hand_joints)
    for rows in ("120", "3-5", "0:9:0"):
        assert "--rows" in run(capsys, "select", "builtin", "--rows", rows, "--out", tmp_path / "s")[1]
    other = ("--objects", "drill", "--tasks", "drink")
    assert "none of" in run(capsys, "select", "builtin", *other, "--out", tmp_path / "s")[1]


def test_what_could_not_be_tested_is_said(tmp_path, capsys):
    arrays = foreign("inverted")
    arrays["object_name"] = np.full(120, "my_cup")
    np.savez(tmp_path / "x.npz", **arrays)
    _, out = run(capsys, "check", tmp_path / "x.npz", "--json")
    answer = json.loads(out)
    assert not answer["usable"] and "my_cup" in answer["untested"][0]
    assert "not tested" in run(capsys, "check", tmp_path / "x.npz")[1]


def test_one_wrong_row_is_no_remedy_for_all():
    arrays = foreign("fungrasp")
    arrays["object_pose"] = arrays["object_pose"].copy()
    arrays["object_pose"][7, 3:] = [0, 1, 0, 0]
    found = diagnosis(arrays, load_objects(builtin_grasps()))
    assert found.fatal is None and not found.convention.changes


@pytest.mark.parametrize("given", ["all false", "no field"])
def test_missing_contacts_and_rest_poses_are_computed(tmp_path, caplog, given):
    arrays = foreign("fungrasp")
    wanted = arrays.pop("link_contacts")
    rest = arrays.pop("object_rest_pose")
    if given == "all false":
        arrays["link_contacts"] = np.zeros_like(wanted)
    np.savez(tmp_path / "x.npz", **arrays)
    found = load_human_grasps(tmp_path / "x.npz")
    assert found.link_contacts.any(axis=1).all()
    assert (found.link_contacts == wanted).mean() > 0.85
    np.testing.assert_allclose(found.object_rest_pose[:, 2], rest[:, 2], atol=2e-3)
    arrays["object_name"] = np.full(120, "my_cup")
    np.savez(tmp_path / "x.npz", **arrays)
    with pytest.raises(FungraspError, match=r"'object_rest_pose' is missing .*convert --objects"):
        load_human_grasps(tmp_path / "x.npz")


FOREIGN = Path(__file__).parents[3] / "shared" / "data" / "foreign" / "files"

TABLE = {
    "joints_in_object_frame": "--joints-frame object",
    "joints_normalised": "relative to the wrist, and in no unit",
    "left_hand_plain": "--side left",
    "no_contacts": "usable grasps",
    "object_in_mm": "--object-unit mm",
    "order_frankmocap": "--joint-order frankmocap",
    "order_interhand": "--joint-order interhand",
    "order_mano_fingers": "--joint-order mano-fingers",
    "order_openpose": "--joint-order openpose",
    "order_tip_to_base": "--joint-order tip-first",
    "pose_inverted": "--pose world-in-object",
    "rest_is_held": "--table-height 0.25",
    "rotation_transposed": "--rotation transposed",
    "turned_right": "usable grasps",
    "unit_dm": "--unit dm",
    "unknown_object": "not tested: whether fingers touch",
    "world_camera": "--up -y --table-height",
    "world_opengl": "--up y --table-height",
    "world_y_up": "--up y",
    "wrist_relative": "relative to the wrist",
}
"""What ``check`` says of each grasp file of others."""


@pytest.mark.skipif(not FOREIGN.is_dir(), reason="needs the files of others in ../shared/data/foreign")
@pytest.mark.parametrize("name", TABLE)
def test_grasp_files_of_others(tmp_path, capsys, name):
    path = FOREIGN / name / "grasps.npz"
    _, out = run(capsys, "check", path)
    assert TABLE[name] in out
    if "to convert: " not in out:
        return
    options = out.split(f"convert {path} ")[1].split(" --out")[0].split()
    run(capsys, "convert", path, *options, "--out", tmp_path / "y.npz")
    assert "usable grasps" in run(capsys, "check", tmp_path / "y.npz")[1]
    if name != "left_hand_plain":  # Retargeting takes some of a second.
        assert (
            run_command(capsys, "retarget", "--grasps", tmp_path / "y.npz", "--out", tmp_path / "r.npz")[0]
            == 0
        )


@pytest.mark.skipif(not FOREIGN.is_dir(), reason="needs the files of others in ../shared/data/foreign")
def test_a_mesh_with_a_piece_of_the_table_is_not_blamed_on_quaternions(tmp_path, capsys):
    mugs = builtin_grasps().select(np.flatnonzero(builtin_grasps().object_name == "mug"))
    save_human_grasps(tmp_path / "mugs.npz", mugs)
    _, out = run(capsys, "check", tmp_path / "mugs.npz", "--objects", FOREIGN / "mesh_table_included")
    assert "quaternion" not in out and "to convert" not in out
    assert "not tested: in which convention the poses of mug are" in out


def test_meshes_of_an_odd_size_tell_no_convention():
    arrays, objects = foreign("xyzw"), load_objects(builtin_grasps())
    assert diagnosis(arrays, objects).convention.quaternion == "xyzw"
    tiny = {name: scaled_object(model, 0.05) for name, model in objects.items()}
    found = diagnosis(arrays, tiny)
    assert found.convention == Convention() and "odd size" in found.untested[0]
    assert any("that the mesh fits" in remark.words for remark in found.remarks)
    # The others tell it where only one is doubted.
    some = objects | {"mug": tiny["mug"]}
    assert diagnosis(arrays, some).convention.quaternion == "xyzw"


def written(path, **changes):
    """The built-in grasps of the mug in a file, with other fields."""
    mugs = builtin_grasps().select(np.flatnonzero(builtin_grasps().object_name == "mug"))
    mugs.save(path)
    np.savez(path, **{**np.load(path), **changes})
    return path, mugs


def test_masses_in_grams_are_refused(tmp_path, capsys):
    path, mugs = written(tmp_path / "x.npz")
    written(path, object_mass=1e3 * mugs.object_mass)
    status, out = run(capsys, "check", path)
    assert status == 2 and "is the mass in grams?" in out
    with pytest.raises(FungraspError, match="is the mass in grams"):
        retarget(load_human_grasps(path))


def test_contacts_of_links_far_from_the_object_are_doubted(tmp_path, capsys):
    path, mugs = written(tmp_path / "x.npz")
    written(path, link_contacts=np.ones_like(mugs.link_contacts))
    assert "are the contacts in the order of HUMAN_LINKS" in run(capsys, "check", path)[1]


def test_unusable_rows_are_not_counted_and_one_grasp_is_no_set(tmp_path, capsys, caplog):
    path, mugs = written(tmp_path / "x.npz")
    joints = mugs.hand_joints.copy()
    joints[0] *= [1, -1, 1]
    written(path, hand_joints=joints)
    status, out = run(capsys, "check", path)
    assert status == 0 and f"{len(mugs) - 1} of {len(mugs)} usable grasps" in out
    assert len(load_human_grasps(path)) == len(mugs)
    assert "grasp 0: the fingers bend backwards" in caplog.text
    written(path, object_name=np.array("mug"))
    assert "field 'object_name' has shape ()" in run(capsys, "check", path)[1]

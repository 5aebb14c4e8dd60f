"""Files of human grasps in other conventions: recognised, explained, converted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_human_grasps, save_human_grasps
from fungrasp.grasps.conversion import converted, mend_below_table
from fungrasp.grasps.diagnosis import grouped, hand_remarks, rows_in_words
from fungrasp.grasps.human_hand import ORDERS

FORTH = [0, 1, 2, 4, 5, 6, 3]
"""A wxyz pose written as xyzw."""


def fields(grasps: HumanGraspSet) -> dict[str, np.ndarray]:
    return {name: getattr(grasps, name) for name in grasps.FIELDS if getattr(grasps, name) is not None}


def foreign(kind: str) -> dict[str, np.ndarray]:
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
    if kind == "xyzw":
        arrays |= {name: arrays[name][:, FORTH] for name in ("object_pose", "object_rest_pose")}
    return arrays


def run(capsys, *arguments: object) -> tuple[int, str]:
    status = main(["grasps", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        ("openpose", "--joint-order openpose"),
        ("mano", "--joint-order mano"),
        ("mm", "--unit mm"),
        ("cm", "--unit cm"),
        ("left", "--side left"),
    ],
)
def test_other_conventions_are_refused_on_loading_with_their_remedy(tmp_path, capsys, kind, option):
    arrays = foreign(kind)
    np.savez(tmp_path / "x.npz", **arrays)
    with pytest.raises(FungraspError, match=f"grasps 0, 1, 2.*convert .*x.npz {option} --out"):
        load_human_grasps(tmp_path / "x.npz")
    status, out = run(capsys, "check", tmp_path / "x.npz")
    assert status == 0 and f"to convert: fungrasp grasps convert {tmp_path / 'x.npz'} {option} " in out
    status, out = run(capsys, "convert", tmp_path / "x.npz", *option.split(), "--out", tmp_path / "y.npz")
    assert status == 0
    if kind != "left":
        found = load_human_grasps(tmp_path / "y.npz")
        np.testing.assert_allclose(found.hand_joints, builtin_grasps().hand_joints, atol=1e-9)
        np.testing.assert_allclose(found.object_pose, builtin_grasps().object_pose, atol=1e-9)


def test_quaternions_in_another_order_are_seen_by_what_the_fingers_touch(tmp_path, capsys):
    np.savez(tmp_path / "x.npz", **foreign("xyzw"))
    _, out = run(capsys, "check", tmp_path / "x.npz")
    assert "only if quaternions are xyzw" in out and "--quaternion xyzw" in out
    back = converted(foreign("xyzw"), quaternion="xyzw")
    np.testing.assert_allclose(back["object_pose"], builtin_grasps().object_pose)


def test_good_grasps_are_not_complained_about(tmp_path, capsys, caplog):
    save_human_grasps(tmp_path / "x.npz", builtin_grasps())
    status, out = run(capsys, "check", tmp_path / "x.npz")
    assert status == 0 and out.endswith("120 grasps that can be used\n") and out.count("\n") == 1
    load_human_grasps(tmp_path / "x.npz")
    assert not caplog.records


def test_single_rows_are_named_and_loaded(tmp_path, caplog):
    arrays = foreign("fungrasp")
    arrays["hand_joints"] = arrays["hand_joints"].copy()
    arrays["hand_joints"][7] *= [1, -1, 1]
    np.savez(tmp_path / "x.npz", **arrays)
    assert len(load_human_grasps(tmp_path / "x.npz")) == 120
    assert "grasp 7: the fingers bend backwards" in caplog.text


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
    assert hand_remarks(np.zeros((0, 21, 3))) == []


def test_selecting_grasps(tmp_path, capsys, robot_grasps):
    from fungrasp.grasps import load_grasps, save_robot_grasps

    extra = {"force_closure_residual": np.array([0.3, 0.1, np.nan, 0.2]), "other": np.arange(4.0)}
    save_robot_grasps(tmp_path / "r.npz", robot_grasps(4, extra=extra))
    _, out = run(capsys, "select", tmp_path / "r.npz", "--best", "0.5", "--out", tmp_path / "s.npz")
    assert "2 of 4 grasps" in out
    np.testing.assert_array_equal(load_grasps(tmp_path / "s.npz").extra["other"], [1, 3])
    _, out = run(
        capsys, "select", tmp_path / "r.npz", "--by", "othr", "--best", "0.5", "--out", tmp_path / "s"
    )
    assert "Did you mean 'other'?" in out
    _, out = run(capsys, "select", "builtin", "--objects", "mug", "--out", tmp_path / "m.npz")
    assert set(load_human_grasps(tmp_path / "m.npz").object_name) == {"mug"}
    _, out = run(capsys, "select", "builtin", "--rows", "0::3", "1", "--out", tmp_path / "m.npz")
    assert out.endswith("41 of 120 grasps\n")
    first = builtin_grasps().select([0, 1, 3])
    np.testing.assert_array_equal(load_grasps(tmp_path / "m.npz").hand_joints[:3], first.hand_joints)
    for rows in ("120", "3-5", "0:9:0"):
        assert "--rows" in run(capsys, "select", "builtin", "--rows", rows, "--out", tmp_path / "s")[1]
    other = ("--objects", "drill", "--tasks", "drink")
    assert "none of" in run(capsys, "select", "builtin", *other, "--out", tmp_path / "s")[1]

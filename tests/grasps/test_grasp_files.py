"""Grasp files: what is written is read again; bad files get one line that names the thing."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from test_grasp_sets import same

import fungrasp.grasps.grasp_files as files
from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import is_plain_name
from fungrasp.grasps import (
    HumanGraspSet,
    builtin_grasps,
    load_grasps,
    load_human_grasps,
    load_robot_grasps,
    save_human_grasps,
    save_robot_grasps,
)

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared"
DEXYCB = SHARED / "data" / "dexycb_train.npz"

names = st.text(
    st.characters(exclude_characters="/\\\0", exclude_categories=("Cs",)), min_size=1, max_size=20
)
plain = names.filter(is_plain_name)
numbers = st.floats(-1e6, 1e6)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), count=st.integers(1, 4), single=st.booleans())
def test_human_sets_survive(tmp_path, human_grasps, data, count, single):
    grasps = human_grasps(
        count,
        seed=data.draw(st.integers(0, 100)),
        object_name=np.array(data.draw(st.lists(plain, min_size=count, max_size=count))),
        task=data.draw(st.none() | st.lists(plain, min_size=count, max_size=count).map(np.array)),
        hand_qpos=data.draw(st.none() | hnp.arrays(np.float64, (count, 51), elements=numbers)),
    )
    if single:
        parts = {name: getattr(grasps, name) for name in grasps.FIELDS}
        short = {
            k: v.astype(np.float32) if v is not None and v.dtype == float else v for k, v in parts.items()
        }
        grasps = HumanGraspSet(**short)
    save_human_grasps(tmp_path / "g.npz", grasps)
    same(load_human_grasps(tmp_path / "g.npz"), grasps)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), count=st.integers(1, 4), joints=st.integers(0, 5))
def test_robot_sets_survive(tmp_path, robot_grasps, data, count, joints):
    anything = st.floats(allow_nan=True, allow_infinity=True)
    grasps = robot_grasps(
        count,
        joint_names=data.draw(st.lists(names, min_size=joints, max_size=joints, unique=True)),
        joint_positions=data.draw(hnp.arrays(np.float64, (count, joints), elements=numbers)),
        extra={
            "settings": data.draw(hnp.arrays(np.float64, (count, 3), elements=anything)),
            "tries": data.draw(hnp.arrays(np.int64, count)),
            "held": data.draw(hnp.arrays(bool, count)),
        },
    )
    save_robot_grasps(tmp_path / "r.npz", grasps)
    again = load_robot_grasps(tmp_path / "r.npz")
    same(again, grasps)
    assert {name: value.dtype for name, value in again.extra.items()} == {
        name: value.dtype for name, value in grasps.extra.items()
    }


def test_same_set_same_bytes_and_any_suffix(tmp_path, human_grasps):
    for name in ("a.npz", "b"):
        save_human_grasps(tmp_path / name, human_grasps(2))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"a.npz", "b"}


def test_singles_are_kept_short(tmp_path, human_grasps):
    exact = human_grasps(3)
    save_human_grasps(tmp_path / "g.npz", HumanGraspSet.concatenate([exact]))
    with np.load(tmp_path / "g.npz") as data:
        assert data["object_mass"].dtype == np.float64 and int(data["version"]) == 1
    save_human_grasps(tmp_path / "g.npz", human_grasps(3, object_mass=np.array([0.5, 1.0, 2.0])))
    with np.load(tmp_path / "g.npz") as data:
        assert data["object_mass"].dtype == np.float32


def test_kinds_are_told_apart(tmp_path, human_grasps, robot_grasps):
    save_human_grasps(tmp_path / "h.npz", human_grasps())
    save_robot_grasps(tmp_path / "r.npz", robot_grasps())
    with pytest.raises(FungraspError, match=r"r\.npz holds robot grasps \(of the hand 'claw'\)"):
        load_human_grasps(tmp_path / "r.npz")
    with pytest.raises(FungraspError, match=r"h\.npz holds human grasps, robot grasps are needed"):
        load_robot_grasps(tmp_path / "h.npz")
    same(load_grasps(tmp_path / "h.npz"), human_grasps())
    same(load_grasps(tmp_path / "r.npz"), robot_grasps())


def write(path: Path, grasps: HumanGraspSet, **changes: object) -> Path:
    fields = {name: getattr(grasps, name) for name in grasps.FIELDS} | changes
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hand_joints": None}, "field 'hand_joints' is missing; found: hand_qpos, link_contacts"),
        ({"object_mass": np.ones(2)}, r"field 'object_mass' has shape \(2,\), expected \(N,\) with N = 3"),
        ({"object_pose": np.zeros((3, 7))}, "field 'object_pose', row 0 has a quaternion"),
        ({"task": np.array([None] * 3)}, "field 'task' holds Python objects; only numbers"),
        ({"version": 2}, "file version 2, this fungrasp reads versions up to 1"),
        ({"version": "x"}, "file version x"),
    ],
)
def test_bad_fields_name_the_file(tmp_path, human_grasps, changes, words):
    path = write(tmp_path / "bad.npz", human_grasps(3), **changes)
    with pytest.raises(FungraspError, match=rf"bad\.npz.*{words}"):
        load_human_grasps(path)


def test_no_version_and_bytes_for_text_are_read(tmp_path, human_grasps):
    grasps = human_grasps(3)
    path = write(tmp_path / "old.npz", grasps, object_name=grasps.object_name.astype("S"), task=None)
    assert load_human_grasps(path).object_name.tolist() == grasps.object_name.tolist()
    assert load_human_grasps(path).task.tolist() == ["", "", ""]


def test_bad_files(tmp_path, human_grasps):
    save_human_grasps(tmp_path / "good.npz", human_grasps(20))
    whole = (tmp_path / "good.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0xFF
    (tmp_path / "flipped.npz").write_bytes(flipped)
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as archive:
        archive.writestr("hand_joints.npy", b"nonsense")
    for name, words in (
        ("missing.npz", "does not exist"),
        (".", "is a folder"),
        ("cut.npz", "not an .npz file, or one that is cut short"),
        ("flipped.npz", "can't be read"),
        ("text.npz", "not an .npz file"),
        ("empty.npz", "not an .npz file"),
        ("array.npy", "not an .npz file"),
        ("zip.npz", "field 'hand_joints' can't be read: not a NumPy array"),
    ):
        with pytest.raises(FungraspError, match=words) as caught:
            load_human_grasps(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_empty_sets_are_not_exchanged(tmp_path, human_grasps):
    nothing = human_grasps(3).select([])
    with pytest.raises(FungraspError, match="no grasps to write"):
        save_human_grasps(tmp_path / "g.npz", nothing)
    assert not any(tmp_path.iterdir())
    with pytest.raises(FungraspError, match="holds no grasps"):
        load_human_grasps(write(tmp_path / "g.npz", nothing))


def test_builtin_is_a_name(tmp_path, human_grasps, monkeypatch):
    monkeypatch.setattr(files, "BUILTIN_PATH", tmp_path / "none.npz")
    with pytest.raises(FungraspError, match="lacks the built-in human grasps"):
        builtin_grasps()
    save_human_grasps(tmp_path / "none.npz", human_grasps(2))
    same(load_human_grasps("builtin"), human_grasps(2))
    same(load_grasps("builtin"), human_grasps(2))


@pytest.mark.skipif(not DEXYCB.is_file(), reason="the shared DexYCB grasps are not here")
def test_real_grasps_are_read_and_survive(tmp_path):
    grasps = load_human_grasps(DEXYCB)
    assert len(grasps) == 375 and len(set(grasps.object_name.tolist())) == 20
    save_human_grasps(tmp_path / "g.npz", grasps)
    same(load_human_grasps(tmp_path / "g.npz"), grasps)
    with np.load(DEXYCB) as data:
        np.testing.assert_array_equal(grasps.hand_joints, data["hand_joints"])
        np.testing.assert_allclose(grasps.object_pose, data["object_pose"], atol=1e-6)

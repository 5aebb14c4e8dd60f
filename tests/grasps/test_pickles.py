"""Pickles that may hold arrays only, and D-Grasp's labels in them."""

from __future__ import annotations

import base64
import gzip
import os
import pathlib
import pickle
import zlib
from collections import OrderedDict

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.pickle_file import load_arrays_pickle
from fungrasp.grasps.importers.dgrasp import import_dgrasp

JOBLIB = zlib.decompress(
    base64.b85decode(
        "c-m!9Jxjzu5X~kRJwK3BK@|T$Y_77f5Ii}sFqp!|O2Tdu-DtkZCTNO-*l2|5ob>)O|H`>ZRxNz&%$s3mm^WLG+AnRu"
        "0&TKD3kXHneMngpvT0JrS><M-_ZS5T+fJ9B=Q*uza++m9jvsjRg5A_ul+25$5C~>Jg|M3VwCj~kU<yvN0BzkiUS*c%"
        "z8nTJm$6?|vclJXBH69q9piiRhSzA>29Q&99OrT=(K}l!kij~QqV&m)W13+DhlA37pG%|gK8b^*a9LFZ0_{o3R+c@6"
        "Q|mM7X7Wj^rG3uYEA<ON7;<wsijVmQ-yAgaEg%=jCwvF=@Z?V&-}|qP?>GFQTT0YEO*0e|#UsVKVpDND`PJd!Em{qb"
        "XADX){RT??j_d"
    )
)
"""joblib.dump of {1: {"a": 2 x 3 float32, "b": 2 x 3 int64 in Fortran order, "c": [True, "x"]}}."""

CONTENT = {
    1: {
        "floats": np.linspace(0, 1, 6, dtype=np.float32).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "big endian": np.arange(3, dtype=">i2"),
        "flags": np.array([True, False]),
        "words": np.array(["a", "bcd"]),
        "empty": np.zeros((0, 4)),
        "scalar": np.float64(2.5),
        "whole": np.array(7),
    },
    "plain": [1, 2.5, None, True, "text", b"bytes", (1, 2), {3}, OrderedDict(a=1)],
}


def same(found, wanted) -> None:
    if isinstance(wanted, dict):
        assert list(found) == list(wanted)
        for key in wanted:
            same(found[key], wanted[key])
    elif isinstance(wanted, np.ndarray):
        np.testing.assert_array_equal(found, wanted)
        assert found.dtype == wanted.dtype.newbyteorder("=")
    elif isinstance(wanted, list):
        for left, right in zip(found, wanted, strict=True):
            same(left, right)
    else:
        assert found == wanted


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("pack", [bytes, gzip.compress, zlib.compress])
def test_arrays_survive(tmp_path, protocol, pack):
    path = tmp_path / "data.pkl"
    path.write_bytes(pack(pickle.dumps(CONTENT, protocol=protocol)))
    same(load_arrays_pickle(path), CONTENT)


@pytest.mark.parametrize("pack", [bytes, gzip.compress, zlib.compress])
def test_joblib_files_are_read(tmp_path, pack):
    path = tmp_path / "data.pkl"
    path.write_bytes(pack(JOBLIB))
    content = load_arrays_pickle(path)
    same(content[1]["a"], np.arange(6, dtype=np.float32).reshape(2, 3))
    same(content[1]["b"], np.arange(6).reshape(2, 3))
    assert content[1]["c"] == [True, "x"]


class Calls:
    """Pickles as a call."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


def harmful(target: str) -> list[object]:
    return [
        Calls(os.system, f"touch {target}"),
        {1: {"final_ee": [np.zeros(3), Calls(os.mkdir, target)]}},
        Calls(eval, f"open({target!r}, 'w')"),
        Calls(getattr, "text", "upper"),
        np.array([Calls(os.mkdir, target)], dtype=object),
        Calls(np.load, target),
        Calls(np.zeros, 3),
        pathlib.Path(target),
        np.array([(1, 2.0)], dtype=[("a", "i4"), ("b", "f8")]),
        np.datetime64("2020-01-01"),
        len,
        np.ndarray,
    ]


@pytest.mark.parametrize("number", range(len(harmful(""))))
@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_anything_else_is_refused_and_nothing_runs(tmp_path, number, protocol):
    target = tmp_path / "ran"
    path = tmp_path / "evil.pkl"
    path.write_bytes(pickle.dumps(harmful(str(target))[number], protocol=protocol))
    with pytest.raises(FungraspError, match=r"cannot read .*evil\.pkl: it (asks for|holds)") as caught:
        load_arrays_pickle(path)
    assert not target.exists() and "\n" not in str(caught.value)


def test_forged_array_states_are_refused(tmp_path):
    # An array of objects whose type claims to be plain numbers would make NumPy take the bytes for addresses.
    dtype = Calls(np.dtype, "O", False, True)
    reduced = np.zeros(1).__reduce__()
    array = Calls(*reduced[:1], *reduced[1])
    for state in ((1, (1,), dtype, False, b"A" * 8), (1, (9,), np.dtype("f8"), False, b"A" * 8), (1, 2)):

        class Forged:
            content = state

            def __reduce__(self):
                return (*array.call, self.content)

        path = tmp_path / "forged.pkl"
        path.write_bytes(pickle.dumps(Forged()))
        with pytest.raises(FungraspError, match=r"forged\.pkl"):
            load_arrays_pickle(path)


def test_tensors_are_read_without_torch(tmp_path):
    torch = pytest.importorskip("torch")
    whole = torch.arange(24.0).reshape(2, 3, 4)
    tensors = {"view": whole.permute(2, 0, 1)[1:], "whole": torch.tensor([1, 2]), "none": torch.zeros(0, 3)}
    found = load_arrays_pickle(dump(tmp_path / "x.pkl", tensors))
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(found[name], tensor.numpy())
        assert found[name].dtype == tensor.numpy().dtype
    # A shape that reaches beyond the 24 numbers.
    data = pickle.dumps(torch.arange(24.0), protocol=2)
    (tmp_path / "x.pkl").write_bytes(data.replace(b"K\x18\x85", b"K\x19\x85"))
    with pytest.raises(FungraspError, match="reaches beyond its numbers"):
        load_arrays_pickle(tmp_path / "x.pkl")


@pytest.mark.parametrize(
    "content", [b"", b"nonsense", pickle.dumps(CONTENT)[:200], JOBLIB[:-30], b"x\x9c12", b"\x80\x05."]
)
def test_broken_pickles_are_named(tmp_path, content):
    path = tmp_path / "broken.pkl"
    path.write_bytes(content)
    with pytest.raises(FungraspError, match=r"cannot read the pickle .*broken\.pkl: "):
        load_arrays_pickle(path)
    with pytest.raises(FungraspError, match=r"missing does not exist"):
        load_arrays_pickle(tmp_path / "missing")


def labels(grasps, rise: float = 0.5) -> dict:
    """A set as D-Grasp writes it."""
    up = np.array([0, 0, rise])

    def raised(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:, :3] + up, values[:, 3:]], axis=1)

    return {
        "final_ee": (grasps.hand_joints + up).reshape(len(grasps), 63),
        "final_contacts": grasps.link_contacts.astype(np.float32),
        "final_obj_pos": raised(grasps.object_pose),
        "obj_pose_reset": raised(grasps.object_rest_pose),
        "final_qpos": raised(grasps.hand_qpos),
        "final_pose": grasps.hand_qpos[:, 3:],
        "obj_w_stacked": grasps.object_mass,
        "obj_type_stacked": np.full(len(grasps), 2),
    }


def dump(path: pathlib.Path, content: object) -> pathlib.Path:
    path.write_bytes(pickle.dumps(content))
    return path


def test_labels_become_grasps(tmp_path, human_grasps):
    first, second = human_grasps(2, seed=1), human_grasps(3, seed=2)
    path = dump(tmp_path / "labels.pkl", {14: labels(first), "teapot": labels(second)})
    grasps = import_dgrasp(path)
    assert grasps.object_name.tolist() == ["025_mug"] * 2 + ["teapot"] * 3
    for field in (
        "object_pose",
        "object_rest_pose",
        "hand_joints",
        "link_contacts",
        "hand_qpos",
        "object_mass",
    ):
        wanted = np.concatenate([getattr(first, field), getattr(second, field)])
        np.testing.assert_allclose(getattr(grasps, field), wanted, atol=1e-12, err_msg=field)
    np.testing.assert_allclose(
        import_dgrasp(path, 0.0).hand_joints, grasps.hand_joints + np.array([0, 0, 0.5])
    )


def test_labels_may_lack_joint_rotations(tmp_path, human_grasps):
    entry = labels(human_grasps(2))
    del entry["final_qpos"]
    assert import_dgrasp(dump(tmp_path / "labels.pkl", {1: entry})).hand_qpos is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"final_ee": None}, r"object 14 \(025_mug\): field 'final_ee' is missing"),
        ({"final_ee": np.zeros((2, 60))}, r"'final_ee' has shape \(2, 60\), expected \(2, 63\)"),
        ({"final_contacts": np.array([["a"] * 16] * 2)}, "'final_contacts' holds <U1, expected numbers"),
        ({"obj_w_stacked": np.array([0.1, -1])}, "object_mass', row 1 must be greater than 0"),
    ],
)
def test_bad_labels_are_named(tmp_path, human_grasps, change, words):
    entry = {k: v for k, v in (labels(human_grasps(2)) | change).items() if v is not None}
    with pytest.raises(FungraspError, match=words):
        import_dgrasp(dump(tmp_path / "labels.pkl", {14: entry}))


def test_other_pickles_are_no_labels(tmp_path):
    for content, words in (
        ([1], "expected a dict"),
        ({}, "no grasps"),
        ({99: {}}, "99 is neither"),
        ({1: 2}, "expected"),
    ):
        with pytest.raises(FungraspError, match=words):
            import_dgrasp(dump(tmp_path / "labels.pkl", content))


def test_the_older_files_of_contactopt_and_grasptta(tmp_path, human_grasps):
    grasps = human_grasps(2)
    relative = grasps.object_pose[:, None, :3]
    entry = {
        "final_wpos": (grasps.hand_joints - relative).reshape(2, 63),
        "final_obj": grasps.object_pose * ([0.0] * 3 + [1.0] * 4),
        "final_contacts": grasps.link_contacts.astype(float),
        "obj_w": grasps.object_mass[:, None],
    }
    (tmp_path / "old.pkl").write_bytes(pickle.dumps({4: entry}))
    found = import_dgrasp(tmp_path / "old.pkl")
    height = 0.05  # Of the can's middle.
    np.testing.assert_allclose(found.hand_joints, grasps.hand_joints - relative + [0, 0, height], atol=1e-12)
    np.testing.assert_allclose(found.object_pose[:, :3], [[0, 0, height]] * 2)
    np.testing.assert_array_equal(found.object_rest_pose, found.object_pose)
    assert set(found.object_name) == {"005_tomato_soup_can"}

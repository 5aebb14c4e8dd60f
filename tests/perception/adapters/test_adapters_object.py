import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.core import plugins
from fungrasp.core.errors import FungraspError
from fungrasp.perception.acceptance import ACCEPT
from fungrasp.perception.adapters import read_object_pose

TURN = Rotation.from_rotvec([0.4, -1.2, 2.0])
PLACE = np.array([0.05, -0.02, 0.62])
MATRIX = np.eye(4)
MATRIX[:3, :3], MATRIX[:3, 3] = TURN.as_matrix(), PLACE
POSE = np.concatenate([PLACE, TURN.as_quat(scalar_first=True)])


def same_pose(pose, wanted=POSE):
    np.testing.assert_allclose(pose[:3], wanted[:3], atol=1e-9)
    assert abs(pose[3:] @ wanted[3:]) == pytest.approx(1)


def test_foundation_pose_writes_a_matrix_per_image(tmp_path):
    folder = tmp_path / "debug" / "ob_in_cam"
    folder.mkdir(parents=True)
    for number, distance in ((3, 0.62), (12, 0.7)):
        matrix = MATRIX.copy()
        matrix[2, 3] = distance
        np.savetxt(folder / f"{number:06d}.txt", matrix)
    for which in (3, "3", "000003"):
        estimate = read_object_pose(tmp_path / "debug", image=which)
        same_pose(estimate.pose_camera_object)
    assert estimate.accepted and estimate.score == ACCEPT and "no score" in estimate.note
    assert read_object_pose(folder / "000012.txt").pose_camera_object[2] == 0.7
    with pytest.raises(FungraspError, match="2 images: say which is meant"):
        read_object_pose(folder)
    with pytest.raises(FungraspError, match="no pose of image 4; it has 000003 to 000012"):
        read_object_pose(folder, image=4)
    with pytest.raises(FungraspError, match="has no poses"):
        read_object_pose(tmp_path)


def test_matrices_and_our_seven_numbers_in_any_file(tmp_path):
    np.savetxt(tmp_path / "seven.txt", POSE[None], delimiter=",")
    np.savetxt(tmp_path / "row.txt", MATRIX.reshape(1, 16))
    np.save(tmp_path / "one.npy", MATRIX)
    np.save(tmp_path / "many.npy", np.stack([np.eye(4), MATRIX]))
    np.save(tmp_path / "sevens.npy", np.stack([POSE + np.eye(7)[2], POSE]))
    (tmp_path / "bare.json").write_text(json.dumps(MATRIX.tolist()))
    (tmp_path / "named.json").write_text(json.dumps({"pose": POSE.tolist(), "score": 0.4}))
    for name, image in (
        ("seven.txt", None), ("row.txt", None), ("one.npy", None), ("many.npy", 1), ("sevens.npy", 1),
        ("bare.json", None), ("named.json", None),
    ):  # fmt: skip
        same_pose(read_object_pose(tmp_path / name, image=image).pose_camera_object)
    unsure = read_object_pose(tmp_path / "named.json")
    assert unsure.score == 0.4 and not unsure.accepted and unsure.note.startswith("low confidence")
    with pytest.raises(FungraspError, match="has 2 poses: say which is meant"):
        read_object_pose(tmp_path / "many.npy")
    with pytest.raises(FungraspError, match="no pose of image 2; it has 0 to 1"):
        read_object_pose(tmp_path / "many.npy", image=2)


def changed(rotation=None, place=None, last=None):
    matrix = MATRIX.copy()
    if rotation is not None:
        matrix[:3, :3] = rotation
    if place is not None:
        matrix[:3, 3] = place
    if last is not None:
        matrix[3] = last
    return matrix


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        (changed(rotation=1000 * TURN.as_matrix()), "scales by 1000"),
        (changed(rotation=np.diag([1.0, 1, -1]) @ TURN.as_matrix()), "mirrors"),
        (changed(rotation=TURN.as_matrix() + np.diag([0.2, 0, 0])), "not perpendicular or not of length 1"),
        (changed(rotation=np.zeros((3, 3))), "no rotation"),
        (changed(place=1000 * PLACE), "millimeters taken for meters"),
        (changed(place=0.001 * PLACE), "another unit"),
        (changed(place=PLACE * [1, 1, -1]), "behind the camera.*OpenGL"),
        (changed(place=[9.0, 0, 0.5]), "far outside"),
        (MATRIX.T, "it is transposed"),
        (changed(last=[0, 0, 0, 2.0]), "last row"),
        (changed(place=[np.nan, 0, 1]), "non-finite"),
        (np.eye(3), r"4 x 4 matrix or 7 numbers .* not an array of shape \[3, 3\]"),
        (POSE * [1, 1, 1, 2, 2, 2, 2], "quaternion .* has length 2, not 1"),
    ],
)
def test_what_is_no_pose_is_named(tmp_path, numbers, words):
    np.save(tmp_path / "pose.npy", numbers)
    with pytest.raises(FungraspError, match=words):
        read_object_pose(tmp_path / "pose.npy")


def test_a_rotation_written_with_few_digits_is_mended(tmp_path):
    np.savetxt(tmp_path / "pose.txt", MATRIX, fmt="%.2f")
    quaternion = read_object_pose(tmp_path / "pose.txt").pose_camera_object[3:]
    assert abs(quaternion @ POSE[3:]) > 0.9999 and np.linalg.norm(quaternion) == pytest.approx(1)


def test_a_score_that_is_no_probability(tmp_path):
    (tmp_path / "pose.json").write_text(json.dumps({"pose": POSE.tolist(), "score": 61.5}))
    estimate = read_object_pose(tmp_path / "pose.json")
    assert estimate.score == ACCEPT and "no probability" in estimate.note


def test_files_that_are_none(tmp_path):
    with pytest.raises(FungraspError, match="does not exist"):
        read_object_pose(tmp_path / "missing.txt")
    for name, content, words in (
        ("pose.pkl", b"", "not '.pkl'"),
        ("cut.npy", b"\x93NUMPY cut", "can't be read"),
        ("cut.json", b"[[1, 0", "not valid JSON"),
        ("empty.json", b"{}", "'pose' is missing"),
        ("text.txt", b"here it is", "can't be read"),
        ("ragged.txt", b"1 0 0 0\n0 1", "all rows of the same length"),
        ("score.json", b'{"pose": [0, 0, 1, 1, 0, 0, 0], "score": "good"}', "score must be a number"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FungraspError, match=words):
            read_object_pose(tmp_path / name)


def test_estimators_of_other_packages(monkeypatch):
    def broken():
        raise ImportError("no module named torch")

    entries = {
        "fungrasp.hand_estimators": [
            SimpleNamespace(name="my-hands", load=lambda: lambda capture: f"a hand in {capture}"),
            SimpleNamespace(name="broken", load=broken),
        ],
        "fungrasp.object_pose_estimators": [],
    }
    monkeypatch.setattr(plugins, "entry_points", lambda group: entries[group])
    hands = partial(plugins.load_plugin, "fungrasp.hand_estimators", "hand estimator")
    assert hands("my-hands")("an image") == "a hand in an image"
    with pytest.raises(FungraspError, match=r"unknown hand estimator 'my-hand'. Did you mean 'my-hands'"):
        hands("my-hand")
    with pytest.raises(FungraspError, match="'broken' can't be loaded: no module named torch"):
        hands("broken")
    with pytest.raises(FungraspError, match=r"no installed package brings any .*object_pose_estimators"):
        plugins.load_plugin("fungrasp.object_pose_estimators", "object pose estimator", "any")

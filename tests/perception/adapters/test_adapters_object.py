import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fungrasp.errors import FungraspError
from fungrasp.perception.adapters import (
    entry_point,
    load_hand_estimator,
    load_object_pose_estimator,
    read_object_pose,
)
from fungrasp.perception.object_pose.confidence import ACCEPT

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
    with pytest.raises(FungraspError, match="2 images: say which image"):
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
    with pytest.raises(FungraspError, match="has 2 poses: say which image"):
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
        (changed(place=1000 * PLACE), "millimetres taken for metres"),
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


def bop_line(image=7, object_id=5, score=0.9, place=PLACE, scene=2, unit=0.001):
    rotation = " ".join(map(str, TURN.as_matrix().ravel()))
    return f"{scene},{image},{object_id},{score},{rotation},{' '.join(map(str, place / unit))},0.3\n"


def write_bop(path, *lines, header=True):
    path.write_text(("scene_id,im_id,obj_id,score,R,t,time\n" if header else "") + "".join(lines))
    return path


@pytest.mark.parametrize("header", [True, False])
def test_bop_results_are_in_millimetres_and_the_best_score_counts(tmp_path, header):
    path = write_bop(
        tmp_path / "gdrnpp_ycbv-test.csv",
        bop_line(score=0.3, place=PLACE + 0.1),
        bop_line(),
        bop_line(image=8, place=PLACE + 0.2),
        bop_line(object_id=6, place=PLACE + 0.3),
        header=header,
    )
    estimate = read_object_pose(path, image=7, object_id=5)
    same_pose(estimate.pose_camera_object)
    assert estimate.score == 0.9 and estimate.accepted and estimate.note == ""
    ((other, score),) = estimate.alternatives
    assert score == 0.3 and other[0] == pytest.approx(0.15)
    for given, words in (
        ({"image": 9, "object_id": 5}, "no row for image 9; it has image 7, 8"),
        ({"image": 8, "object_id": 6}, "no row for object 6; it has object 5"),
        ({"image": 7}, r"has 2 objects \(5, 6\): say which object"),
        ({"object_id": 5}, "has 2 images"),
        ({"image": 7, "scene": 1}, "no row for scene 1; it has scene 2"),
    ):
        with pytest.raises(FungraspError, match=words):
            read_object_pose(path, **given)


def test_scores_that_are_no_probabilities(tmp_path):
    path = write_bop(tmp_path / "r.csv", bop_line(score=61.5), bop_line(score=80.0, place=PLACE * 1.1))
    estimate = read_object_pose(path)
    assert estimate.score == ACCEPT and "no probabilities" in estimate.note
    assert estimate.pose_camera_object[2] == pytest.approx(0.62 * 1.1)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (bop_line(unit=1.0), "were they written in metres"),
        ("2,7,5,0.9,1 0 0 0 1 0 0 0 1\n", "line 2: a row is .* not 5 values"),
        ("2,7,5,0.9,1 0 0 0 1 0 0 0,0 0 600,1\n", "R must be 9 numbers and t 3, not 8 and 3"),
        ("2,seven,5,0.9,1 0 0 0 1 0 0 0 1,0 0 600,1\n", "a value is not a number"),
        ("2,7,5,nan,1 0 0 0 1 0 0 0 1,0 0 600,1\n", "score is not finite"),
        ("2,7,5,0.9,1 0 0 0 1 0 0 0 2,0 0 600,1\n", "line 2: the matrix is no rotation"),
        ("", "has no rows"),
    ],
)
def test_bad_bop_results(tmp_path, line, words):
    with pytest.raises(FungraspError, match=words):
        read_object_pose(write_bop(tmp_path / "r.csv", line))


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
    monkeypatch.setattr(entry_point, "entry_points", lambda group: entries[group])
    assert load_hand_estimator("my-hands")("an image") == "a hand in an image"
    with pytest.raises(FungraspError, match=r"unknown hand estimator 'my-hand'. Did you mean 'my-hands'"):
        load_hand_estimator("my-hand")
    with pytest.raises(FungraspError, match="'broken' can't be loaded: no module named torch"):
        load_hand_estimator("broken")
    with pytest.raises(FungraspError, match=r"no installed package brings any .*object_pose_estimators"):
        load_object_pose_estimator("any")

"""The command ``fungrasp perceive``, on the demo's image. A stand-in says where the landmarks are."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from grasp_files import run
from PIL import Image
from scipy.spatial.transform import Rotation

from fungrasp.cli.perceive import parse_plane
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import load_human_grasps, load_robot_grasps
from fungrasp.objects import builtin_object
from fungrasp.objects.resolved_object import DENSITY, resolve_object
from fungrasp.perception import pipeline
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import builtin_truth, read_folder

TRUTH = builtin_truth()
NAME = TRUTH.object_name
LENS = json.loads((FOLDER / "K.json").read_text())


def landmarks() -> DetectedHand:
    """Noise of 4 pixels per axis, 6 mm and 8 degrees in shape."""
    rng = np.random.default_rng(0)
    joints, lens = TRUTH.joints_camera, read_folder(FOLDER).intrinsics
    turn = Rotation.from_rotvec(rng.normal(size=3) * np.radians(8))
    shape = turn.apply(joints - joints.mean(axis=0) + rng.normal(size=(21, 3)) * 0.006)
    return DetectedHand(lens.project(joints) + rng.normal(size=(21, 2)) * 4, shape, "right", 0.95, 0.95)


def object_mask() -> np.ndarray:
    """Pixels that show the object and what hides it, roughly: the depth of its silhouette."""
    from fungrasp.perception.object_pose.object_template import MeshRays

    model, capture = builtin_object(NAME), read_folder(FOLDER)
    rays = capture.intrinsics.rays().reshape(-1, 3)
    depth = MeshRays(model.vertices, model.faces).cast(TRUTH.pose_camera_object[None], rays)[0]
    return np.abs(depth.reshape(capture.depth.shape) - capture.depth) < 0.004


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The image's files, a mask, a mesh and the object's true pose."""
    folder = tmp_path_factory.mktemp("capture")
    for name in ("rgb.png", "depth.png", "K.json"):
        shutil.copyfile(FOLDER / name, folder / name)
    Image.fromarray(np.where(object_mask(), 255, 0).astype(np.uint8)).save(folder / "mask.png")
    model = builtin_object(NAME)
    trimesh.Trimesh(model.vertices, model.faces, process=False).export(folder / "thing.obj")
    trimesh.Trimesh(1000 * model.vertices, model.faces, process=False).export(folder / "millimeters.obj")
    (folder / "pose.txt").write_text(" ".join(map(str, TRUTH.pose_camera_object)))
    return folder


LOAD_WEIGHTS = "fungrasp.perception.hand.mediapipe_models.load_weights"


@pytest.fixture(autouse=True)
def models(monkeypatch):
    """Hand models need not be set up: a stand-in is in their place."""
    monkeypatch.setattr(LOAD_WEIGHTS, dict)


@pytest.fixture
def found(monkeypatch) -> list[DetectedHand]:
    """What the detector finds; to be changed."""
    hands = [landmarks()]

    class StandIn:
        def detect(self, color, near=None):
            scale = color.shape[1] / LENS["width"]
            return [dataclasses.replace(hand, pixels=hand.pixels * scale) for hand in hands]

    monkeypatch.setattr(pipeline, "MediaPipeHandDetector", StandIn)
    return hands


def files(folder: Path, **others: Path) -> list[object]:
    paths = {"rgb": "rgb.png", "depth": "depth.png", "intrinsics": "K.json"}
    given = {name: folder / file for name, file in paths.items()} | others
    return [word for name, path in given.items() for word in (f"--{name}", path)]


def test_three_files_become_a_grasp_that_can_be_retargeted(folder, found, tmp_path, capsys):
    out, result, page = tmp_path / "g.npz", tmp_path / "r.json", tmp_path / "p.html"
    status, words, err = run(
        capsys,
        "perceive",
        *files(folder),
        *("--mesh", folder / "thing.obj", "--mask", folder / "mask.png", "--task", "spray"),
        *("--out", out, "--json", result, "--report", page),
    )
    assert status == 0 and err.count("\n") == 1
    # Front and back are much alike.
    assert re.search(r"the object's orientation is ambiguous: rotated by (179|180) degrees", err)
    grasps = load_human_grasps(out)
    assert len(grasps) == 1 and grasps[0].object_name == "thing" and grasps[0].task == "spray"
    volume = builtin_object(NAME).mesh.convex_hull.volume
    assert grasps[0].object_mass == pytest.approx(DENSITY * volume, rel=1e-3)
    assert "the mass was guessed" in words and "a right hand on 'thing'" in words and str(page) in words
    told = json.loads(result.read_text())
    assert told["sure"] and len(told["doubts"]) == len(told["warnings"]) == 1 and told["table_found"]
    np.testing.assert_allclose(told["grasp"]["hand_joints"], grasps[0].hand_joints)
    assert len(told["grasp"]["links_in_contact"]) == grasps[0].link_contacts.sum()
    np.testing.assert_allclose(told["object"]["pose_camera"][:3], TRUTH.pose_camera_object[:3], atol=0.005)
    assert told["acceptance"]["object"] == told["object"]["score"]
    text = page.read_text()
    assert "<html" in text and "Made by" in text
    assert f"next: fungrasp retarget --grasps {out} --objects {folder} --out robot.npz" in words
    robot = tmp_path / "robot.npz"
    status, _, err = run(capsys, "retarget", "--grasps", out, "--objects", folder, "--out", robot)
    assert status == 0 and load_robot_grasps(robot).object_name.tolist() == ["thing"]


def test_a_folder_a_builtin_object_and_a_pose_from_elsewhere(folder, found, tmp_path, capsys):
    out = tmp_path / "g.npz"
    pose = ("--object-pose-file", folder / "pose.txt", "--mass", 0.3)
    for place in (folder, "builtin"):
        out.unlink(missing_ok=True)
        status, _, err = run(capsys, "perceive", "--folder", place, "--mesh", NAME, *pose, "--out", out)
        assert status == 0, err
        grasp = load_human_grasps(out)[0]
        assert (grasp.object_name, grasp.object_mass) == (NAME, pytest.approx(0.3))


@pytest.fixture
def camera(monkeypatch) -> list[tuple[object, object]]:
    """A camera that sees the demo's image; what it was asked for."""
    asked = []

    def capture(recording=None, *, image=None):
        asked.append((recording, image))
        return read_folder(FOLDER)

    monkeypatch.setattr("fungrasp.perception.io.realsense.capture_from_camera", capture)
    return asked


def test_a_camera_gives_its_image_when_asked(camera, found, tmp_path, capsys):
    given = ("--camera", "--keep", tmp_path / "kept", "--mesh", NAME, "--out", tmp_path / "g.npz")
    status, _, err = run(capsys, "perceive", *given)
    assert status == 0 and camera == [(None, None)], err
    np.testing.assert_array_equal(read_folder(tmp_path / "kept").color, read_folder(FOLDER).color)
    assert load_human_grasps(tmp_path / "g.npz").object_name[0] == NAME
    recorded = ("--recording", "r.bag", "--image", 7, "--mesh", NAME, "--out", tmp_path / "g.npz")
    assert run(capsys, "perceive", *recorded)[0] == 0 and camera[1:] == [(Path("r.bag"), 7)]


def test_missing_hand_models_are_said_before_anything_is_read(tmp_path, capsys, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path))
    given = ("--folder", tmp_path / "none", "--mesh", "nothing", "--out", tmp_path / "g.npz")
    status, _, err = run(capsys, "perceive", *given)
    assert status == 2 and err.count("\n") == 1 and "run 'fungrasp setup perception' once" in err


def test_matrices_are_multiplied_in_one_thread_unless_told_otherwise(tmp_path):
    program = (
        "import os, sys; from fungrasp.cli.main import main\n"
        "main(['perceive', '--mesh', 'mug', '--out', 'g.npz']); print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    kept = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    for given, expected in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")):
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, env=kept | given, cwd=tmp_path
        )
        assert done.stdout.split() == [expected.encode()], done.stderr


def test_a_plane_is_four_numbers():
    plane = parse_plane("0,-1,0,0.4")
    assert plane is not None
    np.testing.assert_allclose(plane, [0, -1, 0, 0.4])
    assert parse_plane(None) is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--report", "g.npz"), "--out and --report are the same file"),
        (("--json", "there"), "there (--json): it is a folder: add a file's name"),
        (("--camera", "realsense"), "give either --folder, or --camera"),
        (("--seed", "-1"), "the seed must be 0 or more"),
    ],
)
def test_options_that_cannot_work_are_refused_before_any_work(
    options, words, folder, found, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(pipeline, "find_hands", lambda *_: pytest.fail("nothing should be looked for"))
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path)
    given = ("--folder", folder, "--mesh", NAME, "--out", "g.npz", *options)
    status, out, err = run(capsys, "perceive", *given)
    assert status == 2 and words in err and err.count("\n") == 1 and not out
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_a_mass_in_grams_is_refused(folder):
    with pytest.raises(FungraspError, match=r"300 kg at this size is .* denser than any .*in grams\?"):
        resolve_object(folder / "thing.obj", 300.0)

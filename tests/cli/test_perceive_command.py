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
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from grasp_files import run
from PIL import Image
from scipy.spatial.transform import Rotation

from fungrasp.cli.perceive import LOW_CONFIDENCE, parse_plane
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import CannotWriteError
from fungrasp.grasps import load_human_grasps, load_objects, load_robot_grasps
from fungrasp.objects import builtin_object
from fungrasp.objects.resolved_object import DENSITY, resolve_object
from fungrasp.perception import HandEstimate, ObjectEstimate
from fungrasp.perception import pipeline as room
from fungrasp.perception.adapters import entry_point
from fungrasp.perception.builtin_image import builtin_truth
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.hand.fit_problem import joint_confidence
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import read_folder

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
    from fungrasp.perception.object_pose.known_object import MeshRays

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

    monkeypatch.setattr(room, "MediaPipeHandDetector", StandIn)
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
    assert re.search(r"which way round the object is: turned by (179|180) degrees", err)
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
    assert told["verdict"]["object"] == told["object"]["score"]
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


def test_a_recorded_stream_is_taken_when_all_is_seen(folder, found, tmp_path, capsys, monkeypatch):
    """Three frames without a hand, then the demo's image: the loop says so, waits, counts down."""
    monkeypatch.setattr("fungrasp.perception.camera.live.MediaPipeHandDetector", room_detector())
    stream, kept = tmp_path / "stream", tmp_path / "kept"
    for i in range(8):
        shutil.copytree(FOLDER, stream / f"{i:02d}", ignore=shutil.ignore_patterns("truth.json"))
    for i in range(3):
        Image.new("RGB", (LENS["width"], LENS["height"]), (90, 90, 90)).save(stream / f"{i:02d}" / "rgb.png")
    given = ("--camera", stream, "--countdown", "0.2", "--keep", kept, "--mesh", NAME)
    status, words, err = run(capsys, "perceive", *given, "--out", tmp_path / "g.npz")
    assert status == 0, err
    lines = words.splitlines()
    assert "http://127.0.0.1:" in lines[0] and lines[1] == "no hand"
    assert lines[2:5] == ["all is seen; keep still: 1", "all is seen; keep still: 0", "the picture is taken"]
    np.testing.assert_array_equal(read_folder(kept).color, read_folder(FOLDER).color)
    assert load_human_grasps(tmp_path / "g.npz").object_name[0] == NAME
    status, _, err = run(capsys, "perceive", *given, "--countdown", "30", "--out", tmp_path / "g.npz")
    assert status == 2 and "ended before a picture could be taken; last: all is seen" in err


def test_a_look_that_leaves_doubt_asks_for_another(folder, found, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fungrasp.perception.camera.live.MediaPipeHandDetector", room_detector())
    found[:] = [dataclasses.replace(landmarks(), score=0.2)]
    for i in range(2):
        shutil.copytree(FOLDER, tmp_path / "stream" / f"{i}", ignore=shutil.ignore_patterns("truth.json"))
    with Image.open(FOLDER / "rgb.png") as first:
        changed = np.array(first)
    changed[0, 0] ^= 1
    Image.fromarray(changed).save(tmp_path / "stream" / "0" / "rgb.png")
    given = ("--camera", tmp_path / "stream", "--countdown", "0", "--frames", "2", "--mesh", NAME)
    with pytest.raises(SystemExit) as end:
        run(capsys, "perceive", *given, "--out", tmp_path / "g.npz")
    assert end.value.code == LOW_CONFIDENCE
    words = capsys.readouterr().out
    assert re.search(r"^look 1 of 2: not sure: .*; turn the hand a little, or move the camera$", words, re.M)
    assert re.search(r"^not sure: .*; 2 looks", words, re.M), "the verdict is of both"


def test_missing_hand_models_are_said_before_anything_is_read(tmp_path, capsys, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path))
    given = ("--folder", tmp_path / "none", "--mesh", "nothing", "--out", tmp_path / "g.npz")
    status, _, err = run(capsys, "perceive", *given)
    assert status == 2 and err.count("\n") == 1 and "run 'fungrasp setup perception' once" in err


def room_detector():
    """What ``found`` has put in the place of the detector; on a gray image it finds nothing."""
    stand_in = room.MediaPipeHandDetector

    class Seeing:
        def detect(self, color, near=None):
            return stand_in().detect(color) if color.std() > 1 else []

    return Seeing


def test_a_pose_from_elsewhere_is_judged_by_the_depth(folder, found, tmp_path, capsys):
    near, far = (TRUTH.pose_camera_object + np.array([x, 0, 0, 0, 0, 0, 0]) for x in (0.004, 0.05))
    (tmp_path / "near.json").write_text(json.dumps({"pose": near.tolist(), "score": 0.1}))
    (tmp_path / "far.json").write_text(json.dumps({"pose": far.tolist(), "score": 1.0}))
    result = tmp_path / "r.json"
    common = ("--folder", folder, "--mesh", NAME, "--out", tmp_path / "g.npz", "--json", result)
    pose = ("--object-pose-file", tmp_path / "near.json", "--improve-pose")
    status, _, err = run(capsys, "perceive", *common, *pose)
    assert status == 0, err
    position = json.loads(result.read_text())["object"]["pose_camera"][:3]
    np.testing.assert_allclose(position, TRUTH.pose_camera_object[:3], atol=0.002)
    with pytest.raises(SystemExit) as end:
        run(capsys, "perceive", *common, "--object-pose-file", tmp_path / "far.json")
    assert end.value.code == LOW_CONFIDENCE and "not sure: look at the grasp" in capsys.readouterr().err


def test_estimators_of_other_packages_are_asked(folder, tmp_path, capsys, monkeypatch):
    asked = []

    def find_hand(capture):
        joints, covariance = TRUTH.joints_camera, np.tile(1e-4 * np.eye(3), (21, 1, 1))
        pixels = capture.intrinsics.project(joints)
        return HandEstimate(joints, pixels, joint_confidence(covariance), covariance, "right", 0.9)

    def find_object(capture, mesh):
        asked.append(mesh)
        return ObjectEstimate(TRUTH.pose_camera_object, 0.9, True, judged=False)

    brought = {"hand_estimators": find_hand, "object_pose_estimators": find_object}
    monkeypatch.setattr(
        entry_point,
        "entry_points",
        lambda group: [SimpleNamespace(name="mine", load=lambda: brought[group.removeprefix("fungrasp.")])],
    )
    common = ("perceive", "--folder", folder, "--mesh", NAME, "--out", tmp_path / "g.npz")
    status, _, err = run(capsys, *common, "--hand-from", "mine", "--object-pose-from", "mine")
    assert status == 0, err
    assert len(asked) == 1 and len(asked[0].vertices) == len(builtin_object(NAME).vertices)
    joints = load_human_grasps(tmp_path / "g.npz").hand_joints[0]
    true = np.linalg.norm(TRUTH.joints_camera - TRUTH.joints_camera[0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(joints - joints[0], axis=1), true, atol=0.015)
    status, _, err = run(capsys, *common, "--hand-from", "mime")
    assert status == 2 and "Did you mean 'mine'?" in err
    status, _, err = run(capsys, *common, "--hand-from", "mine", "--hand-file", "hand.json")
    assert status == 2 and "not both" in err


def test_an_image_of_a_recording(folder, found, camera, tmp_path, capsys):
    recorded = ("--recording", folder / "x.bag", "--image", 4)
    pose = ("--object-pose-file", folder / "pose.txt")
    status, _, err = run(capsys, "perceive", *recorded, "--mesh", NAME, *pose, "--out", tmp_path / "g.npz")
    assert status == 0, err
    assert camera == [(folder / "x.bag", 4)]


def test_a_camera_without_its_package_is_told(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    status, out, err = run(capsys, "perceive", "--camera", "--mesh", NAME, "--out", tmp_path / "g.npz")
    assert status == 2 and 'pip install "fungrasp[realsense]"' in err and err.count("\n") == 1 and not out
    given = ("--camera", tmp_path / "none", "--mesh", NAME, "--out", tmp_path / "g.npz")
    status, _, err = run(capsys, "perceive", *given)
    assert status == 2 and "--camera is realsense, or a folder" in err


def test_an_object_by_file_or_name(folder):
    held = resolve_object(NAME, None)
    assert held.model.mass == builtin_object(NAME).mass and held.colored is None and held.notes == ()
    held = resolve_object(str(folder / "thing.obj"), None)
    volume = held.model.mesh.convex_hull.volume
    assert held.model.mass == pytest.approx(DENSITY * volume) and "was guessed" in held.notes[0]
    assert resolve_object(str(folder / "thing.obj"), 0.2).notes == ()
    with pytest.raises(UnknownNameError, match="Did you mean 'mug'"):
        resolve_object("mugg", 0.2)
    with pytest.raises(FungraspError, match="does not exist"):
        resolve_object("mugg.obj", 0.2)


def test_a_left_hand_brings_its_mirrored_mesh(folder, found, tmp_path, capsys):
    """The mirror image of the capture; the mirrored object is put there by its pose."""
    for name in ("rgb.png", "depth.png"):
        Image.fromarray(np.array(Image.open(folder / name))[:, ::-1]).save(tmp_path / name)
    last = LENS["width"] - 1
    (tmp_path / "K.json").write_text(json.dumps({**LENS, "cx": last - LENS["cx"]}))
    flip = np.array([-1.0, 1.0, 1.0])
    found[0] = dataclasses.replace(
        found[0],
        pixels=found[0].pixels * [-1, 1] + [last, 0],
        shape_camera=found[0].shape_camera * flip,
        side="left",
    )
    (tmp_path / "pose.txt").write_text(
        " ".join(map(str, TRUTH.pose_camera_object * [-1, 1, 1, 1, 1, -1, -1]))
    )
    model = builtin_object(NAME)
    trimesh.Trimesh(model.vertices * flip, model.faces[:, ::-1], process=False).export(tmp_path / "thing.obj")
    out = tmp_path / "out" / "g.npz"
    status, words, err = run(
        capsys,
        *("perceive", "--folder", tmp_path, "--mesh", tmp_path / "thing.obj", "--mass", 0.5),
        *("--object-pose-file", tmp_path / "pose.txt", "--out", out),
    )
    assert status == 0, err
    assert load_human_grasps(out)[0].object_name == "thing_mirrored"
    assert "'thing_mirrored' is the mesh's mirror image" in words and not list(out.parent.glob("*.obj"))
    (mirrored,) = load_objects(load_human_grasps(out), tmp_path).values()
    np.testing.assert_allclose(mirrored.vertices, model.vertices * [-1, -1, 1], atol=1e-6)


def test_an_unsure_result_is_written_and_says_so(folder, found, tmp_path, capsys):
    found[0] = dataclasses.replace(found[0], score=0.2)
    arguments = ["--folder", folder, "--mesh", NAME, "--object-pose-file", folder / "pose.txt"]
    out, result = tmp_path / "g.npz", tmp_path / "r.json"
    with pytest.raises(SystemExit) as end:
        run(capsys, "perceive", *arguments, "--out", out, "--json", result)
    assert end.value.code == LOW_CONFIDENCE == 3
    err = capsys.readouterr().err
    assert "not sure: look at the grasp" in err
    told = json.loads(result.read_text())
    assert not told["sure"] and told["verdict"]["help"] and len(load_human_grasps(out)) == 1


@pytest.mark.parametrize("option", ["--report", "--json"])
def test_a_full_disk_takes_the_page_but_not_the_grasp(option, folder, found, tmp_path, capsys, monkeypatch):
    def full(path, *_):
        raise CannotWriteError(f"cannot write {path}: No space left on device")

    monkeypatch.setattr("fungrasp.cli.perceive.write_json", full)
    monkeypatch.setattr("fungrasp.media.page.atomic_path", full)
    given = ("--folder", folder, "--mesh", NAME, "--object-pose-file", folder / "pose.txt")
    out, other = tmp_path / "g.npz", tmp_path / "other"
    status, words, err = run(capsys, "perceive", *given, "--out", out, option, other)
    last = f"fungrasp: error: cannot write {other}: No space left on device; the grasp is in {out}"
    assert status == 2 and err.splitlines()[-1] == last
    assert len(load_human_grasps(out)) == 1 and f"{out}: a right hand" in words and not other.exists()


def test_a_box_instead_of_a_mask_chooses_between_two_hands(folder, found, tmp_path, capsys):
    found.insert(0, dataclasses.replace(found[0], pixels=found[0].pixels * 0.7, score=0.99))
    rows, columns = np.nonzero(object_mask())
    box = f"{columns.min()},{rows.min()},{columns.max()},{rows.max()}"
    status, _, err = run(
        capsys,
        *("perceive", *files(folder), "--mesh", NAME, "--box", box),
        *("--object-pose-file", folder / "pose.txt", "--out", tmp_path / "g.npz"),
    )
    assert status == 0 and "2 hands are in the image; the one nearest to the box was taken" in err


@pytest.mark.slow
def test_twenty_megapixels(folder, found, tmp_path, capsys):
    times = 8
    size = (LENS["width"] * times, LENS["height"] * times)
    assert size[0] * size[1] > 19e6
    color, depth = Image.open(folder / "rgb.png"), Image.open(folder / "depth.png")
    color.resize(size, Image.Resampling.NEAREST).save(tmp_path / "rgb.jpg", quality=85)
    meters = np.array(depth, np.float32) * LENS["depth_unit"]
    np.save(tmp_path / "depth.npy", meters.repeat(times, axis=0).repeat(times, axis=1))
    scaled = {name: times * LENS[name] for name in ("width", "height", "fx", "fy")}
    center = {name: times * (LENS[name] + 0.5) - 0.5 for name in ("cx", "cy")}
    (tmp_path / "K.json").write_text(json.dumps(scaled | center))
    large = files(tmp_path, rgb=tmp_path / "rgb.jpg", depth=tmp_path / "depth.npy")
    pose = ("--object-pose-file", folder / "pose.txt")
    result = tmp_path / "r.json"
    status, _, err = run(
        capsys,
        *("perceive", *large, "--mesh", NAME, *pose, "--out", tmp_path / "g.npz", "--json", result),
    )
    assert status == 0, err
    joints = np.array(json.loads(result.read_text())["hand"]["joints_camera"])
    assert np.linalg.norm(joints - TRUTH.joints_camera, axis=1).mean() < 0.015


def truncated(folder: Path, tmp: Path) -> list[object]:
    path = tmp / "cut.png"
    path.write_bytes((folder / "rgb.png").read_bytes()[:5000])
    return files(folder, rgb=path)


def rescaled_lens(folder: Path, tmp: Path) -> list[object]:
    path = tmp / "K.json"
    path.write_text(json.dumps({**LENS, "width": 1280, "height": 960}))
    return files(folder, intrinsics=path)


def small_mask(folder: Path, tmp: Path) -> list[object]:
    Image.new("L", (320, 240), 255).save(tmp / "mask.png")
    return [*files(folder), "--mask", tmp / "mask.png"]


def glove(folder: Path, tmp: Path) -> list[object]:
    return files(folder)


BAD = {
    "a truncated PNG": (truncated, "damaged or cut short"),
    "no color image": (lambda f, t: files(f, rgb=t / "none.png"), "does not exist"),
    "the depth as color": (lambda f, t: files(f, rgb=f / "depth.png"), "is it the depth?"),
    "the color as depth": (lambda f, t: files(f, depth=f / "rgb.png"), "16-bit"),
    "meters for millimeters": (lambda f, t: [*files(f), "--depth-unit", 1], "with units of 0.001 m"),
    "intrinsics of another resolution": (rescaled_lens, "1280 x 960"),
    "a mask of another size": (small_mask, "320 x 240"),
    "a box outside the image": (lambda f, t: [*files(f), "--box", "900,900,950,950"], "outside the image"),
    "no box": (lambda f, t: [*files(f), "--box", "1,2,3"], "a box is x0,y0,x1,y1"),
    "no table": (lambda f, t: [*files(f), "--table", "0,0,3,1"], "normal of length 1"),
    "only two files": (lambda f, t: files(f)[:4], "--intrinsics must be given"),
    "nothing": (lambda f, t: [], "--rgb and --depth and --intrinsics must be given"),
    "files and a folder": (lambda f, t: [*files(f), "--folder", f], "give either --folder"),
    "files and a camera": (lambda f, t: [*files(f), "--camera"], "give either --camera, or --rgb"),
    "two cameras": (lambda f, t: ["--camera", "--recording", f / "x.bag"], "give either --camera, or --rec"),
    "no recording": (lambda f, t: ["--recording", t / "x.bag"], "x.bag does not exist"),
    "a camera's unit": (lambda f, t: ["--camera", "--depth-unit", 0.001], "--depth-unit is for files"),
    "no pose to improve": (lambda f, t: [*files(f), "--improve-pose"], "needs --object-pose-file"),
    "files to be kept": (lambda f, t: [*files(f), "--keep", t / "out"], "--keep needs --camera"),
    "a folder of something else": (lambda f, t: ["--folder", t], "is no capture"),
    "a hand file that is none": (lambda f, t: [*files(f), "--hand-file", f / "mask.png"], "hand file"),
    "a pose that is none": (lambda f, t: [*files(f), "--object-pose-file", f / "K.json"], "K.json"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_images_end_with_a_word_and_write_nothing(name, folder, found, tmp_path, capsys):
    arguments, word = BAD[name]
    out = tmp_path / "out"
    given = arguments(folder, tmp_path)
    status, _, err = run(
        capsys, "perceive", *given, "--mesh", NAME, "--out", out / "g.npz", "--json", out / "r.json"
    )
    assert status == 2 and word in err and err.count("\n") == 1, err
    assert not out.exists()


@pytest.mark.parametrize(
    ("mesh", "mass", "word"),
    [
        ("millimeters.obj", 0.3, "looks like millimeters"),
        ("no_such.obj", 0.3, "does not exist"),
        ("rgb.png", 0.3, "a mesh is a file .obj, .stl, .ply, .glb"),
        ("thing.obj", -1, "the mass must be positive"),
    ],
)
def test_bad_meshes_end_with_a_word_and_write_nothing(mesh, mass, word, folder, found, tmp_path, capsys):
    arguments = [*files(folder), "--mesh", folder / mesh, "--mass", mass]
    status, _, err = run(capsys, "perceive", *arguments, "--out", tmp_path / "g.npz")
    assert status == 2 and word in err, err
    assert not (tmp_path / "g.npz").exists()


def test_no_hand_or_one_in_a_glove_ends_with_a_word(folder, found, tmp_path, capsys):
    found.clear()
    status, _, err = run(capsys, "perceive", *files(folder), "--mesh", NAME, "--out", tmp_path / "g.npz")
    assert status == 2 and "no hand was found" in err and "bare" in err
    assert not (tmp_path / "g.npz").exists()


def test_models_that_are_not_set_up_are_named(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FUNGRASP_CACHE", str(tmp_path / "cache"))
    status, _, err = run(capsys, "perceive", *files(folder), "--mesh", NAME, "--out", tmp_path / "g.npz")
    assert status == 2 and "fungrasp setup perception" in err


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
        (("--camera", "there"), "give either --folder, or --camera"),
        (("--frames", "0"), "--frames must be 1 or more, not 0"),
        (("--frames", "3"), "--frames needs --camera, --recording, or a scene and its first --image"),
        (("--seed", "-1"), "the seed must be 0 or more"),
    ],
)
def test_options_that_cannot_work_are_refused_before_any_work(
    options, words, folder, found, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(room, "find_hands", lambda *_: pytest.fail("nothing should be looked for"))
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path)
    given = ("--folder", folder, "--mesh", NAME, "--out", "g.npz", *options)
    status, out, err = run(capsys, "perceive", *given)
    assert status == 2 and words in err and err.count("\n") == 1 and not out
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_a_mass_in_grams_is_refused(folder):
    with pytest.raises(FungraspError, match=r"300 kg in its size is .* denser than anything .*in grams\?"):
        resolve_object(folder / "thing.obj", 300.0)

"""The page of a perceived grasp: what it says first, what it marks, what it draws, and where."""

import base64
import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.grasps.human_hand import mirror_points, mirror_pose
from fungrasp.media import perception_page
from fungrasp.media.page import Quantity
from fungrasp.media.perception_page import (
    alternatives,
    contact_words,
    true_errors,
    write_perception_page,
)
from fungrasp.media.perception_pictures import (
    FINGER_COLORS,
    REJECTED_LINE,
    SHAPE,
    CloseUp,
)
from fungrasp.objects import builtin_object
from fungrasp.perception import HandEstimate, ObjectEstimate
from fungrasp.perception.acceptance import Acceptance, Meter
from fungrasp.perception.io.estimates import PerceptionWarning
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import builtin_truth, read_folder
from fungrasp.perception.perceived import Perceived

CAPTURE = read_folder(FOLDER)
TRUTH = builtin_truth()
MODEL = builtin_object(TRUTH.object_name)
TURN = Rotation.from_euler("x", -120, degrees=True).as_quat(scalar_first=True)
LEVEL = np.concatenate([[0.0, -0.5, 0.4], TURN])
"""A camera that looks along y and down by 30 degrees."""


METERS = (
    Meter("unexplained", 7.0, 30.0, 10.0),
    Meter("joints", float("nan"), 60.0, 20.0, True),
)


def perceived(**changes) -> Perceived:
    """The truth about the demo's image as if it had been perceived."""
    hand = HandEstimate(
        TRUTH.joints_camera,
        CAPTURE.intrinsics.project(TRUTH.joints_camera),
        np.full(21, 0.97),
        np.tile(np.eye(3) * 0.004**2, (21, 1, 1)),
        "right",
        0.9,
    )
    pose = TRUTH.pose_camera_object
    grasp = HumanGrasp(
        MODEL.name,
        MODEL.mass,
        compose(LEVEL, pose),
        compose(LEVEL, pose),
        transform_points(LEVEL, TRUTH.joints_camera),
        np.arange(16) % 3 == 0,
        "spray",
    )
    return Perceived(
        **{
            "capture": CAPTURE,
            "object_model": MODEL,
            "grasp": grasp,
            "pose_world_camera": LEVEL,
            "hand": hand,
            "object": ObjectEstimate(pose, 0.95, True),
            "table": np.array([0.0, -1.0, 0.0, 0.4]),
            "table_found": True,
            "warnings": (),
            "acceptance": Acceptance(True, 0.95, 0.9, METERS, ()),
            **changes,
        }
    )


@pytest.fixture
def no_pictures(monkeypatch):
    """Pictures take a second; not every test looks at them."""
    picture = np.zeros((3, 4, 3), np.uint8)
    monkeypatch.setattr(perception_page, "grasp_from_four_sides", lambda *_: [picture] * 4)
    for name in ("found", "depth", "whole_image"):
        monkeypatch.setattr(CloseUp, name, lambda *_: picture)


def page(tmp_path, seen: Perceived) -> str:
    path = write_perception_page(tmp_path / "page.html", seen, {"Command": "<mine>"})
    return path.read_text(encoding="utf-8")


def words(html: str) -> str:
    """What a reader reads."""
    text = re.sub(r"<style>.*?</style>|<[^>]+>", " ", html, flags=re.DOTALL)
    return " ".join(text.split())


def turned(degrees: float, axis: str = "z") -> np.ndarray:
    """The object's true pose after a turn about its own axis."""
    quaternion = Rotation.from_euler(axis, degrees, degrees=True).as_quat(scalar_first=True)
    return compose(TRUTH.pose_camera_object, np.concatenate([np.zeros(3), quaternion]))


def test_the_verdict_comes_first(tmp_path, no_pictures):
    said = words(page(tmp_path, perceived()))
    assert said.index("✓ Sure: the 1 known of 2 quantities are within their limits") < said.index(
        "In the image"
    )
    assert "Not sure" not in said and "What would help" not in said
    assert "seen in one image" in said
    warnings = (PerceptionWarning.of("not_searched", problem="<wrong> mesh?"),)
    obj = replace(perceived().object, score=0.3, accepted=False)
    verdict = Acceptance(
        False, 0.3, 0.5, (Meter("unexplained", 7.0, 5.0, 10.0), *METERS[1:]), ("a click at the object",)
    )
    html = page(tmp_path, perceived(object=obj, acceptance=verdict, warnings=warnings))
    said = words(html)
    assert "✓" not in said
    assert (
        said.index("? Not sure: object or mesh pixels that disagree 7 %, not at most 5 %")
        < said.index("A click at the object.")
        < said.index("In the image")
    )
    assert "so what touches it is uncertain" in said
    assert "<wrong>" not in html and "mesh?</li>" in html
    assert "<mine>" not in html


def test_a_page_holds_its_pictures_and_needs_nothing_from_outside(tmp_path):
    html = page(tmp_path, perceived())
    assert not re.search(r'(src|href)="(?!data:|#)', html)
    assert not re.search(r"https?://|url\(|@import|<script|<link", html)
    assert len(html) < 1_500_000
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", html)
    views = [np.asarray(Image.open(io.BytesIO(base64.b64decode(picture)))) for picture in pictures]
    views = [view for view in views if view.shape == (360, 480, 3)]
    assert len(views) == 4
    for view in views:
        red, green, blue = view.astype(int).transpose(2, 0, 1)
        assert ((red > 180) & (blue < 90)).sum() > 100, "no contact is marked"
        assert ((blue > red + 40) & (blue > green)).sum() > 1000, "the object is missing"


def test_page_and_terminal_show_the_same_evidence(tmp_path, no_pictures):
    seen = perceived()
    said = words(page(tmp_path, seen))
    for row in seen.acceptance.rows():
        assert all(cell in said for cell in row), row
    assert "not known" in said
    assert "poor" not in said


@pytest.mark.parametrize(
    ("value", "limit", "least", "good"),
    [
        (1.0, 1.0, None, True),
        (1.1, 1.0, None, False),
        (0.5, None, 0.5, True),
        (0.4, None, 0.5, False),
        (0.4, None, None, None),
        (float("nan"), 1.0, None, None),
        ("words", 1.0, None, None),
    ],
)
def test_a_quantity_keeps_to_its_limits(value, limit, least, good):
    assert Quantity("x", value, limit=limit, least=least).good is good


def test_contacts_in_words():
    flags = np.zeros(16, bool)
    assert contact_words(flags) == "nothing"
    flags[[0, 3, 14, 15]] = True
    assert contact_words(flags) == "palm; index: distal; thumb: middle, distal"


def test_a_left_hand_and_a_guessed_table_are_told(tmp_path, no_pictures):
    right = perceived()
    grasp = replace(
        right.grasp,
        object_name=MODEL.name + "_mirrored",
        object_pose=mirror_pose(right.grasp.object_pose),
        hand_joints=mirror_points(right.grasp.hand_joints),
    )
    seen = replace(right, grasp=grasp, hand=replace(right.hand, side="left"), table_found=False)
    said = words(page(tmp_path, seen))
    assert "Spray bottle, to spray" in said
    assert "mirrored" not in said
    assert "Left hand" in said
    assert "its reflection" in said
    assert "the one drawn is a guess" in said


def test_joints_that_are_not_trusted_are_counted(tmp_path, no_pictures):
    confidence = np.full(21, 0.97)
    confidence[[3, 4]] = 0.2
    seen = perceived()
    said = words(page(tmp_path, replace(seen, hand=replace(seen.hand, confidence=confidence))))
    assert "19 of the hand's 21 joints are sure" in said


def test_another_pose_that_fits_as_well_is_told():
    def said(*others: tuple[np.ndarray, float]) -> str:
        obj = ObjectEstimate(TRUTH.pose_camera_object, 0.95, True, others)
        return alternatives(CAPTURE, MODEL, perceived(object=obj))

    assert "No other pose" in said()
    assert "turned by 180°, fits almost as well" in words(said((turned(180), 0.93)))
    assert "fit worse" in said((turned(180), 0.5))
    assert "looks the same" in said((turned(2), 0.93))
    many = said((turned(180), 0.93), (turned(179), 0.92), (turned(2), 0.9), (turned(90, "x"), 0.3))
    assert many.count("<figure>") == 2, "poses that look alike are drawn once"
    assert "Pose 5" in many


def test_the_skeleton_is_drawn_where_the_joints_are():
    seen = perceived()
    pose = TRUTH.pose_camera_object
    picture = CloseUp(CAPTURE, seen.hand, MODEL, pose).found(True)
    assert picture.shape == (SHAPE[1], SHAPE[0], 3)
    view = CloseUp(CAPTURE, seen.hand, MODEL, pose)
    columns, rows = np.round(view.place(seen.hand.pixels)).astype(int).T
    nearest = np.argmin(TRUTH.joints_camera[:, 2])
    for joint, finger in ((4, "index"), (12, "ring"), (20, "thumb"), (18, "thumb")):
        np.testing.assert_allclose(picture[rows[joint], columns[joint]], FINGER_COLORS[finger], atol=12)
    hollow = replace(seen.hand, confidence=np.zeros(21))
    drawn = CloseUp(CAPTURE, hollow, MODEL, pose).found(True)
    assert drawn[rows[nearest], columns[nearest]].max() < 60


def test_the_close_up_shows_the_image_where_it_says():
    """A pixel of the image is found again where ``place`` puts it."""
    marked = CAPTURE.color.copy()
    marked[200:203, 300:303] = (0, 255, 0)
    seen = perceived()
    view = CloseUp(CAPTURE, seen.hand, MODEL, TRUTH.pose_camera_object)
    picture = view.cut(Image.fromarray(marked)).astype(float)
    green = np.argwhere((picture[..., 1] > 200) & (picture[..., 0] < 60))
    np.testing.assert_allclose(green.mean(axis=0)[::-1], view.place(np.array([301, 201])), atol=0.3)


def test_the_outline_is_that_of_the_object():
    """Between the last pixels that show the object and the first that don't, where no hand is before it."""
    seen = perceived()
    pose = TRUTH.pose_camera_object
    view = CloseUp(CAPTURE, seen.hand, MODEL, pose)
    picture = CloseUp(CAPTURE, seen.hand, MODEL, pose).another_pose(pose)
    red = np.argwhere(np.abs(picture.astype(int) - REJECTED_LINE).max(axis=-1) < 30)[:, ::-1]
    assert len(red) > 1000
    corners = view.place(CAPTURE.intrinsics.project(transform_points(pose, MODEL.vertices)))
    np.testing.assert_allclose(red.min(axis=0), corners.min(axis=0), atol=3)
    np.testing.assert_allclose(red.max(axis=0), corners.max(axis=0), atol=3)


def test_an_object_out_of_the_image_is_not_drawn():
    seen = perceived()
    away = TRUTH.pose_camera_object + np.array([5.0, 0, 0, 0, 0, 0, 0])
    behind = TRUTH.pose_camera_object * np.array([1.0, 1, -1, 1, 1, 1, 1])
    for pose in (away, behind):
        picture = CloseUp(CAPTURE, seen.hand, MODEL, pose).found(False)
        assert not np.any(np.abs(picture.astype(int) - REJECTED_LINE).max(axis=-1) < 10)


def test_depth_has_colors_and_holes_are_black():
    seen = perceived()
    picture = CloseUp(CAPTURE, seen.hand, MODEL, TRUTH.pose_camera_object).depth(True)
    view = CloseUp(CAPTURE, seen.hand, MODEL, TRUTH.pose_camera_object)
    depth = view.cut(Image.fromarray(CAPTURE.depth))
    part = np.s_[:300]
    dark = picture[part].max(axis=-1) < 30
    assert dark[depth[part] == 0].mean() > 0.9
    assert dark[depth[part] > 0].mean() < 0.1


def test_joints_that_are_no_hand_still_make_a_page(tmp_path):
    seen = perceived()
    broken = replace(seen.grasp, hand_joints=seen.grasp.hand_joints * 5)
    assert "no hand that can be drawn" in words(page(tmp_path, replace(seen, grasp=broken)))


def test_the_demo_image_is_small_and_its_truth_is_known():
    assert sum(file.stat().st_size for file in FOLDER.iterdir()) < 600_000
    errors = {item.name: float(item.value) for item in true_errors(TRUTH, perceived())}
    assert max(errors.values()) < 1e-4
    surface = transform_points(TRUTH.pose_camera_object, MODEL.vertices)
    columns, rows = np.round(CAPTURE.intrinsics.project(surface)).astype(int).T
    assert np.median(np.abs(CAPTURE.depth[rows, columns] - surface[:, 2])) < 0.1

"""From an image to a grasp: ``perceive``. A stand-in says where the landmarks are, with noise."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from hand_scenes import CAMERA, HandScene, hand_scene

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import compose, inverse_transform_points, invert, transform_points
from fungrasp.grasps import load_objects
from fungrasp.grasps.human_hand import mirror_points
from fungrasp.objects import ObjectModel, builtin_object
from fungrasp.perception import Capture, ObjectEstimate, pipeline
from fungrasp.perception.acceptance import SURE_JOINT, joint_probabilities, plausibility_warnings
from fungrasp.perception.hand.detected_hand import DetectedHand, settle_side
from fungrasp.perception.io.estimates import PerceptionWarning
from fungrasp.perception.io.scene_folders import write_folder
from fungrasp.perception.object_pose.object_template import MeshRays
from fungrasp.perception.object_pose.pose_error import add_s
from fungrasp.perception.perceived import Perceived
from fungrasp.perception.pipeline import perceive
from fungrasp.perception.scene.table import table_under

MUG_ROW, BOWL_ROW = 0, 36
FLIP = np.array([-1.0, 1.0, 1.0])


class StandIn:
    """A detector that finds what it was told."""

    def __init__(self, *hands: DetectedHand):
        self.hands = list(hands)

    def detect(self, color, near=None):
        return self.hands


class Forbidden:
    def detect(self, color, near=None):
        raise AssertionError("nobody should look for hands")


@cache
def mug() -> tuple[HandScene, DetectedHand]:
    rng = np.random.default_rng(0)
    scene = hand_scene(MUG_ROW, rng)
    return scene, scene.detected(rng)


@cache
def seen() -> Perceived:
    scene, detected = mug()
    return perceive(scene.capture, scene.model, detector=StandIn(detected), task="drink")


@cache
def object_pixels() -> np.ndarray:
    """A mask of the mug."""
    scene, _ = mug()
    rays = CAMERA.rays().reshape(-1, 3)
    depth = MeshRays(scene.model.vertices, scene.model.faces).cast(scene.pose_camera_object[None], rays)[0]
    return np.abs(depth.reshape(CAMERA.height, CAMERA.width) - scene.capture.depth) < 0.005


def known(scene: HandScene, score: float = 0.9) -> ObjectEstimate:
    """The true pose."""
    return ObjectEstimate(scene.pose_camera_object, score, True)


def in_object(perceived: Perceived) -> np.ndarray:
    """Joints in the object's frame."""
    return inverse_transform_points(perceived.grasp.object_pose, perceived.grasp.hand_joints)


def test_an_image_becomes_a_grasp():
    scene, _ = mug()
    perceived = seen()
    assert perceived.confident and perceived.table_found
    # The handle is hidden.
    (warning,) = perceived.warnings
    assert warning.code == "object_orientation" and "orientation is ambiguous" in str(warning)
    error = np.linalg.norm(perceived.hand.joints_camera - scene.joints, axis=1)
    assert error.mean() < 0.012
    obj = perceived.object
    poses = [obj.pose_camera_object, *(p for p, score in obj.alternatives if score > obj.score - 0.1)]
    assert min(add_s(scene.model.vertices, pose, scene.pose_camera_object) for pose in poses) < 0.004
    np.testing.assert_allclose(perceived.table, scene.table, atol=0.01)
    grasp = perceived.grasp
    assert (grasp.object_name, grasp.object_mass, grasp.task) == ("mug", scene.model.mass, "drink")
    assert grasp.link_contacts[[3, 15]].any() and 3 <= grasp.link_contacts.sum() <= 12
    judged = perceived.acceptance
    assert judged.sure and judged.object == perceived.object.score > 0.8 and not judged.help


def test_the_world_is_that_of_the_architecture():
    scene, _ = mug()
    perceived = seen()
    camera, grasp = perceived.pose_world_camera, perceived.grasp
    plane = perceived.table
    heights = transform_points(camera, scene.joints)[:, 2]
    np.testing.assert_allclose(heights, scene.joints @ plane[:3] + plane[3], atol=1e-9)
    held = compose(invert(camera), grasp.object_pose)
    np.testing.assert_allclose(held[:3], perceived.object.pose_camera_object[:3], atol=1e-9)
    center = transform_points(grasp.object_pose, scene.model.center_of_mass[None])[0]
    np.testing.assert_allclose(center[:2], 0.0, atol=1e-9)
    looks = transform_points(camera, np.array([[0.0, 0.0, 0.3], [0.1, 0.0, 0.3]])) - camera[:3]
    assert camera[2] > 0.2 and looks[0, 1] > 0.05 and abs(looks[0, 0]) < 1e-9
    assert (looks[1] - looks[0])[0] > 0.09
    np.testing.assert_allclose(
        grasp.hand_joints, transform_points(camera, perceived.hand.joints_camera), atol=1e-9
    )


@pytest.mark.parametrize("name", ["mug", "can", "hammer"])
def test_an_object_is_put_down_on_its_nearest_stable_face(name):
    from fungrasp.perception.scene.table import put_down

    model = builtin_object(name)
    tilt = np.array([0.98, 0.14, 0.1, 0.09])
    held = np.array([0.1, -0.2, 0.5, *(tilt / np.linalg.norm(tilt))])
    rest = put_down(model, held)
    heights = transform_points(rest, model.vertices)[:, 2]
    assert heights.min() == pytest.approx(0.0, abs=1e-9)
    assert (heights < 1e-4).sum() >= 3
    centers = [transform_points(pose, model.center_of_mass[None])[0, :2] for pose in (held, rest)]
    np.testing.assert_allclose(*centers, atol=1e-9)
    np.testing.assert_allclose(put_down(model, rest), rest, atol=1e-6)
    # A tilt of some 20 degrees is not the other way up.
    assert abs(rest[3:] @ held[3:]) > 0.95


def test_what_is_known_is_not_looked_for():
    scene, _ = mug()
    table = np.array([0.0, -0.8, -0.6, 0.5])
    perceived = perceive(
        scene.capture,
        scene.model,
        hand=seen().hand,
        object_estimate=known(scene),
        table=table,
        detector=Forbidden(),
    )
    assert perceived.table_found
    np.testing.assert_array_equal(perceived.table, table)
    np.testing.assert_array_equal(perceived.object.pose_camera_object, scene.pose_camera_object)
    moved = np.linalg.norm(perceived.hand.joints_camera - seen().hand.joints_camera, axis=1)
    assert 0 < moved.max() < 0.02


def test_a_table_above_the_camera_is_refused():
    scene, _ = mug()
    with pytest.raises(FungraspError, match="reverse all four signs"):
        perceive(scene.capture, scene.model, table=-np.array([0.0, -0.8, -0.6, 0.5]), detector=Forbidden())


def mirrored(
    scene: HandScene, detected: DetectedHand
) -> tuple[Capture, ObjectModel, ObjectEstimate, DetectedHand]:
    """The scene in a mirror: a left hand."""
    capture, width = scene.capture, CAMERA.width - 1
    lens = dataclasses.replace(CAMERA, cx=width - CAMERA.cx)
    image = Capture(capture.color[:, ::-1].copy(), capture.depth[:, ::-1].copy(), lens)
    model = ObjectModel(
        "gum", scene.model.mass, mirror_points(scene.model.vertices), scene.model.faces[:, ::-1].copy()
    )
    # S_x R S_y of the rotation, S_x of the position.
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(scene.pose_camera_object[3:], scalar_first=True).as_matrix()
    turn = np.diag(FLIP) @ turn @ np.diag([1.0, -1.0, 1.0])
    pose = np.concatenate(
        [scene.pose_camera_object[:3] * FLIP, Rotation.from_matrix(turn).as_quat(scalar_first=True)]
    )
    hand = dataclasses.replace(
        detected,
        pixels=detected.pixels * [-1.0, 1.0] + [width, 0.0],
        shape_camera=detected.shape_camera * FLIP,
        side="left",
    )
    return image, model, ObjectEstimate(pose, 0.9, True), hand


def test_a_left_hand_is_mirrored_on_the_way_in():
    scene, detected = mug()
    right = perceive(
        scene.capture,
        scene.model,
        detector=StandIn(detected),
        object_estimate=known(scene),
        table=scene.table,
    )
    image, model, obj, hand = mirrored(scene, detected)
    left = perceive(
        image, model, detector=StandIn(hand), object_estimate=obj, table=scene.table * [-1, 1, 1, 1]
    )
    assert left.hand.side == "left" and left.grasp.object_name == "gum_mirrored"
    assert left.grasp.objects["gum_mirrored"].mirror_image is model
    # Other pixels show the hand, and the meshes' distance grids differ by a fraction of a cell: either may
    # decide the search of a finger.
    apart = np.linalg.norm(left.hand.joints_camera * FLIP - right.hand.joints_camera, axis=1)
    assert np.median(apart) < 4e-3 and apart.max() < 0.012
    # The mirrored mesh of the mirrored mesh is the first one.
    apart = np.linalg.norm(in_object(left) - in_object(right), axis=1)
    assert np.median(apart) < 4e-3 and apart.max() < 0.012
    np.testing.assert_allclose(left.grasp.object_rest_pose[2], right.grasp.object_rest_pose[2], atol=1e-6)
    assert (left.grasp.link_contacts == right.grasp.link_contacts).sum() >= 15


def test_of_two_hands_the_one_at_the_object_is_taken():
    scene, detected = mug()
    other = dataclasses.replace(detected, pixels=detected.pixels * 0.5 + [10.0, 10.0], score=0.99)
    u, v = CAMERA.project(scene.pose_camera_object[:3])
    capture = scene.capture.with_object(box=(u - 40, v - 40, u + 40, v + 40))
    found = StandIn(other, detected)
    for image in (capture, scene.capture):
        perceived = perceive(image, scene.model, detector=found, object_estimate=known(scene))
        np.testing.assert_array_equal(perceived.hand.pixels, detected.pixels)
        assert perceived.confident and "2 hands are in the image; the one nearest" in str(
            perceived.warnings[0]
        )


def test_of_two_hands_the_one_that_holds_the_object_is_taken(monkeypatch):
    scene, detected = mug()
    middle = detected.pixels.mean(axis=0)
    larger = dataclasses.replace(
        detected, pixels=(detected.pixels - middle) * 1.3 + middle + [60.0, 0.0], side="left", side_score=0.55
    )

    def estimate(capture, mesh, hand, table, seed):
        near = np.linalg.norm(hand.pixels.mean(axis=0) - middle) < 5
        return known(scene, 0.95 if near else 0.4)

    monkeypatch.setattr(pipeline, "estimate_object_pose", estimate)
    perceived = perceive(scene.capture, scene.model, detector=StandIn(larger, detected))
    np.testing.assert_array_equal(perceived.hand.pixels, detected.pixels)
    assert "2 hands are in the image; the one that holds" in str(perceived.warnings[0])
    # What was uncertain about the other hand is of no interest.
    assert "side_from_fingers" not in {warning.code for warning in perceived.warnings}


def test_a_hand_hidden_by_somebody_elses_is_looked_for(monkeypatch):
    """The detector stops at a hand that is easy to see; the object is not at it."""
    scene, detected = mug()
    away = np.array([-120.0, -60.0]) if detected.pixels[:, 0].mean() > 160 else np.array([120.0, -60.0])
    somebody = dataclasses.replace(detected, pixels=detected.pixels + away, score=0.99)
    looks = []

    class StopsAtTheFirst:
        def detect(self, color, near=None):
            looks.append(color)
            return [somebody] if len(looks) == 1 else [detected]

    def search(capture, mesh, hand, table, seed):
        held = np.abs(hand.pixels - detected.pixels).max() < 1
        return known(scene, score=0.8) if held else dataclasses.replace(known(scene, 0.3), accepted=False)

    monkeypatch.setattr(pipeline, "estimate_object_pose", search)
    perceived = perceive(scene.capture, scene.model, detector=StopsAtTheFirst())
    assert len(looks) == 2 and perceived.object.accepted
    error = np.linalg.norm(perceived.hand.joints_camera - scene.joints, axis=1)
    assert error.mean() < 0.02
    assert any(w.code == "several_candidates" for w in perceived.warnings)


@pytest.mark.parametrize(("score", "looked"), [(0.3, 2), (0.7, 1)])
def test_no_other_hand_is_looked_for_where_this_one_rather_holds_the_object(monkeypatch, score, looked):
    scene, detected = mug()
    looks = []

    class FindsOne:
        def detect(self, color, near=None):
            looks.append(color)
            return [detected] if len(looks) == 1 else []

    not_accepted = dataclasses.replace(known(scene, score), accepted=False)
    monkeypatch.setattr(pipeline, "estimate_object_pose", lambda *_, **__: not_accepted)
    assert not perceive(scene.capture, scene.model, detector=FindsOne()).object.accepted
    assert len(looks) == looked


def test_fingers_tell_which_hand_it_is_where_the_model_is_in_doubt():
    _, detected = mug()
    assert settle_side(detected)[0] is detected
    doubtful = dataclasses.replace(detected, side="left", side_score=0.55)
    settled, (warning,) = settle_side(doubtful)
    assert settled.side == "right" and "fingers bend like those of a right one" in str(warning)
    np.testing.assert_array_equal(settled.pixels, detected.pixels)
    # The model is sure, the landmarks can't be.
    wrong, (warning,) = settle_side(dataclasses.replace(doubtful, side_score=0.99))
    assert (wrong.side, wrong.score) == (
        "left",
        detected.score / 2,
    ) and warning.code == "fingers_bent_backwards"
    assert settle_side(doubtful, "left")[0].side == "left"


def test_no_hand_or_one_in_a_glove():
    scene, _ = mug()
    gray = dataclasses.replace(scene.capture, color=np.full_like(scene.capture.color, 120))
    with pytest.raises(FungraspError, match=r"no hand was found .* must be bare"):
        perceive(gray, scene.model, detector=StandIn())
    dark = dataclasses.replace(scene.capture, color=np.full_like(scene.capture.color, 12))
    with pytest.raises(FungraspError, match=r"no hand was found .* too dark"):
        perceive(dark, scene.model, detector=StandIn())


def test_swapped_colors_show_by_the_hand():
    scene, detected = mug()
    skin = np.full_like(scene.capture.color, (70, 55, 40))
    swapped = dataclasses.replace(scene.capture, color=np.ascontiguousarray(skin[..., ::-1]))
    for capture, codes in ((dataclasses.replace(swapped, color=skin), []), (swapped, ["colors_swapped"])):
        warnings = plausibility_warnings(capture, seen().hand, seen().object, scene.model)
        assert [one.code for one in warnings] == codes

    class OfRedHands:
        def detect(self, color, near=None):
            return [detected] if color[0, 0, 0] > color[0, 0, 2] else []

    with pytest.raises(FungraspError, match="one is with red and blue swapped"):
        perceive(swapped, scene.model, detector=OfRedHands())


def test_what_is_cut_off_at_the_edge_is_not_sure():
    scene, detected = mug()
    model, pose = scene.model, scene.pose_camera_object
    columns = CAMERA.project(transform_points(pose, model.vertices))[:, 0], detected.pixels[:, 0]
    first = int(min(column.min() for column in columns)) + 20
    lens = dataclasses.replace(CAMERA, width=CAMERA.width - first, cx=CAMERA.cx - first)
    cut = Capture(scene.capture.color[:, first:].copy(), scene.capture.depth[:, first:].copy(), lens)
    found = perceive(
        cut, model, detector=StandIn(dataclasses.replace(detected, pixels=detected.pixels - [first, 0]))
    )
    assert found.object.accepted and not found.confident
    assert found.acceptance.doubt.endswith("is cut off at the left edge of the image")
    assert found.hand.confidence.max() < SURE_JOINT < seen().hand.confidence.max()


def test_the_wrong_mesh_is_not_believed():
    scene, detected = mug()
    perceived = perceive(
        scene.capture.with_object(object_pixels()), builtin_object("hammer"), detector=StandIn(detected)
    )
    assert not perceived.confident and perceived.acceptance.help
    record = perceived.as_json()["acceptance"]
    assert record["sure"] is False and record["object"] == perceived.object.score
    assert [row["name"] for row in record["evidence"]] == [one.name for one in perceived.acceptance.evidence]
    assert perceived.grasp.object_name == "hammer"


def test_joints_that_nothing_speaks_for_are_not_sure():
    scene, _ = mug()
    found = seen()
    fitted = found.candidates[0].hand
    same = joint_probabilities(scene.capture, fitted, found.hand, True)
    np.testing.assert_array_equal(same, found.hand.confidence)
    behind = found.hand.joints_camera.copy()
    behind[17:] += 0.055 * behind[17:] / np.linalg.norm(behind[17:], axis=1, keepdims=True)
    behind[17:, 0] += 0.02
    moved = dataclasses.replace(found.hand, joints_camera=behind)
    wrong = joint_probabilities(scene.capture, fitted, moved, True)
    assert wrong[17:].mean() < 0.6 < found.hand.confidence[17:].min()
    assert (wrong < found.hand.confidence).all()
    unknown = joint_probabilities(scene.capture, fitted, found.hand, False)
    assert (unknown < found.hand.confidence).all()


def test_a_mesh_in_millimeters_is_refused():
    scene, _ = mug()
    for factor, sides in ((1000, "x 95,000 mm"), (4, "x 380 mm")):
        model = ObjectModel("mug", 0.3, scene.model.vertices * factor, scene.model.faces)
        with pytest.raises(FungraspError, match=f"{sides}, which no hand holds: is its unit right"):
            perceive(scene.capture, model, detector=Forbidden())


def test_a_hand_too_faint_to_lead_to_the_table_is_kept_above_it():
    scene, detected = mug()
    faint = dataclasses.replace(detected, score=0.35)
    perceived = perceive(scene.capture, scene.model, detector=StandIn(faint), object_estimate=known(scene))
    assert perceived.table_found and not perceived.confident
    assert "more of the hand" in perceived.acceptance.help[-1]
    np.testing.assert_allclose(perceived.table, scene.table, atol=0.01)
    assert np.linalg.norm(perceived.hand.joints_camera - scene.joints, axis=1).mean() < 0.012


def test_without_a_table_the_world_is_a_guess():
    scene, detected = mug()
    heights = scene.capture.points() @ scene.table[:3] + scene.table[3]
    depth = np.where(heights > 0.004, scene.capture.depth, 0).astype(np.float32)
    perceived = perceive(
        Capture(scene.capture.color, depth, CAMERA),
        scene.model,
        detector=StandIn(detected),
        object_estimate=known(scene),
    )
    assert not perceived.table_found and any(
        "no table was found" in str(warning) for warning in perceived.warnings
    )
    assert perceived.confident
    surface = transform_points(perceived.grasp.object_pose, scene.model.vertices)
    lowest = min(surface[:, 2].min(), perceived.grasp.hand_joints[:, 2].min())
    assert lowest == pytest.approx(0.0, abs=1e-6)


def test_a_wall_is_no_table():
    """A wall close behind fills more of the image than the table."""
    scene, _ = mug()
    away = np.array([0.0, 0.0, 1.0]) - scene.table[:3] * scene.table[2]
    wall = np.append(-away, away @ scene.pose_camera_object[:3]) / np.linalg.norm(away)
    wall[3] += 0.06
    heights = scene.capture.points() @ scene.table[:3] + scene.table[3]
    slope = CAMERA.rays() @ wall[:3]
    reach = np.where(slope < -1e-3, -wall[3] / np.minimum(slope, -1e-3), 9.0)
    depth = np.where(heights < 0.004, np.minimum(scene.capture.depth, reach), scene.capture.depth)
    depth[CAMERA.height * 3 // 4 :] = 0.0
    walled = Capture(scene.capture.color, depth.astype(np.float32), CAMERA)
    seen = walled.points()[walled.measured]
    assert (np.abs(seen @ wall[:3] + wall[3]) < 1e-2).sum() > (
        np.abs(seen @ scene.table[:3] + scene.table[3]) < 1e-2
    ).sum()
    found = table_under(walled, scene.joints, np.random.default_rng(0))
    assert found is not None
    np.testing.assert_allclose(found, scene.table, atol=0.01)


def test_the_record_goes_on_and_says_what_happened():
    scene, detected = mug()
    found = seen()
    assert found.capture is scene.capture and len(repr(found)) < 100
    assert len(found.grasps) == 1
    # The mesh is the one in the image, even if a built-in object has the same name.
    assert load_objects(found.grasps) == load_objects(found) == {"mug": scene.model}
    np.testing.assert_array_equal(found.grasps[0].hand_joints, found.grasp.hand_joints)
    (candidate,) = found.candidates
    assert candidate.detected is detected and candidate.holds
    np.testing.assert_array_equal(candidate.object.pose_camera_object, found.object.pose_camera_object)


def test_an_image_may_be_where_it_is(tmp_path):
    scene, detected = mug()
    write_folder(scene.capture, tmp_path / "image")
    files = [tmp_path / "image" / name for name in ("rgb.png", "depth.png", "K.json")]
    options = {"detector": StandIn(detected), "object_estimate": known(scene)}
    by_folder = perceive(tmp_path / "image", scene.model, **options)
    by_files = perceive(files, "mug", mass=scene.model.mass, **options)
    np.testing.assert_array_equal(by_folder.grasps.hand_joints, by_files.grasps.hand_joints)
    with pytest.raises(FungraspError, match="not 2 files"):
        perceive(files[:2], scene.model, **options)
    with pytest.raises(FungraspError, match="already has a mass"):
        perceive(scene.capture, scene.model, mass=0.3, **options)


def scaled(capture: Capture, factor: float) -> Capture:
    """By another unit of depth."""
    return dataclasses.replace(capture, depth=(capture.depth * factor).astype(np.float32))


def test_a_hand_of_another_size_tells_of_a_wrong_scale():
    scene, detected = mug()
    large = dataclasses.replace(detected, shape_camera=1.5 * detected.shape_camera)
    capture = scaled(scene.capture, 1.5)
    found = perceive(capture, scene.model, detector=StandIn(large))
    (warning,) = (one for one in found.warnings if one.code == "hand_size")
    assert 1.25 < float(warning.values["size"]) < 1.6 and not found.confident
    assert not any(one.code == "hand_size" for one in seen().warnings)
    # A shape that is fitted takes any size: the hand's is all that is known of the scale.
    shape = perceive(capture, "unknown", detector=StandIn(large))
    (warning,) = (one for one in shape.warnings if one.code == "hand_size")
    assert not shape.confident and shape.acceptance.doubt == str(warning)


@pytest.mark.parametrize("factor", [4.0, 0.25])
def test_a_hand_that_is_too_small_or_large_for_its_depth_is_told_as_such(factor):
    scene, detected = mug()
    with pytest.raises(FungraspError, match=r"a candidate at pixel .* times as long as a hand is at"):
        perceive(scaled(scene.capture, factor), scene.model, detector=StandIn(detected))


def test_a_side_that_the_image_denies_is_not_sure():
    scene, detected = mug()
    said = perceive(scene.capture, scene.model, detector=StandIn(detected), side="left")
    assert (
        not said.confident
        and said.acceptance.doubt == "the hand looks like a right hand, but a left one was given"
    )
    doubtful = dataclasses.replace(detected, side_score=0.6)
    said = perceive(scene.capture, scene.model, detector=StandIn(doubtful), side="left")
    assert said.hand.side == "left" and said.grasp.object_name == "mug_mirrored"
    assert not said.acceptance.doubt and said.warnings[0].code == "side_not_as_given"


def test_an_object_far_from_the_hand_or_its_origin_ends_with_a_word():
    scene, detected = mug()
    away = scene.pose_camera_object.copy()
    away[:3] += [0.2, 0.0, 3.0]
    with pytest.raises(
        FungraspError, match=r"no hand holds .*: the place given for it is \d\.\d+ m from the detected hand"
    ):
        perceive(
            scene.capture,
            scene.model,
            detector=StandIn(detected),
            object_estimate=ObjectEstimate(away, 0.9, True),
        )
    offset = ObjectModel("mug", 0.3, scene.model.vertices + np.array([5.0, 0.0, 0.0]), scene.model.faces)
    with pytest.raises(FungraspError, match=r"the origin of 'mug' is 4\.9\d m from its surface"):
        perceive(scene.capture, offset, detector=Forbidden())


def test_a_hand_without_depth_does_not_keep_another_from_being_found():
    scene, detected = mug()
    depth = scene.capture.depth.copy()
    corner = dataclasses.replace(detected, pixels=detected.pixels - detected.pixels.min(axis=0) + 1.0)
    u, v = np.ceil(corner.pixels.max(axis=0)).astype(int)
    depth[: v + 20, : u + 20] = 0.0
    capture = dataclasses.replace(scene.capture, depth=depth)
    found = perceive(capture, scene.model, detector=StandIn(corner, detected))
    assert np.linalg.norm(found.hand.joints_camera - scene.joints, axis=1).mean() < 0.02
    with pytest.raises(FungraspError, match="no depth where the hand is"):
        perceive(capture, scene.model, detector=StandIn(corner))


def test_what_looks_wrong_with_the_files_is_in_the_answer():
    scene, detected = mug()
    shifted = PerceptionWarning.of("depth_shifted", across=16, down=0)
    capture = dataclasses.replace(scene.capture, warnings=(shifted,))
    said = perceive(capture, scene.model, detector=StandIn(detected)).as_json()
    assert not said["sure"] and said["doubts"][0] == said["acceptance"]["doubt"] == str(shifted)
    assert said["warnings"][0]["values"] == {"across": 16, "down": 0}

"""Measuring perception on captures whose truth is known."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.perception.capture_job import MeasuredCapture
from benchmarks.perception.chain import chain_figures, chain_sets
from benchmarks.perception.figures import capture_rows, perception_figures, target_rows
from benchmarks.perception.measurements import (
    TIP_LINKS,
    AbsentResult,
    CaptureResult,
    HandResult,
    PoseResult,
    measure_absent,
    measure_perception,
)
from benchmarks.perception.true_landmarks import TrueLandmarks
from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.grasps import HUMAN_JOINTS, HUMAN_LINKS, HumanGraspSet, builtin_grasps
from fungrasp.jobs import PartStore
from fungrasp.objects import builtin_object
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.object_pose.known_object import MeshRays
from fungrasp.perception.perceived import StageSeconds
from fungrasp.perception.scene.segmentation import TIPS

GRASP = builtin_grasps()[0]
MODEL = builtin_object(GRASP.object_name)
RIGHT = PoseResult(1.0, 2.0, 0.9, True, {})
WRONG = PoseResult(30.0, 90.0, 0.3, False, {})


class StandIn:
    def __init__(self, *hands):
        self.hands = list(hands)

    def detect(self, color, near=None):
        return self.hands


def result(**changes) -> CaptureResult:
    hand = HandResult(True, 0.9, True, 4.0, 10.0, 8.0, 6.0)
    seconds = {"hand": StageSeconds(0.1, 0.05), "object_masked": StageSeconds(1.0, 0.5)}
    whole = CaptureResult("mug", hand, RIGHT, RIGHT, None, None, seconds, False)
    return dataclasses.replace(whole, **changes)


def measured(*perceived, **changes) -> MeasuredCapture:
    hands = HumanGraspSet.of(perceived) if perceived else None
    return MeasuredCapture(result(**changes), HumanGraspSet.of([GRASP]), hands)


def known_capture() -> Any:
    """The first built-in grasp in depth, without noise and clutter: blue object, gray table, no skin."""
    camera = Intrinsics(160, 120, 150.0, 150.0, 80.0, 60.0)
    middle = GRASP.object_pose[:3]
    # Half a metre in front of the object, 45 degrees above it.
    turn = np.array([np.cos(1.178), -np.sin(1.178), 0.0, 0.0])
    world_camera = np.concatenate([middle + 0.35 * np.array([0.0, -1.0, 1.0]), turn])
    camera_world = invert(world_camera)
    pose = compose(camera_world, GRASP.object_pose)
    rays = camera.rays().reshape(-1, 3)
    thing = MeshRays(MODEL.vertices, MODEL.faces).cast(pose[None], rays)[0]
    up = transform_points(camera_world, np.array([[0.0, 0.0, 1.0]]))[0] - camera_world[:3]
    with np.errstate(divide="ignore"):
        table = -(world_camera[2] / (rays @ up))
    depth = np.minimum(thing, np.where(table > 0, table, 3.0)).reshape(120, 160)
    mask = (thing == depth.ravel()).reshape(120, 160)
    color = np.where(mask[..., None], (60, 90, 160), 90).astype(np.uint8)
    return SimpleNamespace(
        capture=Capture(color, depth.astype(np.float32), camera),
        grasp=GRASP,
        pose_camera_object=pose,
        joints_camera=transform_points(camera_world, GRASP.hand_joints),
        object_mask=mask,
    )


def test_a_capture_is_measured_against_its_truth():
    known = known_capture()
    assert known.object_mask.sum() > 300
    pixels = known.capture.intrinsics.project(known.joints_camera)
    shape = known.joints_camera - known.joints_camera.mean(axis=0)
    seen = DetectedHand(pixels + np.array([3.0, 0.0]), shape, "right", 1.0, 0.9)
    found, perceived = measure_perception(known, MODEL, StandIn(seen), builtin_object("hammer"))
    assert found.masked.right and found.masked.add_s_mm < 4
    assert found.wrong_mesh is not None
    assert not found.wrong_mesh.right and not found.wrong_mesh.accepted
    assert found.hand.found and found.hand.right_side
    assert found.hand.pixel_error == pytest.approx(3.0 * 4), "as of an image 640 wide"
    assert found.hand.joint_error_mm > 0 and perceived is not None
    assert set(found.seconds) == {"mesh", "hand", "object_masked", "object_unmasked", "perceive"}
    parts = [found.seconds[name].wall for name in ("hand", "object_unmasked")]
    assert found.seconds["perceive"].wall > sum(parts)


def test_without_a_hand_there_is_neither_grasp_nor_pose():
    found, perceived = measure_perception(known_capture(), MODEL, StandIn())
    assert perceived is None and not found.hand.found and found.wrong_mesh is None
    assert not found.masked.right and not found.masked.accepted and found.seconds == {}
    figures = perception_figures([found])
    assert figures["hand"]["found"]["rate"] == 0 and figures["hand"]["joint_error_mm"] is None
    assert capture_rows([found])[0]["hand"]["joint_error_mm"] is None


def test_landmarks_that_are_true_but_for_noise():
    known = known_capture()
    lens = known.capture.intrinsics
    pixels = lens.project(known.joints_camera)
    rng = np.random.default_rng(0)
    off = np.concatenate(
        [
            TrueLandmarks(known.joints_camera, lens, 6.0, rng).detect(known.capture.color)[0].pixels - pixels
            for _ in range(40)
        ]
    )
    # The image is 160 wide.
    assert off.std() == pytest.approx(6.0 / 4, rel=0.1) and abs(off.mean()) < 0.1
    (hand,) = TrueLandmarks(known.joints_camera, lens, 0.0, rng).detect(known.capture.color)
    np.testing.assert_allclose(hand.pixels, pixels)
    found, _ = measure_perception(known, MODEL, StandIn(hand))
    assert hand.side == "right" and found.hand.pixel_error == pytest.approx(0.0, abs=1e-9)


def test_each_tip_ends_its_own_fingers_last_link():
    for tip, link in zip(TIPS, TIP_LINKS, strict=True):
        assert HUMAN_JOINTS[tip].removesuffix("_tip") == HUMAN_LINKS[link].removesuffix("_distal")


def test_figures():
    results = [
        result(),
        result(unmasked=WRONG, hand=HandResult(False)),
        result(wrong_mesh=dataclasses.replace(WRONG, add_s_mm=np.inf, accepted=True)),
        result(unmasked=dataclasses.replace(RIGHT, add_s_mm=3.0)),
    ]
    results[0] = dataclasses.replace(results[0], sure=True)
    figures = perception_figures(results)
    assert figures["hand"]["sure"]["count"] == 1
    assert figures["hand"]["sure"]["refined_joint_error_mm"]["mean"] == 8.0
    assert figures["hand"]["found"]["rate"] == 0.75
    assert figures["object_masked"]["right"]["rate"] == 1
    assert figures["object_unmasked"]["right"]["rate"] == 0.75
    assert figures["object_unmasked"]["accepted_and_right"]["rate"] == 1
    assert figures["object_unmasked"]["add_s_mm"]["median"] == 2.0
    assert figures["wrong_mesh"]["accepted"]["count"] == 1
    # Four with a mask, three without, and the wrong mesh's, which is none.
    assert figures["accepted"]["right"]["rate"] == pytest.approx(7 / 8)
    assert figures["seconds"]["object_masked"]["median_cpu"] == 0.5


def test_what_is_not_there_counts_as_wrong_where_it_is_accepted():
    nowhere = dataclasses.replace(WRONG, add_s_mm=np.inf)
    believed = dataclasses.replace(nowhere, accepted=True)
    results = [
        result(absent=AbsentResult(0.9, believed)),
        result(absent=AbsentResult(0.0, nowhere)),
        result(),
    ]
    figures = perception_figures(results)
    assert figures["no_hand"]["sure"]["count"] == 2 and figures["no_hand"]["sure"]["rate"] == 0.5
    assert figures["no_object"]["accepted"]["rate"] == 0.5
    assert figures["accepted"]["right"]["rate"] == pytest.approx(6 / 7)


def test_an_absent_object_is_looked_for_in_the_empty_hand():
    known = known_capture()
    empty = Capture(known.capture.color, np.full_like(known.capture.depth, 2.0), known.capture.intrinsics)
    found = measure_absent(empty, empty, MODEL, StandIn())
    assert found.hand_score == 0 and not found.pose.accepted and found.pose.add_s_mm == np.inf


def test_targets_are_met_or_not():
    rows = {words: met for words, _, _, met in target_rows(perception_figures([result(), result()]))}
    assert rows["object right, no mask"] == "yes" and rows["hand, median"] == "yes"
    poor = [result(unmasked=WRONG), result(seconds={"hand": StageSeconds(0.5, 0.1)})]
    rows = {
        words: (value, met)
        for words, value, _, met in target_rows(perception_figures(poor[:1]) | {"peak_memory_gb": 2.5})
    }
    assert rows["object right, no mask"] == ("0.0 %", "no")
    assert rows["peak memory"] == ("2.50 GB", "no")
    assert "success of the chain, in that of the true grasps" not in rows


def test_what_perception_did_not_find_counts_as_failed_in_the_chain():
    mirrored = dataclasses.replace(GRASP, object_name="mug_mirrored")
    results = [measured(GRASP), measured(), measured(mirrored)]
    true, found, rows = chain_sets(results, {GRASP.object_name: MODEL})
    assert len(true) == 3 and found is not None and len(found) == 1 and rows.tolist() == [0]
    np.testing.assert_array_equal(found.hand_joints[0], GRASP.hand_joints)
    sure = np.array([True, False, True])
    figures = chain_figures(np.array([True, True, False]), np.array([True]), rows, sure)
    assert figures["perceived"]["rate"] == pytest.approx(1 / 3)
    assert figures["share"] == pytest.approx(0.5)
    assert figures["perceived_where_sure"]["rate"] == 0.5


def test_the_chain_of_nothing():
    true, found, rows = chain_sets([measured()], {})
    assert len(true) == 1 and found is None and rows.shape == (0,)
    figures = chain_figures(np.array([False]), np.zeros(0, bool), rows, np.array([False]))
    assert figures["share"] is None and figures["perceived_where_sure"] is None


def test_a_measured_capture_is_the_same_when_read_again(tmp_path):
    absent = AbsentResult(0.2, dataclasses.replace(WRONG, add_s_mm=np.inf, rotation_deg=np.nan))
    whole = measured(GRASP, sure=True, wrong_mesh=WRONG, absent=absent)
    store = PartStore(tmp_path / "kept")
    store.save("3", whole.arrays())
    store.save("4", measured(hand=HandResult(False)).arrays())
    kept, other = store.load("3"), store.load("4")
    assert kept is not None and other is not None
    read = MeasuredCapture.from_arrays(kept)
    assert capture_rows([read.result]) == capture_rows([whole.result])
    assert read.result.absent is not None and read.result.absent.pose.add_s_mm == np.inf
    assert read.perceived is not None and MeasuredCapture.from_arrays(other).perceived is None
    assert read.true.digest == whole.true.digest and read.perceived.digest == whole.true.digest

"""Poses of other programs, judged by the depth."""

from dataclasses import replace

import numpy as np
import pytest
from object_pose_scenes import scene

from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector
from fungrasp.objects import load_object
from fungrasp.perception import Capture
from fungrasp.perception.acceptance import ACCEPT
from fungrasp.perception.io.estimates import ObjectEstimate
from fungrasp.perception.object_pose.estimate import score_given_pose
from fungrasp.perception.object_pose.pose_evidence import ambiguity

MUG = load_object("mug")
LIFTED = np.concatenate([[0.0, 0.0, 0.08], quaternion_from_rotation_vector(np.array([0.3, 0.2, 0.8]))])
SCENE = scene(MUG, LIFTED, np.array([0.05, 0.0, 0.06]))


def said(shift: tuple[float, float, float] = (0, 0, 0)) -> ObjectEstimate:
    """The true pose, moved in the camera frame [m], as a file without a score gives it."""
    pose = SCENE.pose + np.concatenate([shift, np.zeros(4)])
    return ObjectEstimate(pose, ACCEPT, True, judged=False)


@pytest.mark.parametrize("masked", [True, False])
def test_a_pose_is_right_or_wrong_whatever_its_program_says(masked: bool) -> None:
    capture = SCENE.capture.with_object(mask=SCENE.mask) if masked else SCENE.capture
    right = score_given_pose(
        replace(said(), score=0.1, accepted=False), capture, MUG, SCENE.hand, SCENE.table
    )
    assert right.accepted and right.judged and right.note == ""
    assert right.pose_camera_object.tobytes() == SCENE.pose.tobytes(), "it is not moved"
    wrong = score_given_pose(said((0.05, 0.0, 0.0)), capture, MUG, SCENE.hand, SCENE.table)
    assert not wrong.accepted and wrong.evidence is not None and wrong.score < 0.2
    again = score_given_pose(said(), capture, MUG, SCENE.hand, SCENE.table)
    assert again.score == right.score


def test_a_pose_that_is_nearly_right_can_be_improved() -> None:
    capture = SCENE.capture.with_object(mask=SCENE.mask)
    kept = score_given_pose(said((0.004, 0.0, 0.004)), capture, MUG, SCENE.hand, SCENE.table)
    better = score_given_pose(said((0.004, 0.0, 0.004)), capture, MUG, SCENE.hand, SCENE.table, improve=True)
    assert kept.accepted and better.accepted and kept.score == better.score
    assert np.linalg.norm(better.pose_camera_object[:3] - SCENE.pose[:3]) < 0.002


def test_without_depth_at_the_object_it_is_not_sure() -> None:
    mask = np.zeros_like(SCENE.mask)
    mask[:3, :3] = True
    capture = Capture(SCENE.capture.color, SCENE.capture.depth, SCENE.capture.intrinsics, mask)
    judged = score_given_pose(said(), capture, MUG)
    assert not judged.accepted and judged.score == 0.0
    assert "can't be compared with the depth: the mask has only 9 pixels" in judged.note


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_a_pose_that_fits_the_other_way_round_as_well_is_warned_of(turn: float) -> None:
    """The front and the back of a spray bottle are much alike, but the true one fits clearly better; a bowl
    looks the same from all sides."""
    for name, alike in (("spray_bottle", turn > 0), ("bowl", False)):
        model = load_object(name)
        there = scene(model, model.rest_pose(0.4), np.array([0.05, 0.0, 0.1]))
        around = np.array([0, 0, 0, np.cos(turn / 2), 0, 0, np.sin(turn / 2)])
        given = ObjectEstimate(compose(there.pose, around), ACCEPT, True, judged=False)
        capture = there.capture.with_object(mask=there.mask)
        judged = score_given_pose(given, capture, model, there.hand, there.table)
        warning = ambiguity(model, judged)
        assert (warning is not None and warning.code == "object_orientation") == alike
        assert judged.alternatives and all(score <= judged.score for _, score in judged.alternatives)
        assert judged.pose_camera_object.tobytes() == given.pose_camera_object.tobytes()

"""Held as shown: by hand-made cases, and as the reference implementation of the definition says."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lifted_grasps import allegro_hand, good_grasps, grasped_objects, human_grasps

from fungrasp.evaluation import evaluate
from fungrasp.evaluation.grasp_quality import static_quality
from fungrasp.grasps import RobotGraspSet, save_human_grasps, save_robot_grasps
from fungrasp.grasps.as_shown import AsShown, ShownContacts, ShownJudge, place_marks, with_shown_places
from fungrasp.hands.correspondence import correspond

TOOL = Path(__file__).parents[3] / "shared" / "tools" / "as_shown.py"
MOVED = {
    "fungrasp.evaluation.grasp_quality import nearest_surface_points": (
        "fungrasp.objects.object_model import nearest_surface_points"
    ),
    "fungrasp.hands.collision_spheres": "fungrasp.hands.collisions",
    "fungrasp.optimization.collision_scene": "fungrasp.geometry.signed_distance",
}


def judged(grasps: RobotGraspSet, touching: bool | None = None) -> AsShown:
    contacts = ShownContacts.of(grasps)
    assert contacts is not None
    palm = grasps.wrist_pose_object
    flags = None if touching is None else np.full(contacts.wanted.shape, touching)
    return ShownJudge(allegro_hand(), grasped_objects())(palm, grasps.joint_positions, contacts, flags)


def of_thumb() -> np.ndarray:
    return correspond(allegro_hand()).is_thumb


def at_its_own_places() -> RobotGraspSet:
    """Grasps whose person touched exactly where the robot does."""
    grasps = with_shown_places(good_grasps(), human_grasps(), grasped_objects())
    everywhere = replace(grasps, link_contacts=np.ones_like(grasps.link_contacts))
    return replace(everywhere, shown_places=judged(everywhere, True).points)


def test_a_hand_at_the_places_is_as_shown_and_one_that_does_not_touch_is_not():
    grasps = at_its_own_places()
    there = judged(grasps, True)
    np.testing.assert_allclose(there.place_error, 0.0, atol=1e-9)
    np.testing.assert_allclose(there.share, 1.0 - there.other_side)
    assert not there.strays.any() and not judged(grasps, False).holds.any()


def test_places_within_two_centimeters_count_on_the_same_side_alone():
    grasps = at_its_own_places()
    places, normals = grasps.shown_places, grasps.shown_normals
    assert places is not None and normals is not None
    for shift, near in ((0.019, True), (0.021, False)):
        moved = judged(replace(grasps, shown_places=places + np.array([shift, 0.0, 0.0])), True)
        np.testing.assert_allclose(moved.place_error, shift, atol=1e-9)
        assert moved.shown.any() == near
    turned = judged(replace(grasps, shown_normals=-normals), True)
    np.testing.assert_array_equal(turned.shown, ~judged(grasps, True).shown)


def test_the_thumb_and_two_thirds_of_the_links_are_needed():
    grasps = at_its_own_places()
    places, wanted = grasps.shown_places, np.zeros_like(grasps.link_contacts)
    assert places is not None
    names = allegro_hand().link_names
    tips = [names.index(name) for name in ("index_distal", "middle_distal", "thumb_distal")]
    wanted[:, tips] = True
    asked = replace(grasps, link_contacts=wanted)
    normals = judged(asked, True)
    if not normals.holds.all():
        pytest.fail("the good grasps touch with these three tips, each on its side")
    for away, holds in ((tips[0], True), (tips[2], False)):
        moved = places.copy()
        moved[:, away - 1] += [0.0, 0.0, 0.1]
        found = judged(replace(asked, shown_places=moved), True)
        np.testing.assert_allclose(found.share, 2 / 3)
        assert found.holds.all() == holds
        assert set(found.reason) == {"" if holds else "the thumb is more than 20 mm off"}
    assert set(judged(asked, False).reason) == {"the thumb does not touch"}
    assert set(judged(replace(asked, link_contacts=np.zeros_like(wanted))).reason) == {"no link is wanted"}
    fingers = replace(asked, shown_normals=np.where(of_thumb()[:, None], 1.0, -1.0) * asked.shown_normals)
    assert set(judged(fingers, True).reason) == {"fingers are on the other side"}


def test_what_is_drawn_are_the_wanted_links():
    grasps, objects = at_its_own_places(), grasped_objects()
    wanted = good_grasps().link_contacts
    asked = replace(grasps, link_contacts=wanted)
    marks, found = place_marks(asked, 1, objects), judged(asked)
    assert marks is not None
    np.testing.assert_allclose(marks.points, found.points[1, wanted[1, 1:]], atol=1e-12)
    np.testing.assert_array_equal(marks.shown, found.shown[1, wanted[1, 1:]])
    assert marks.words == f"{marks.shown.sum()} of {wanted[1, 1:].sum()} links, 0 mm"
    assert place_marks(replace(asked, shown_places=None, shown_normals=None), 1, objects) is None


@pytest.mark.skipif(not TOOL.is_file(), reason="the reference implementation is not beside this clone")
def test_static_grasps_and_episodes_agree_with_the_reference_implementation(tmp_path):
    human, robot, objects = human_grasps(), good_grasps(), grasped_objects()
    source = TOOL.read_text()
    for before, after in MOVED.items():
        source = source.replace(before, after)
    tool = tmp_path / "tool.py"
    tool.write_text(source)
    save_human_grasps(tmp_path / "human.npz", human)
    save_robot_grasps(tmp_path / "robot.npz", robot)
    result = evaluate(robot, objects, human=human, threads=1, record=tmp_path / "episodes")
    quality, outcomes = static_quality(robot, human, objects), result.outcomes
    ours = {
        "static": (quality.held_as_shown, quality.shown_share, quality.place_error_mm, quality.strays),
        "episodes": (
            outcomes.held_as_shown,
            outcomes.shown_share,
            outcomes.place_error_mm,
            outcomes.strays,
        ),
    }
    for name, (held, share, place, strays) in ours.items():
        options = ["--recordings", "episodes"] if name == "episodes" else []
        command = [sys.executable, "tool.py", "--human", "human.npz", "--robot", "robot.npz", *options]
        subprocess.run([*command, "--json", "numbers.json"], cwd=tmp_path, check=True, timeout=300)
        theirs = json.loads((tmp_path / "numbers.json").read_text())["episodes"]
        assert [each["held_as_shown"] for each in theirs] == held.astype(bool).tolist()
        np.testing.assert_allclose([each["shown_share"] for each in theirs], share, atol=1e-6)
        # Recordings are in single precision.
        np.testing.assert_allclose([each["place_error_mm"] for each in theirs], place, atol=1e-3)
        assert [each["strays"] for each in theirs] == strays.astype(int).tolist()

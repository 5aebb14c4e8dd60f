"""The use test on grasps: which parts people hold, and how outcomes are summarized."""

from __future__ import annotations

import numpy as np
from lifted_grasps import allegro_hand, good_grasps, grasped_objects, human_grasps

from fungrasp.evaluation import LiftTestSpec, evaluate, replay
from fungrasp.evaluation.results import result_json
from fungrasp.evaluation.use_evaluation import use_json
from fungrasp.geometry.poses import inverse_transform_points
from fungrasp.grasps import builtin_grasps, load_objects
from fungrasp.grasps.as_shown import shown_places
from fungrasp.hands.correspondence import correspond
from fungrasp.objects.object_model import nearest_parts
from fungrasp.planning import MotionPlanner
from fungrasp.task import DIVERGED
from fungrasp.task.use import UseOutcomes, load_use_motions


def test_people_hold_what_their_specification_says():
    grasps, match = builtin_grasps(), correspond(allegro_hand())
    rows = [
        int(np.flatnonzero((grasps.object_name == name) & (grasps.task == task))[0])
        for name, task in (("mug", "drink"), ("hammer", "hammer"), ("screwdriver", "drive"))
    ]
    human = grasps.select(rows)
    objects = load_objects(human)
    places = shown_places(human, objects, match)[0]
    wanted = match.link_contacts(human.link_contacts)[:, 1:]
    for row, part in enumerate(("handle", "grip", "handle")):
        parts = nearest_parts(objects[str(human.object_name[row])], places[row, wanted[row]])
        assert (parts == part).mean() > 0.5


def test_the_trigger_is_held_by_the_index_finger():
    grasps, hand = builtin_grasps(), allegro_hand()
    human = grasps.select(np.flatnonzero(grasps.task == "drill")[:1])
    objects = load_objects(human)
    places = shown_places(human, objects, correspond(hand))[0]
    tip = hand.link_names.index("index_distal") - 1
    assert nearest_parts(objects["drill"], places[0, [tip]]) == ["trigger"]


def test_evaluate_adds_the_use_test():
    objects = grasped_objects()
    asked = LiftTestSpec(use=True)
    result = evaluate(good_grasps(), objects, spec=asked, human=human_grasps(), threads=1)
    assert result.use is not None
    tested = result.use.motion != ""
    assert tested.any() and not (tested & ~result.outcomes.success).any()
    whole = result_json(result)
    assert whole["use"]["count"] == tested.sum()
    assert {trial["use_motion"] for trial in whole["trials"]} == set(result.use.motion.tolist())
    planner = MotionPlanner(allegro_hand(), objects)
    plain = evaluate(good_grasps(), objects, plans=planner, threads=1)
    assert plain.use is None and "use" not in result_json(plain)
    np.testing.assert_array_equal(plain.outcomes.lifted_height_m, result.outcomes.lifted_height_m)


def test_use_tests_are_recorded_by_themselves(tmp_path):
    objects = grasped_objects()
    motions = load_use_motions()
    asked = LiftTestSpec(use=True)
    result = evaluate(good_grasps(), objects, spec=asked, human=human_grasps(), threads=1, record=tmp_path)
    assert result.use is not None
    found = {replay(file).index: replay(file) for file in tmp_path.glob("*_use.npz")}
    tested = np.flatnonzero(result.use.motion != "")
    assert sorted(found) == tested.tolist() and len(found)
    for row, episode in found.items():
        motion = motions[str(result.use.motion[row])]
        assert (episode.success, episode.reason) == (result.use.success[row], result.use.reason[row])
        assert {name for _, name in episode.phases} == {"use"}
        assert (episode.controls is not None) == motion.only_moves
        assert episode.times[-1] <= motion.whole_duration + 1e-6
        if episode.success:
            assert episode.times[-1] > motion.duration - 0.1
        moved = np.linalg.norm(
            inverse_transform_points(episode.palm_pose, episode.object_pose[:, None, :3])[:, 0]
            - inverse_transform_points(episode.palm_pose, episode.object_pose[:, None, :3])[0, 0],
            axis=1,
        )
        assert moved.max() < 0.03 or not episode.success


def test_rates_are_over_the_grasps_that_were_tested():
    nan = np.nan
    use = UseOutcomes(
        motion=np.array(["pour", "pour", "", "screw"]),
        success=np.array([True, False, False, True]),
        shift_m=np.array([0.001, 0.02, nan, 0.0]),
        turn_rad=np.array([0.0, 0.1, nan, 0.0]),
        trigger_force_n=np.full(4, nan),
        functional_contact=np.array([1.0, 0.5, nan, 0.75]),
        reason=np.array(["", DIVERGED, "", ""]),
    )
    numbers = use_json(use, np.array(["drink", "drink", "drink", "drive"]))
    assert (numbers["count"], numbers["success_rate"]) == (3, 2 / 3)
    assert numbers["by_task"]["drink"]["success_rate"] == 0.5
    assert numbers["functional_contact"] == 0.75
    assert (numbers["unstable"], numbers["by_task"]["drive"]["unstable"]) == (1, 0)

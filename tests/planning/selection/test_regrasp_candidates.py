"""Other grips of the same object for its use, and how much of a use motion's load contacts can take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from planned_grasps import belief, grasps_and_objects, hand, plan

from fungrasp.geometry.poses import compose, invert
from fungrasp.grasps import RobotGraspSet
from fungrasp.planning import MotionPlanner, MotionSettings
from fungrasp.planning.selection.regrasp_candidates import parts_to_hold, regrasp_candidates, resisted_share
from fungrasp.task import GraspPlan


def handed_over() -> RobotGraspSet:
    grasps = grasps_and_objects()[0]
    return replace(grasps, task=np.array(["hand over", "hand over"]))


def grips(grasps: RobotGraspSet, rows: list[int], kept: int = 3) -> RobotGraspSet:
    objects = grasps_and_objects()[1]
    some = np.array(rows)
    return regrasp_candidates(
        grasps.select(some), belief().select(some), hand(), objects, 16, 2, kept, seed=0
    )


def strength(grasps: RobotGraspSet) -> np.ndarray:
    objects = grasps_and_objects()[1]
    planner = MotionPlanner(hand(), objects, MotionSettings(for_use=True))
    which = np.resize([0, 1], len(grasps))
    plans = planner.plan(grasps, belief().select(which))
    assert grasps.task is not None
    return resisted_share(plans, grasps.task, hand(), objects)


def test_a_pull_is_taken_by_other_grips_than_the_given_one():
    given = handed_over()
    found = strength(grips(given, [0, 1])).reshape(3, 2).max(axis=0)
    assert (found > strength(given)).all()


def test_grips_stay_at_the_object_and_each_is_its_own():
    given = handed_over()
    found = grips(given, [0, 1])
    assert found.object_name.tolist() == given.object_name.tolist() * 3
    np.testing.assert_array_equal(found.link_contacts[:2], given.link_contacts)
    places = compose(invert(found.object_pose), found.wrist_pose)[:, :3]
    assert (np.linalg.norm(places, axis=1) < 0.25).all()
    assert len(np.unique(places.round(6), axis=0)) == 6


def test_grips_of_a_grasp_do_not_depend_on_the_others():
    given = handed_over()
    both, alone = grips(given, [0, 1]), grips(given, [1])
    np.testing.assert_allclose(both.wrist_pose[1::2], alone.wrist_pose, atol=1e-9)
    np.testing.assert_allclose(both.joint_positions[1::2], alone.joint_positions, atol=1e-9)


def share(plans: GraspPlan, *tasks: str) -> np.ndarray:
    return resisted_share(plans, np.array(tasks), hand(), grasps_and_objects()[1])


def test_what_has_no_motion_is_withstood():
    assert share(plan(), "read", "").tolist() == [1.0, 1.0]


def test_a_hand_that_touches_nothing_withstands_nothing():
    away = plan().grasp_palm_pose.copy()
    away[:, :3] += 0.5
    assert share(replace(plan(), grasp_palm_pose=away), "drink", "hand over").tolist() == [0.0, 0.0]


def test_a_light_object_is_tilted_more_easily_than_a_heavy_one():
    light, heavy = (
        share(replace(plan(), object_mass=np.full(2, mass)), "drink", "drink") for mass in (0.05, 20.0)
    )
    assert (light > 0.9).any()
    assert (heavy < 0.5).all() and (heavy <= light).all()


def test_plans_do_not_depend_on_each_other():
    both = share(plan(), "drink", "hand over")
    alone = [share(plan().select(np.array([i])), task)[0] for i, task in enumerate(("drink", "hand over"))]
    np.testing.assert_allclose(both, alone, atol=1e-9)


def test_the_parts_to_hold_are_those_under_the_links_that_should_touch():
    grasps, objects = grasps_and_objects()
    assert parts_to_hold(grasps, hand(), objects)[0] == {"body"}
    idle = replace(grasps, link_contacts=np.zeros_like(grasps.link_contacts))
    assert parts_to_hold(idle, hand(), objects) == [frozenset(), frozenset()]

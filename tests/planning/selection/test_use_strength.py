"""How much of a use motion's load contacts can take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from planned_grasps import grasps_and_objects, hand, plan

from fungrasp.planning.selection.use_strength import resisted_share
from fungrasp.task import GraspPlan


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

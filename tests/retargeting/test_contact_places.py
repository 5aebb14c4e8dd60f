"""Other places for fingertips on a flat thing, which a person takes by its edges."""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh
from retarget_scenes import held

from fungrasp.geometry import SignedDistanceGrid
from fungrasp.grasps import HumanGraspSet
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.optimization.pose_terms import contact_targets
from fungrasp.optimization.retargeting_problem import RetargetingProblem
from fungrasp.retargeting.contact_optimization import initial_pose
from fungrasp.retargeting.contact_places import with_firm_places

SIZE = np.array([0.12, 0.07, 0.016])
"""Of a plate that is thinner than an Allegro's fingertip [m]."""


@cache
def plate() -> ObjectModel:
    mesh = trimesh.creation.box(SIZE)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32)
    thing = ObjectModel("plate", 0.1, vertices, faces)
    thing.__dict__["signed_distance"] = SignedDistanceGrid.from_mesh(vertices, faces, spacing=0.002)
    return thing


def pressed_from_above(count: int) -> HumanGraspSet:
    """Grasps whose thumb and three fingers all lie on top of the plate."""
    grasps = held().select(np.zeros(count, dtype=int))
    pose = np.tile([0.0, 0, SIZE[2] / 2, 1, 0, 0, 0], (count, 1))
    joints = np.tile(grasps.hand_joints[:1], (count, 1, 1))
    joints[:, :, 2] += 0.15
    tips = {4: (0.0, -0.025), 8: (-0.03, 0.025), 12: (0.0, 0.025), 16: (0.03, 0.025)}
    for number, (joint, (x, y)) in enumerate(tips.items()):
        joints[:, joint] = (x, y, SIZE[2] + 0.008)
        joints[:, joint] += 0.001 * np.arange(count)[:, None] * (number % 2)
    contacts = np.zeros_like(grasps.link_contacts)
    contacts[:, [3, 6, 9, 12]] = True
    return HumanGraspSet(
        np.full(count, "plate"), np.full(count, 0.1), pose, pose.copy(), joints, contacts
    )


def places(rows: list[int]) -> tuple[HandPoints, RetargetingProblem, RetargetingProblem]:
    """The hand's points, the grasps as shown and with other places, of some rows of two grasps."""
    grasps, hand = pressed_from_above(2).select(rows), load_hand("allegro")
    points = HandPoints(HandKinematics(hand, len(rows)))
    shown = RetargetingProblem.from_grasps(grasps, {"plate": plate()}, points.match)
    return points, shown, with_firm_places(points, shown, *initial_pose(points, shown), 0.3)


def test_fingertips_leave_the_top_for_sides_that_oppose_each_other():
    points, shown, other = places([0, 1])
    human = points.match.human_far[np.flatnonzero(points.match.is_last)]
    wanted = shown.contacts[:, 1:][:, points.match.is_last]
    before, after = shown.normals[:, human][wanted], other.normals[:, human][wanted]
    assert (before[:, 2] > 0.9).all()
    assert (np.abs(after[:, 2]) < 0.6).sum() >= 4
    # Some press one way and some the other.
    sideways = after[np.abs(after[:, 2]) < 0.6]
    assert (sideways @ sideways.T).min() < -0.5


def test_places_are_where_a_fingertip_touches_the_object_above_the_table():
    points, _, other = places([0, 1])
    tips = np.flatnonzero(points.match.is_last)
    wanted = other.contacts[:, 1:][:, tips]
    center = contact_targets(points, other)[:, tips]
    radius = np.broadcast_to(points.far_radius[tips], wanted.shape)[wanted]
    distance = other.bank.query(other.grid, center)[0][wanted]
    np.testing.assert_allclose(distance, radius, atol=0.002)
    for plane in range(other.up.shape[1]):
        height = np.einsum("nfi,ni->nf", center, other.up[:, plane]) + other.height[:, plane, None]
        assert (height[wanted] > radius - 1e-3).all()


def test_places_of_a_grasp_do_not_depend_on_the_others():
    both, alone = places([0, 1])[2], places([1])[2]
    np.testing.assert_allclose(both.surface[1:], alone.surface, atol=1e-12)

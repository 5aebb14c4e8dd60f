"""References: joined, selected, kept as arrays, and where their key points are."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from planned_grasps import grasps_and_objects, hand, motion, references
from scipy.spatial.transform import Rotation

from fungrasp.geometry.poses import compose, transform_points
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.planning.grasp_motion import Motion
from fungrasp.planning.references import References, object_tables


def made_up(seed: int, count: int, steps: int) -> References:
    rng = np.random.default_rng(seed)

    def poses(*shape: int) -> np.ndarray:
        turns = Rotation.random(int(np.prod(shape)), rng=rng).as_quat(scalar_first=True)
        return np.concatenate([rng.normal(size=(*shape, 3)), turns.reshape(*shape, 4)], axis=-1)

    plan = Motion(
        poses(count, steps),
        rng.normal(size=(count, steps, 6)),
        poses(count, steps),
        rng.normal(size=(count, steps, 3)),
        rng.integers(0, steps, count),
        rng.integers(0, steps, count),
        poses(count),
        rng.normal(size=(count, 6)),
        rng.random(count),
    )
    names = np.array([f"thing {seed} {i}" for i in range(count)])
    return References(
        plan,
        names,
        rng.random(count),
        poses(count),
        rng.random((count, 5)) < 0.5,
        rng.normal(size=(count, 4, 3)),
    )


def assert_same(a: References, b: References) -> None:
    for field in fields(References):
        if field.name != "motion":
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))
    for field in fields(Motion):
        np.testing.assert_array_equal(getattr(a.motion, field.name), getattr(b.motion, field.name))


def test_joined_motions_stay_where_they_end():
    short, long = made_up(0, 2, 3), made_up(1, 3, 7)
    both = References.join([short, long])
    assert len(both) == 5 and len(both.motion) == 5
    for steps in (np.array([0, 1]), np.array([2, 2]), np.array([4, 99])):
        for ours, theirs in zip(both.motion.at(steps, np.arange(2)), short.motion.at(steps), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(both.motion.set_point[:2, 3:], short.motion.set_point[:, [-1] * 4])
    assert_same(both.select(np.arange(2, 5)), long)
    assert both.object_name.tolist() == ["thing 0 0", "thing 0 1", "thing 1 0", "thing 1 1", "thing 1 2"]


def test_selecting_picks_the_same_rows_of_everything():
    whole = made_up(2, 4, 5)
    rows = np.array([3, 0, 3])
    some = whole.select(rows)
    assert_same(some.select(np.array([1])), whole.select(np.array([0])))
    np.testing.assert_array_equal(some.keypoints, whole.keypoints[rows])
    np.testing.assert_array_equal(some.motion.wrist_goal, whole.motion.wrist_goal[rows])
    assert_same(whole.select(np.array([True, False, False, True])), whole.select(np.array([0, 3])))


def test_arrays_in_a_file_bring_everything_back(tmp_path):
    whole = made_up(3, 3, 4)
    np.savez(tmp_path / "r.npz", **whole.arrays())  # pyright: ignore[reportArgumentType]
    with np.load(tmp_path / "r.npz", allow_pickle=False) as data:
        assert_same(References.from_arrays(data), whole)


def test_key_points_are_those_of_the_grasp_in_the_objects_frame():
    refs, plan = references(), motion()
    kinematics = HandKinematics(hand(), 2)
    joints = plan.grasp @ kinematics.matrix.T + kinematics.offset
    settled = refs.settled_pose
    world = kinematics.keypoints(compose(settled, plan.wrist), joints)
    np.testing.assert_allclose(transform_points(settled, refs.keypoints), world, atol=1e-9)
    grasps, _ = grasps_and_objects()
    np.testing.assert_array_equal(refs.contacts, grasps.link_contacts)
    np.testing.assert_array_equal(refs.mass, grasps.object_mass)


def test_tables_follow_the_names():
    _, objects = grasps_and_objects()
    names = ["tennis_ball", "can", "tennis_ball"]
    center, size = object_tables(names, objects)
    np.testing.assert_array_equal(center[[0, 2]], [objects["tennis_ball"].center_of_mass] * 2)
    np.testing.assert_array_equal(size[1], objects["can"].size)

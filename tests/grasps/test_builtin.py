"""The built-in human grasps as they are shipped: anatomy, contact, penetration, variety."""

from collections import defaultdict

import numpy as np
import pytest

from fungrasp.geometry.poses import inverse_transform_points, transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank
from fungrasp.grasps import BONES, HUMAN_LINKS, bone_lengths, builtin_grasps
from fungrasp.grasps.anatomy import check_anatomy
from fungrasp.hands import load_hand
from fungrasp.objects import load_object, object_names
from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS
from fungrasp.synthesis.human_hand_terms import part_samples

FINGER_LINKS = HUMAN_LINKS[1:]


@pytest.fixture(scope="module")
def grasps():
    return builtin_grasps()


@pytest.fixture(scope="module")
def surface(grasps):
    """Balls along the finger links in the objects' frames: centers [N, 15, 12, 3], radii [15]."""
    model = load_hand("human").model
    joints = inverse_transform_points(grasps.object_pose, grasps.hand_joints)
    radius = np.array([model.geom(name).size[0] for name in FINGER_LINKS])
    near, far = np.array([bone for i, bone in enumerate(BONES) if i % 4]).T
    start, end = joints[:, near], joints[:, far]
    along = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    distal = np.arange(15) % 3 == 2
    end = end - (distal * radius)[:, None] * along
    share = np.linspace(0, 1, 12)[:, None]
    return start[:, :, None] * (1 - share) + end[:, :, None] * share, radius


def test_there_are_enough_of_every_object_and_many_tasks(grasps):
    assert len(grasps) >= 100
    names, counts = np.unique(grasps.object_name, return_counts=True)
    assert set(names) == set(object_names())
    assert counts.min() >= 3
    assert len(set(grasps.task.tolist())) >= 8
    assert set(zip(grasps.object_name.tolist(), grasps.task.tolist(), strict=True)) <= {
        (spec.object, spec.task) for spec in BUILTIN_SPECIFICATIONS
    }


def test_people_have_such_hands_and_bend_them_so(grasps):
    assert check_anatomy(grasps) == []
    lengths = bone_lengths(grasps.hand_joints)
    assert np.ptp(lengths[:, [i for i in range(20) if i % 4]], axis=0).max() < 1e-6


def test_objects_rest_on_the_table_with_their_own_mass(grasps):
    np.testing.assert_array_equal(grasps.object_pose, grasps.object_rest_pose)
    for grasp in grasps:
        obj = load_object(grasp.object_name)
        assert grasp.object_mass == pytest.approx(obj.mass)


def test_fingers_stay_out_of_object_and_table(grasps, surface):
    centers, radius = surface
    names = sorted(set(grasps.object_name.tolist()))
    bank = SignedDistanceBank([load_object(name).signed_distance for name in names])
    grid = np.array([names.index(name) for name in grasps.object_name.tolist()])
    distance, _ = bank.query(grid, centers.reshape(len(grasps), -1, 3))
    clearance = distance.reshape(centers.shape[:-1]) - radius[:, None]
    assert clearance.min() >= -0.002
    world = transform_points(grasps.object_pose, centers.reshape(len(grasps), -1, 3)).reshape(centers.shape)
    assert (world[..., 2] - radius[:, None]).min() >= 0.0
    assert grasps.hand_joints[..., 2].min() >= 0.0


def test_contacts_are_on_the_specified_parts(grasps, surface):
    centers, radius = surface
    parts = defaultdict(set)
    for spec in BUILTIN_SPECIFICATIONS:
        parts[spec.object, spec.task] |= spec.all_parts
    for row, grasp in enumerate(grasps):
        gap = np.full(15, np.inf)
        for part in parts[grasp.object_name, grasp.task]:
            tree = part_samples(load_object(grasp.object_name), part)
            gap = np.minimum(gap, tree.query(centers[row])[0].min(axis=1) - radius)
        touching = grasp.link_contacts[1:]
        assert touching.sum() >= 2, (row, grasp.object_name)
        assert touching[12:].any(), f"{row} {grasp.object_name}: no thumb"
        assert touching[:12].any(), f"{row} {grasp.object_name}: no finger"
        assert gap[touching].max() <= 0.004, (row, grasp.object_name, grasp.task)


def test_no_two_are_alike(grasps):
    joints = inverse_transform_points(grasps.object_pose, grasps.hand_joints)
    for name in object_names():
        mine = joints[grasps.object_name == name]
        apart = np.linalg.norm(mine[:, None] - mine, axis=-1).mean(axis=-1)
        assert apart[np.triu_indices(len(mine), 1)].min() > 0.005, name

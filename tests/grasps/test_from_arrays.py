"""A human grasp from arrays: what a tracker gives, in a few lines, with the checks of files."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import inverse_transform_points, rotation_matrix, transform_points
from fungrasp.grasps.human_hand import MANO, OPENPOSE


@pytest.fixture(scope="module")
def shown():
    """A built-in grasp, and its object's mesh as trimesh has it."""
    grasp = fungrasp.builtin_grasps()[36]
    model = fungrasp.load_object(grasp.object_name)
    return grasp, trimesh.Trimesh(model.vertices, model.faces, process=False)


def test_arrays_and_a_mesh_become_the_robot_grasp_that_a_file_becomes(shown):
    grasp, mesh = shown
    scattered = np.empty((21, 3))
    scattered[OPENPOSE] = grasp.hand_joints
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_matrix(grasp.object_pose[3:]), grasp.object_pose[:3]
    again = fungrasp.human_grasp(
        scattered,
        fungrasp.object_from_mesh(mesh, grasp.object_mass, grasp.object_name),
        order="mediapipe",
        object_pose=matrix,
        contacts=grasp.link_contacts,
    )
    np.testing.assert_allclose(again.object_pose, grasp.object_pose, atol=1e-9)
    robot, wanted = fungrasp.retarget(again), fungrasp.retarget(grasp)
    assert isinstance(robot, fungrasp.RobotGrasp)
    np.testing.assert_allclose(robot.joint_positions, wanted.joint_positions, atol=0.02)
    assert fungrasp.evaluate(robot).success.tolist() == [True]


def test_without_a_pose_joints_are_in_the_frame_of_the_mesh(shown):
    grasp, mesh = shown
    local = inverse_transform_points(grasp.object_pose, grasp.hand_joints)
    scattered = np.empty((21, 3))
    scattered[MANO] = local
    found = fungrasp.human_grasp(scattered, mesh, order="mano", mass=0.3)
    assert found.object_name == "object" and found.object_mass == 0.3
    np.testing.assert_allclose(
        inverse_transform_points(found.object_pose, found.hand_joints), local, atol=1e-9
    )
    np.testing.assert_array_equal(found.object_pose, found.object_rest_pose)
    lowest = transform_points(found.object_pose, np.asarray(mesh.vertices))[:, 2].min()
    assert abs(lowest) < 1e-9
    assert (found.link_contacts == grasp.link_contacts).mean() > 0.8


def test_points_of_contact_mark_links(shown):
    grasp, mesh = shown
    tips = grasp.hand_joints[[4, 8, 20]]
    found = fungrasp.human_grasp(
        grasp.hand_joints, mesh, mass=0.3, object_pose=grasp.object_pose, contacts=tips
    )
    assert np.flatnonzero(found.link_contacts).tolist() == [3, 6, 15]
    with pytest.raises(FungraspError, match=r"contact point 0 is .* mm from the hand"):
        fungrasp.human_grasp(grasp.hand_joints, mesh, object_pose=grasp.object_pose, contacts=tips * 1e3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joints": np.zeros((20, 3))}, r"joints have shape \(20, 3\), expected \(21, 3\)"),
        ({"joints": np.full((21, 3), np.nan)}, "joints are not all finite"),
        ({"order": "mediapipes"}, "Did you mean 'mediapipe'"),
        ({"order": "mano"}, "order"),
        ({"contacts": np.zeros(3, dtype=bool)}, "one flag for each of 16 links"),
        ({"object_pose": np.ones((4, 4))}, "is no rotation"),
        ({"object_pose": [0, 0, 0]}, "object_pose have shape"),
        ({"mesh": 3}, "expected a mesh .* not int"),
        ({"mesh": "nowhere.obj"}, "nowhere"),
        ({"mass": 400.0}, "is the mass in grams"),
    ],
)
def test_mistakes_are_named(shown, change, words):
    grasp, mesh = shown
    given = {"joints": grasp.hand_joints, "mesh": mesh, "object_pose": grasp.object_pose, "mass": 0.3}
    given |= change
    with pytest.raises(FungraspError, match=words):
        fungrasp.human_grasp(given.pop("joints"), given.pop("mesh"), **given)


def test_a_guessed_mass_is_said_and_its_spread_kept(shown, caplog):
    grasp, mesh = shown
    model = fungrasp.object_from_mesh(mesh)
    assert "the mass was guessed" in caplog.text and 0.05 < model.mass < 1.0
    found = fungrasp.human_grasp(grasp.hand_joints, mesh, object_pose=grasp.object_pose)
    assert found.object_mass == pytest.approx(model.mass) and found.object_mass_spread == pytest.approx(
        0.62, abs=0.02
    )
    with pytest.raises(FungraspError, match=r"60 mm if it is in mm"):
        fungrasp.object_from_mesh(trimesh.creation.box((60, 40, 30)))

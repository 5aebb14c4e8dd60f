"""A human grasp from arrays: what a tracker gives, in a few lines, with the checks of files."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import fungrasp
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    compose,
    inverse_transform_points,
    rotation_matrix,
    transform_points,
)
from fungrasp.grasps import Convention
from fungrasp.grasps.human_hand import MANO, OPENPOSE
from fungrasp.objects.object_variants import mirrored_object


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
        ({"joints": np.zeros((20, 3))}, r"joints: shape \(20, 3\), expected \(21, 3\)"),
        ({"joints": np.zeros((2, 21, 3))}, r"HumanGraspSet\.of"),
        ({"joints": [[1, 2], [3]]}, "joints: not an array of numbers"),
        ({"joints": np.full((21, 3), np.nan)}, "joints: a number is not finite"),
        ({"order": "mediapipes"}, "Did you mean 'mediapipe'"),
        ({"order": "mano"}, "order"),
        ({"contacts": np.zeros(3, dtype=bool)}, "a flag"),
        ({"contacts": np.full(16, 0.5)}, "expected a flag"),
        ({"object_pose": np.ones((4, 4))}, "is no rotation"),
        ({"object_pose": np.eye(4).T + 0.05 * np.eye(4, k=-3)}, "last row of the matrix .* is it transposed"),
        ({"object_pose": np.zeros(7)}, "its quaternion .* has length 0, not 1"),
        ({"object_pose": np.eye(4)[:3]}, r"shape \(3, 4\), expected \(7,\) or \(4, 4\)"),
        ({"mesh": 3}, "expected a mesh .* not int"),
        ({"mesh": "nowhere.obj"}, "nowhere"),
        ({"mass": 400.0}, "is the mass in grams"),
        ({"mesh": "mug", "mass": 350}, "is the mass in grams"),
        ({"object_pose": np.eye(4).T + 0.05 * np.eye(4, k=-3)}, "last row of the matrix .* is it transposed"),
        ({"object_pose": np.zeros(7)}, "its quaternion .* has length 0, not 1"),
        ({"object_pose": np.eye(4)[:3]}, r"shape \(3, 4\), expected \(7,\) or \(4, 4\)"),
        ({"joints": np.zeros((2, 21, 3))}, r"HumanGraspSet\.of"),
        ({"joints": [[1, 2], [3]]}, "joints: not an array of numbers"),
        ({"contacts": np.full(16, 0.5)}, "expected a flag"),
        ({"convention": "mm"}, "expected a Convention, such as .* not 'mm'"),
        ({"convention": Convention(side="left")}, "1 of 1 hands bend as those of right hands"),
        ({"task": "drink\n"}, "'task', row 0 must be a plain text"),
    ],
)
def test_mistakes_are_named(shown, change, words):
    grasp, mesh = shown
    given = {"joints": grasp.hand_joints, "mesh": mesh, "object_pose": grasp.object_pose, "mass": 0.3}
    given |= change
    with pytest.raises(FungraspError, match=words):
        fungrasp.human_grasp(given.pop("joints"), given.pop("mesh"), **given)


def test_another_mesh_of_the_same_name_is_refused(shown, tmp_path):
    """A file holds the bounds of the mesh, and not the mesh."""
    grasp, mesh = shown
    own = fungrasp.object_from_mesh(mesh.copy().apply_scale(1.1), 0.3, grasp.object_name)
    fungrasp.human_grasp(grasp.hand_joints, own, object_pose=grasp.object_pose).save(tmp_path / "g.npz")
    grasps = fungrasp.load_grasps(tmp_path / "g.npz")
    for again in (grasps, fungrasp.retarget(grasps, own)):
        again.save(tmp_path / "again.npz")
        loaded = fungrasp.load_grasps(tmp_path / "again.npz")
        with pytest.raises(FungraspError, match=rf"'{own.name}' is not that of the grasps.*objects="):
            fungrasp.load_objects(loaded)
        mesh.copy().apply_scale(1.11).export(tmp_path / f"{own.name}.obj")
        assert fungrasp.load_objects(loaded, tmp_path)[own.name].mass == 0.3
        assert fungrasp.load_objects(loaded, own) == {own.name: own}
    theirs = fungrasp.human_grasp(grasp.hand_joints, grasp.object_name, object_pose=grasp.object_pose)
    with pytest.raises(FungraspError, match="stands for different meshes"):
        fungrasp.HumanGraspSet.of([grasps[0], theirs])


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


def mug():
    """A built-in grasp of the mug, which stands upright."""
    grasps = fungrasp.builtin_grasps()
    return grasps[int(np.flatnonzero(grasps.object_name == "mug")[0])]


@pytest.mark.parametrize(
    ("changes", "convention"),
    [
        ({"joints": 1e3}, Convention(unit="mm", object_unit="m")),
        ({"joints": 1e3, "pose": [1e3, 1e3, 1e3, 1, 1, 1, 1]}, Convention(unit="mm")),
        ({"pose": [1e3, 1e3, 1e3, 1, 1, 1, 1]}, Convention(object_unit="mm")),
        ({"joints": [1, -1, 1], "pose": [1, -1, 1, 1, -1, 1, -1]}, Convention(side="left")),
    ],
)
def test_the_remedy_that_the_error_names_works(changes, convention):
    grasp = mug()
    joints, pose = grasp.hand_joints * changes.get("joints", 1), grasp.object_pose * changes.get("pose", 1)
    mesh = fungrasp.load_object("mug")
    if convention.side == "left":
        mesh = replace(mirrored_object(mesh), name="mug")
    with pytest.raises(FungraspError, match=re.escape(f"convention=Convention({convention.as_arguments()})")):
        fungrasp.human_grasp(joints, mesh, object_pose=pose)
    found = fungrasp.human_grasp(joints, mesh, object_pose=pose, convention=convention)
    np.testing.assert_allclose(found.hand_joints, grasp.hand_joints, atol=1e-9)
    np.testing.assert_allclose(found.object_pose, grasp.object_pose, atol=1e-9)
    assert found.object_name == ("mug_mirrored" if convention.side == "left" else "mug")


def test_tensors_and_flags_as_numbers_are_read():
    torch = pytest.importorskip("torch")
    grasp = mug()
    found = fungrasp.human_grasp(
        torch.tensor(grasp.hand_joints, requires_grad=True),
        "mug",
        object_pose=torch.tensor(grasp.object_pose).bfloat16(),
        contacts=grasp.link_contacts.astype(int),
    )
    np.testing.assert_array_equal(found.link_contacts, grasp.link_contacts)


def test_a_grasp_in_a_cameras_frame_is_doubted(caplog):
    """The camera looks down at the table; hand and object fit together, so that nothing else tells it."""
    grasp = mug()
    turn = np.array([np.cos(1.1), -np.sin(1.1), 0.0, 0.0])
    camera = np.array([0.0, 0.0, 0.7, *turn])
    joints, pose = transform_points(camera, grasp.hand_joints), compose(camera, grasp.object_pose)
    fungrasp.human_grasp(joints, "mug", object_pose=pose)
    assert "the z axis of the world does not point up" in caplog.text
    caplog.clear()
    fungrasp.human_grasp(grasp.hand_joints, "mug", object_pose=grasp.object_pose)
    assert not caplog.text


def test_a_scene_is_taken_as_one_mesh(shown):
    """What trimesh.load makes of a GLB."""
    assert fungrasp.object_from_mesh(trimesh.Scene(shown[1]), 0.3).size == pytest.approx(shown[1].extents)

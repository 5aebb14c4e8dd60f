"""Human grasps made from specifications: what they promise, and that wrong specifications are named."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import rotate, transform_points
from fungrasp.grasps import HUMAN_LINKS, bone_lengths, load_human_grasps
from fungrasp.grasps.anatomy import check_anatomy
from fungrasp.hands import load_hand
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.objects import ObjectModel, load_object
from fungrasp.optimization.hand_state import HandState
from fungrasp.optimization.problem import CollisionScene
from fungrasp.synthesis import SynthesisSettings, synthesize_grasps
from fungrasp.synthesis.builtin_specifications import BUILTIN_SPECIFICATIONS
from fungrasp.synthesis.grasp_specification import GRASP_KINDS, WHOLE, GraspKind, GraspSpecification
from fungrasp.synthesis.human_hand_terms import (
    HumanPoints,
    PartTargets,
    natural_posture,
    part_gap,
    part_samples,
    place_error,
)
from fungrasp.synthesis.synthesize import random_offsets

QUICK = SynthesisSettings(starts=2)
CAN = GraspSpecification("can", "drink", "body", "wrap", at=(0, 0, 0), palm=(0, 1, 0), fingers=(1, 0, 0))
BALL = GraspSpecification(
    "tennis_ball", "throw", "ball", "disk", at=(0, 0, 0), palm=(0, 0, -1), fingers=(1, 0, 0)
)


@pytest.fixture(scope="module")
def made():
    return synthesize_grasps([CAN, BALL], seed=3, settings=QUICK)


def state_of(
    spec: GraspSpecification, pose: np.ndarray, joints: np.ndarray
) -> tuple[HandState[CollisionScene], PartTargets]:
    objects = {spec.object: load_object(spec.object)}
    scene = CollisionScene.settled([spec.object], spec.rest_pose(objects[spec.object])[None], objects)
    points = HumanPoints(HandKinematics(load_hand("human"), 1))
    return HandState(points, scene, pose[None], joints[None]), PartTargets.from_specifications(
        [spec], objects
    )


def test_grasps_are_as_specified(made):
    assert made.object_name.tolist() == ["can", "tennis_ball"]
    assert made.task.tolist() == ["drink", "throw"]
    assert made.object_mass.tolist() == [load_object("can").mass, load_object("tennis_ball").mass]
    np.testing.assert_array_equal(made.object_pose, made.object_rest_pose)
    for row, spec in enumerate((CAN, BALL)):
        touching = {name for name, flag in zip(HUMAN_LINKS, made.link_contacts[row], strict=True) if flag}
        assert set(spec.links) <= touching
    assert check_anatomy(made) == []
    hand = load_hand("human")
    kinematics = HandKinematics(hand, 1)
    kinematics.update(np.array([[0, 0, 0, 1.0, 0, 0, 0]]), np.zeros((1, 21)))
    bones = bone_lengths(kinematics.points(kinematics.body_points(hand.keypoint_names)))
    inner = [bone for bone in range(20) if bone % 4]
    np.testing.assert_allclose(
        bone_lengths(made.hand_joints)[:, inner], bones[:, inner].repeat(2, 0), atol=1e-9
    )


def test_the_palm_faces_where_the_specification_says(made):
    for row, spec in enumerate((CAN, BALL)):
        joints = made.hand_joints[row]
        normal = np.cross(joints[1] - joints[0], joints[13] - joints[0])
        fingers = joints[5] - joints[0]
        assert normal @ spec.palm > 0.8 * np.linalg.norm(normal)
        assert fingers @ spec.fingers > 0.7 * np.linalg.norm(fingers)


def test_random_starts_depend_on_seed_and_specification_only():
    offsets = random_offsets([CAN, BALL], 1, 3, 0.01, 0.1)
    np.testing.assert_array_equal(offsets[[0, 3]], 0.0)
    np.testing.assert_array_equal(offsets[3:], random_offsets([BALL], 1, 3, 0.01, 0.1))
    assert not np.any(offsets[1:3] == random_offsets([CAN], 2, 3, 0.01, 0.1)[1:])


def test_a_specification_twice_gives_one_grasp_and_an_impossible_one_none():
    twice = synthesize_grasps([BALL, BALL], settings=replace(QUICK, starts=1))
    assert len(twice) == 1
    under_the_table = replace(BALL, palm=(0, 0, 1))
    with pytest.raises(FungraspError, match="no grasp meets any"):
        synthesize_grasps([under_the_table], settings=replace(QUICK, starts=1))


def test_a_users_mesh_is_held_anywhere():
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    bead = ObjectModel("bead", 0.1, np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32))
    spec = replace(BALL, object="bead", part=WHOLE)
    grasps = synthesize_grasps([spec], settings=QUICK, objects={"bead": bead})
    assert grasps.object_mass.tolist() == [0.1]
    assert grasps.object_pose[0, 2] == pytest.approx(-mesh.vertices[:, 2].min())


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -2, 0), (1, 1, 1)])
def test_rest_pose_stands_on_the_table_with_up_up(up):
    book = load_object("book")
    pose = replace(CAN, object="book", up=up).rest_pose(book)
    np.testing.assert_allclose(rotate(pose[3:], np.array(up) / np.linalg.norm(up)), [0, 0, 1], atol=1e-12)
    assert transform_points(pose, book.vertices)[:, 2].min() == pytest.approx(0.0, abs=1e-12)


def test_turning_a_specification_turns_all_of_it():
    spec = replace(CAN, at=(0.01, 0, 0.02), places={"thumb_distal": (0.03, 0, 0)})
    turned = spec.turned(np.pi / 2, about=(0.01, 0))
    np.testing.assert_allclose(turned.at, (0.01, 0, 0.02), atol=1e-12)
    np.testing.assert_allclose(turned.palm, (-1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(turned.fingers, (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(turned.places["thumb_distal"], (0.01, 0.02, 0), atol=1e-12)


def test_parts_of_fingers_and_links():
    spec = replace(
        CAN, contacts=("index_middle", "index_distal", "palm"), parts={"index": "a", "index_distal": "b"}
    )
    assert spec.part_of_link == {"index_middle": "a", "index_distal": "b", "palm": "body"}
    assert spec.all_parts == {"body", "a", "b"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "wrapp"}, "did you mean 'wrap'"),
        ({"contacts": ("index_tip",)}, "index_tip"),
        ({"parts": {"indx": "body"}}, "indx"),
        ({"fingers": (0, 2, 0)}, "parallel"),
        ({"palm": (0, 0, 0)}, "parallel or zero"),
    ],
)
def test_wrong_specifications_are_named(change, words):
    with pytest.raises(FungraspError, match=f"(?i){words}"):
        replace(CAN, **change)


def test_unknown_objects_and_parts_are_named():
    with pytest.raises(FungraspError, match="handel"):
        synthesize_grasps([replace(CAN, object="mug", part="handel")], settings=QUICK)
    with pytest.raises(FungraspError, match="cann"):
        synthesize_grasps([replace(CAN, object="cann")], settings=QUICK)


def test_kinds_are_within_the_hands_limits():
    kinematics = HandKinematics(load_hand("human"), 1)
    for kind in GRASP_KINDS.values():
        for angles in (np.array(kind.open), np.array(kind.closed)):
            assert np.all(angles >= kinematics.lower) and np.all(angles <= kinematics.upper)
    with pytest.raises(FungraspError, match="21"):
        GraspKind(open=(0.0,), closed=(0.0,), center=(0, 0, 0), contacts=())


def test_part_samples_lie_on_the_part():
    mug = load_object("mug")
    samples = part_samples(mug, "handle").data
    corners = mug.vertices[mug.faces[mug.parts["handle"]]].reshape(-1, 3)
    assert np.all(samples >= corners.min(axis=0) - 1e-9) and np.all(samples <= corners.max(axis=0) + 1e-9)


def test_gap_is_the_distance_of_the_pad_from_the_part():
    spec = replace(BALL, contacts=("index_distal",))
    pose = np.array([-0.15, 0.0, 0.14, 0.7071067811865476, 0.0, 0.7071067811865476, 0.0])
    state, targets = state_of(spec, pose, np.array(GRASP_KINDS["disk"].open))
    residual, _ = part_gap(state, targets, unit=1.0)
    column = HUMAN_LINKS.index("index_distal")
    assert np.count_nonzero(residual) == 1
    members = state.points.link_members[column]
    clearance = (
        np.linalg.norm(state.spheres[0, members], axis=1) - 0.0335 - state.points.spheres.radius[members]
    )
    assert residual[0, column] == pytest.approx(clearance.min(), abs=0.006)
    assert residual[0, column] >= clearance.min() - 1e-4


@pytest.mark.parametrize("term", ["gap", "place", "posture"])
def test_jacobians_are_derivatives(term):
    spec = replace(BALL, places={"thumb_distal": (0.0, 0.03, 0.0)})
    random = np.random.default_rng(0)
    pose = np.array([-0.15, 0.01, 0.08, *random.normal(size=4)])
    pose[3:] /= np.linalg.norm(pose[3:])
    joints = np.array(GRASP_KINDS["disk"].open) + 0.1
    state, targets = state_of(spec, pose, joints)

    def value(state):
        if term == "gap":
            return part_gap(state, targets)
        return place_error(state, targets) if term == "place" else natural_posture(state, ["disk"])

    residual, jacobian = value(state)
    assert np.any(jacobian)
    step = 1e-6 * random.normal(size=(1, state.points.kinematics.size))
    moved_pose, moved_joints = state.points.kinematics.step(pose[None], joints[None], step)
    moved, _ = value(HandState(state.points, state.problem, moved_pose, moved_joints))
    np.testing.assert_allclose(moved - residual, (jacobian @ step[..., None])[..., 0], atol=2e-8)


def test_builtin_specifications_cover_objects_and_tasks():
    from fungrasp.objects import object_names

    assert {spec.object for spec in BUILTIN_SPECIFICATIONS} == set(object_names())
    assert len({spec.task for spec in BUILTIN_SPECIFICATIONS}) >= 8
    for spec in BUILTIN_SPECIFICATIONS:
        assert spec.all_parts <= set(load_object(spec.object).parts), spec


def test_the_command_makes_a_file_or_says_what_is_unknown(tmp_path, capsys):
    out = tmp_path / "made.npz"
    assert main(["grasps", "make", "--out", str(out), "--objects", "tennis_ball"]) == 0
    assert set(load_human_grasps(out).object_name.tolist()) == {"tennis_ball"}
    assert "grasps of 1 objects" in capsys.readouterr().out
    assert main(["grasps", "make", "--out", str(tmp_path / "no.npz"), "--objects", "tenis_ball"]) == 2
    assert "tennis_ball" in capsys.readouterr().err
    assert not (tmp_path / "no.npz").exists()


def test_an_interrupted_command_goes_on_and_several_seeds_make_different_grasps(tmp_path, monkeypatch):
    import fungrasp.synthesis.synthesize as parts

    monkeypatch.setattr("fungrasp.synthesis.synthesize.BATCH_SIZE", 3)
    command = ["grasps", "make", "--objects", "tennis_ball", "--seed", "0", "1", "--out"]
    assert main([*command, str(tmp_path / "whole.npz")]) == 0
    solved, solve = [], parts.solve_batch

    def counted(specs, objects, seed, settings):
        solved.append(seed)
        if len(solved) == 2:
            raise KeyboardInterrupt
        return solve(specs, objects, seed, settings)

    monkeypatch.setattr(parts, "solve_batch", counted)
    out = tmp_path / "made.npz"
    assert main([*command, str(out)]) == 130 and not out.exists()
    assert main([*command, str(out)]) == 0
    batches = -(-sum(spec.object == "tennis_ball" for spec in BUILTIN_SPECIFICATIONS) // 3)
    assert len(solved) == 2 * batches + 1, "the batch that was interrupted is solved again, and no other"
    assert out.read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["made.npz", "whole.npz"]
    joints = load_human_grasps(out).hand_joints
    apart = np.linalg.norm(joints[:, None] - joints, axis=-1).mean(axis=-1) + np.eye(len(joints))
    assert apart.min() >= SynthesisSettings().min_difference
    assert main([*command[:-2], "0", "--out", str(out)]) == 2

"""A mirrored hand grasps mirrored objects as the hand it is the image of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from lifted_grasps import allegro_hand, good_grasps, grasped_objects, human_grasps

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import evaluate
from fungrasp.grasps import (
    HumanGraspSet,
    hand_sides,
    load_objects,
    load_robot_grasps,
    mirrored_grasps,
    save_human_grasps,
)
from fungrasp.grasps.anatomy import check_anatomy
from fungrasp.hands import FINGERS, Hand, hand_files, load_hand
from fungrasp.objects import mirrored_object
from fungrasp.retargeting import retarget

FLIP = np.array([1.0, -1.0, 1.0])


def mirrored_hand(folder: Path) -> Hand:
    """The Allegro hand reflected in the plane y = 0 of its palm."""
    original = allegro_hand()
    model = original.model
    spec = mujoco.MjSpec.from_file(str(original.model_path))
    compiled = spec.copy().compile()
    turn = np.array([1.0, -1.0, 1.0, -1.0])
    for body in spec.bodies[1:]:
        i = compiled.body(body.name).id
        body.pos, body.quat = compiled.body_pos[i] * FLIP, compiled.body_quat[i] * turn
        body.mass, body.explicitinertial = compiled.body_mass[i], True
        body.ipos, body.iquat = compiled.body_ipos[i] * FLIP, compiled.body_iquat[i] * turn
        body.inertia = compiled.body_inertia[i]
    for geom in spec.geoms:
        i = compiled.geom(geom.name).id
        geom.fromto = [np.nan] * 6
        geom.size, geom.mass = compiled.geom_size[i], np.nan
        geom.pos, geom.quat = compiled.geom_pos[i] * FLIP, compiled.geom_quat[i] * turn
    for site in spec.sites:
        site.pos = compiled.site_pos[compiled.site(site.name).id] * FLIP
    for joint in spec.joints:
        # A rotation is reflected with its axis as a pseudo-vector.
        i = compiled.joint(joint.name).id
        joint.axis = -compiled.jnt_axis[i] * FLIP
        joint.pos = compiled.jnt_pos[i] * FLIP
    folder.mkdir()
    (folder / original.model_path.name).write_text(spec.to_xml())
    (folder / "hand.toml").write_text(original.path.read_text().replace('"allegro"', '"allegro_left"'))
    hand = load_hand(folder)
    np.testing.assert_allclose(hand.model.body_mass, model.body_mass)
    return hand


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return mirrored_hand(tmp_path_factory.mktemp("left") / "allegro_left")


def test_side_is_found_from_geometry(left: Hand):
    assert left.side == "left"
    assert {name: load_hand(name).side for name in hand_files()} == dict.fromkeys(hand_files(), "right")


def test_side_of_the_toml_prevails(left: Hand, tmp_path: Path):
    (tmp_path / "hand.toml").write_text('side = "right"\n' + left.path.read_text())
    (tmp_path / left.model_path.name).write_text(left.model_path.read_text())
    assert load_hand(tmp_path).side == "right"
    (tmp_path / "hand.toml").write_text('side = "both"\n' + left.path.read_text())
    with pytest.raises(FungraspError, match='side must be "right" or "left"'):
        load_hand(tmp_path)


@pytest.mark.parametrize("method", ["contact", "angle-copy", "dexgraspnet"])
def test_mirrored_hand_gets_mirrored_grasps(left: Hand, method: str):
    grasps = mirrored_grasps(human_grasps())
    assert set(hand_sides(grasps.hand_joints)) == {"left"}
    right = retarget(human_grasps(), grasped_objects(), allegro_hand(), method)
    result = retarget(grasps, load_objects(grasps), left, method)
    np.testing.assert_allclose(result.joint_positions, right.joint_positions, atol=1e-4)
    np.testing.assert_allclose(result.keypoints, right.keypoints * FLIP, atol=1e-4)


def test_mirrored_grasps_lift_as_well(left: Hand):
    grasps = mirrored_grasps(human_grasps())
    objects = load_objects(grasps)
    expected = evaluate(good_grasps(), grasped_objects()).outcomes
    outcomes = evaluate(retarget(grasps, objects, left), objects, hand=left).outcomes
    np.testing.assert_array_equal(outcomes.success, expected.success)
    np.testing.assert_allclose(outcomes.lifted_height_m, expected.lifted_height_m, atol=1e-3)


def test_mixed_pairs_are_refused(left: Hand):
    with pytest.raises(FungraspError, match=r"'allegro_left' is a left hand.*--mirror"):
        retarget(human_grasps(), grasped_objects(), left)
    grasps = mirrored_grasps(human_grasps())
    with pytest.raises(FungraspError, match=r"'allegro' is a right hand.*--mirror"):
        retarget(grasps, load_objects(grasps), allegro_hand())


def test_mirroring_twice_gives_the_same():
    grasps: HumanGraspSet = replace(human_grasps(), objects=grasped_objects())
    once = mirrored_grasps(grasps)
    assert {model.name: model.mirror_image for model in load_objects(once).values()} == {
        f"{name}_mirrored": model for name, model in grasped_objects().items()
    }
    from_file = mirrored_grasps(replace(human_grasps(), objects={}, object_bounds=grasps.object_bounds))
    for name, corners in from_file.object_bounds.items():
        np.testing.assert_allclose(corners, once.object_bounds[name], atol=1e-12)
    assert set(from_file.object_bounds) == set(once.object_bounds) != set()
    twice = mirrored_grasps(once)
    for name in ("object_name", "object_pose", "object_rest_pose", "hand_joints", "link_contacts"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(grasps, name))
    assert check_anatomy(mirrored_grasps(grasps)) == check_anatomy(grasps)
    assert set(FINGERS) == set(allegro_hand().fingers) | {"pinky"}


def test_object_in_the_mirror():
    model = grasped_objects()["can"]
    image = mirrored_object(model)
    assert (image.name, mirrored_object(image).name) == ("can_mirrored", "can")
    np.testing.assert_allclose(image.center_of_mass, model.center_of_mass * FLIP, atol=1e-9)
    points = np.array([[0.01, 0.02, 0.03], [0.0, -0.05, 0.0], [0.03, 0.04, 0.1]])
    from fungrasp.geometry.signed_distance import SignedDistanceBank

    bank = SignedDistanceBank([model.signed_distance, image.signed_distance])
    here, _ = bank.query(np.array([0]), points[None])
    there, _ = bank.query(np.array([1]), (points * FLIP)[None])
    np.testing.assert_allclose(there, here, atol=1e-7)


def test_mirror_option(left: Hand, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    save_human_grasps(tmp_path / "human.npz", human_grasps())
    arguments = [
        "retarget",
        "--grasps",
        tmp_path / "human.npz",
        "--hand",
        left.path,
        "--out",
        tmp_path / "r.npz",
    ]
    assert main([str(a) for a in arguments]) == 2
    assert "--mirror" in capsys.readouterr().err
    assert main([str(a) for a in (*arguments, "--mirror")]) == 0
    names = load_robot_grasps(tmp_path / "r.npz").object_name
    assert set(names) == {"can_mirrored", "tennis_ball_mirrored"}


def test_grasps_are_mirrored_for_an_evaluation(
    left: Hand, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_human_grasps(tmp_path / "human.npz", human_grasps().select([0]))
    arguments = ["evaluate", "--grasps", tmp_path / "human.npz", "--hand", left.path]
    assert main([str(a) for a in arguments]) == 2
    assert "--mirror" in capsys.readouterr().err
    assert main([str(a) for a in (*arguments, "--mirror")]) == 0
    assert "1 episodes" in capsys.readouterr().out


def test_what_comes_next_for_a_left_hand(left: Hand, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "again"
    assert main(["hands", "add", str(left.model_path), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"next: fungrasp retarget --mirror --hand {out / 'hand.toml'}" in said

import mujoco
import numpy as np
import pytest
import trimesh
from flat_hand import FLAT_HAND

from fungrasp.core.errors import FungraspError
from fungrasp.grasps.as_shown import PlaceMarks
from fungrasp.hands import load_hand
from fungrasp.media import Renderer, look_at_grasp
from fungrasp.media.camera import orbit_camera
from fungrasp.media.grasp_scenes import (
    CONTACT,
    MISSED,
    OBJECT_BODY,
    UNWANTED,
    human_grasp_scene,
    robot_grasp_scene,
    robot_scene_colors,
    robot_scene_states,
)
from fungrasp.media.pictures import AS_SHOWN, NOT_SHOWN, captioned, draw_place_marks, four_views, grid
from fungrasp.objects import ObjectModel

_BOX = trimesh.creation.box((0.06, 0.06, 0.04))
BOX = ObjectModel("block", 0.1, np.array(_BOX.vertices), np.array(_BOX.faces))
POSE = np.array([0.0, 0.15, 0.02, 1, 0, 0, 0])


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro")


def _robot(hand, contacts=None):
    wrist = np.array([0.02, -0.03, 0.2, 0.5, -0.5, 0.5, -0.5])
    joints = np.linspace(0.1, 0.4, len(hand.joint_names))
    return wrist, joints, robot_grasp_scene(hand, wrist, joints, BOX, POSE, contacts)


def _human(contacts):
    return human_grasp_scene(FLAT_HAND + np.array([0, 0, 0.05]), BOX, POSE, contacts)


def _orange(picture):
    return (picture[..., 2] < 0.45 * picture[..., 0]).sum()


def test_a_contact_sheet_holds_every_picture():
    images = [np.full((20, 30, 3), 40 * i, np.uint8) for i in range(5)]
    sheet = grid(images, [f"picture number {i}" for i in range(5)], columns=3, gap=4)
    plain = grid(images, columns=3, gap=4)
    assert plain.shape == (4 + 2 * 24, 4 + 3 * 34, 3)
    assert sheet.shape[0] > plain.shape[0]
    for i in range(5):
        row, column = divmod(i, 3)
        y, x = 4 + row * 24, 4 + column * 34
        np.testing.assert_array_equal(plain[y : y + 20, x : x + 30], images[i])


def test_places_are_marked_where_they_are():
    camera = orbit_camera(POSE[:3].tolist(), 0.5, 30.0, 20.0, width=640, height=480)
    places = np.array([[0.03, 0.0, 0.0], [0.0, 0.03, 0.02]])
    marks = PlaceMarks(
        places, places + np.array([[0.0, 0.0, 0.01], [0.0, -0.05, 0.0]]), np.array([True, False])
    )
    before = np.full((480, 640, 3), 128, np.uint8)
    after = draw_place_marks(before, camera, POSE, marks)
    at = np.round(camera.project(marks.points + POSE[:3])[0]).astype(int)
    for (u, v), color in zip(at, (AS_SHOWN, NOT_SHOWN), strict=True):
        np.testing.assert_array_equal(after[v, u], color)
    u, v = np.round(camera.project(places[1] + POSE[:3])[0]).astype(int)
    off = np.abs(after.astype(int) - NOT_SHOWN).max(axis=2)
    assert off[v - 5, u] < 40 and off[v - 2, u] > 150, "a ring is open"
    changed = np.any(after != before, axis=2)
    assert changed.mean() < 0.02, "marks hide what is below them"


def test_contact_sheets_check_what_they_get():
    image = np.zeros((8, 8, 3), np.uint8)
    for images, labels in (([], []), ([image], ["a", "b"]), ([image, image[:4]], [])):
        with pytest.raises(FungraspError):
            grid(images, labels)


def test_a_caption_changes_only_the_lower_edge():
    image = np.full((120, 200, 3), 230, np.uint8)
    bar = captioned(image, "a very long line of words that can't possibly fit beside the time", "1.0 s")
    assert bar.shape == image.shape
    np.testing.assert_array_equal(bar[:90], image[:90])
    assert bar[-5:, :5].mean() < 120
    assert (image == 230).all()


def test_human_contacts_are_colored():
    none, tips = np.zeros(16, bool), np.zeros(16, bool)
    tips[[3, 6, 9, 12, 15]] = True
    seen = {}
    for name, contacts in (("none", none), ("tips", tips)):
        model = _human(contacts)
        seen[name] = next(Renderer(model).stream(model.qpos0, look_at_grasp(model, width=80, height=60)))
    assert _orange(seen["none"]) == 0
    assert _orange(seen["tips"]) > 20


def test_a_touching_palm_is_colored_only_near_the_object():
    contacts = np.zeros(16, bool)
    contacts[0] = True
    model = _human(contacts)
    place = model.mesh_texcoord[model.mesh_texcoordadr[0] :][: model.mesh_texcoordnum[0], 0]
    assert place.max() < 0.3


def test_the_robot_is_where_it_was_put(allegro):
    wrist, joints, (model, qpos) = _robot(allegro)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    palm = data.body("robot/" + allegro.palm)
    np.testing.assert_allclose(palm.xpos, wrist[:3], atol=1e-9)
    np.testing.assert_allclose(palm.xquat, wrist[3:], atol=1e-9)
    np.testing.assert_allclose(data.body(OBJECT_BODY).xpos, POSE[:3], atol=1e-9)
    for name, value in zip(allegro.joint_names, joints, strict=True):
        assert data.joint("robot/" + name).qpos[0] == value


def test_robot_links_in_contact_are_colored(allegro):
    contacts = np.zeros(len(allegro.links), bool)
    link = allegro.link_names.index("index_distal")
    contacts[link] = True
    _, _, (model, _) = _robot(allegro, contacts)
    colored = np.flatnonzero(np.all(np.isclose(model.geom_rgba[:, :3], CONTACT), axis=1))
    bodies = {model.body(int(model.geom_bodyid[g])).name for g in colored}
    assert bodies == {"robot/" + body for body in allegro.links[link]}


def test_links_light_up_along_a_motion(allegro):
    wrist, joints, (model, qpos) = _robot(allegro)
    contacts = np.zeros((3, len(allegro.links)), bool)
    contacts[2, 1:] = True
    colors = robot_scene_colors(model, allegro, contacts)
    np.testing.assert_array_equal(colors[0], colors[1])
    wanted = np.arange(len(allegro.links)) == 1
    asked = robot_scene_colors(model, allegro, contacts, wanted)[..., :3]
    assert np.isclose(asked[0], MISSED).all(-1).sum() == np.isclose(asked[2], CONTACT).all(-1).sum() > 0
    assert np.isclose(asked[2], UNWANTED).all(-1).sum() > 10
    assert np.isclose(colors[2, :, :3], CONTACT).all(-1).sum() > 10
    states = robot_scene_states(
        model, allegro, np.tile(wrist, (3, 1)), np.tile(joints, (3, 1)), np.tile(POSE, (3, 1))
    )
    np.testing.assert_array_equal(states[1], qpos)


def test_the_automatic_camera_sees_hand_and_object_from_above(allegro):
    _, _, (model, qpos) = _robot(allegro)
    camera = look_at_grasp(model, qpos, width=80, height=60)
    assert camera.position[2] > 0
    seen = Renderer(model).views(qpos, camera).segmentation[0]
    of_object = [g for g in range(model.ngeom) if model.body(int(model.geom_bodyid[g])).name == OBJECT_BODY]
    assert np.isin(seen, of_object).sum() > 30
    assert ((seen >= 0) & ~np.isin(seen, of_object)).sum() > 300
    border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
    assert (border < 0).all()


def test_four_views_differ(allegro):
    _, _, (model, _) = _robot(allegro)
    views = four_views(model)
    assert [v.shape for v in views] == [(360, 480, 3)] * 4
    assert all(np.abs(views[0].astype(int) - v).max() > 30 for v in views[1:])


def test_wrong_arguments_are_named(allegro):
    wrist, joints, _ = _robot(allegro)
    good = {"wrist_pose": wrist, "joint_positions": joints, "object_pose": POSE}
    wrong = {"wrist_pose": wrist[:6], "joint_positions": joints[:-1], "object_pose": POSE * np.nan}
    for name, value in wrong.items():
        with pytest.raises(FungraspError, match=name):
            robot_grasp_scene(allegro, obj=BOX, **{**good, name: value})
    with pytest.raises(FungraspError, match="link_contacts"):
        _robot(allegro, np.zeros(3, bool))
    with pytest.raises(FungraspError, match="link_contacts"):
        _human(np.zeros(13, bool))

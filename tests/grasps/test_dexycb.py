"""DexYCB in its own folder layout: a small copy made here, with a world we know."""

from __future__ import annotations

import logging
import pickle
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bent_hand import bent_hand
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.grasps import HUMAN_LINKS, HumanGraspSet, load_objects
from fungrasp.grasps.contacts import link_contacts, surface_contacts
from fungrasp.grasps.human_hand import OPENPOSE, mirror_points, mirror_pose
from fungrasp.grasps.importers.dexycb import import_dexycb

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")

SERIALS = ("1111", "2222")
BOX = (0.06, 0.04, 0.2)
TAG = (Rotation.from_euler("XYZ", [2.2, 0.1, -0.3]), np.array([-0.4, 0.1, 0.9]))
"""Tag in the frame of the first camera, which is DexYCB's world."""
CAMERAS = (
    (Rotation.identity(), np.zeros(3)),
    (Rotation.from_euler("XYZ", [0.1, -1, 0.2]), np.array([1.0, 0.1, 0.3])),
)
REST = np.array([0.5, 0.2, 0.1])
TURN = Rotation.from_euler("z", 0.7)
UP = np.array([0.0, 0.0, 0.012])
LIFT = (0.0, 0.0, 0.004, 0.012, 0.03)
"""Height of the object by frame [m]."""


def palm_on_box() -> np.ndarray:
    """Right hand on top of the box at rest, our joint order, our world; only fingers touch."""
    return bent_hand((0.0, 0.0, 0.0)) + REST + [-0.09, 0.0, 0.1 + 0.008]


def in_camera(points: np.ndarray, camera: int) -> np.ndarray:
    """From our world (the tag's frame) to a camera's."""
    master = TAG[0].apply(points) + TAG[1]
    rotation, shift = CAMERAS[camera]
    return rotation.inv().apply(master - shift)


def write_dataset(root: Path, side: str = "right", lift: tuple[float, ...] = LIFT, **meta: object) -> Path:
    """One sequence with two objects, the second of which is grasped, seen by two cameras."""
    folder = root / "20200709-subject-01" / "20200709_141754"
    calibration = root / "calibration"
    for path in (calibration / "extrinsics_a", calibration / "mano_b", root / "models" / "003_cracker_box"):
        path.mkdir(parents=True)
    trimesh.creation.box(BOX).export(root / "models" / "003_cracker_box" / "textured_simple.obj")
    poses = dict(zip(("apriltag", *SERIALS), (TAG, *CAMERAS), strict=True))
    extrinsics = {
        name: tuple(np.column_stack([rotation.as_matrix(), shift]).ravel().tolist())
        for name, (rotation, shift) in poses.items()
    }
    # As in DexYCB's own files, which carry the tag of Python's tuples.
    content = {"master": SERIALS[0], "extrinsics": extrinsics}
    (calibration / "extrinsics_a" / "extrinsics.yml").write_text(yaml.dump(content))
    (calibration / "mano_b" / "mano.yml").write_text(yaml.safe_dump({"betas": [0.1] * 10}))
    fields = {
        "serials": list(SERIALS),
        "num_frames": len(lift),
        "ycb_ids": [14, 2],
        "ycb_grasp_ind": 1,
        "mano_sides": [side],
        "mano_calib": ["b"],
        "extrinsics": "a",
    }
    folder.mkdir(parents=True)
    (folder / "meta.yml").write_text(
        yaml.safe_dump({k: v for k, v in (fields | meta).items() if v is not None})
    )
    for camera, serial in enumerate(SERIALS):
        (folder / serial).mkdir()
        for frame, height in enumerate(lift):
            write_label(folder / serial / f"labels_{frame:06d}.npz", camera, side, height, seen=frame > 0)
    return root


def write_label(path: Path, camera: int, side: str, height: float, seen: bool) -> None:
    up = np.array([0, 0, height])
    center = in_camera((REST + up)[None], camera)[0]
    turn = CAMERAS[camera][0].inv() * TAG[0] * TURN
    pose_y = np.stack([np.zeros((3, 4)), np.column_stack([turn.as_matrix(), center])])
    ours = palm_on_box() + up
    if side == "left":
        ours = mirror_points(ours - REST) + REST
    joints = np.empty((21, 3))
    joints[OPENPOSE] = in_camera(ours, camera)
    np.savez(
        path,
        seg=np.zeros((4, 4), dtype=np.uint8),
        pose_y=pose_y.astype(np.float32),
        joint_3d=(joints if seen else np.full((21, 3), -1.0))[None].astype(np.float32),
        pose_m=np.full((1, 51), 0.1 if seen else 0.0, dtype=np.float32),
    )


def test_the_grasp_is_where_the_object_has_moved(tmp_path):
    grasps = import_dexycb(write_dataset(tmp_path))
    assert grasps.object_name.tolist() == ["003_cracker_box"] and grasps.object_mass.tolist() == [0.411]
    quaternion = TURN.as_quat(scalar_first=True)
    np.testing.assert_allclose(grasps.object_rest_pose[0], [*REST, *quaternion], atol=1e-6)
    np.testing.assert_allclose(grasps.object_pose[0], [*(REST + UP), *quaternion], atol=1e-6)
    np.testing.assert_allclose(grasps.hand_joints[0], palm_on_box() + UP, atol=1e-6)
    assert grasps.hand_qpos is None and grasps.task is not None and grasps.task.tolist() == [""]


def test_fingers_on_the_box_touch_and_the_others_do_not(tmp_path):
    grasps = import_dexycb(write_dataset(tmp_path))
    touching = {name for name, flag in zip(HUMAN_LINKS, grasps.link_contacts[0], strict=True) if flag}
    assert {"middle_proximal", "index_proximal"} <= touching
    assert not touching & {"index_distal", "pinky_distal", "thumb_distal"}


def test_another_camera_stands_in(tmp_path):
    root = write_dataset(tmp_path)
    folder = root / "20200709-subject-01" / "20200709_141754" / SERIALS[0]
    whole = import_dexycb(root)
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    second = import_dexycb(root)
    np.testing.assert_allclose(second.hand_joints, whole.hand_joints, atol=1e-6)
    np.testing.assert_allclose(second.object_pose, whole.object_pose, atol=1e-6)


def test_left_hands_are_left_out_or_mirrored(tmp_path):
    root = write_dataset(tmp_path / "left", side="left")
    with pytest.raises(FungraspError, match="holds no right hand"):
        import_dexycb(root)
    mirrored = import_dexycb(root, left_hands="mirror")
    right = import_dexycb(write_dataset(tmp_path / "right"))
    assert mirrored.object_name.tolist() == ["003_cracker_box_mirrored"]
    np.testing.assert_allclose(mirror_pose(mirrored.object_pose), right.object_pose, atol=1e-6)
    shift = REST * [0, 2, 0]
    np.testing.assert_allclose(mirrored.hand_joints[0] + shift, right.hand_joints[0], atol=1e-6)
    mesh = load_objects(mirrored, root / "models")["003_cracker_box_mirrored"].mesh
    assert mesh.volume == pytest.approx(np.prod(BOX), rel=1e-4)
    # In the mirrored scene, the mirrored mesh is touched by the same links.
    again = link_contacts(mirrored.hand_joints, mirrored.object_pose, mesh.vertices, mesh.faces)
    np.testing.assert_array_equal(again, mirrored.link_contacts)


def test_one_bad_sequence_does_not_spoil_the_others(tmp_path, caplog):
    root = write_dataset(tmp_path)
    broken = root / "20200709-subject-01" / "20200709_999999"
    broken.mkdir()
    (broken / "meta.yml").write_text("serials: [")
    with caplog.at_level(logging.WARNING):
        assert len(import_dexycb(root)) == 1
    assert "20200709_999999" in caplog.text and "not valid YAML" in caplog.text


def spoil_label(root: Path, **fields: np.ndarray) -> None:
    for path in root.glob("*/*/*/labels_000003.npz"):
        with np.load(path) as data:
            np.savez(path, **(dict(data) | fields))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda root: (root / "calibration/extrinsics_a/extrinsics.yml").unlink(),
            r"extrinsics\.yml",
        ),
        (
            lambda root: (root / "calibration/mano_b/mano.yml").write_text("a: 1"),
            "the field 'betas' is missing",
        ),
        (
            lambda root: (root / "calibration/extrinsics_a/extrinsics.yml").write_text(
                "extrinsics: {apriltag: [1]}"
            ),
            "no 3 by 4 pose of 'apriltag'",
        ),
        (
            lambda root: spoil_label(root, joint_3d=np.zeros((1, 20, 3))),
            "'joint_3d' holds float64 of shape",
        ),
        (lambda root: spoil_label(root, pose_y=np.zeros((1, 3, 4))), "object 1 is missing"),
        (
            lambda root: [p.unlink() for p in root.glob("*/*/*/labels_000002.npz")],
            r"labels_000002\.npz does not exist",
        ),
        (
            lambda root: [p.write_bytes(b"PK") for p in root.glob("*/*/*/labels_*.npz")],
            "DexYCB label .* cut short",
        ),
        (
            lambda root: (root / "models/003_cracker_box/textured_simple.obj").unlink(),
            "unknown mesh '003_cracker_box'",
        ),
    ],
)
def test_what_is_missing_is_named(tmp_path, spoil, words):
    root = write_dataset(tmp_path)
    spoil(root)
    with pytest.raises(FungraspError, match=words):
        import_dexycb(root)


@pytest.mark.parametrize(
    ("meta", "words"),
    [
        ({"ycb_ids": None}, r"meta\.yml: the field 'ycb_ids' is missing"),
        ({"ycb_ids": [14, 99]}, "unknown object number 99"),
        ({"ycb_grasp_ind": 2}, "ycb_grasp_ind is 2, but there are 2 objects"),
        ({"serials": ["3333"]}, "no folder of any of its cameras 3333"),
        ({"lift": (0.0, 0.001, 0.002)}, "never moves the object"),
    ],
)
def test_what_is_wrong_in_a_sequence_is_named(tmp_path, meta, words):
    with pytest.raises(FungraspError, match=words):
        import_dexycb(write_dataset(tmp_path, **meta))


def test_folders_that_are_no_dexycb(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(FungraspError, match="holds no DexYCB sequence"):
            import_dexycb(path)


def test_meta_files_can_not_run_code(tmp_path):
    target = tmp_path / "ran"
    root = write_dataset(tmp_path / "data")
    meta = next(root.glob("*/*/meta.yml"))
    meta.write_text(f"serials: !!python/object/apply:os.mkdir [{target}]")
    with pytest.raises(FungraspError, match="not valid YAML"):
        import_dexycb(root)
    assert not target.exists()


def test_surface_contacts_follow_the_vertices():
    box = trimesh.creation.box(BOX)
    poses = np.array([[0.0, 0, 0, 1, 0, 0, 0], [0.0, 0, 1, 1, 0, 0, 0]])
    surface = np.array([[0.032, 0, 0], [0.0, 0.0, 0.0], [0.1, 0, 0]])
    contacts = surface_contacts(
        np.stack([surface, surface]), np.array([3, 5, 6]), poses, box.vertices, box.faces
    )
    assert np.flatnonzero(contacts[0]).tolist() == [3, 5] and not contacts[1].any()


@pytest.fixture
def mano_model(tmp_path: Path) -> Path:
    """A hand of MANO's layout and of no likeness: every joint a cloud of vertices."""
    random = np.random.default_rng(0)
    parents = np.array([2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14], dtype=np.uint32)
    owner = np.arange(778) % 16
    joints = random.normal(scale=0.03, size=(16, 3))
    regressor = (owner[None] == np.arange(16)[:, None]).astype(float)
    model = {
        "v_template": joints[owner] + random.normal(scale=0.003, size=(778, 3)),
        "shapedirs": random.normal(scale=1e-3, size=(778, 3, 10)),
        "posedirs": np.zeros((778, 3, 135)),
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "kintree_table": np.stack([parents, np.arange(16, dtype=np.uint32)]),
        "weights": (owner[:, None] == np.arange(16)).astype(float),
        "f": np.arange(777).reshape(-1, 3).astype(np.uint32),
        "hands_components": np.linalg.qr(random.normal(size=(45, 45)))[0],
        "hands_mean": random.normal(scale=0.1, size=45),
    }
    folder = tmp_path / "mano"
    folder.mkdir()
    (folder / "MANO_RIGHT.pkl").write_bytes(pickle.dumps(model))
    return folder


def test_mano_gives_rotations_and_contacts(tmp_path, mano_model):
    from fungrasp.grasps.mano import MANO_TO_OURS, ManoHand

    hand = ManoHand(mano_model)
    model = pickle.loads((mano_model / "MANO_RIGHT.pkl").read_bytes())
    pose = np.random.default_rng(1).normal(scale=0.3, size=51)
    joints, vertices, rotations = hand.posed(np.zeros(10), pose[:3], pose[3:48], pose[48:], pca=True)
    wrist = joints[0]
    fingers = pose[3:48] @ model["hands_components"] + model["hands_mean"]
    wanted = np.concatenate([pose[None, :3], fingers.reshape(15, 3)])[MANO_TO_OURS]
    np.testing.assert_allclose(rotations, wanted, atol=1e-6)
    rest = model["J_regressor"] @ model["v_template"]
    np.testing.assert_allclose(wrist, rest[0] + pose[48:], atol=1e-6)
    # The wrist's own vertices turn rigidly about it.
    palm = hand.vertex_links == 0
    moved = Rotation.from_rotvec(pose[:3]).apply(model["v_template"][palm] - rest[0]) + wrist
    np.testing.assert_allclose(vertices[palm], moved, atol=1e-6)
    assert (hand.vertex_links[np.arange(778) % 16 == 7] == HUMAN_LINKS.index("pinky_proximal")).all()


def test_hands_by_the_parameters_of_mano(mano_model):
    from fungrasp.grasps.mano import ManoHand

    hand = ManoHand(mano_model)
    model = pickle.loads((mano_model / "MANO_RIGHT.pkl").read_bytes())
    orient, shift = np.array([0.3, -0.2, 0.1]), np.array([0.1, 0.2, 0.3])
    angles = np.random.default_rng(2).normal(scale=0.2, size=45)
    joints = hand.joints(np.full(10, 0.5), orient, angles, shift)
    assert joints.shape == (21, 3)
    # The bones between joints keep their lengths, and turn with their parents (the index finger's).
    rest = model["J_regressor"] @ (model["v_template"] + model["shapedirs"] @ np.full(10, 0.5))
    base = Rotation.from_rotvec(orient)
    knuckle = base * Rotation.from_rotvec((angles + model["hands_mean"])[:3])
    np.testing.assert_allclose(joints[0], rest[0] + shift, atol=1e-9)
    np.testing.assert_allclose(joints[1], joints[0] + base.apply(rest[1] - rest[0]), atol=1e-9)
    np.testing.assert_allclose(joints[2], joints[1] + knuckle.apply(rest[2] - rest[1]), atol=1e-9)
    components = np.linalg.solve(model["hands_components"].T, angles)
    for given, options in (
        (components, {"pca": True}),
        (angles.reshape(15, 3), {}),
        (angles + model["hands_mean"], {"flat_hand": True}),
    ):
        found = hand.joints(np.full(10, 0.5), orient, given, shift, **options)
        np.testing.assert_allclose(found, joints, atol=1e-9)
    few = np.concatenate([components[:6], np.zeros(39)])
    np.testing.assert_allclose(
        hand.joints([], orient, components[:6]), hand.joints([], orient, few, pca=True), atol=1e-9
    )
    with pytest.raises(FungraspError, match="45 numbers, or fewer components: not 48"):
        hand.joints([], orient, np.zeros(48))


def test_a_model_with_chumpy_objects_is_read_and_runs_nothing(tmp_path):
    from fungrasp.grasps.mano import ManoHand

    path = Path(__file__).parents[3] / "shared" / "data" / "foreign" / "files" / "mano_chumpy"
    if not path.is_dir():
        pytest.skip("needs the files of others in ../shared/data/foreign")
    joints = ManoHand(path).joints(np.zeros(10), np.zeros(3), np.zeros(45))
    assert joints.shape == (21, 3) and np.isfinite(joints).all() and np.ptp(joints) > 0
    (tmp_path / "MANO_RIGHT.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(FungraspError, match=r"asks for os.system"):
        ManoHand(tmp_path)


def test_labels_with_mano(tmp_path, mano_model):
    from fungrasp.grasps.mano import ManoHand

    root = write_dataset(tmp_path / "data")
    with pytest.raises(FungraspError, match="mm from the label's: is it the right model"):
        import_dexycb(root, mano=mano_model)
    hand = ManoHand(mano_model)
    pose = np.random.default_rng(1).normal(scale=0.3, size=51)
    betas = np.full(10, 0.1)
    for path in root.glob("*/*/*/labels_*.npz"):
        with np.load(path) as data:
            fields = dict(data)
        pose[48:] = 0
        pose[48:] = fields["joint_3d"][0, 0] - hand.joints(betas, pose[:3], pose[3:48], pca=True)[0]
        np.savez(path, **(fields | {"pose_m": pose[None].astype(np.float32)}))
    grasps: HumanGraspSet = import_dexycb(root, mano=mano_model)
    assert grasps.hand_qpos is not None
    np.testing.assert_allclose(grasps.hand_qpos[0, :3], grasps.hand_joints[0, 0], atol=1e-6)
    wrist = TAG[0].inv() * CAMERAS[0][0] * Rotation.from_rotvec(pose[:3])
    found = Rotation.from_euler("XYZ", grasps.hand_qpos[0, 3:6])
    assert (wrist.inv() * found).magnitude() < 1e-5

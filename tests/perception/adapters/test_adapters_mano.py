"""With a made hand of MANO's layout: the model itself must not be in the repository."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from recorded import CAMERA, hamer_fields, made_capture, made_up_camera, true_hand, write_npz
from scipy.spatial.transform import Rotation

from fungrasp.errors import FungraspError
from fungrasp.grasps.joint_orders import MANO, TIP_VERTICES
from fungrasp.perception.adapters import read_hand_estimate
from fungrasp.perception.adapters.mano_model import rotation_vectors

JOINTS = true_hand()
PARENTS = np.array([2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14], dtype=np.uint32)
MEAN = np.random.default_rng(4).normal(scale=0.1, size=45)


@pytest.fixture
def mano(tmp_path: Path) -> Path:
    """A model whose joints at rest are ``JOINTS`` about the wrist: each joint has vertices around it."""
    rest = (JOINTS - JOINTS[0])[np.argsort(MANO)]
    owner = np.arange(778) % 16
    owner[TIP_VERTICES] = [15, 3, 6, 12, 9]
    offsets = np.random.default_rng(0).normal(scale=0.003, size=(778, 3))
    body = np.setdiff1d(np.arange(778), TIP_VERTICES)
    regressor = np.zeros((16, 778))
    for joint in range(16):
        mine = body[owner[body] == joint]
        offsets[mine] -= offsets[mine].mean(axis=0)
        regressor[joint, mine] = 1 / len(mine)
    vertices = rest[owner] + offsets
    vertices[TIP_VERTICES] = rest[16:]
    model = {
        "v_template": vertices,
        "shapedirs": np.zeros((778, 3, 10)),
        "posedirs": np.zeros((778, 3, 135)),
        "J_regressor": regressor,
        "kintree_table": np.stack([PARENTS, np.arange(16, dtype=np.uint32)]),
        "weights": (owner[:, None] == np.arange(16)).astype(float),
        "f": np.arange(777).reshape(-1, 3).astype(np.uint32),
        "hands_components": np.eye(45),
        "hands_mean": MEAN,
    }
    folder = tmp_path / "mano"
    folder.mkdir()
    (folder / "MANO_RIGHT.pkl").write_bytes(pickle.dumps(model))
    return folder


def test_joints_from_parameters(tmp_path, mano):
    pytest.importorskip("smplx", reason="smplx is not installed")
    turn = Rotation.from_rotvec([0.3, -0.2, 0.4])
    fields = {
        "source": "mano",
        "side": "right",
        "betas": np.zeros(10),
        "global_orient": turn.as_rotvec(),
        "hand_pose": np.zeros((15, 3)),
        "transl": JOINTS[0],
        "metric": True,
    }
    wanted = turn.apply(JOINTS - JOINTS[0]) + JOINTS[0]
    capture = made_capture(wanted)
    for change in (
        {},
        {"global_orient": turn.as_matrix()[None], "hand_pose": np.tile(np.eye(3), (15, 1, 1))},
        {"hand_pose": -MEAN, "flat_hand_mean": False},
    ):
        hand = read_hand_estimate(write_npz(tmp_path / "h.npz", {**fields, **change}), capture, mano=mano)
        np.testing.assert_allclose(hand.joints_camera, wanted, atol=2e-4)
    # One finger's last joint bent: only its tip moves, by the bone's length.
    pose = np.zeros((15, 3))
    pose[2] = [0.0, 0.0, 0.5]
    hand = read_hand_estimate(
        write_npz(tmp_path / "h.npz", {**fields, "hand_pose": pose}), capture, mano=mano
    )
    moved = np.linalg.norm(hand.joints_camera - wanted, axis=1) > 1e-3
    assert np.flatnonzero(moved).tolist() == [4], "the index finger's tip"
    with pytest.raises(FungraspError, match=r"'fingers' or 'hand_pose' is missing"):
        del fields["hand_pose"]
        read_hand_estimate(write_npz(tmp_path / "h.npz", fields), capture, mano=mano)


def test_joints_from_a_surface(tmp_path, mano):
    pytest.importorskip("smplx", reason="smplx is not installed")
    model = pickle.loads((mano / "MANO_RIGHT.pkl").read_bytes())
    shape, translation, _ = made_up_camera(JOINTS)
    # The turn from the rest pose to what the program saw.
    turn = Rotation.align_vectors(shape, JOINTS - JOINTS[0])[0]
    fields = hamer_fields(JOINTS)
    del fields["pred_keypoints_3d"]
    fields |= {"pred_vertices": turn.apply(model["v_template"]), "pred_cam_t_full": translation}
    hand = read_hand_estimate(write_npz(tmp_path / "h.npz", fields), made_capture(JOINTS), mano=mano)
    assert np.linalg.norm(hand.joints_camera - JOINTS, axis=1).max() < 0.008
    np.testing.assert_allclose(hand.pixels, CAMERA.project(JOINTS), atol=1.5)


def test_without_a_model_or_smplx_the_way_is_told(tmp_path, monkeypatch):
    fields = {"source": "mano", "side": "right", "betas": np.zeros(10)}
    path = write_npz(tmp_path / "h.npz", fields)
    capture = made_capture(JOINTS)
    with pytest.raises(FungraspError, match=r"has no joints .* say where your MANO model is"):
        read_hand_estimate(path, capture)
    import sys

    monkeypatch.setitem(sys.modules, "smplx", None)
    fields |= {"global_orient": np.zeros(3), "hand_pose": np.zeros(45), "transl": JOINTS[0]}
    with pytest.raises(FungraspError, match=r"needs smplx: pip install 'fungrasp\[mano\]'"):
        read_hand_estimate(write_npz(tmp_path / "h.npz", fields), capture, mano=tmp_path)


def test_rotations_come_as_vectors_or_matrices():
    turns = Rotation.random(15, rng=np.random.default_rng(0))
    for given in (turns.as_rotvec(), turns.as_rotvec().ravel(), turns.as_matrix()):
        np.testing.assert_allclose(rotation_vectors(given, 15), turns.as_rotvec(), atol=1e-12)
    with pytest.raises(FungraspError, match=r"45 numbers .* or 135 .*, not 12; components of a PCA"):
        rotation_vectors(np.zeros(12), 15)

"""Files of the layouts that other programs leave, made from a known hand."""

import json
from pathlib import Path

import numpy as np

from fungrasp.grasps import load_human_grasps
from fungrasp.grasps.human_hand import MANO, OPENPOSE
from fungrasp.perception import Capture, Intrinsics

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
FLESH = 0.009
"""Depth of the made captures is so far in front of the joints [m]."""

TO_OPENPOSE, TO_MANO = np.argsort(OPENPOSE), np.argsort(MANO)


def true_hand(distance: float = 0.6, side: str = "right", aside: float = 0.0) -> np.ndarray:
    """Joints of a built-in grasp, camera frame, palm to the camera, shape [21, 3]."""
    joints = load_human_grasps("builtin")[0].hand_joints
    joints = joints - joints.mean(axis=0)
    # Looked at along the thinnest direction, so that hardly any joint hides another.
    _, _, axes = np.linalg.svd(joints)
    axes[2] *= np.sign(np.linalg.det(axes))
    turned = joints @ axes.T
    if side == "left":
        turned = turned * [-1.0, 1.0, 1.0]
    return turned + np.array([aside, 0.02, distance])


def made_capture(joints: np.ndarray, background: float = 1.2) -> Capture:
    """Depth of a hand: discs along its bones before a wall."""
    depth = np.full((CAMERA.height, CAMERA.width), background, np.float32)
    parent = [0, *(0 if joint % 4 == 1 else joint - 1 for joint in range(1, 21))]
    points = np.concatenate([x * joints + (1 - x) * joints[parent] for x in np.linspace(0, 1, 9)])
    for (u, v), point in zip(CAMERA.project(points), points, strict=True):
        radius = FLESH * CAMERA.fx / point[2]
        top, left = max(int(v - radius), 0), max(int(u - radius), 0)
        around = depth[top : int(v + radius) + 2, left : int(u + radius) + 2]
        rows, columns = np.indices(around.shape)
        inside = np.hypot(columns + left - u, rows + top - v) < radius
        around[inside] = np.minimum(around[inside], point[2] - FLESH)
    color = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    return Capture(color, depth, CAMERA)


def made_up_camera(joints: np.ndarray, size: float = 1.0) -> tuple[np.ndarray, np.ndarray, float]:
    """What HaMeR and WiLoR say of a hand: joints about the wrist, translation, a made-up focal length.

    The hand is seen as if it were in the middle of the image, ``size`` times as large as it is.
    """
    middle = joints.mean(axis=0)
    ahead = middle / np.linalg.norm(middle)
    axis = np.cross([0, 0, 1.0], ahead)
    cosine = ahead[2]
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + cross + cross @ cross / (1 + cosine)
    shape = size * (joints - joints[0]) @ turn
    focal = 5000 / 256 * CAMERA.width
    slopes = (CAMERA.project(joints) - [CAMERA.width / 2, CAMERA.height / 2]) / focal
    u, v = slopes.T
    one, zero = np.ones(21), np.zeros(21)
    rows = np.concatenate([np.stack([one, zero, -u], axis=1), np.stack([zero, one, -v], axis=1)])
    values = np.concatenate([u * shape[:, 2] - shape[:, 0], v * shape[:, 2] - shape[:, 1]])
    return shape, np.linalg.lstsq(rows, values, rcond=None)[0], focal


def hamer_fields(joints: np.ndarray, side: str = "right", size: float = 1.0) -> dict:
    """One hand as HaMeR's and WiLoR's demos hold it."""
    shape, translation, focal = made_up_camera(joints, size)
    return {
        "version": 1,
        "source": "hamer",
        "is_right": float(side == "right"),
        "pred_keypoints_3d": shape[TO_OPENPOSE],
        "pred_cam_t_full": translation,
        "scaled_focal_length": focal,
    }


def write_json(path: Path, fields: dict) -> Path:
    content = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields.items()
    }
    path.write_text(json.dumps(content))
    return path


def write_npz(path: Path, fields: dict) -> Path:
    np.savez(path, **fields)
    return path

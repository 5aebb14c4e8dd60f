import numpy as np
import pytest
from object_pose_scenes import CAMERA

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import quaternion_from_rotation_vector
from fungrasp.objects import load_object
from fungrasp.perception.object_pose.object_template import MeshRays
from fungrasp.perception.object_pose.pose_error import add
from fungrasp.perception.object_pose.tracker import FOLLOWED, ObjectTracker

DRILL = load_object("drill")
RAYS = MeshRays(DRILL.vertices, DRILL.faces)
DIRECTIONS = CAMERA.rays().reshape(-1, 3)


def pose_at(time: float) -> np.ndarray:
    turn = quaternion_from_rotation_vector(np.array([0.4 * np.sin(2 * time), 2.0 + 0.8 * time, 0.3]))
    return np.concatenate([[0.08 * np.sin(3 * time), 0.05 * np.cos(2 * time) - 0.05, 0.6 + 0.1 * time], turn])


def image(pose: np.ndarray | None, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Color and depth of the object in front of a wall, or of the wall alone."""
    rng = np.random.default_rng(seed)
    color = np.full((CAMERA.height, CAMERA.width, 3), (150, 140, 120), np.uint8)
    depth = np.full(color.shape[:2], 1.1)
    if pose is not None:
        seen = RAYS.cast(pose[None], DIRECTIONS)[0].reshape(depth.shape)
        color[np.isfinite(seen)] = [50, 90, 180]
        depth = np.minimum(depth, seen)
    noisy = depth + 0.0015 * rng.normal(size=depth.shape)
    return color, noisy.astype(np.float32)


def test_follows_a_moving_object() -> None:
    tracker = ObjectTracker(DRILL, CAMERA, pose_at(0.0))
    points = np.asarray(DRILL.vertices)
    errors, scores = [], []
    for i in range(1, 25):
        truth = pose_at(i / 15)
        found = tracker.update(*image(truth, i))
        errors.append(float(add(points, found.pose, truth)))
        scores.append(found.score)
    assert max(errors) < 0.01, "m, of points of the surface"
    assert np.median(errors) < 0.004
    assert min(scores) > FOLLOWED


def test_says_that_the_object_is_gone() -> None:
    tracker = ObjectTracker(DRILL, CAMERA, pose_at(0.0))
    tracker.update(*image(pose_at(0.0), 1))
    gone = tracker.update(*image(None, 2))
    assert gone.score < FOLLOWED
    assert np.allclose(gone.pose, tracker.pose)
    again = tracker.update(*image(pose_at(0.0), 3))
    assert again.score > FOLLOWED


def test_other_image_sizes_are_refused() -> None:
    tracker = ObjectTracker(DRILL, CAMERA, pose_at(0.0))
    color, depth = image(None, 0)
    with pytest.raises(FungraspError, match="320 x 240"):
        tracker.update(color[::2], depth[::2])
    with pytest.raises(FungraspError, match="7 finite numbers"):
        ObjectTracker(DRILL, CAMERA, np.full(7, np.nan))

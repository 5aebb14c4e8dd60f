import numpy as np
import pytest
import trimesh

from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, transform_points
from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid
from fungrasp.perception import Intrinsics
from fungrasp.perception.compiled_loops import intrusion
from fungrasp.perception.object_pose.object_template import KnownSurface
from fungrasp.perception.object_pose.pose_error import add
from fungrasp.perception.object_pose.search import (
    FreeSpace,
    IcpSettings,
    ObjectEvidence,
    fit_poses,
    free_space,
)

SIZE = np.array([0.12, 0.08, 0.05])
CAMERA = Intrinsics(200, 160, 200.0, 200.0, 99.5, 79.5)
POSE = np.array([0.01, -0.02, 0.5, 1.0, 0.0, 0.0, 0.0])
FINE = IcpSettings(15, 300, 300, 0.005)


def box_surface() -> KnownSurface:
    box = trimesh.creation.box(SIZE)
    grid = SignedDistanceGrid.from_mesh(np.asarray(box.vertices), np.asarray(box.faces), 0.004)
    samples = trimesh.sample.sample_surface(box, 400, seed=1)[0]
    return KnownSurface(SignedDistanceBank([grid]), np.asarray(samples))


SURFACE = box_surface()


def nothing_forbidden() -> FreeSpace:
    empty = np.zeros((160, 200), np.float32)
    return free_space(empty, CAMERA, np.ones((160, 200), bool))


def moved(shift: tuple[float, float, float], turn: tuple[float, float, float]) -> np.ndarray:
    step = np.concatenate([shift, quaternion_from_rotation_vector(np.array(turn))])
    return compose(POSE, step)


def on_all_sides(count: int) -> np.ndarray:
    points = trimesh.sample.sample_surface(trimesh.creation.box(SIZE), count, seed=2)[0]
    return transform_points(POSE, np.asarray(points))


def test_recovers_a_pose_from_points_on_all_sides() -> None:
    evidence = ObjectEvidence(on_all_sides(300), nothing_forbidden())
    starts = np.stack(
        [moved((0.01, 0.005, -0.01), (0.2, -0.1, 0.15)), moved((-0.01, 0.0, 0.01), (0, 0.2, 0))]
    )
    coarse, _ = fit_poses(SURFACE, evidence, starts, IcpSettings(10, 100, 100, 0.02))
    poses, cost = fit_poses(SURFACE, evidence, coarse, FINE)
    assert add(SURFACE.samples, poses, POSE).max() < 1e-3
    assert cost.max() < 1e-6


def test_batch_equals_loop() -> None:
    evidence = ObjectEvidence(on_all_sides(100), nothing_forbidden())
    starts = np.stack([moved((0.01, 0, 0), (0, 0, 0.1)), moved((0, 0.02, 0), (0.3, 0, 0))])
    together, cost = fit_poses(SURFACE, evidence, starts, FINE)
    for i in range(2):
        alone, its_cost = fit_poses(SURFACE, evidence, starts[i : i + 1], FINE)
        assert together[i] == pytest.approx(alone[0], abs=1e-9)
        assert cost[i] == pytest.approx(its_cost[0], abs=1e-12)


def flat_side_image() -> tuple[np.ndarray, np.ndarray]:
    """Depth image and mask of the box seen straight on, a wall behind it."""
    rays = CAMERA.rays()
    front = POSE[2] - SIZE[2] / 2
    at_front = rays * front - POSE[:3]
    mask = (np.abs(at_front[..., 0]) < SIZE[0] / 2) & (np.abs(at_front[..., 1]) < SIZE[1] / 2)
    return np.where(mask, front, 1.0).astype(np.float32), mask


@pytest.mark.parametrize("known", [True, False])
def test_free_space_fixes_what_one_flat_side_leaves_open(known: bool) -> None:
    depth, mask = flat_side_image()
    points = (CAMERA.rays() * depth[..., None])[mask]
    points = points[np.random.default_rng(0).permutation(len(points))]
    forbidden = free_space(depth, CAMERA, mask) if known else nothing_forbidden()
    # Inside the seen side, so that the points alone are content.
    start = moved((0.012, 0.009, 0.0), (0, 0, 0.1))
    points = points[np.linalg.norm(points[:, :2] - POSE[:2], axis=1) < 0.025]
    poses, _ = fit_poses(
        SURFACE, ObjectEvidence(points, forbidden), start[None], IcpSettings(30, 300, 400, 0.005)
    )
    error = add(SURFACE.samples, poses, POSE)[0]
    assert error < 0.003 if known else error > 0.01


def test_intrusion_by_hand() -> None:
    depth = np.full((160, 200), 1.0, np.float32)
    shown = np.zeros((160, 200), bool)
    shown[70:90, 90:110] = True
    depth[shown] = 0.5
    depth[:, :50] = 0.0
    space = free_space(depth, CAMERA, shown, np.array([0.0, -1.0, 0.0, 0.3]), tolerance=0.01)
    points = CAMERA.deproject(
        np.array([[100, 80], [100, 80], [114, 80], [20, 80], [114, 80], [500, 80]]),
        np.array([0.6, 0.45, 0.5, 0.5, 1.2, 0.5]),
    )

    def intruding(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = [intrusion.py_func(*p, space.depth, space.refuge, space.lens, space.table) for p in points]
        return np.array(found)[:, 0], np.array(found)[:, 1:]

    distance, gradient = intruding(points)
    # Behind its pixel; 4 cm (less the tolerance) in front of it; 5 pixels beside it; not measured; behind the
    # wall; outside the image.
    assert distance == pytest.approx([0.0, 0.04, 5 * 0.5 / 200, 0.0, 0.0, 0.0], abs=1e-6)
    assert gradient[1] == pytest.approx([0, 0, -1])
    assert gradient[2, :2] == pytest.approx([1, 0])
    below = np.array([[0.0, 0.35, 0.5]])
    deep, up = intruding(below)
    assert deep == pytest.approx([0.04])
    assert up[0] == pytest.approx([0, 1, 0])

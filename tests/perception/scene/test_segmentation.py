import numpy as np
import pytest
from object_pose_scenes import HERE, hand_joints, scene

from fungrasp.objects import load_object
from fungrasp.perception import Capture
from fungrasp.perception.scene import segmentation
from fungrasp.perception.scene.segmentation import distance_from_hand, segment
from fungrasp.perception.scene.table import largest_plane

MUG = load_object("mug")
STANDING = MUG.rest_pose(0.3)
SCENE = scene(MUG, STANDING, np.array([0.05, 0.0, 0.04]))


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_the_table_is_found() -> None:
    table = largest_plane(SCENE.capture, np.random.default_rng(0))
    assert table is not None
    assert np.degrees(np.arccos(table[:3] @ SCENE.table[:3])) < 0.5
    assert table[3] == pytest.approx(SCENE.table[3], abs=0.002)


def test_no_table_among_scattered_points() -> None:
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.3, 2.0, SCENE.capture.depth.shape).astype(np.float32)
    scattered = Capture(SCENE.capture.color, depth, SCENE.capture.intrinsics)
    assert largest_plane(scattered, np.random.default_rng(0)) is None


def test_one_mask_is_the_object() -> None:
    found = segment(SCENE.capture, SCENE.hand.joints_camera, SCENE.table, 0.16)
    best = max(overlap(mask, SCENE.mask) for mask in found.masks)
    assert best > 0.75
    support = found.support
    assert support[SCENE.mask].mean() > 0.7
    height = SCENE.capture.points() @ SCENE.table[:3] + SCENE.table[3]
    # But for its border, where neighboring pixels share their evidence.
    assert (support[height < 0.003] > 0.5).mean() < 0.01


def test_a_box_bounds_the_masks() -> None:
    rows, columns = np.nonzero(SCENE.mask)
    box = (float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max()))
    found = segment(SCENE.capture.with_object(box=box), None, SCENE.table, 0.16)
    inside = np.zeros_like(SCENE.mask)
    inside[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
    assert found.masks
    assert not any((mask & ~inside).any() for mask in found.masks)


def test_nothing_in_the_hand_is_no_mask() -> None:
    far = SCENE.hand.joints_camera + np.array([0.0, 0.0, 5.0])
    assert segment(SCENE.capture, far, SCENE.table, 0.16).masks == ()


def test_distance_from_hand() -> None:
    joints = hand_joints(HERE[:3])
    tip = joints[8]
    points = tip + np.array([[-0.03, 0.0, 0.0], [0.0, 0.0, 0.0]])
    # The flesh round the last bone of a finger is 8 mm thick.
    assert distance_from_hand(points, joints) == pytest.approx([0.022, -0.008], abs=1e-3)


def test_pieces_whose_distance_from_the_hand_is_not_known(recwarn: pytest.WarningsRecorder) -> None:
    """They come after those near it, and nothing is said on the terminal."""
    hand = np.full((20, 40), np.inf)
    hand[5:15, 25:30] = 0.01
    unknown, near, partly = np.zeros((3, 20, 40), dtype=bool)
    unknown[2:18, 2:18] = True
    near[5:15, 25:30] = True
    partly[5:15, 25:35] = True
    found = segmentation._groups([unknown, near], hand, held=True)
    assert [mask.tolist() for mask in found[:2]] == [near.tolist(), near.tolist()]
    assert segmentation._near_end(hand[unknown]) == np.inf
    assert segmentation._near_end(hand[partly]) == pytest.approx(0.01)
    assert not [w for w in recwarn if issubclass(w.category, RuntimeWarning)]

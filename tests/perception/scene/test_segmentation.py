"""Which pixels may show the object: masks, hints, and how wide outlines are in depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from object_pose_scenes import HERE, hand_joints, scene
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object
from fungrasp.perception import Capture
from fungrasp.perception.hand.hand_capsules import SURE_SKIN, capsule_distances
from fungrasp.perception.io.capture import depth_noise
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.object_view import cleaned_mask, view_of_object
from fungrasp.perception.scene import segmentation
from fungrasp.perception.scene.pixel_classes import NEVER, SHARP, depth_spread, edge_width
from fungrasp.perception.scene.segmentation import (
    MASK_SURE,
    hinted_odds,
    pointed_pieces,
    segment,
)
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
    distance = capsule_distances(points, *SURE_SKIN.ends(joints), SURE_SKIN.radius)
    assert distance == pytest.approx([0.022, -0.008], abs=1e-3)


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


def square(low: int, high: int) -> np.ndarray:
    mask = np.zeros(SCENE.mask.shape, dtype=bool)
    mask[low:high, low:high] = True
    return mask


def test_odds_of_a_mask_leave_its_border_to_color_and_depth() -> None:
    prior, samples = hinted_odds(SCENE.capture.with_object(mask=square(80, 140)), 0.16)
    along = prior[110, 60:112]
    assert (np.diff(along) >= 0).all() and along[0] == NEVER
    assert prior[110, 110] == MASK_SURE
    assert prior[110, 81] == prior[110, 78] == 0
    assert samples[110, 110] and not samples[110, 82]


def test_odds_of_a_box_and_of_a_point() -> None:
    prior, samples = hinted_odds(SCENE.capture.with_object(box=(80.0, 90.0, 100.0, 110.0)), 0.16)
    assert prior[100, 90] == 0 and prior[100, 101] == NEVER and not samples.any()
    prior, samples = hinted_odds(SCENE.capture.with_object(point=(90.0, 100.0)), 0.05)
    assert samples[100, 90] and prior[100, 90] == MASK_SURE
    assert prior[200, 300] == NEVER


def test_a_point_chooses_the_piece() -> None:
    first, second = square(20, 40), square(100, 110)
    assert pointed_pieces([first, second], (105.0, 104.0))[0] is second
    assert pointed_pieces([], (1.0, 1.0)) == []


@pytest.mark.parametrize("pixels", [-4, 4])
def test_masks_too_large_or_small_become_the_object(pixels: int) -> None:
    change = ndimage.binary_dilation if pixels > 0 else ndimage.binary_erosion
    wrong = np.asarray(change(SCENE.mask, iterations=abs(pixels)))
    color = SCENE.capture.color.copy()
    color[SCENE.mask] = [40, 60, 190]
    capture = replace(SCENE.capture, color=color, mask=wrong)
    found = segment(capture, SCENE.hand.joints_camera, SCENE.table, 0.16).masks[0]

    def overlap(a: np.ndarray) -> float:
        return float((a & SCENE.mask).sum() / (a | SCENE.mask).sum())

    assert overlap(found) > max(0.8, overlap(wrong) + 0.05)


def test_background_in_a_mask_is_left_out() -> None:
    capture, rng = SCENE.capture, np.random.default_rng(0)
    depth, wrong = capture.depth.copy(), SCENE.mask.copy()
    # A tenth of the mask shows a wall behind, as masks of labeling tools do.
    rows, columns = np.nonzero(SCENE.mask)
    some = rng.permutation(len(rows))[: len(rows) // 10]
    depth[rows[some], columns[some]] = 5.0
    cleaned, extent = cleaned_mask(replace(capture, depth=depth, mask=wrong), 0.16, rng)
    assert not cleaned[rows[some], columns[some]].any() and extent < 12.0
    assert cleaned.sum() == SCENE.mask.sum() - len(some)
    view, problem = view_of_object(
        object_template(MUG),
        replace(capture, depth=depth, mask=wrong),
        SCENE.hand.joints_camera,
        SCENE.table,
        rng,
    )
    assert view is not None and not problem


def test_a_point_outside_is_an_error() -> None:
    with pytest.raises(FungraspError, match="outside the image"):
        SCENE.capture.with_object(point=(400.0, 10.0))


def blocks(smoothed: int) -> np.ndarray:
    """Blocks 10 cm in front of a wall, smoothed over so many pixels."""
    depth = np.full((240, 320), 0.8)
    for column in (60, 160, 260):
        depth[60:180, column - 25 : column + 25] = 0.7
    return ndimage.uniform_filter(depth, smoothed).astype(np.float32)


@pytest.mark.parametrize("smoothed", [9, 15])
def test_width_of_smoothed_steps(smoothed: int) -> None:
    # Of a straight ramp, eight tenths lie between 10 and 90 %.
    assert edge_width(blocks(smoothed)) == pytest.approx(0.8 * smoothed, abs=1.0)


def test_sharp_steps_and_no_steps() -> None:
    assert edge_width(blocks(1)) == SHARP
    assert edge_width(np.full((240, 320), 0.8, np.float32)) == SHARP
    assert edge_width(np.zeros((240, 320), np.float32)) == SHARP


def test_depth_is_uncertain_near_smoothed_steps_only() -> None:
    depth = blocks(11)
    spread, noise = depth_spread(depth, edge_width(depth)), depth_noise(depth)
    assert spread[120, 185] > 5 * noise[120, 185]
    assert spread[120, 160] == noise[120, 160]
    assert np.array_equal(depth_spread(depth, SHARP), noise)

from dataclasses import replace

import numpy as np
import pytest
from object_pose_scenes import scene
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.objects import load_object
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.object_view import cleaned_mask, view_of_object
from fungrasp.perception.scene.pixel_classes import NEVER
from fungrasp.perception.scene.segmentation import MASK_SURE, hinted_odds, pointed_pieces, segment

MUG = load_object("mug")
SCENE = scene(MUG, MUG.rest_pose(0.3), np.array([0.05, 0.0, 0.04]))


def square(low: int, high: int) -> np.ndarray:
    mask = np.zeros(SCENE.mask.shape, dtype=bool)
    mask[low:high, low:high] = True
    return mask


def test_odds_of_a_mask_fall_across_its_border() -> None:
    prior, samples = hinted_odds(SCENE.capture.with_object(mask=square(80, 140)), 0.16)
    along = prior[110, 60:112]
    assert (np.diff(along) >= 0).all() and along[0] == NEVER
    assert prior[110, 110] == MASK_SURE
    assert prior[110, 81] > 0 > prior[110, 78] > NEVER
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

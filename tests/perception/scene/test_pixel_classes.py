import numpy as np
import pytest
from scipy import ndimage

from fungrasp.perception.io.capture import depth_noise
from fungrasp.perception.scene.pixel_classes import SHARP, depth_spread, edge_width


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

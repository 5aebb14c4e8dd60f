"""Where the image's outline is beside the silhouette of a pose."""

import numpy as np
import pytest

from fungrasp.perception.object_pose.outline import outline_offset

V, U = np.mgrid[:120, :160]
GREEN, TABLE = (60, 160, 80), (190, 170, 150)


def ellipse(a, b, x=80.0, y=60.0):
    return ((U - x) / a) ** 2 + ((V - y) / b) ** 2 < 1.0


def picture(thing, noise=3.0):
    color = np.where(thing[..., None], GREEN, TABLE) + np.random.default_rng(0).normal(
        0, noise, (*thing.shape, 3)
    )
    return np.clip(color, 0, 255).astype(np.uint8)


NOTHING = np.zeros((120, 160), bool)


@pytest.mark.parametrize("pixels", [-6, -3, 0, 3, 6])
def test_the_size_of_the_outline_is_told_by_color(pixels):
    larger, off = outline_offset(picture(ellipse(30 + pixels, 30 + pixels)), ellipse(30, 30), NOTHING)
    assert larger == pytest.approx(pixels, abs=0.7)
    assert off == pytest.approx(abs(pixels), abs=1.0)


def test_a_shift_is_no_other_size():
    larger, off = outline_offset(picture(ellipse(30, 30, x=84.0)), ellipse(30, 30), NOTHING)
    assert abs(larger) < 0.5 and off > 2.5


def test_a_mesh_that_is_too_short_is_off_at_one_end():
    """Nothing changes in color where it ends."""
    whole = ellipse(40, 20)
    larger, off = outline_offset(picture(whole), whole & (U > 60), NOTHING)
    assert off > 2.5 > abs(larger)
    assert outline_offset(picture(whole), whole, NOTHING)[1] < 1.0


def test_shadows_change_it_little():
    color = picture(ellipse(30, 30), noise=0.0)
    shadow = ellipse(34, 34, x=86.0) & ~ellipse(30, 30)
    color[shadow] = (0.75 * color[shadow]).astype(np.uint8)
    assert abs(outline_offset(color, ellipse(30, 30), NOTHING)[0]) < 1.0


def test_what_is_hidden_does_not_count():
    thing, hand = ellipse(30, 30), U < 70
    color = picture(thing)
    color[hand] = (200, 140, 120)
    larger, off = outline_offset(color, thing, hand)
    assert abs(larger) < 0.7 and off < 1.5


def test_hardly_any_outline_tells_nothing():
    assert np.isnan(outline_offset(picture(ellipse(30, 30)), ellipse(30, 30), U < 105)).all()
    tiny = (abs(U - 80) < 2) & (abs(V - 60) < 2)
    assert np.isnan(outline_offset(picture(tiny), tiny, NOTHING)).all()


def test_a_silhouette_that_fills_the_image_tells_nothing():
    everything = ~NOTHING
    assert np.isnan(outline_offset(picture(everything), everything, NOTHING)).all()


def test_an_image_of_one_color_tells_nothing():
    assert np.isnan(outline_offset(np.full((120, 160, 3), 128, np.uint8), ellipse(30, 30), NOTHING)).all()

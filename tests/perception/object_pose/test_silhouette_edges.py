"""Where the image's outline is beside the silhouette of a pose."""

import numpy as np
import pytest
from scipy import ndimage

from fungrasp.objects import plain_shape
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.object_pose.object_template import object_template
from fungrasp.perception.object_pose.object_view import view_of_object
from fungrasp.perception.object_pose.pose_evidence import edge_offset, silhouette_edges

V, U = np.mgrid[:120, :160]
GREEN, TABLE = (60, 160, 80), (190, 170, 150)


def ellipse(a, b, x=80.0, y=60.0):
    return ((U - x) / a) ** 2 + ((V - y) / b) ** 2 < 1.0


def picture(obj, noise=3.0):
    color = np.where(obj[..., None], GREEN, TABLE) + np.random.default_rng(0).normal(
        0, noise, (*obj.shape, 3)
    )
    return np.clip(color, 0, 255).astype(np.uint8)


NOTHING = np.zeros((120, 160), bool)


@pytest.mark.parametrize("pixels", [-6, -3, 0, 3, 6])
def test_the_size_of_the_outline_is_told_by_color(pixels):
    larger, off = edge_offset(picture(ellipse(30 + pixels, 30 + pixels)), ellipse(30, 30), NOTHING)
    assert larger == pytest.approx(pixels, abs=0.7)
    assert off == pytest.approx(abs(pixels), abs=1.0)


def test_a_shift_is_no_other_size():
    larger, off = edge_offset(picture(ellipse(30, 30, x=84.0)), ellipse(30, 30), NOTHING)
    assert abs(larger) < 0.5 and off > 2.5


def test_a_mesh_that_is_too_short_is_off_at_one_end():
    """Nothing changes in color where it ends."""
    whole = ellipse(40, 20)
    larger, off = edge_offset(picture(whole), whole & (U > 60), NOTHING)
    assert off > 2.5 > abs(larger)
    assert edge_offset(picture(whole), whole, NOTHING)[1] < 1.0


def test_shadows_change_it_little():
    color = picture(ellipse(30, 30), noise=0.0)
    shadow = ellipse(34, 34, x=86.0) & ~ellipse(30, 30)
    color[shadow] = (0.75 * color[shadow]).astype(np.uint8)
    assert abs(edge_offset(color, ellipse(30, 30), NOTHING)[0]) < 1.0


def test_what_is_hidden_does_not_count():
    obj, hand = ellipse(30, 30), U < 70
    color = picture(obj)
    color[hand] = (200, 140, 120)
    larger, off = edge_offset(color, obj, hand)
    assert abs(larger) < 0.7 and off < 1.5


def test_hardly_any_outline_tells_nothing():
    assert np.isnan(edge_offset(picture(ellipse(30, 30)), ellipse(30, 30), U < 105)).all()
    tiny = (abs(U - 80) < 2) & (abs(V - 60) < 2)
    assert np.isnan(edge_offset(picture(tiny), tiny, NOTHING)).all()


LENS = Intrinsics(320, 240, 400.0, 400.0, 160.0, 120.0)
POSE = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])


def mask_piece(length: int, spill: int = 0) -> float:
    """Of a bar 240 mm long behind a board, looked at with a mesh of another length that ends at the bar's
    left end and with its mask, which spills over the wall behind it by so many pixels."""
    bar = object_template(plain_shape("box:240x40x30", 0.2))
    v, u = np.mgrid[: LENS.height, : LENS.width]
    rays = LENS.deproject(np.stack([u.ravel(), v.ravel()], axis=-1), np.ones(u.size))
    depth = bar.rays.cast(POSE[None], rays)[0].reshape(u.shape)
    board, shown = (u >= 180) & (u < 220), np.isfinite(depth)
    depth = np.where(board, 0.35, np.where(shown, depth, 1.2)).astype(np.float32)
    color = np.where(
        board[..., None], (90, 150, 60), np.where(shown[..., None], (40, 80, 170), (190, 170, 150))
    )
    spilled = ndimage.binary_dilation(shown, iterations=spill) if spill else shown
    capture = Capture(color.astype(np.uint8), depth, LENS, spilled & ~board)
    mesh = object_template(plain_shape(f"box:{length}x40x30", 0.2))
    view, problem = view_of_object(mesh, capture, None, None, np.random.default_rng(0))
    assert view is not None, problem
    moved = POSE.copy()
    moved[0] += (length - 240) / 2000
    return silhouette_edges(view, moved, 0)["mask_piece"]


def test_a_piece_of_the_mask_beyond_what_hides_it_is_found():
    """It is farther from the middle than the short mesh is large, which is no reason not to see it."""
    assert mask_piece(240) == 0.0
    assert mask_piece(150) > 500


def test_what_a_mask_shows_of_the_wall_is_no_piece():
    assert mask_piece(240, spill=9) == 0.0

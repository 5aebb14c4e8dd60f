import dataclasses

import numpy as np
import pytest

from benchmarks.synthetic_captures.camera_errors import (
    DEPTH_CAMERAS,
    camera_depth,
)
from benchmarks.synthetic_captures.capture_settings import camera_settings
from benchmarks.synthetic_captures.render_capture import vary_hand
from fungrasp.core.errors import FungraspError
from fungrasp.grasps import builtin_grasps
from fungrasp.grasps.human_hand import bone_lengths
from fungrasp.perception import Intrinsics
from fungrasp.perception.scene.pixel_classes import edge_width

LENS = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
EXACT = {"noise": 0.0, "waves": 0.0, "subpixel": 0.0, "axial": (0.0, 0.0), "scale": 0.0, "speckle": 1e-9}


def a_board(near: float = 0.7, far: float = 0.8) -> np.ndarray:
    """A flat board in front of a flat wall."""
    depth = np.full((240, 320), far, np.float32)
    depth[60:180, 100:220] = near
    return depth


def seen(name: str, depth: np.ndarray, brightness: np.ndarray | None = None, **changes) -> np.ndarray:
    camera = dataclasses.replace(DEPTH_CAMERAS[name], **changes)
    return camera_depth(depth, LENS, camera, np.random.default_rng(0), brightness)


def test_outlines_of_filtered_stereo_melt_and_those_of_structured_light_do_not():
    mixed = {name: edge_width(seen(name, a_board())) for name in ("d435i_filtered", "xtion")}
    assert mixed["d435i_filtered"] >= 3 > mixed["xtion"]


def test_the_shadow_is_on_the_side_that_the_second_camera_cannot_see():
    depth = seen("xtion", a_board(0.5, 0.8), grazing=(89.0, 90.0), **EXACT)
    lost = depth[80:160] == 0
    # 300 px * 0.075 m * (1 / 0.5 m - 1 / 0.8 m) = 16.9 pixels left of the board.
    assert lost[:, 75:105].sum(axis=1).mean() == pytest.approx(16.9, abs=4)
    assert lost[:, 215:260].sum(axis=1).mean() < 3
    tof = seen("tof", a_board(0.5, 0.8), grazing=(89.0, 90.0), **EXACT)
    assert (tof[80:160] == 0).mean() < 0.01


def test_filters_fill_shadows():
    holes = {name: (seen(name, a_board(0.5, 0.8)) == 0).mean() for name in DEPTH_CAMERAS}
    assert holes["d435i_filtered"] < 0.5 * holes["d435i"] < 0.5 * holes["d435i_high_accuracy"] + 1e-9


def test_dark_and_shiny_surfaces_are_lost():
    brightness = np.full((240, 320), 0.3)
    brightness[:, :100], brightness[:, 220:] = 0.0005, 3.0
    lost = seen("tof", np.full((240, 320), 0.8, np.float32), brightness) == 0
    assert lost[:, :90].mean() > 0.95
    assert lost[:, 230:].mean() > 0.5
    assert lost[:, 110:210].mean() < 0.02


def test_other_hands_touch_where_the_first_one_did():
    grasps = builtin_grasps()
    lengths = []
    for i in range(30):
        grasp = grasps[i]
        joints = vary_hand(grasp, 0.07, np.random.default_rng(i))
        touching = np.flatnonzero(grasp.link_contacts[[3, 6, 9, 12, 15]])
        tips = np.array([4, 8, 12, 16, 20])[touching]
        moved = joints[tips] - grasp.hand_joints[tips]
        # All by the same way up, where the hand would be in the table.
        assert np.abs(moved - moved[:1]).max(initial=0.0) < 1e-9
        assert np.abs(moved[:, :2]).max(initial=0.0) < 1e-9
        assert moved[:, 2].min(initial=0.0) >= -1e-9
        assert moved[:, 2].max(initial=0.0) < 0.015
        lengths.append(bone_lengths(joints).sum() / bone_lengths(grasp.hand_joints).sum())
    assert 0.03 < np.std(lengths) < 0.12


def test_an_unknown_camera_is_named():
    with pytest.raises(FungraspError, match="d435i"):
        camera_settings("d435")
    with pytest.raises(FungraspError, match="window"):
        dataclasses.replace(DEPTH_CAMERAS["tof"], window=0.0)

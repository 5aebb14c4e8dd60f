import json
from pathlib import Path

import numpy as np
import pytest
from capture_files import HEIGHT, OURS, WIDTH, scene
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.perception.io.capture import Capture, Intrinsics
from fungrasp.perception.io.image_source import ImageSource
from fungrasp.perception.io.scene_folders import read_dexycb, read_folder, write_folder


def a_bop_scene(folder):
    color, depth = scene()
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    Image.fromarray(color).save(folder / "rgb" / "000007.jpg", quality=95)
    Image.fromarray(np.round(depth * 10000).astype(np.uint16)).save(folder / "depth" / "000007.png")
    matrix = [OURS["fx"], 0, OURS["cx"], 0, OURS["fy"], OURS["cy"], 0, 0, 1]
    cameras = {"7": {"cam_K": matrix, "depth_scale": 0.1}, "8": {"cam_K": matrix, "depth_scale": 0.1}}
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    return folder


def test_what_is_written_is_read_again(tmp_path):
    (color, depth), mask = scene(), np.zeros((HEIGHT, WIDTH), bool)
    mask[80:180, 100:220] = True
    lens = Intrinsics(WIDTH, HEIGHT, 301.5, 300.25, 160.5, 119.0)
    capture = Capture(color, depth + np.float32(0.00337), lens, mask)
    write_folder(capture, tmp_path / "near")
    again = read_folder(tmp_path / "near")
    np.testing.assert_array_equal(again.color, capture.color)
    np.testing.assert_array_equal(again.mask, mask)
    np.testing.assert_allclose(again.depth, capture.depth, atol=0.51e-4)
    assert again.intrinsics == lens
    with pytest.raises(FungraspError, match="mask of another image"):
        write_folder(Capture(color, capture.depth, lens), tmp_path / "near")
    far = capture.depth.copy()
    far[0, :2] = 20.0, 100.0
    write_folder(Capture(color, far, lens), tmp_path / "far")
    again = read_folder(tmp_path / "far")
    assert again.mask is None and again.depth[0, :2].tolist() == pytest.approx([20.0, 0.0])
    np.testing.assert_allclose(again.depth[1:], far[1:], atol=0.51e-3)


def test_a_bop_scene(tmp_path):
    folder = a_bop_scene(tmp_path / "000002")
    capture = read_folder(folder, 7)
    np.testing.assert_allclose(capture.depth, scene()[1], atol=1e-4)
    assert capture.intrinsics.fy == 301
    assert read_folder(folder).mask is None
    with pytest.raises(FungraspError, match="has no image 8"):
        read_folder(folder, 8)


def test_a_unit_that_is_given_counts_for_every_kind_of_folder(tmp_path):
    write_folder(read_folder(a_bop_scene(tmp_path / "000002"), 7), tmp_path / "own")
    for folder, unit in (
        (tmp_path / "000002", 1e-4),
        (tmp_path / "own", 1e-4),
        (a_dexycb_camera(tmp_path / "dexycb"), 1e-3),
    ):
        as_it_says = ImageSource(folder=folder).read()
        doubled = ImageSource(folder=folder, depth_unit=2 * unit).read()
        np.testing.assert_allclose(doubled.depth, 2 * as_it_says.depth, rtol=1e-5)


def a_dexycb_camera(root):
    color, depth = scene()
    camera = root / "20200709-subject-01" / "20200709_141754" / "836212060125"
    calibration = root / "calibration" / "intrinsics"
    camera.mkdir(parents=True)
    calibration.mkdir(parents=True)
    Image.fromarray(color).save(camera / "color_000071.jpg", quality=95)
    Image.fromarray(np.round(depth * 1000).astype(np.uint16)).save(
        camera / "aligned_depth_to_color_000071.png"
    )
    lens = "{fx: 300.0, fy: 301.0, ppx: 160.0, ppy: 119.0}"
    (calibration / f"{camera.name}_{WIDTH}x{HEIGHT}.yml").write_text(f"color: {lens}\ndepth: {{fx: 1.0}}\n")
    return camera


def test_a_dexycb_camera(tmp_path):
    pytest.importorskip("yaml")
    camera = a_dexycb_camera(tmp_path)
    capture = read_dexycb(camera, 71)
    np.testing.assert_allclose(capture.depth, scene()[1], atol=1e-3)
    assert (capture.intrinsics.fx, capture.intrinsics.cy) == (300, 119)
    assert read_folder(camera).mask is None
    with pytest.raises(FungraspError, match="does not exist"):
        read_dexycb(camera, 3)


def test_a_folder_of_something_else_is_refused(tmp_path):
    with pytest.raises(FungraspError, match="is no capture"):
        read_folder(tmp_path)
    with pytest.raises(FungraspError, match="does not exist"):
        read_folder(tmp_path / "missing")


FOREIGN = Path(__file__).parents[4] / "shared" / "data" / "foreign" / "files"

KINDS = {
    "K_azure": "lens_distorted",
    "K_distortion_names": "lens_distorted",
    "K_open3d": "",
    "K_ros2": "",
    "K_ros_yaml_json": "lens_distorted",
    "bop_hot3d": "FISHEYE624 is no pinhole",
    "depth_65535": "",
    "depth_ho3d": "a picture of depth",
    "folder_foundationpose": "",
    "squeezed": "axis_off_centre",
}
"""Images of others: the warning, or the words of the refusal."""


@pytest.mark.skipif(not FOREIGN.is_dir(), reason="needs the files of others in ../shared/data/foreign")
@pytest.mark.parametrize("name", KINDS)
def test_images_of_others(name):
    if " " in KINDS[name]:
        with pytest.raises(FungraspError, match=KINDS[name]):
            read_folder(FOREIGN / name)
        return
    capture = read_folder(FOREIGN / name)
    assert [warning.code for warning in capture.warnings] == ([KINDS[name]] if KINDS[name] else [])
    assert 610 < capture.intrinsics.fx < 630 and 0.3 < capture.depth.max() < 4.0
    assert (capture.mask is not None) == (name == "folder_foundationpose")

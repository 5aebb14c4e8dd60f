import json
import logging

import pytest
from capture_files import OURS

from fungrasp.core.errors import FungraspError
from fungrasp.perception import Intrinsics
from fungrasp.perception.io.intrinsics_files import read_intrinsics

SIZE = (320, 240)
LENS = Intrinsics(320, 240, 300, 301, 160, 119)
MATRIX = [[300, 0, 160], [0, 301, 119], [0, 0, 1]]
FLAT = [300, 0, 160, 0, 301, 119, 0, 0, 1]
REAL_SENSE = {
    "width": 320,
    "height": 240,
    "fx": 300,
    "fy": 301,
    "ppx": 160,
    "ppy": 119,
    "model": "none",
    "coeffs": [0] * 5,
}


@pytest.mark.parametrize(
    ("content", "unit"),
    [
        (OURS, 0.001),
        (REAL_SENSE, None),
        ({**REAL_SENSE, "depth_scale": 0.00025}, 0.00025),
        ({"color": REAL_SENSE, "depth": {"fx": 1}}, None),
        (
            {"cx": 160, "cy": 119, "depth_scale": 0.1, "fx": 300, "fy": 301, "height": 240, "width": 320},
            0.0001,
        ),
        ({"3": {"cam_K": FLAT, "depth_scale": 1.0}, "12": {"cam_K": [1] * 9}}, 0.001),
        (MATRIX, None),
        (FLAT, None),
        ({"K": MATRIX}, None),
    ],
)
def test_every_layout_gives_the_same_lens(tmp_path, content, unit):
    path = tmp_path / "K.json"
    path.write_text(json.dumps(content))
    lens = read_intrinsics(path, SIZE, image=3)
    assert lens.intrinsics == LENS
    assert lens.depth_unit == pytest.approx(unit) if unit else lens.depth_unit is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({**OURS, "width": 640, "height": 480}, "640 x 480 .* multiply fx, fy, cx and cy by 0.5"),
        ({**OURS, "width": 1280, "height": 720}, "1280 x 720 .* another resolution"),
        ([[600, 0, 320], [0, 600, 240], [0, 0, 1]], "another resolution, .* cropped"),
        ([[0.94, 0, 0.5], [0, 1.25, 0.5], [0, 0, 1]], "not in pixels"),
        ([[300, 0, 0], [5, 301, 0], [160, 119, 1]], "row by row"),
        ([1, 2, 3], "3 x 3"),
        ({**OURS, "fx": "300"}, "'fx' must be a number, not '300'"),
        ({"fx": 1, "fy": 1}, "'cx' must be a number"),
        ({"1": {"cam_K": FLAT}, "2": {"cam_K": FLAT}}, "has no image 3"),
        ({**OURS, "depth_unit": 0}, "unit of depth must be positive"),
        ({"K": FLAT, "D": ["none"]}, "distortion must be numbers"),
        ("K", "3 x 3 matrix"),
    ],
)
def test_bad_intrinsics_are_named(tmp_path, content, words):
    path = tmp_path / "K.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FungraspError, match=words) as error:
        read_intrinsics(path, SIZE, image=3)
    assert str(path) in str(error.value)


def test_intrinsics_of_many_images_need_a_number(tmp_path):
    path = tmp_path / "scene_camera.json"
    path.write_text(json.dumps({"3": {"cam_K": FLAT}, "5": {"cam_K": FLAT}}))
    with pytest.raises(FungraspError, match="intrinsics of 2 images"):
        read_intrinsics(path, SIZE)


def test_a_matrix_with_an_image_size_is_held_to_it_and_its_distortion_named(tmp_path, caplog):
    path = tmp_path / "camera_info.json"
    path.write_text(json.dumps({"K": FLAT, "width": SIZE[0], "height": SIZE[1], "D": [0.1, -0.2, 0, 0, 0]}))
    with caplog.at_level(logging.WARNING):
        read_intrinsics(path, SIZE)
    assert "distortion" in caplog.text
    with pytest.raises(FungraspError, match="multiply fx"):
        read_intrinsics(path, (SIZE[0] + 40, SIZE[1] + 30))


@pytest.mark.parametrize(
    ("cx", "cy", "told"), [(238.0, 322.0, True), (322.0, 238.0, False), (250.0, 250.0, False)]
)
def test_a_swapped_optical_axis_is_told(tmp_path, cx, cy, told):
    path = tmp_path / "K.json"
    path.write_text(json.dumps({"fx": 600.0, "fy": 600.0, "cx": cx, "cy": cy}))
    warnings = read_intrinsics(path, (640, 480)).warnings
    codes = [warning.code for warning in warnings]
    assert ("axis_swapped" in codes) == told
    assert ("axis_off_centre" in codes) == (abs(cx - 320) > 50 or abs(cy - 240) > 38)


ROWS = [[300.0, 0.0, 160.0], [0.0, 301.0, 119.0], [0.0, 0.0, 1.0]]
IN_ROWS = [number for row in ROWS for number in row]
IN_COLUMNS = [ROWS[i][j] for j in range(3) for i in range(3)]


@pytest.mark.parametrize(
    ("content", "distorted"),
    [
        ({"k": IN_ROWS, "d": [0.0] * 5, "width": 320, "height": 240}, False),
        ({"intrinsic_matrix": IN_COLUMNS, "width": 320, "height": 240}, False),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": IN_ROWS}, "image_width": 320}, False),
        ({"K": ROWS, "distortion_coefficients": {"data": [0.1, 0, 0, 0, 0]}}, True),
        ({"fx": 300.0, "fy": 301.0, "cx": 160.0, "cy": 119.0, "k1": 0.2, "p1": 0}, True),
        (
            {
                "0": {
                    "cam_model": {
                        "projection_model_type": "PINHOLE",
                        "projection_params": [300, 301, 160, 119],
                    }
                }
            },
            False,
        ),
    ],
)
def test_intrinsics_by_the_names_of_other_programs(tmp_path, content, distorted):
    path = tmp_path / "K.json"
    path.write_text(json.dumps(content))
    read = read_intrinsics(path, (320, 240))
    lens = read.intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (300.0, 301.0, 160.0, 119.0)
    assert [warning.code for warning in read.warnings] == ["lens_distorted"] * distorted


def test_a_fisheye_camera_is_refused_as_one(tmp_path):
    path = tmp_path / "scene_camera.json"
    model = {
        "projection_model_type": "CAMERA_MODEL_TYPE_FISHEYE624",
        "projection_params": [600.0] + [0.1] * 14,
    }
    path.write_text(json.dumps({"0": {"cam_model": model}}))
    with pytest.raises(FungraspError, match="FISHEYE624 is no pinhole: undistort"):
        read_intrinsics(path, (640, 480), image=0)

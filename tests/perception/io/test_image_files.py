import json
import logging
import re
from contextlib import nullcontext

import numpy as np
import pytest
from capture_files import HEIGHT, OURS, WIDTH, scene, write_scene
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.perception import Capture, Intrinsics
from fungrasp.perception.io.image_files import (
    check_alignment,
    check_hints,
    check_turned,
    parse_box,
    read_capture,
    read_color,
    read_mask,
)


def test_files_become_a_capture_in_metres(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        capture = read_capture(*write_scene(tmp_path), box=(100, 80, 220, 180))
    color, depth = scene()
    np.testing.assert_array_equal(capture.color, color)
    np.testing.assert_allclose(capture.depth, depth, atol=5e-4)
    assert capture.intrinsics == Intrinsics(WIDTH, HEIGHT, 300, 301, 160, 119)
    assert capture.depth[6, 6] == 0
    assert not caplog.records


def test_the_unit_of_depth_is_explicit(tmp_path):
    lens = {name: value for name, value in OURS.items() if name != "depth_unit"}
    paths = write_scene(tmp_path, lens, unit=0.0001)
    with pytest.raises(FungraspError, match=r"how many meters a unit of depth is: 0.001 \(1 mm\) is usual"):
        read_capture(*paths)
    assert read_capture(*paths, depth_unit=0.0001).depth[100, 150] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("unit", "given", "right"), [(0.001, 1.0, "0.001"), (0.0001, 0.001, "0.0001"), (0.001, 1e-6, "0.001")]
)
def test_a_wrong_unit_is_named_with_the_right_one(tmp_path, unit, given, right):
    paths = write_scene(tmp_path, unit=unit)
    with pytest.raises(FungraspError, match=f"with units of {right} m it would be 0.9 m"):
        read_capture(*paths, depth_unit=given)


def test_masks_of_any_kind_of_image(tmp_path):
    paths = write_scene(tmp_path)
    wanted = scene()[1] == np.float32(0.6)
    for kind in ("L", "1", "RGB"):
        Image.fromarray(np.where(wanted, 255, 0).astype(np.uint8)).convert(kind).save(tmp_path / "mask.png")
        np.testing.assert_array_equal(read_capture(*paths, mask=tmp_path / "mask.png").mask, wanted)
    Image.fromarray(np.full((10, 10), 255, np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(FungraspError, match=r"mask .* has 10 x 10 pixels"):
        read_capture(*paths, mask=tmp_path / "mask.png")
    np.save(tmp_path / "mask.npy", wanted)
    np.testing.assert_array_equal(read_capture(*paths, mask=tmp_path / "mask.npy").mask, wanted)
    np.save(tmp_path / "mask.npy", wanted[None])
    with pytest.raises(FungraspError, match=r"must be numbers \[H, W\], not bool \(1, 240, 320\)"):
        read_capture(*paths, mask=tmp_path / "mask.npy")


def test_float_depth_is_metres(tmp_path):
    color, _, lens = write_scene(tmp_path)
    depth = scene()[1]
    depth[0, 0] = np.nan
    np.save(tmp_path / "depth.npy", depth)
    read = read_capture(color, tmp_path / "depth.npy", lens).depth
    assert read[0, 0] == 0
    assert read[100, 150] == np.float32(0.6)
    np.save(tmp_path / "depth.npy", 1000 * depth)
    read = read_capture(color, tmp_path / "depth.npy", lens, depth_unit=0.001).depth
    assert read[100, 150] == pytest.approx(0.6), "floats in millimeters, as was said"
    assert read[0, 0] == 0
    with pytest.raises(FungraspError, match=r"it would be 0.9 m: --depth-unit 0.001"):
        read_capture(color, tmp_path / "depth.npy", lens)
    with pytest.raises(FungraspError, match=r"0\.9 m"):
        read_capture(color, tmp_path / "depth.npy", lens)


def cut_short(path):
    path.write_bytes(path.read_bytes()[:200])


def not_aligned(path):
    Image.fromarray(np.full((480, 848), 700, np.uint16)).save(path)


def on_its_side(path):
    Image.fromarray(np.full((WIDTH, HEIGHT), 700, np.uint16)).save(path)


def a_picture_of_depth(path):
    Image.fromarray(np.full((HEIGHT, WIDTH), 100, np.uint8)).save(path)


def words(path):
    path.write_text("this is not an image")


def enormous(path):
    Image.new("L", (9000, 9000)).save(path)


def depth_given_as_color(path):
    Image.fromarray(np.full((HEIGHT, WIDTH), 700, np.uint16)).save(path)


def nothing_measured(path):
    Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint16)).save(path)


@pytest.mark.parametrize(
    ("which", "mistake", "message"),
    [
        (0, cut_short, "color image .* damaged or cut short"),
        (1, cut_short, "depth image .* damaged or cut short"),
        (0, words, "none of the kinds of images that are read: PNG, JPEG"),
        (1, words, "none of the kinds of images that are read: PNG, JPEG"),
        (1, on_its_side, "240 x 320 pixels and the color image 320 x 240: one of them is turned"),
        (1, not_aligned, "848 x 480 pixels and the color image 320 x 240: align"),
        (1, a_picture_of_depth, "picture of depth"),
        (1, nothing_measured, "no pixel has a measurement"),
        (0, lambda path: path.unlink(), "does not exist"),
        (0, enormous, "9000 x 9000 pixels; the largest allowed"),
        (0, depth_given_as_color, "is it the depth"),
        (2, lambda path: path.unlink(), "does not exist"),
        (2, words, "not valid JSON"),
    ],
)
def test_usual_mistakes_are_named(tmp_path, which, mistake, message):
    paths = write_scene(tmp_path)
    mistake(paths[which])
    with pytest.raises(FungraspError, match=message) as error:
        read_capture(*paths)
    assert paths[which].name in str(error.value)
    assert "\n" not in str(error.value)


def test_far_numbers_of_programs_that_render_are_no_measurement(tmp_path):
    color, _, lens = write_scene(tmp_path)
    depth = scene()[1]
    for part in (0.1, 0.9):
        far = np.where(np.arange(HEIGHT)[:, None] < part * HEIGHT, 1e10, depth)
        np.save(tmp_path / "depth.npy", far)
        read = read_capture(color, tmp_path / "depth.npy", lens).depth
        np.testing.assert_array_equal(read, np.where(far > 20.0, 0.0, depth).astype(np.float32))


@pytest.mark.parametrize("step", [2, 3, 5])
def test_gaps_of_sparse_depth_are_filled(tmp_path, caplog, step):
    color, _, lens = write_scene(tmp_path)
    depth = scene()[1]
    sparse = np.zeros_like(depth)
    sparse[::step, ::step] = depth[::step, ::step]
    np.save(tmp_path / "depth.npy", sparse)
    with caplog.at_level(logging.WARNING):
        read = read_capture(color, tmp_path / "depth.npy", lens).depth
    assert "of the pixels have a depth" in caplog.text
    inner = np.s_[step:-step, step:-step]
    np.testing.assert_array_equal(read[sparse > 0], sparse[sparse > 0])
    assert (read[inner] > 0).mean() > 0.98
    assert (np.abs(read - depth)[inner] < 0.01).mean() > 0.9


def test_depth_that_is_mirrored_or_turned_is_told(tmp_path):
    path, _, lens = write_scene(tmp_path)
    # Away from the middle, where it would be the same.
    color, depth = (np.roll(image, (30, 40), (0, 1)) for image in scene())
    Image.fromarray(color).save(path)
    for turned, how in (
        (depth[:, ::-1], "mirrored left to right"),
        (depth[::-1], "mirrored top to bottom"),
        (depth[::-1, ::-1], "turned by 180 degrees"),
        (depth, ""),
    ):
        np.save(tmp_path / "depth.npy", turned)
        warnings = read_capture(path, tmp_path / "depth.npy", lens).warnings
        assert [(one.code, one.values["how"]) for one in warnings] == [("depth_turned", how)] * bool(how)


def test_a_shift_is_not_taken_for_a_mirror_image():
    """The shifted box is where the mirror image of the color has it, too."""
    color, depth = scene()
    lens = Intrinsics(WIDTH, HEIGHT, 300, 301, 160, 119)
    capture = Capture(np.roll(color, -8, axis=1), np.roll(depth, 8, axis=1), lens)
    assert check_alignment(capture) == (16, 0) and not check_turned(capture)


def test_large_images_are_made_smaller_with_a_word(tmp_path, caplog):
    color, depth, lens = write_scene(tmp_path)
    factor = 8
    for path in (color, depth):
        pixels = np.array(Image.open(path))
        Image.fromarray(pixels.repeat(factor, 0).repeat(factor, 1)).save(path, compress_level=1)
    big = {name: value * factor for name, value in OURS.items()} | {"depth_unit": 0.001}
    lens.write_text(json.dumps(big))
    with caplog.at_level(logging.WARNING):
        capture = read_capture(color, depth, lens, box=(800, 640, 1760, 1440))
    assert "2560 x 1920 pixels are made smaller: 1280 x 960" in caplog.text
    assert capture.box is not None
    pixel = np.array([capture.box[0], capture.box[1]])
    assert pixel == pytest.approx([400, 320])
    # The corner of the box is seen in the same direction as before.
    before = Intrinsics(2560, 1920, big["fx"], big["fy"], big["cx"], big["cy"])
    ray = before.deproject(np.array([800.0, 640.0]), np.array(1.0))
    np.testing.assert_allclose(capture.intrinsics.project(ray), pixel, atol=0.5)
    column, row = np.round(pixel).astype(int)
    assert (capture.depth[row - 2, column], capture.depth[row + 2, column + 2]) == pytest.approx((0.9, 0.6))


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tiff"])
@pytest.mark.parametrize("orientation", [0, 1, 2, 3, 6, 8])
def test_an_image_that_is_shown_turned_is_refused(tmp_path, orientation, suffix):
    """Depth and intrinsics may be of the pixels as stored or as shown."""
    path, pixels = tmp_path / f"turned{suffix}", np.zeros((20, 30, 3), np.uint8)
    pixels[:, :15] = 200
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(path, exif=exif)
    if orientation < 2:
        assert np.abs(read_color(path).astype(int) - pixels).max() < 20
        return
    with pytest.raises(
        FungraspError, match=rf"color image .* \(EXIF orientation {orientation}\): turn color"
    ):
        read_color(path)


def test_a_shift_between_depth_and_color_is_seen():
    color, depth = scene()
    lens = Intrinsics(WIDTH, HEIGHT, 300, 301, 160, 119)
    assert check_alignment(Capture(color, depth, lens)) is None
    assert check_alignment(Capture(color, np.roll(depth, (0, 16), (0, 1)), lens)) == (16, 0)
    assert check_alignment(Capture(color, np.roll(depth, (-12, 0), (0, 1)), lens)) == (0, -12)


def test_a_busy_background_is_not_taken_for_a_shift():
    """Stripes at the image's top, and noise that makes steps in far depth below them."""
    color, depth = scene()
    rng = np.random.default_rng(0)
    color[:20] = np.where(np.arange(WIDTH)[None, :, None] // 6 % 2, 255, 0)
    color[40:70] = 20, 30, 25
    depth[40:70] = 3.0 + 0.1 * rng.normal(size=(30, WIDTH)).astype(np.float32)
    lens = Intrinsics(WIDTH, HEIGHT, 300, 301, 160, 119)
    assert check_alignment(Capture(color, depth, lens)) is None
    assert check_alignment(Capture(color, np.roll(depth, (0, 16), (0, 1)), lens)) == (16, 0)


def test_stripes_beside_one_thing_are_not_taken_for_a_shift():
    """Something striped, like the fingers of a hand, has edges of color beside its edges of depth."""
    rng = np.random.default_rng(1)
    color = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    depth = np.full((HEIGHT, WIDTH), 1.2, np.float32)
    for u in range(30, 290, 60):
        for v in (170, 215):
            # Small things whose faint edges are where their depth says.
            color[v : v + 24, u : u + 30] = 90 + rng.integers(12, 20)
            depth[v : v + 24, u : u + 30] = 0.8
    color[30:130, 120:180] = 90
    depth[30:130, 120:180] = 0.6
    color[30:130, [v for c in (136, 196) for v in range(c, c + 3)]] = 255
    lens = Intrinsics(WIDTH, HEIGHT, 300, 301, 160, 119)
    assert check_alignment(Capture(color, depth, lens)) is None


def test_a_box_is_four_numbers():
    assert parse_box("1,2.5, 30,40") == (1, 2.5, 30, 40)
    with pytest.raises(FungraspError, match=re.escape("x0,y0,x1,y1 in pixels, not '1,2,3'")):
        parse_box("1,2,3")


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
def test_an_opaque_pixel_of_a_mask_is_not_marked_for_that(tmp_path, mode):
    marked = np.zeros((HEIGHT, WIDTH), bool)
    marked[2:5, 3:9] = True
    Image.fromarray(np.where(marked, 255, 0).astype(np.uint8)).convert(mode).save(tmp_path / "mask.png")
    assert np.array_equal(read_mask(tmp_path / "mask.png", marked.shape), marked)


def test_what_was_cut_out_is_marked(tmp_path):
    color, depth = scene()
    wanted = depth == np.float32(0.6)
    picture = np.dstack([np.maximum(color, 1), np.where(wanted, 255, 0)]).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "mask.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png", wanted.shape), wanted)


def test_what_looks_wrong_with_the_files_goes_with_the_capture(tmp_path, caplog):
    paths = write_scene(tmp_path, {**OURS, "cx": 118.0, "cy": 161.0, "D": [0.1, 0, 0, 0, 0]})
    _, depth = scene()
    Image.fromarray(np.round(1000 * np.roll(depth, 16, axis=1)).astype(np.uint16)).save(paths[1])
    with caplog.at_level(logging.WARNING):
        capture = read_capture(*paths)
    codes = [warning.code for warning in capture.warnings]
    assert codes == ["lens_distorted", "axis_off_centre", "axis_swapped", "depth_shifted"]
    assert all(str(warning) in caplog.text for warning in capture.warnings)
    assert capture.with_object(point=(5, 5)).warnings == capture.warnings


@pytest.mark.parametrize(
    ("hints", "words"),
    [
        ({"box": (100, 80, 200, 180), "point": (220, 100)}, "outside its box, which reaches from 100, 80"),
        ({"mask": True, "point": (5, 5)}, "lies outside its mask"),
        ({"mask": True, "box": (0, 0, 40, 40)}, "mask has no pixel in the object's box"),
        ({"mask": True, "box": (0, 0, 120, 100), "point": (110, 90)}, ""),
    ],
)
def test_hints_that_contradict_each_other_are_refused(hints, words):
    color, depth = scene()
    if "mask" in hints:
        hints = hints | {"mask": depth == np.float32(0.6)}
    capture = Capture(color, depth, Intrinsics(WIDTH, HEIGHT, 300, 301, 160, 119), **hints)
    with pytest.raises(FungraspError, match=words) if words else nullcontext():
        check_hints(capture)

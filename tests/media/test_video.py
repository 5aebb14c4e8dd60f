import av
import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.media.video import write_video


def _frames(count, height=48, width=64):
    for i in range(count):
        frame = np.zeros((height, width, 3), np.uint8)
        frame[:, : 4 + 5 * i] = (200, 120, 40)
        yield frame


def _decode(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        return frames, stream.average_rate, stream.codec_context.pix_fmt


def test_an_mp4_holds_every_frame(tmp_path):
    path = write_video(tmp_path / "film.mp4", _frames(9), 25)
    frames, rate, pixel_format = _decode(path)
    assert len(frames) == 9
    assert rate == 25
    assert pixel_format == "yuv420p"
    data = path.read_bytes()
    assert 0 < data.find(b"moov") < data.find(b"mdat"), "a browser can't start at once"
    for decoded, given in zip(frames, _frames(9), strict=True):
        assert np.abs(decoded.astype(int) - given).mean() < 6


def test_odd_sizes_are_made_even(tmp_path):
    frames, _, _ = _decode(write_video(tmp_path / "film.mp4", _frames(2, 47, 63), 10))
    assert frames[0].shape == (48, 64, 3)


@pytest.mark.parametrize(
    ("name", "frames", "fps", "words"),
    [
        ("film.avi", list(_frames(2)), 25, "film.avi"),
        ("film.mp4", [], 25, "at least one frame"),
        ("film.mp4", list(_frames(2)), 0, "frames per second"),
        ("film.mp4", [*_frames(1), *_frames(1, 32)], 25, "frame 1"),
        ("film.mp4", [np.zeros((4, 4, 3))], 25, "frame 0"),
    ],
)
def test_bad_films_are_refused_and_leave_nothing(tmp_path, name, frames, fps, words):
    with pytest.raises(FungraspError, match=words):
        write_video(tmp_path / name, iter(frames), fps)
    assert not list(tmp_path.iterdir())


def test_a_film_that_breaks_off_leaves_nothing(tmp_path):
    def frames():
        yield from _frames(3)
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError):
        write_video(tmp_path / "film.mp4", frames(), 25)
    assert not list(tmp_path.iterdir())


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FungraspError, match="cannot write"):
        write_video(tmp_path / "file" / "film.mp4", _frames(2), 25)

"""Writing videos: H.264 in mp4 files."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, check_suffix


def write_video(
    path: str | Path,
    frames: Iterable[np.ndarray],
    fps: float,
    *,
    quality: float = 21.0,
    keyframes: int | None = None,
) -> Path:
    """Write a video, encoding each frame as it arrives.

    An odd number of rows or columns is made even by repeating the last one, as H.264 requires.

    Args:
        path: mp4 file.
        frames: sRGB, each of shape [H, W, 3] uint8, all of one size.
        fps: frames per second.
        quality: constant rate factor of H.264, from 0 (lossless) to 51 (worst).
        keyframes: keyframe interval in frames, for fast seeking; chosen by the encoder if None.

    Returns:
        The path.

    Raises:
        FungraspError: no frames, frames of different shapes, a wrong suffix, or the file can't be written.
    """
    import av
    from av.error import FFmpegError
    from av.video.reformatter import ColorRange, Colorspace, VideoReformatter

    path = check_suffix(path, "a film", ".mp4")
    if not 0 < fps <= 1000:
        raise FungraspError(f"{path}: frames per second must lie between 0 and 1000, not {fps}")
    checked = _checked(path, frames)
    first = next(checked, None)
    if first is None:
        raise FungraspError(f"{path}: a film needs at least one frame")
    if "libx264" not in av.codecs_available:
        raise FungraspError(
            f"{path}: this build of PyAV has no H.264; the wheels on the package index have it"
        )
    options: dict[str, object] = {"crf": f"{quality:g}", "preset": "veryfast"}
    options |= {} if keyframes is None else {"g": str(keyframes), "bf": "0"}
    odd = ((0, first.shape[0] % 2), (0, first.shape[1] % 2), (0, 0))
    with atomic_path(path) as temporary:
        try:
            with av.open(str(temporary), "w", options={"movflags": "+faststart"}) as container:
                stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
                stream.height, stream.width = first.shape[0] + odd[0][1], first.shape[1] + odd[1][1]
                stream.pix_fmt = "yuv420p"
                stream.options = options
                # Reuse one converter: creating it takes ten times as long as using it.
                converter = VideoReformatter()
                for array in itertools.chain([first], checked):
                    frame = av.VideoFrame.from_ndarray(np.pad(array, odd, mode="edge"), format="rgb24")
                    frame = converter.reformat(
                        frame,
                        format="yuv420p",
                        dst_colorspace=Colorspace.ITU709,
                        dst_color_range=ColorRange.MPEG,
                        threads=1,
                    )
                    container.mux(stream.encode(frame))
                container.mux(stream.encode(None))
        except FFmpegError as error:
            raise FungraspError(f"cannot write {path}: {' '.join(str(error).split())}") from error
    return path


def _checked(path: Path, frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    shape = None
    for i, frame in enumerate(frames):
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise FungraspError(
                f"{path}: frame {i} must have shape [H, W, 3] uint8, not {frame.shape} {frame.dtype}"
            )
        if shape is not None and frame.shape != shape:
            raise FungraspError(f"{path}: frame {i} has shape {frame.shape}, but the first has {shape}")
        shape = frame.shape
        yield frame

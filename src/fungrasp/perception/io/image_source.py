"""Image sources: files, a folder, a camera or its recording.

Readers are imported on use, because ``ImageSource`` provides options of commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.perception.io.capture import Box, Capture, Pixel, RgbdCamera

REALSENSE = "realsense"
"""Name of the connected RealSense camera."""


@dataclass(frozen=True)
class ImageSource:
    """The image: three files, a folder, a RealSense camera or its recording."""

    rgb: Path | None = None
    """Color image, PNG or JPEG."""
    depth: Path | None = None
    """Depth aligned to the color image: 16-bit PNG or TIFF, or .npy."""
    intrinsics: Path | None = None
    """Camera intrinsics, JSON: our layout, RealSense's or BOP's."""
    folder: Path | None = None
    """Instead of the three files: a folder with rgb.png, depth.png, K.json (and mask.png), a BOP scene, or
    one camera of a DexYCB sequence. "builtin": an image of a spray_bottle."""
    camera: str | None = None
    """Instead of files: take an image now, with the connected RealSense camera ("realsense")."""
    recording: Path | None = None
    """Instead of files: a recording of a RealSense camera, .bag or .db3."""
    keep: Path | None = None
    """Folder to store the image of the camera or recording in; --folder reads it again."""
    image: int | None = None
    """Number of the image. Default: the first of a BOP scene, the last of a DexYCB sequence, number 30 of a
    recording."""
    depth_unit: float | None = None
    """Meters per unit of the depth image, usually 0.001. Default: from the intrinsics; floats are in
    meters."""
    mask: Path | None = None
    """Mask of the object: an image that is not 0 there."""
    box: str | None = None
    """Box around the object, x0,y0,x1,y1 [pixels]."""
    point: str | None = None
    """A pixel of the object, u,v: column and row."""

    @property
    def name(self) -> str:
        """Name of the source, as text to print."""
        from fungrasp.perception.io.scene_folders import BUILTIN

        if self.folder is not None and str(self.folder) == BUILTIN and not self.folder.is_dir():
            return "the built-in one"
        if self.camera is not None:
            return f"of the camera {self.camera}"
        return str(self.folder or self.recording or self.rgb)

    def read(self) -> Capture:
        """Read the capture, with mask, box or point if given.

        Raises:
            FungraspError: no source, several sources, or an unreadable image.
        """
        from fungrasp.perception.io.image_files import parse_box, parse_point, read_capture
        from fungrasp.perception.io.scene_folders import read_folder

        self.check()
        box = None if self.box is None else parse_box(self.box)
        point = None if self.point is None else parse_point(self.point)
        if self.camera is not None or self.recording is not None:
            return self._marked(self._of_camera(), box, point)
        if self.folder is not None:
            return read_folder(self.folder, self.image, self.depth_unit, mask=self.mask, box=box, point=point)
        assert self.rgb is not None and self.depth is not None and self.intrinsics is not None
        return read_capture(
            self.rgb,
            self.depth,
            self.intrinsics,
            depth_unit=self.depth_unit,
            mask=self.mask,
            box=box,
            point=point,
            image=self.image,
        )

    def check(self) -> None:
        """Check that the options fit together.

        Raises:
            FungraspError: no source, several sources, or an option for another source.
        """
        files = {"--rgb": self.rgb, "--depth": self.depth, "--intrinsics": self.intrinsics}
        missing = [name for name, path in files.items() if path is None]
        others = {"--folder": self.folder, "--camera": self.camera, "--recording": self.recording}
        given = [name for name, value in others.items() if value is not None]
        if len(missing) < 3:
            given.append("--rgb, --depth and --intrinsics")
        if len(given) > 1:
            raise FungraspError(f"give either {given[0]}, or {given[1]}")
        if missing and not any(name in others for name in given):
            raise FungraspError(
                f"{' and '.join(missing)} must be given, or --folder, --camera or --recording instead"
            )
        if self.camera not in (None, REALSENSE):
            raise FungraspError(f"--camera is {REALSENSE}, not '{self.camera}'; --folder reads a folder")
        live = self.camera is not None or self.recording is not None
        if live and self.depth_unit is not None:
            raise FungraspError("--depth-unit is for files: a camera says itself what its depth means")
        if not live and self.keep is not None:
            raise FungraspError("--keep needs --camera or --recording")

    def _of_camera(self) -> Capture:
        from fungrasp.perception.io.realsense import capture_from_camera
        from fungrasp.perception.io.scene_folders import read_folder, write_folder

        capture = capture_from_camera(self.recording, image=self.image)
        if self.keep is None:
            return capture
        write_folder(capture, self.keep)
        # Read back, so that reading the folder later gives the same result.
        return read_folder(self.keep)

    def _marked(self, capture: Capture, box: Box | None, point: Pixel | None) -> Capture:
        from fungrasp.perception.io.image_files import read_mask

        mask = None if self.mask is None else read_mask(self.mask, capture.depth.shape)
        return capture if mask is box is point is None else capture.with_object(mask, box, point)


def as_capture(image: ImageSource | RgbdCamera | str | Path | Sequence[str | Path]) -> Capture:
    """Read an image from any source.

    Args:
        image: a folder (see ``read_folder``), a recording or "builtin"; paths of color image, depth and
            intrinsics; a source; or a camera, not yet started.

    Raises:
        FungraspError: the image can't be read.
    """
    from fungrasp.perception.io.image_files import read_capture
    from fungrasp.perception.io.realsense import RECORDINGS, capture_from_camera
    from fungrasp.perception.io.scene_folders import PICTURES, read_folder

    if isinstance(image, ImageSource):
        return image.read()
    if isinstance(image, str | Path) and Path(image).suffix.lower() not in PICTURES:
        recorded = Path(image).suffix in RECORDINGS
        return capture_from_camera(image) if recorded else read_folder(image)
    if isinstance(image, list | tuple) and all(isinstance(file, str | Path) for file in image):
        if len(image) != 3:
            raise FungraspError(f"an image is color image, depth and intrinsics, not {len(image)} files")
        return read_capture(*image)
    if hasattr(image, "capture"):
        with image as camera:
            return camera.capture()
    given = image if isinstance(image, str | Path) else f"a {type(image).__name__}"
    raise FungraspError(
        f"expected a capture with depth, not {given}: the folder of rgb.png, depth.png and K.json, the paths "
        "of three such files, or fungrasp.perception.Capture(color, depth, Intrinsics(...)) of arrays"
    )

"""Where a command's image comes from: files, a folder, a camera or a recording of one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.cli.live_capture import CameraChoice

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel
    from fungrasp.perception import Capture
    from fungrasp.perception.io.capture import Box, Pixel

BUILTIN = "builtin"
"""Stands for the image that comes with the package."""


@dataclass(frozen=True)
class _Hints:
    """Where in the image the object is, as far as that was said."""

    box: Box | None = None
    point: Pixel | None = None


@dataclass(frozen=True)
class ImageSource:
    """The image: three files, or a folder, or a RealSense camera, or a recording of one."""

    rgb: Path | None = None
    """Colour image, PNG or JPEG."""
    depth: Path | None = None
    """Depth aligned to it: 16-bit PNG or TIFF, or .npy."""
    intrinsics: Path | None = None
    """The camera's, JSON: our layout, RealSense's or BOP's."""
    folder: Path | None = None
    """Instead of the three files a folder: rgb.png, depth.png, K.json (and mask.png); a BOP scene; one camera
    of a DexYCB sequence; or "builtin", an image of a spray_bottle to try things with."""
    camera: CameraChoice = None
    """Instead of files: take an image now, with the RealSense camera that is connected, or out of a FOLDER
    that has a capture's folder for each frame. What is missing is said; the image is taken when hand, table
    and object are seen."""
    countdown: float = 3.0
    """Seconds between all being seen and the camera's image."""
    page: bool = True
    """Show the camera's picture on a page that only this computer can open."""
    recording: Path | None = None
    """Instead of files: an image out of a RealSense camera's recording, .bag or .db3."""
    keep: Path | None = None
    """Folder in which the image of the camera or recording is kept; --folder reads it again."""
    image: int | None = None
    """Number of the image in a BOP scene (by default the first), a DexYCB sequence (the last) or a recording
    (number 30, or the last)."""
    depth_unit: float | None = None
    """Metres per unit of the depth image, if the intrinsics don't say: 0.001 is usual. Depth of floats is in
    metres if this is not given."""
    mask: Path | None = None
    """Image that is not 0 where the object is."""
    box: str | None = None
    """Box around the object, x0,y0,x1,y1 [pixels]."""
    point: str | None = None
    """A pixel that shows the object, u,v: column and row, as if it were clicked at."""

    @property
    def name(self) -> str:
        """Name of the source, as text to print."""
        if _is_builtin(self.folder):
            return "the built-in one"
        if self.camera is not None:
            return f"of the camera {self.camera}"
        return str(self.folder or self.recording or self.rgb)

    def read(self, model: ObjectModel) -> Capture:
        """The capture, with mask, box or point if one is given.

        Args:
            model: the object; a camera waits until it is seen.

        Raises:
            FungraspError: it is not said, or said twice, where the image comes from; or it can't be read.
        """
        from fungrasp.perception.io.image_files import parse_box, parse_point

        self._check()
        hints = _Hints(
            None if self.box is None else parse_box(self.box),
            None if self.point is None else parse_point(self.point),
        )
        if self.folder is not None:
            return self._of_folder(self.folder, hints)
        if self.camera is not None or self.recording is not None:
            return self._of_camera(model, hints)
        return self._of_files(self.rgb, self.depth, self.intrinsics, self.mask, hints)

    def _check(self) -> None:
        from fungrasp.errors import FungraspError

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
        live = self.camera is not None or self.recording is not None
        if live and self.depth_unit is not None:
            raise FungraspError("--depth-unit is for files: a camera says itself what its depth means")
        if not live and self.keep is not None:
            raise FungraspError("--keep needs --camera or --recording")

    def _of_folder(self, folder: Path, hints: _Hints) -> Capture:
        from fungrasp.perception.io.scene_folders import own_files, read_folder
        from fungrasp.report.demo_capture import FOLDER

        own = own_files(FOLDER if _is_builtin(folder) else folder)
        if own is None:
            return self._marked(read_folder(folder, self.image), hints)
        rgb, depth, intrinsics, mask = own
        return self._of_files(rgb, depth, intrinsics, self.mask or mask, hints)

    def _of_camera(self, model: ObjectModel, hints: _Hints) -> Capture:
        from fungrasp.cli.live_capture import live_capture
        from fungrasp.perception.io.realsense import capture_from_camera
        from fungrasp.perception.io.scene_folders import read_folder, write_folder

        if self.camera is not None:
            capture = live_capture(
                self.camera,
                model,
                self.countdown,
                self.page,
                lambda seen: self._marked(seen, hints),
            )
        else:
            capture = capture_from_camera(self.recording, image=self.image)
        if self.keep is not None:
            write_folder(capture, self.keep)
            # As it will be read again, so that the same comes out then.
            capture = read_folder(self.keep)
        return self._marked(capture, hints)

    def _of_files(
        self, rgb: Path | None, depth: Path | None, lens: Path | None, mask: Path | None, hints: _Hints
    ) -> Capture:
        from fungrasp.perception.io.image_files import read_capture

        assert rgb is not None and depth is not None and lens is not None
        return read_capture(
            rgb,
            depth,
            lens,
            depth_unit=self.depth_unit,
            mask=mask,
            box=hints.box,
            point=hints.point,
            image=self.image,
        )

    def _marked(self, capture: Capture, hints: _Hints) -> Capture:
        from fungrasp.perception.io.image_files import read_mask

        mask = None if self.mask is None else read_mask(self.mask, capture.depth.shape)
        if mask is None and hints == _Hints():
            return capture
        return capture.with_object(mask, hints.box, hints.point)


def _is_builtin(folder: Path | None) -> bool:
    """Whether the package's own image is meant: no folder has its name."""
    return folder is not None and str(folder) == BUILTIN and not folder.is_dir()

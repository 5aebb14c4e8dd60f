"""Where an image comes from: files, a folder, a camera or a recording of one.

What reads them is imported on use: ``ImageSource`` is the options of a command, whose help comes at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel
    from fungrasp.perception.camera.frames import RgbdCamera
    from fungrasp.perception.camera.live import LiveView
    from fungrasp.perception.io.capture import Box, Capture, Pixel

    Hints = tuple[Box | None, Pixel | None]

BUILTIN = "builtin"
"""Stands for the image that comes with the package, where no folder has this name."""

NO_LIVE = "a camera waits until the object is seen, which needs its mesh: take an image into a folder first"

RECORDED, APART = 30, 15
"""Image of a recording that is looked at if none is named; others are so many images apart."""

REALSENSE = "realsense"
"""Stands for the RealSense camera that is connected."""


@dataclass(frozen=True)
class ImageSource:
    """The image: three files, or a folder, or a RealSense camera, or a recording of one."""

    rgb: Path | None = None
    """Color image, PNG or JPEG."""
    depth: Path | None = None
    """Depth aligned to it: 16-bit PNG or TIFF, or .npy."""
    intrinsics: Path | None = None
    """The camera's, JSON: our layout, RealSense's or BOP's."""
    folder: Path | None = None
    """Instead of the three files a folder: rgb.png, depth.png, K.json (and mask.png); a BOP scene; one camera
    of a DexYCB sequence; or "builtin", an image of a spray_bottle to try things with."""
    camera: str | None = None
    """Instead of files: take an image now, with the RealSense camera that is connected ("realsense"), or out
    of a FOLDER that has a capture's folder for each frame. What is missing is said; the image is taken when
    hand, table and object are seen."""
    countdown: float = 3.0
    """Seconds between all being seen and the camera's image."""
    recording: Path | None = None
    """Instead of files: an image out of a RealSense camera's recording, .bag or .db3."""
    keep: Path | None = None
    """Folder in which the image of the camera or recording is kept; --folder reads it again."""
    image: int | None = None
    """Number of the image in a BOP scene (by default the first), a DexYCB sequence (the last) or a recording
    (number 30, or the last)."""
    depth_unit: float | None = None
    """Meters per unit of the depth image, if the intrinsics don't say: 0.001 is usual. Depth of floats is in
    meters if this is not given."""
    mask: Path | None = None
    """Image that is not 0 where the object is."""
    box: str | None = None
    """Box around the object, x0,y0,x1,y1 [pixels]."""
    point: str | None = None
    """A pixel that shows the object, u,v: column and row, as if it were clicked at."""

    @property
    def name(self) -> str:
        """Name of the source, as text to print."""
        if self.folder is not None and str(self.folder) == BUILTIN and not self.folder.is_dir():
            return "the built-in one"
        if self.camera is not None:
            return f"of the camera {self.camera}"
        return str(self.folder or self.recording or self.rgb)

    def read(self, obj: ObjectModel | None, show: Callable[[LiveView], None] | None = None) -> Capture:
        """The capture, with mask, box or point if one is given.

        Args:
            obj: the object; a camera waits until it is seen. None: it is not known.
            show: shows what a camera sees.

        Raises:
            FungraspError: it is not said, or said twice, where the image comes from; or it can't be read.
        """
        from fungrasp.perception.io.image_files import parse_box, parse_point, read_capture
        from fungrasp.perception.io.scene_folders import own_files, read_folder

        self.check()
        hints = (
            None if self.box is None else parse_box(self.box),
            None if self.point is None else parse_point(self.point),
        )
        files: tuple[Path, Path, Path, Path | None] | None = None
        if self.folder is not None:
            files = own_files(self.folder)
            if files is None:
                return self._marked(read_folder(self.folder, self.image, self.depth_unit), hints)
        elif self.camera is not None or self.recording is not None:
            return self._of_camera(obj, hints, show)
        rgb, depth, intrinsics, mask = files or (self.rgb, self.depth, self.intrinsics, None)
        assert rgb is not None and depth is not None and intrinsics is not None
        return read_capture(
            rgb,
            depth,
            intrinsics,
            depth_unit=self.depth_unit,
            mask=self.mask or mask,
            box=hints[0],
            point=hints[1],
            image=self.image,
        )

    def looks(
        self, obj: ObjectModel | None, most: int, show: Callable[[LiveView], None] | None = None
    ) -> Iterator[Capture]:
        """The capture, then others of the same grasp, ``most`` in all: what the camera sees next, other
        frames of a camera's folder, later images of a recording or a scene. Mask, box and point are of the
        first.

        Args:
            obj: see ``read``.
            most: how many are wanted; there may be fewer.
            show: see ``read``.

        Raises:
            FungraspError: see ``read``; or ``most`` is below 1, or there can be no other image to look at.
        """
        from fungrasp.perception.io.scene_folders import own_files, read_folder

        if most < 1:
            raise FungraspError(f"--frames must be 1 or more, not {most}")
        live = self.camera is not None or self.recording is not None
        scene = self.folder is not None and self.image is not None and own_files(self.folder) is None
        if most > 1 and not live and not scene:
            raise FungraspError("--frames needs --camera, --recording, or a scene and its first --image")
        yield self.read(obj, show)
        if most == 1:
            return
        # Where the object was in the first image need not be where it is in another.
        plain = replace(self, mask=None, box=None, point=None, keep=None)
        if self.camera is not None and Path(self.camera).is_dir():
            inside = (path for path in Path(self.camera).iterdir() if path.is_dir())
            folders = sorted(path for path in inside if own_files(path) is not None)
            count = min(most - 1, len(folders))
            yield from (read_folder(folders[-1 - i * len(folders) // count]) for i in range(count))
        elif self.camera is not None:
            yield from (plain.read(obj, show) for _ in range(most - 1))
        else:
            first = RECORDED if self.image is None else self.image
            # It may end before.
            with suppress(FungraspError):
                for number in range(1, most):
                    yield replace(plain, image=first + number * APART).read(obj)

    def check(self) -> None:
        """Complain about options that don't go together.

        Raises:
            FungraspError: it is not said, or said twice, where the image comes from; or an option is for
                another source.
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
        live = self.camera is not None or self.recording is not None
        if live and self.depth_unit is not None:
            raise FungraspError("--depth-unit is for files: a camera says itself what its depth means")
        if not live and self.keep is not None:
            raise FungraspError("--keep needs --camera or --recording")

    def _of_camera(
        self,
        obj: ObjectModel | None,
        hints: Hints,
        show: Callable[[LiveView], None] | None,
    ) -> Capture:
        from fungrasp.perception.camera.live import LiveSettings, live_capture
        from fungrasp.perception.io.realsense import capture_from_camera
        from fungrasp.perception.io.scene_folders import read_folder, write_folder

        if self.camera is not None:
            if obj is None:
                raise FungraspError(NO_LIVE)
            settings = LiveSettings(countdown=self.countdown)
            camera = opened_camera(self.camera)
            capture = live_capture(camera, obj, settings, show, lambda seen: self._marked(seen, hints))
        else:
            capture = capture_from_camera(self.recording, image=self.image)
        if self.keep is not None:
            write_folder(capture, self.keep)
            # As it will be read again, so that the same comes out then.
            capture = read_folder(self.keep)
        return self._marked(capture, hints)

    def _marked(self, capture: Capture, hints: Hints) -> Capture:
        from fungrasp.perception.io.image_files import read_mask

        mask = None if self.mask is None else read_mask(self.mask, capture.depth.shape)
        if mask is None and hints == (None, None):
            return capture
        return capture.with_object(mask, *hints)


def as_capture(
    image: ImageSource | RgbdCamera | str | Path | Sequence[str | Path], obj: ObjectModel | None
) -> Capture:
    """The capture of an image, wherever it is.

    Args:
        image: a folder (see ``read_folder``), a recording or "builtin"; paths of color image, depth and
            intrinsics; a source; or a camera, which waits until hand, table and object are seen.
        obj: the object; None: it is not known.

    Raises:
        FungraspError: it can't be read, or a camera can't wait for an object that is not known.
    """
    from fungrasp.perception.camera.live import live_capture
    from fungrasp.perception.io.image_files import read_capture
    from fungrasp.perception.io.realsense import RECORDINGS, capture_from_camera
    from fungrasp.perception.io.scene_folders import read_folder

    if isinstance(image, ImageSource):
        return image.read(obj)
    if isinstance(image, str | Path):
        recorded = Path(image).suffix in RECORDINGS
        return capture_from_camera(image) if recorded else read_folder(image)
    if not isinstance(image, Sequence):
        if obj is None:
            raise FungraspError(NO_LIVE)
        return live_capture(image, obj)
    if len(image) != 3:
        raise FungraspError(f"an image in files is color image, depth and intrinsics, not {len(image)} files")
    return read_capture(*image)


def opened_camera(name: str) -> RgbdCamera:
    """The camera of that name, not yet started.

    Raises:
        FungraspError: it is neither "realsense" nor a folder of frames.
    """
    from fungrasp.perception.camera.frames import FolderCamera
    from fungrasp.perception.io.realsense import RealSenseCamera

    if Path(name).is_dir():
        return FolderCamera(name)
    if name == REALSENSE:
        return RealSenseCamera()
    raise FungraspError(f"--camera is {REALSENSE}, or a folder that has a capture's folder for each frame")

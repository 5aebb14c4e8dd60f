"""Captures from folders: own ones, which can also be written, BOP scenes, FoundationPose, DexYCB."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_yaml
from fungrasp.perception.io.capture import Box, Capture, Pixel
from fungrasp.perception.io.image_files import read_capture, read_color
from fungrasp.perception.io.intrinsics_files import MILLIMETER, intrinsics_from

# Files of a capture's own folder.
COLOR_FILE, DEPTH_FILE, LENS_FILE, MASK_FILE = "rgb.png", "depth.png", "K.json", "mask.png"
# Units of written depth [m]: the coarse one if the range of the fine one is too small.
FINE, COARSE = 0.0001, 0.001
# Name of the built-in image, unless a folder has this name: a rendered person who holds the built-in spray
# bottle, with ground truth.
BUILTIN, BUILTIN_CAPTURE = "builtin", Path(__file__).parent / "builtin_capture"

PICTURES = (".png", ".jpg", ".jpeg", ".tif")


def read_folder(
    folder: str | Path,
    image: int | None = None,
    depth_unit: float | None = None,
    *,
    mask: str | Path | None = None,
    box: Box | None = None,
    point: Pixel | None = None,
) -> Capture:
    """Read a capture from a folder of any kind:

    - own: ``rgb.png``, ``depth.png``, ``K.json`` and optionally ``mask.png``;
    - a BOP scene (github.com/thodan/bop_toolkit, ``docs/bop_datasets_format.md``): ``scene_camera.json`` with
      cam_K and depth_scale [mm per unit] by image; ``rgb/000000.png``, or .jpg, .tif; ``depth/000000.png``;
    - a capture for FoundationPose: see ``read_foundationpose``;
    - one camera of a DexYCB sequence: see ``read_dexycb``.

    Args:
        folder: the folder; or "builtin" for the built-in image.
        image: number of the image. None: the last of a DexYCB sequence (object in hand), else the first.
        depth_unit: meters per unit of the depth image; from the folder if None.
        mask, box, point: see ``read_capture``; by default, the folder's own mask is used.

    Raises:
        FungraspError: the folder is of no such kind, or a file in it is invalid.
    """
    folder = Path(folder)
    folder = BUILTIN_CAPTURE if str(folder) == BUILTIN and not folder.is_dir() else folder
    if not folder.is_dir():
        raise FungraspError(f"the folder {folder} does not exist")
    read = partial(read_capture, depth_unit=depth_unit, box=box, point=point)
    if (folder / LENS_FILE).is_file():
        own = folder / MASK_FILE
        return read(
            folder / COLOR_FILE,
            folder / DEPTH_FILE,
            folder / LENS_FILE,
            mask=mask or (own if own.is_file() else None),
            image=image,
        )
    scene = folder / "scene_camera.json"
    if scene.is_file():
        number = _numbers(folder, "depth")[0] if image is None else image
        color, depth = _picture(folder / "rgb", number), _picture(folder / "depth", number)
        return read(color, depth, scene, mask=mask, image=number)
    if (folder / "cam_K.txt").is_file():
        return read_foundationpose(folder, image, depth_unit, mask=mask, box=box, point=point)
    frames = sorted(folder.glob("aligned_depth_to_color_*.png"))
    if frames:
        frame = int(frames[-1].stem[-6:]) if image is None else image
        return read_dexycb(folder, frame, depth_unit, mask=mask, box=box, point=point)
    raise FungraspError(
        f"{folder} is no capture: it has neither {LENS_FILE} (ours), scene_camera.json (a BOP scene), "
        "cam_K.txt (FoundationPose), nor aligned_depth_to_color_*.png (one camera of a DexYCB sequence)"
    )


def write_folder(capture: Capture, folder: str | Path) -> None:
    """Write a capture as a folder for ``read_folder``.

    Depth is rounded to ``FINE``, or to ``COARSE`` if it reaches far; box and point are not written.

    Raises:
        FungraspError: the folder can't be written, or has a mask although the capture has none.
    """
    folder = Path(folder)
    if capture.mask is None and (folder / MASK_FILE).exists():
        raise FungraspError(f"{folder} has the mask of another image, {MASK_FILE}: remove it first")
    largest = float(capture.depth.max())
    unit = FINE if largest < FINE * 65535 else COARSE
    depth = np.round(capture.depth / unit)
    depth = np.where(depth > 65535, 0, depth).astype(np.uint16)
    images = {COLOR_FILE: capture.color, DEPTH_FILE: depth}
    if capture.mask is not None:
        images[MASK_FILE] = np.where(capture.mask, 255, 0).astype(np.uint8)
    for name, pixels in images.items():
        with atomic_path(folder / name) as temporary:
            Image.fromarray(pixels).save(temporary)
    # Written last, so that a folder with this file is complete.
    with atomic_path(folder / LENS_FILE) as temporary:
        temporary.write_text(json.dumps({**asdict(capture.intrinsics), "depth_unit": unit}, indent=1) + "\n")


def read_foundationpose(
    folder: str | Path, image: int | None = None, depth_unit: float | None = None, **hints: Any
) -> Capture:
    """Read an image from a folder for FoundationPose (github.com/NVlabs/FoundationPose).

    ::

        <folder>/cam_K.txt                       3 x 3 numbers
        <folder>/rgb/0000001.png                 any names, the same in each folder
        <folder>/depth/0000001.png               [mm]
        <folder>/masks/0000001.png               optional, usually of the first image

    Args:
        image: index in the order of names; the first if None.
        depth_unit: meters per unit of depth; 0.001 if None.
        hints: mask, box and point, see ``read_folder``.

    Raises:
        FungraspError: a file is missing or invalid.
    """
    folder = Path(folder)
    colors = sorted(path for path in (folder / "rgb").glob("*") if path.suffix in PICTURES)
    if not 0 <= (image or 0) < len(colors):
        raise FungraspError(f"{folder} has {len(colors)} images in its folder 'rgb': no image {image or 0}")
    color = colors[image or 0]
    try:
        matrix = np.array((folder / "cam_K.txt").read_text().split(), dtype=float).tolist()
    except (OSError, ValueError) as error:
        raise FungraspError(
            f"{folder / 'cam_K.txt'}: the matrix of intrinsics must be 3 x 3 numbers"
        ) from error
    height, width = read_color(color).shape[:2]
    lens = intrinsics_from(matrix, (width, height), where=str(folder / "cam_K.txt"))
    own = folder / "masks" / color.with_suffix(".png").name
    if own.is_file() and hints.get("mask") is None:
        hints |= {"mask": own}
    unit = MILLIMETER if depth_unit is None else depth_unit
    depth = folder / "depth" / color.with_suffix(".png").name
    return read_capture(color, depth, lens.intrinsics, depth_unit=unit, **hints)


def read_dexycb(camera: str | Path, frame: int, depth_unit: float | None = None, **hints: Any) -> Capture:
    """Read a frame of one camera of a DexYCB sequence (dex-ycb.github.io).

    ::

        <root>/<subject>/<sequence>/<serial>/color_000000.jpg
        <root>/<subject>/<sequence>/<serial>/aligned_depth_to_color_000000.png [mm]
        <root>/calibration/intrinsics/<serial>_640x480.yml                     color: fx, fy, ppx, ppy

    Args:
        camera: folder of the camera, ``<root>/<subject>/<sequence>/<serial>``.
        frame: number of the frame.
        depth_unit, hints: see ``read_foundationpose``.

    Raises:
        FungraspError: a file is missing or invalid, or PyYAML is not installed.
    """
    camera = Path(camera).absolute()
    color = camera / f"color_{frame:06d}.jpg"
    height, width = read_color(color).shape[:2]
    calibration = camera.parents[2] / "calibration" / "intrinsics" / f"{camera.name}_{width}x{height}.yml"
    lens = intrinsics_from(read_yaml(calibration), (width, height), where=str(calibration))
    depth = camera / f"aligned_depth_to_color_{frame:06d}.png"
    unit = MILLIMETER if depth_unit is None else depth_unit
    return read_capture(color, depth, lens.intrinsics, depth_unit=unit, **hints)


@dataclass(frozen=True, eq=False)
class BuiltinTruth:
    """Ground truth of the built-in image."""

    object_name: str
    """Name of the built-in object."""
    task: str
    """Task of the grasp."""
    pose_camera_object: np.ndarray
    """Pose of the object in the camera frame, shape [7]."""
    joints_camera: np.ndarray
    """Joints of the hand [m], camera frame, shape [21, 3]."""


def builtin_truth() -> BuiltinTruth:
    """Read the ground truth of the built-in image."""
    truth = json.loads((BUILTIN_CAPTURE / "truth.json").read_text())
    pose, joints = np.array(truth["pose_camera_object"]), np.array(truth["joints_camera"])
    return BuiltinTruth(truth["object_name"], truth["task"], pose, joints)


def _picture(folder: Path, image: int) -> Path:
    for suffix in PICTURES:
        path = folder / f"{image:06d}{suffix}"
        if path.is_file():
            return path
    raise FungraspError(f"{folder} has no image {image} ({image:06d}.png)")


def _numbers(scene: Path, kind: str) -> list[int]:
    names = (path.stem for path in (scene / kind).glob("*") if path.suffix in PICTURES)
    numbers = sorted(int(name) for name in names if name.isdigit())
    if not numbers:
        raise FungraspError(f"the BOP scene {scene} has no images in its folder '{kind}'")
    return numbers

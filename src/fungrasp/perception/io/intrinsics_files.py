"""Read camera intrinsics from JSON: own layout, RealSense's, BOP's, or a bare matrix."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded
from fungrasp.core.formats.text_files import read_json
from fungrasp.perception.io.capture import Intrinsics
from fungrasp.perception.io.estimates import PerceptionWarning

# Largest possible distance of the optical axis from the image's center, as a fraction of width or height.
OFF_CENTRE = 0.3
# Distance beyond which it is doubtful; depth cameras stay below according to their data sheets. Positions are
# wrong by the same fraction of the image's width.
USUAL_OFF_CENTRE = 0.08
FOCAL_RANGE = (0.25, 6.0)  # Possible focal lengths, as fractions of the image's longer side.

MILLIMETER = 0.001

_MATRIX_NAMES = ("cam_K", "K", "k", "camera_matrix", "intrinsic_matrix")
_DISTORTION_NAMES = ("coeffs", "D", "d", "distortion_coefficients", "dist_coeffs", "distCoeffs", "distortion")
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_DISTORTION = 1e-6
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FileIntrinsics:
    """Intrinsics from a file."""

    intrinsics: Intrinsics
    """Image size, focal lengths and optical axis [pixels]."""
    depth_unit: float | None = None
    """Meters per unit of the depth image; None if the file does not say."""
    warnings: tuple[PerceptionWarning, ...] = ()
    """Warnings about the file; logged, too."""


@guarded("file of intrinsics")
def read_intrinsics(path: str | Path, size: tuple[int, int], *, image: int | None = None) -> FileIntrinsics:
    """Read intrinsics and check that they fit an image.

    Layouts, recognized by their fields:

    - own: ``width, height, fx, fy, cx, cy`` and optionally ``depth_unit`` [m per unit];
    - RealSense: ``width, height, fx, fy, ppx, ppy``, maybe inside ``color``; ``depth_scale`` [m per unit];
    - BOP ``camera.json``: own with ``depth_scale`` [mm per unit] instead of ``depth_unit``;
    - BOP ``scene_camera.json``: by image number, ``cam_K`` (9 numbers) and ``depth_scale`` [mm per unit];
    - BOP ``cam_model`` (2024) of a pinhole camera;
    - a matrix: 3 lists of 3 numbers or 9 numbers, row by row or, as Open3D writes it, column by column; alone
      or as ``K``, ``k`` (ROS 2), ``cam_K``, ``intrinsic_matrix`` or ``camera_matrix`` (OpenCV, ROS 1: with
      its numbers in ``data``), with ``width`` and ``height`` or ``image_width`` and ``image_height``.

    Distortion is recognized by the names of ROS, OpenCV, RealSense and Azure Kinect (``k1`` ... ``p2``).

    Args:
        size: width and height of the color image [pixels].
        image: number of the image, for BOP's ``scene_camera.json``.

    Raises:
        FungraspError: the file can't be read, has none of these layouts, or is for another resolution.
    """
    content = read_json(path, "file of intrinsics")
    return intrinsics_from(content, size, where=str(path), image=image)


def intrinsics_from(
    content: Any, size: tuple[int, int], *, where: str, image: int | None = None
) -> FileIntrinsics:
    """Return intrinsics from the contents of a file; see ``read_intrinsics``. where: file, for messages."""
    if isinstance(content, list):
        return _with_warnings(_from_matrix(content, size, where), None, False, where)
    if not isinstance(content, Mapping):
        raise FungraspError(f"{where}: intrinsics are fields or a 3 x 3 matrix, not {content!r:.40}")
    for name in ("color", "colour", "intrinsics"):
        if isinstance(content.get(name), Mapping):
            content = {**content, **content[name]}
    if content and all(str(key).isdigit() and isinstance(content[key], Mapping) for key in content):
        content = _of_image(content, image, where)
    content = _with_common_names(content, where)
    own = tuple(
        int(_number(content, name, where)) if name in content else None for name in ("width", "height")
    )
    width, height = (value or of_image for value, of_image in zip(own, size, strict=True))
    if (width, height) != size:
        raise FungraspError(
            f"{where}: the intrinsics are for an image of {width} x {height} pixels, but the color image "
            f"has {size[0]} x {size[1]}{_scale_hint((width, height), size)}"
        )
    coefficients = next((content[name] for name in _DISTORTION_NAMES if content.get(name)), [0.0])
    coefficients = [*np.ravel(coefficients), *(content.get(name) or 0.0 for name in _COEFFICIENTS)]
    try:
        distorted = np.abs(np.asarray(coefficients, dtype=float)).max() > _DISTORTION
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{where}: the lens's distortion must be numbers") from error
    for name in _MATRIX_NAMES:
        if name in content:
            lens = _from_matrix(content[name], size, where)
            return _with_warnings(lens, _unit(content, MILLIMETER, where), bool(distorted), where)
    real_sense = "ppx" in content
    names = ("fx", "fy", "ppx", "ppy") if real_sense else ("fx", "fy", "cx", "cy")
    fx, fy, cx, cy = (_number(content, name, where) for name in names)
    lens = _checked(width, height, fx, fy, cx, cy, where)
    unit = _unit(content, 1.0 if real_sense else MILLIMETER, where)
    return _with_warnings(lens, unit, bool(distorted), where)


def _with_common_names(content: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Rename fields of ROS, OpenCV and BOP. Raises: FungraspError: the camera is no pinhole camera."""
    # OpenCV and ROS write a matrix as rows, cols and data.
    flat = {
        name: value["data"] if isinstance(value, Mapping) and "data" in value else value
        for name, value in content.items()
    }
    model = flat.get("cam_model")
    if isinstance(model, Mapping):
        kind, numbers = str(model.get("projection_model_type", "")), model.get("projection_params")
        if not isinstance(numbers, list) or "PINHOLE" not in kind.upper() or len(numbers) not in (3, 4):
            raise FungraspError(
                f"{where}: the camera model {kind or 'without a name'} is no pinhole: undistort color and "
                "depth to a pinhole camera and give that one's intrinsics"
            )
        flat |= dict(zip(("fx", "fy", "cx", "cy"), [numbers[0], *numbers][-4:], strict=True))
        flat |= {name: model[name] for name in ("image_width", "image_height") if name in model}
    for name in ("width", "height"):
        if name not in flat and f"image_{name}" in flat:
            flat[name] = flat[f"image_{name}"]
    return flat


def _with_warnings(lens: Intrinsics, unit: float | None, distorted: bool, where: str) -> FileIntrinsics:
    """Return the intrinsics with warnings."""
    warnings = []
    if distorted:
        warnings.append(PerceptionWarning.of("lens_distorted"))
    aside = max(abs(lens.cx / lens.width - 0.5), abs(lens.cy / lens.height - 0.5))
    if aside > USUAL_OFF_CENTRE:
        warnings.append(PerceptionWarning.of("axis_off_centre", cx=lens.cx, cy=lens.cy, part=100 * aside))
    if _turned(lens.width, lens.height, lens.cx, lens.cy):
        warnings.append(PerceptionWarning.of("axis_swapped", cx=lens.cx, cy=lens.cy))
    for warning in warnings:
        _log.warning("%s: %s", where, warning)
    return FileIntrinsics(lens, unit, tuple(warnings))


def _turned(width: int, height: int, cx: float, cy: float) -> bool:
    """Return whether each coordinate of the optical axis is nearer to the center of the other side."""
    across, down = width / 2, height / 2
    return abs(cx - down) < abs(cx - across) and abs(cy - across) < abs(cy - down)


def _of_image(content: Mapping[str, Any], image: int | None, where: str) -> Mapping[str, Any]:
    if image is None:
        if len(content) == 1:
            return next(iter(content.values()))
        raise FungraspError(
            f"{where} has the intrinsics of {len(content)} images: say which is meant (--image)"
        )
    for key, value in content.items():
        if int(key) == image:
            return value
    raise FungraspError(f"{where} has no image {image}")


def _from_matrix(matrix: Any, size: tuple[int, int], where: str) -> Intrinsics:
    try:
        k = np.array(matrix, dtype=float).reshape(3, 3)
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{where}: the matrix of intrinsics must be 3 x 3 numbers") from error
    if np.abs(k[[0, 1], [2, 2]]).max() < 1e-9 < np.abs(k[2, :2]).max():
        k = k.T  # Open3D writes it column by column.
    if np.abs(k[[1, 2, 2], [0, 0, 1]]).max() > 1e-6 or abs(k[2, 2] - 1) > 1e-6 or abs(k[0, 1]) > 1.0:
        raise FungraspError(
            f"{where}: the matrix of intrinsics must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], row by row"
        )
    return _checked(*size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], where)


def _checked(width: int, height: int, fx: float, fy: float, cx: float, cy: float, where: str) -> Intrinsics:
    try:
        lens = Intrinsics(width, height, fx, fy, cx, cy)
    except FungraspError as error:
        raise FungraspError(f"{where}: {error}") from error
    centered = max(abs(cx / width - 0.5), abs(cy / height - 0.5)) <= OFF_CENTRE
    low, high = (part * max(width, height) for part in FOCAL_RANGE)
    if not (centered and low <= min(fx, fy) and max(fx, fy) <= high and 0.5 < fx / fy < 2):
        swapped = _turned(width, height, cx, cy)
        why = "are cx and cy swapped" if swapped else "intrinsics of another resolution"
        raise FungraspError(
            f"{where}: fx = {fx:g}, fy = {fy:g}, cx = {cx:g}, cy = {cy:g} [pixels] don't fit an image of "
            f"{width} x {height} pixels: {why}, not in pixels, or is the image cropped (give the whole one)?"
        )
    return lens


def _unit(content: Mapping[str, Any], scale_unit: float, where: str) -> float | None:
    if "depth_unit" in content:
        unit = _number(content, "depth_unit", where)
    elif "depth_scale" in content:
        unit = _number(content, "depth_scale", where) * scale_unit
    else:
        return None
    if not unit > 0:
        raise FungraspError(f"{where}: the unit of depth must be positive, not {unit} m")
    return unit


def _number(content: Mapping[str, Any], name: str, where: str) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise FungraspError(f"{where}: the field '{name}' must be a number, not {value!r}")
    return float(value)


def _scale_hint(of: tuple[int, int], size: tuple[int, int]) -> str:
    if of[0] * size[1] == of[1] * size[0]:
        return f"; if it was only resized, multiply fx, fy, cx and cy by {size[0] / of[0]:.4g}"
    return ": intrinsics of another resolution"

"""Read an object's pose that another program has estimated: FoundationPose, or any matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import guarded, read_text
from fungrasp.core.formats.numpy_files import read_npy
from fungrasp.core.formats.text_files import read_json
from fungrasp.perception.acceptance import ACCEPT
from fungrasp.perception.io.capture import DEPTH_LIMIT
from fungrasp.perception.io.estimates import ObjectEstimate, PerceptionWarning

SUFFIXES = (".txt", ".npy", ".json")

NO_SCORE = PerceptionWarning.of("no_score", said="the file gives no score; the pose was taken as it is")
FOREIGN_SCORE = PerceptionWarning.of("no_score", said="the estimator's score is no probability")


# Largest error of an element of ``R^T R - 1``; the nearest rotation is used.
TOLERANCE = 0.02
UNIT_TOLERANCE = 0.001  # Largest error of a quaternion's length.
NEAREST = 0.02  # Smallest distance at which a camera sees an object [m].


@guarded("object's pose")
def read_object_pose(path: str | Path, *, image: int | str | None = None) -> ObjectEstimate:
    """Read the pose of an object.

    A pose maps mesh coordinates [m] to the camera frame (x right, y down, z forward) [m]. Formats:

    - a folder: FoundationPose's ``ob_in_cam``, one ``<image>.txt`` with a 4 x 4 matrix per image;
    - ``.txt``: a 4 x 4 matrix, or 7 numbers ``x y z qw qx qy qz``, separated by spaces or commas;
    - ``.npy``: the same as an array, or one row per image;
    - ``.json``: the same as lists, alone or as ``pose`` with an optional ``score`` (0 to 1).

    The estimate is not ``judged``: ``perceive`` compares it with the depth and computes its own score. Until
    then, a pose without a score, or with one outside 0 to 1, is accepted with the lowest accepted score and a
    warning.

    Args:
        image: name or number of FoundationPose's file, or row of an array; None if there is only one.

    Raises:
        FungraspError: the file can't be read, has no such image, or has no pose of an object in front of the
            camera; the message says why.
    """
    path = Path(path)
    if path.is_dir():
        path, image = _of_folder(path, image), None
    if not path.is_file():
        raise FungraspError(f"the object's pose {path} does not exist")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise FungraspError(f"{path}: an object's pose is a file {', '.join(SUFFIXES)}, not '{suffix}'")
    content = _numbers(path)
    score = None
    if isinstance(content, dict):
        content, score = content.get("pose"), content.get("score")
        if content is None:
            raise FungraspError(f"{path}: the field 'pose' is missing")
    try:
        numbers = np.array(content, dtype=float)
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{path}: a pose is numbers, all rows of the same length") from error
    pose = pose_from_numbers(_of_image(numbers, image, str(path)), str(path))
    if score is None:
        return ObjectEstimate(pose, ACCEPT, True, warnings=(NO_SCORE,), judged=False)
    if isinstance(score, bool) or not isinstance(score, int | float):
        raise FungraspError(f"{path}: the score must be a number, not {score!r}")
    score = float(score)
    if not 0 <= score <= 1:
        return ObjectEstimate(pose, ACCEPT, True, warnings=(FOREIGN_SCORE,), judged=False)
    accepted = score >= ACCEPT
    warnings = () if accepted else (PerceptionWarning.of("low_own_score", score=score),)
    return ObjectEstimate(pose, score, accepted, warnings=warnings, judged=False)


def _of_folder(folder: Path, image: int | str | None) -> Path:
    if (folder / "ob_in_cam").is_dir():
        folder = folder / "ob_in_cam"
    files = {file.stem: file for file in sorted(folder.glob("*.txt"))}
    if not files:
        raise FungraspError(
            f"the folder {folder} has no poses (one .txt per image, as FoundationPose writes)"
        )
    if image is None:
        if len(files) > 1:
            raise FungraspError(
                f"{folder} has the poses of {len(files)} images: say which is meant (--image)"
            )
        return next(iter(files.values()))
    number = _number(image)
    found = [file for stem, file in files.items() if stem == str(image)] or [
        file for stem, file in files.items() if number is not None and stem.isdigit() and int(stem) == number
    ]
    if not found:
        names = list(files)
        raise FungraspError(f"{folder} has no pose of image {image}; it has {names[0]} to {names[-1]}")
    return found[0]


def _of_image(numbers: np.ndarray, image: int | str | None, where: str) -> np.ndarray:
    """Return the pose of one image among several."""
    many = (numbers.ndim == 3) or (numbers.ndim == 2 and numbers.shape[1] in (7, 16))
    if not many:
        return numbers
    if len(numbers) == 1:
        return numbers[0]
    if image is None:
        raise FungraspError(f"{where} has {len(numbers)} poses: say which is meant (--image)")
    row = _number(image)
    if row is None or not 0 <= row < len(numbers):
        raise FungraspError(f"{where} has no pose of image {image}; it has 0 to {len(numbers) - 1}")
    return numbers[row]


def _number(image: int | str | None) -> int | None:
    return int(image) if isinstance(image, int) or (isinstance(image, str) and image.isdigit()) else None


def _numbers(path: Path) -> Any:
    try:
        if path.suffix.lower() == ".json":
            return read_json(path, "object's pose")
        if path.suffix.lower() == ".npy":
            return read_npy(path, "object's pose")
        text = read_text(path, "object's pose")
        rows = [line.replace(",", " ").split() for line in text.splitlines()]
        return [[float(value) for value in row] for row in rows if row and not row[0].startswith("#")]
    except FungraspError:
        raise
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise FungraspError(f"the object's pose {path} can't be read: {reason}") from error


def pose_from_numbers(numbers: np.ndarray, where: str) -> np.ndarray:
    """Return the pose of an object in the camera frame, shape [7].

    Args:
        numbers: 4 x 4 or 3 x 4 matrix, its 16 or 12 numbers row by row, or ``[x y z qw qx qy qz]``; [m].
        where: name of the file, for messages.

    Raises:
        FungraspError: wrong number of values, non-finite values, no rotation, or no position that a camera
            could see.
    """
    numbers = np.asarray(numbers, dtype=float)
    if not np.isfinite(numbers).all():
        raise FungraspError(f"{where}: the pose has non-finite numbers")
    if numbers.size == 7:
        return _from_quaternion(numbers.ravel(), where)
    if numbers.size not in (12, 16):
        raise FungraspError(
            f"{where}: a pose is a 4 x 4 matrix or 7 numbers (x y z qw qx qy qz), not an array of shape "
            f"{list(numbers.shape)}"
        )
    matrix = numbers.reshape(-1, 4)
    if len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        transposed = np.allclose(matrix[:, 3], [0, 0, 0, 1], atol=1e-6)
        hint = "; it is transposed" if transposed else ""
        raise FungraspError(f"{where}: the last row of the 4 x 4 matrix must be 0 0 0 1{hint}")
    return pose_from_rotation(matrix[:3, :3], matrix[:3, 3], where)


def pose_from_rotation(rotation: np.ndarray, translation: np.ndarray, where: str) -> np.ndarray:
    """Return the pose of rotation matrix and translation [m], shape [7]. Raises as ``pose_from_numbers``."""
    if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        raise FungraspError(f"{where}: the pose has non-finite numbers")
    determinant = float(np.linalg.det(rotation))
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if determinant < 0 and abs(determinant + 1) < 3 * TOLERANCE:
        raise FungraspError(
            f"{where}: the matrix mirrors (its determinant is {determinant:.3g}), so it is no rotation: is "
            "one axis of the camera or of the object reversed?"
        )
    if error > TOLERANCE:
        raise FungraspError(f"{where}: {_why_no_rotation(rotation, determinant, error)}")
    _check_position(translation, where)
    quaternion = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([translation, quaternion])


def _why_no_rotation(rotation: np.ndarray, determinant: float, error: float) -> str:
    if determinant > 0:
        scale = determinant ** (1 / 3)
        if np.abs(rotation.T @ rotation / scale**2 - np.eye(3)).max() < TOLERANCE:
            return (
                f"the matrix scales by {scale:.4g}, it is no rotation: scale the mesh instead, and take "
                "the scale out of the matrix"
            )
    return (
        "the matrix is no rotation: its columns are not perpendicular or not of length 1 (off by "
        f"{error:.2g}, determinant {determinant:.3g})"
    )


def _from_quaternion(numbers: np.ndarray, where: str) -> np.ndarray:
    length = float(np.linalg.norm(numbers[3:]))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise FungraspError(
            f"{where}: the quaternion of the pose x y z qw qx qy qz has length {length:.4g}, not 1"
        )
    _check_position(numbers[:3], where)
    return np.concatenate([numbers[:3], numbers[3:] / length])


def _check_position(position: np.ndarray, where: str) -> None:
    x, y, z = position
    if z < 0:
        raise FungraspError(
            f"{where}: the object is behind the camera (z = {z:.4g} m): its pose must be in the camera frame "
            "with x right, y down, z forward; is it the pose of the camera in the object's frame, or are y "
            "and z those of OpenGL?"
        )
    if z > DEPTH_LIMIT:
        raise FungraspError(
            f"{where}: the object is {z:.4g} m from the camera: were millimeters taken for meters?"
        )
    if z < NEAREST:
        raise FungraspError(
            f"{where}: the object is {1000 * z:.3g} mm from the camera; no camera sees that near: is the "
            "pose in another unit?"
        )
    if np.hypot(x, y) > 5 * z:
        raise FungraspError(
            f"{where}: the object is at x = {x:.3g}, y = {y:.3g}, z = {z:.3g} m, far outside any camera's "
            "view"
        )

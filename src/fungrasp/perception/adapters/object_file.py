"""The pose of an object that another program has estimated: FoundationPose, any matrix, BOP results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.formats.file_bytes import read_text
from fungrasp.formats.guarded import guarded
from fungrasp.formats.json_file import read_json
from fungrasp.formats.numpy_files import read_npy
from fungrasp.perception.adapters.bop_results import read_bop_results, select_rows
from fungrasp.perception.adapters.rigid import pose_from_numbers
from fungrasp.perception.estimates import ObjectEstimate
from fungrasp.perception.object_pose.confidence import ACCEPT
from fungrasp.perception.warning import PerceptionWarning

SUFFIXES = (".txt", ".npy", ".json", ".csv")

ANSWERS = 5
"""Most alternatives that are kept."""

NO_SCORE = PerceptionWarning.of("no_score", said="the file gives no score; the pose was taken as it is")
FOREIGN_SCORE = PerceptionWarning.of("no_score", said="the estimator's scores are no probabilities")


@guarded("object's pose")
def read_object_pose(
    path: str | Path,
    *,
    image: int | str | None = None,
    object_id: int | None = None,
    scene: int | None = None,
) -> ObjectEstimate:
    """Read where an object is.

    A pose maps the mesh's coordinates [m] to the camera frame (x right, y down, z forward) [m]. The kind
    of the file decides:

    - a folder: FoundationPose's ``ob_in_cam``, one ``<image>.txt`` with a 4 x 4 matrix per image;
    - ``.txt``: a 4 x 4 matrix, or our 7 numbers ``x y z qw qx qy qz``, separated by spaces or commas;
    - ``.npy``: the same as an array, or one row of them per image;
    - ``.json``: the same as lists, alone or as ``pose`` with, if wanted, ``score`` (0 to 1);
    - ``.csv``: BOP results, ``scene_id,im_id,obj_id,score,R,t,time``, ``t`` in millimetres; the best score
      counts, the others are alternatives.

    What is returned is not ``judged``: ``perceive`` compares it with the depth and gives it another score.
    Until then the file is taken at its word: without a score the pose is accepted, with the lowest score that
    is, and a warning. A score of another range than 0 to 1 is no probability and treated likewise.

    Args:
        path: the file or folder.
        image: which image: name or number of FoundationPose's file, row of an array, BOP's ``im_id``; may be
            None if there is only one.
        object_id: BOP's ``obj_id``; may be None if there is only one.
        scene: BOP's ``scene_id``; may be None if there is only one.

    Raises:
        FungraspError: the file can't be read, has no such image or object, or its numbers are no pose of an
            object before the camera; the message says why.
    """
    path = Path(path)
    if path.is_dir():
        path, image = _of_folder(path, image), None
    if not path.is_file():
        raise FungraspError(f"the object's pose {path} does not exist")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise FungraspError(f"{path}: an object's pose is a file {', '.join(SUFFIXES)}, not '{suffix}'")
    if suffix == ".csv":
        return _from_bop(path, _number(image), object_id, scene)
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
    return _estimate([pose], [float(score)])


def _from_bop(path: Path, image: int | None, object_id: int | None, scene: int | None) -> ObjectEstimate:
    rows = read_bop_results(path)
    if not rows:
        raise FungraspError(f"{path} has no rows")
    rows = select_rows(rows, str(path), image, object_id, scene)[: 1 + ANSWERS]
    return _estimate([row.pose() for row in rows], [row.score for row in rows])


def _estimate(poses: list[np.ndarray], scores: list[float]) -> ObjectEstimate:
    """An estimate from poses, best first."""
    if not all(0 <= score <= 1 for score in scores):
        others = tuple((pose, 0.0) for pose in poses[1:])
        return ObjectEstimate(poses[0], ACCEPT, True, others, warnings=(FOREIGN_SCORE,), judged=False)
    accepted = scores[0] >= ACCEPT
    warnings = () if accepted else (PerceptionWarning.of("low_own_score", score=scores[0]),)
    others = tuple(zip(poses[1:], scores[1:], strict=True))
    return ObjectEstimate(poses[0], scores[0], accepted, others, warnings=warnings, judged=False)


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
            raise FungraspError(f"{folder} has the poses of {len(files)} images: say which image is meant")
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
    """The pose of one image, if there are several."""
    many = (numbers.ndim == 3) or (numbers.ndim == 2 and numbers.shape[1] in (7, 16))
    if not many:
        return numbers
    if len(numbers) == 1:
        return numbers[0]
    if image is None:
        raise FungraspError(f"{where} has {len(numbers)} poses: say which image is meant")
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

"""The pose of an object that another program has estimated: FoundationPose, any matrix, BOP results."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.formats.file_bytes import read_text
from fungrasp.formats.guarded import guarded
from fungrasp.formats.json_file import read_json
from fungrasp.formats.numpy_files import read_npy
from fungrasp.perception.adapters.rigid import pose_from_numbers, pose_from_rotation
from fungrasp.perception.estimates import ObjectEstimate, PerceptionWarning
from fungrasp.perception.io.capture import DEPTH_LIMIT
from fungrasp.perception.object_pose.confidence import ACCEPT

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


COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")

MILLIMETRE = 0.001

LARGEST = 100_000_000
"""Bytes of the largest file that is read."""

LEAST_MILLIMETRES = 20.0
"""Translations shorter than this [mm] were meant in metres."""


@dataclass(frozen=True, eq=False)
class BopRow:
    """One estimate."""

    scene: int
    """Number of the scene."""
    image: int
    """Number of the image in the scene."""
    object_id: int
    """Number of the object in the data set."""
    score: float
    """The estimator's score, in any range."""
    rotation: np.ndarray
    """Rotation matrix of the object in the camera frame, shape [3, 3]."""
    translation: np.ndarray
    """Origin of the object in the camera frame [m], shape [3]."""
    where: str
    """File and line, for messages."""

    def pose(self) -> np.ndarray:
        """Pose of the object in the camera frame, shape [7].

        Raises:
            FungraspError: no rotation, or not where a camera could see it.
        """
        return pose_from_rotation(self.rotation, self.translation, self.where)


def read_bop_results(path: str | Path) -> list[BopRow]:
    """All rows of a file with the columns ``scene_id,im_id,obj_id,score,R,t,time``.

    ``R`` is 9 numbers, row by row, ``t`` 3 [mm], both separated by spaces. The first line may be the header.

    Raises:
        FungraspError: the file can't be read, or a line is not of this form.
    """
    path = Path(path)
    try:
        lines = list(csv.reader(read_text(path, "file of results", LARGEST).splitlines()))
    except csv.Error as error:
        raise FungraspError(f"cannot read the results {path}: {error}") from error
    rows = [
        _row(line, f"{path}, line {number}")
        for number, line in enumerate(lines, start=1)
        if line and not (number == 1 and line[0].strip() == COLUMNS[0])
    ]
    lengths = [float(np.linalg.norm(row.translation)) for row in rows]
    if rows and np.median(lengths) < LEAST_MILLIMETRES * MILLIMETRE:
        raise FungraspError(
            f"{path}: the translations are about {np.median(lengths) / MILLIMETRE:.3g} mm long; the format "
            "has millimetres: were they written in metres?"
        )
    if rows and np.median(lengths) > DEPTH_LIMIT:
        raise FungraspError(
            f"{path}: the translations are about {np.median(lengths):.3g} m long: wrong unit?"
        )
    return rows


def select_rows(
    rows: list[BopRow], where: str, image: int | None, object_id: int | None, scene: int | None
) -> list[BopRow]:
    """The rows of one object in one image, best score first. None takes what all rows have in common.

    Raises:
        FungraspError: there are none, or it is not said which; the message names those there are.
    """
    wanted: list[tuple[str, int | None, Callable[[BopRow], int]]] = [
        ("scene", scene, lambda row: row.scene),
        ("image", image, lambda row: row.image),
        ("object", object_id, lambda row: row.object_id),
    ]
    for kind, number, of in wanted:
        there = sorted({of(row) for row in rows})
        if number is None and len(there) > 1:
            raise FungraspError(
                f"{where} has {len(there)} {kind}s ({_few(there)}): say which {kind} is meant"
            )
        if number is not None and number not in there:
            raise FungraspError(f"{where} has no row for {kind} {number}; it has {kind} {_few(there)}")
        rows = [row for row in rows if number in (None, of(row))]
    return sorted(rows, key=lambda row: -row.score)


def _few(numbers: list[int]) -> str:
    if len(numbers) <= 8:
        return ", ".join(map(str, numbers)) or "none"
    return f"{', '.join(map(str, numbers[:4]))} ... {numbers[-1]}"


def _row(line: list[str], where: str) -> BopRow:
    if len(line) < len(COLUMNS):
        raise FungraspError(f"{where}: a row is {','.join(COLUMNS)}, not {len(line)} values")
    try:
        scene, image, object_id = (int(value) for value in line[:3])
        score = float(line[3])
        rotation, translation = (np.array(value.split(), dtype=float) for value in line[4:6])
    except ValueError as error:
        raise FungraspError(f"{where}: a value is not a number ({error})") from error
    if rotation.size != 9 or translation.size != 3:
        raise FungraspError(
            f"{where}: R must be 9 numbers and t 3, not {rotation.size} and {translation.size}"
        )
    if not np.isfinite(score):
        raise FungraspError(f"{where}: the score is not finite")
    return BopRow(scene, image, object_id, score, rotation.reshape(3, 3), translation * MILLIMETRE, where)

"""Rows of a BOP results file (bop.felk.cvut.cz, "Submission format")."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.formats.file_bytes import read_text
from fungrasp.perception.adapters.rigid import pose_from_rotation
from fungrasp.perception.io.capture import DEPTH_LIMIT

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

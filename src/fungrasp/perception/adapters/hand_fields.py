"""Named arrays of a hand file: JSON or ``.npz``, read and looked up with plain errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.formats.numpy_files import read_npz
from fungrasp.core.formats.text_files import read_json

VERSION = 1
"""Version of the file format."""

SOURCES = ("hamer", "wilor", "joints")

ALIASES = {
    "joints": ("pred_keypoints_3d", "pred_3d_joints"),
    "translation": ("pred_cam_t_full", "transl"),
    "focal_length": ("scaled_focal_length",),
    "pixels": ("pred_keypoints_2d",),
    "right": ("is_right",),
    "image_size": ("img_size",),
    "score": (),
}
"""Our name of each field, and what the programs call it."""


@dataclass(frozen=True, eq=False)
class HandFields:
    """A hand file."""

    where: str
    """Name of the file, for messages."""
    source: str
    """The program that wrote it, one of ``SOURCES``."""
    values: Mapping[str, Any]
    """Arrays and numbers by their names in the file."""

    def has(self, name: str) -> bool:
        """Whether the field is there, by one of its names."""
        return self._key(name) is not None

    def text(self, name: str, default: str) -> str:
        """A word."""
        return str(np.asarray(self.values.get(name, default)).item())

    def flag(self, name: str, default: bool) -> bool:
        """Yes or no, one for all hands."""
        return bool(np.asarray(self.values.get(name, default)).ravel()[0])

    def numbers(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """A field's numbers, one row per hand, shape [hands, *shape].

        Raises:
            FungraspError: the field is missing, not of that shape (a leading axis of hands aside) or not
                finite.
        """
        key = self._key(name)
        if key is None:
            names = " or ".join(f"'{other}'" for other in (name, *ALIASES.get(name, ())))
            raise FungraspError(f"{self.where}: the field {names} is missing")
        try:
            array = np.array(self.values[key], dtype=float)
        except (TypeError, ValueError) as error:
            raise FungraspError(
                f"{self.where}: '{key}' must be numbers, all rows of the same length"
            ) from error
        # WiLoR-mini keeps an axis of length 1 after that of the hands.
        squeezed = array.reshape([n for i, n in enumerate(array.shape) if n != 1 or i == 0])
        for found in (array[None], array, squeezed):
            if found.ndim == len(shape) + 1 and found.shape[1:] == shape:
                break
        else:
            wanted = list(shape) if shape else "one number"
            raise FungraspError(
                f"{self.where}: '{key}' must have shape {wanted} per hand, not {list(array.shape)}"
            )
        if not np.isfinite(found).all():
            raise FungraspError(f"{self.where}: '{key}' has non-finite numbers")
        return found

    def _key(self, name: str) -> str | None:
        return next((key for key in (name, *ALIASES.get(name, ())) if key in self.values), None)


def read_fields(path: str | Path) -> HandFields:
    """Read a hand file.

    Raises:
        FungraspError: it can't be read, is of a newer version, or its source is not known.
    """
    path = Path(path)
    if not path.is_file():
        raise FungraspError(f"the hand file {path} does not exist")
    values = _content(path)
    version = values.get("version", VERSION)
    try:
        version = int(np.asarray(version).item())
    except (TypeError, ValueError) as error:
        raise FungraspError(f"{path}: 'version' must be a whole number, not {version!r}") from error
    if version > VERSION:
        raise FungraspError(f"{path} is of version {version}; this fungrasp reads up to version {VERSION}")
    if "source" not in values:
        raise FungraspError(
            f"{path}: the field 'source' is missing; it says what wrote the hand: {', '.join(SOURCES)}"
        )
    source = str(np.asarray(values["source"]).item()).lower()
    if source not in SOURCES:
        raise UnknownNameError("source of hands", source, SOURCES)
    return HandFields(str(path), source, values)


def _content(path: Path) -> Mapping[str, Any]:
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return read_npz(path, "hand file")
    if suffix == ".json":
        content = read_json(path, "hand file")
        if not isinstance(content, dict):
            raise FungraspError(f"{path}: a hand file has named fields, not {type(content).__name__}")
        return content
    lacks = {
        ".npy": "an array without names does not tell which hand it is and by which camera it was seen",
        ".pkl": "a pickle can run anything when it is opened",
    }
    hint = f"; {lacks[suffix]}" if suffix in lacks else ""
    raise FungraspError(f"{path}: a hand file is .json or .npz, not '{suffix}'{hint}")

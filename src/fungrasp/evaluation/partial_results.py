"""Finished parts of a long test, kept in a folder until all is done, so that an interrupted run can go on."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path
from fungrasp.formats.numpy_files import read_npz

MOST_ARRAYS = 1000


class PartialResults:
    """Arrays of finished parts by key, a file each. A part's key is the digest of all that its numbers depend
    on, so that what was kept by another command is not taken for this one's."""

    def __init__(self, folder: str | Path):
        """folder: it need not exist, and a file in it that can't be read counts as missing."""
        self._folder = Path(folder)

    def __contains__(self, key: str) -> bool:
        """Whether there is a file of this part."""
        return self._file(key).is_file()

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """The arrays of a part by name, None if it was not kept."""
        if key not in self:
            return None
        try:
            return dict(read_npz(self._file(key), "partial result", most=MOST_ARRAYS))
        except FungraspError:
            return None

    def save(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of a part, on disk when this returns.

        Raises:
            FungraspError: the file can't be written.
        """
        if self._folder.is_file():
            # Earlier versions kept all parts in one file.
            self._folder.unlink()
        with atomic_path(self._file(key)) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]

    def remove(self) -> None:
        """Delete the parts, and the folder if nothing else is in it."""
        for file in self._folder.glob("*.npz"):
            file.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def _file(self, key: str) -> Path:
        return self._folder / f"{key}.npz"

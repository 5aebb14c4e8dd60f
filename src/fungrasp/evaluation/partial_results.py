"""Finished parts of a long test, kept in a file until all is done, so that an interrupted run can go on."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.files import atomic_path, remove_leftovers
from fungrasp.formats.numpy_files import read_npz

MOST_ARRAYS = 1_000_000


class PartialResults:
    """Arrays of finished parts by key, in one file. A part's key is the digest of all that its numbers depend
    on, so that what was kept by another command is not taken for this one's."""

    def __init__(self, path: str | Path):
        """path: of the file; it need not exist, and one that can't be read counts as empty."""
        self._path = Path(path)
        self._arrays: dict[str, np.ndarray] = {}
        if self._path.is_file():
            # Many chunks hold many small arrays.
            with contextlib.suppress(FungraspError):
                self._arrays = read_npz(self._path, "partial result", most=MOST_ARRAYS)

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """The arrays of a part by name, None if it was not kept."""
        prefix = f"{key}/"
        return {k.removeprefix(prefix): v for k, v in self._arrays.items() if k.startswith(prefix)} or None

    def save(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of a part, on disk when this returns.

        Raises:
            FungraspError: the file can't be written.
        """
        self._arrays |= {f"{key}/{name}": np.asarray(value) for name, value in arrays.items()}
        with atomic_path(self._path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **self._arrays)  # pyright: ignore[reportArgumentType]

    def remove(self) -> None:
        """Delete the file, if there is one."""
        self._path.unlink(missing_ok=True)
        remove_leftovers(self._path)

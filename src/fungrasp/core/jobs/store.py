"""Finished parts of long work, kept in a folder until all is done."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.numpy_files import read_npz

MOST_ARRAYS = 1000


class PartStore:
    """Arrays of finished parts by key, a file each.

    As a context it removes itself where the block ends well, and stays where it is interrupted::

        with PartStore.beside(out) as store:
            result = evaluate(robot, objects, store=store)
            result.save(out)
    """

    def __init__(self, folder: str | Path):
        """folder: it need not exist, and a file in it that can't be read counts as missing."""
        self._folder = Path(folder)

    @classmethod
    def beside(cls, result: str | Path) -> Self:
        """The parts of what will be this file: the folder ``<result>.partial``."""
        path = Path(result)
        return cls(path.with_name(f"{path.name}.partial"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.remove()

    def __contains__(self, key: str) -> bool:
        """Whether there is a file of this part."""
        return self._file(key).is_file()

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """The arrays of a part by name, None if it was not kept."""
        if key not in self:
            return None
        try:
            return dict(read_npz(self._file(key), "finished part", most=MOST_ARRAYS))
        except FungraspError:
            return None

    def save(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep the arrays of a part, on disk when this returns.

        Raises:
            FungraspError: the file can't be written.
        """
        with atomic_path(self._file(key)) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]

    def kept(self, key: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """The arrays of a part, made and kept if they are not there.

        Raises:
            FungraspError: the file can't be written.
        """
        found = self.load(key)
        if found is None:
            found = make()
            self.save(key, found)
        return found

    def remove(self) -> None:
        """Delete the parts, and the folder if nothing else is in it."""
        for file in self._folder.glob("*.npz"):
            file.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def _file(self, key: str) -> Path:
        return self._folder / f"{key}.npz"

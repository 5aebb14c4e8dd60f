"""Frozen dataclasses of arrays whose first axis is the batch: rows, joins, files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.file_bytes import one_line
from fungrasp.core.formats.numpy_files import read_npz


class BatchRecord:
    """Base of the plain types that pass between planner, policy, simulation and robot.

    A subclass is a frozen dataclass. Its fields are arrays with the batch first, ``None`` where a quantity is
    not known, and scalars (named in ``SCALARS``) that the whole batch shares.
    """

    SCALARS: ClassVar[tuple[str, ...]] = ()

    def __len__(self) -> int:
        return next(len(value) for value in self._rows().values())

    def __repr__(self) -> str:
        known = ", ".join(name for name in self._rows())
        return f"<{type(self).__name__}: {len(self)} rows of {known}>"

    def select(self, rows: np.ndarray | slice) -> Self:
        """Some rows of the batch. rows: indices, flags or a slice."""
        return self._with({name: value[rows] for name, value in self._rows().items()})

    def replaced(self, rows: np.ndarray, other: Self) -> Self:
        """A copy in which some rows are another record's.

        Args:
            rows: indices, shape [I].
            other: I rows that know the same quantities.

        Raises:
            FungraspError: a quantity is known in one of the two only.
        """
        self._check_same(other)
        arrays = {name: value.copy() for name, value in self._rows().items()}
        for name, value in other._rows().items():
            arrays[name][rows] = value
        return self._with(arrays)

    def mapped(self, function: Callable[[Any], Any]) -> Self:
        """The same with a function of each array in its place: those on a device, for example."""
        return self._with({name: function(value) for name, value in self._rows().items()})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """One batch after the other; shared scalars are those of the first.

        Raises:
            FungraspError: a quantity is known in some of them only.
        """
        for part in parts[1:]:
            parts[0]._check_same(part)
        rows = [part._rows() for part in parts]
        return parts[0]._with({name: np.concatenate([r[name] for r in rows]) for name in rows[0]})

    def save(self, path: str | Path) -> None:
        """Write to an ``.npz`` file, whole or not at all.

        Raises:
            FungraspError: the file can't be written.
        """
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **self.arrays())  # pyright: ignore[reportArgumentType]

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what ``save`` wrote.

        Raises:
            FungraspError: no such file, or it holds something else.
        """
        arrays = read_npz(path, f"{cls.__name__} file")
        try:
            return cls.from_arrays(arrays)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FungraspError(f"{path} holds no {cls.__name__}: {one_line(error)}") from error

    def arrays(self) -> dict[str, np.ndarray]:
        """What is known, by name, to be kept in a file."""
        shared = {name: np.asarray(getattr(self, name)) for name in self.SCALARS}
        return shared | self._rows()

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> Self:
        """What ``arrays`` gave; names of other things are left alone.

        Raises:
            KeyError: a quantity that has no default is missing.
        """
        wanted = fields(cls)  # pyright: ignore[reportArgumentType]
        missing = [f.name for f in wanted if f.default is MISSING and f.name not in arrays]
        if missing:
            raise KeyError(f"no {', '.join(missing)}")
        given = {f.name: arrays[f.name] for f in wanted if f.name in arrays}
        values: dict[str, Any] = {n: v.item() if n in cls.SCALARS else v for n, v in given.items()}
        return cls(**values)

    def _check_same(self, other: Self) -> None:
        """Complain if a quantity is known in one of two records only."""
        names = ", ".join(sorted(set(self._rows()) ^ set(other._rows())))
        if names:
            raise FungraspError(f"{type(self).__name__}: {names} is given in one of the two records only")

    def _rows(self) -> dict[str, np.ndarray]:
        """The arrays that have one row for each member of the batch."""
        names = [f.name for f in fields(self)]  # pyright: ignore[reportArgumentType]
        values = {name: getattr(self, name) for name in names if name not in self.SCALARS}
        return {name: value for name, value in values.items() if value is not None}

    def _with(self, arrays: dict[str, np.ndarray]) -> Self:
        unknown = {f.name: None for f in fields(self) if f.name not in arrays}  # pyright: ignore[reportArgumentType]
        return type(self)(**unknown | {name: getattr(self, name) for name in self.SCALARS}, **arrays)

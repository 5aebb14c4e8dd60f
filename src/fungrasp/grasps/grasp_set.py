"""What human and robot grasp sets have in common: checked arrays with one row per grasp."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, Generic, Self, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import digest
from fungrasp.grasps.field_checks import ArrayField, checked_array

Grasp = TypeVar("Grasp")


class GraspSet(Generic[Grasp]):
    """Grasps as arrays, one row each. Subclasses are frozen dataclasses whose ``FIELDS`` name their arrays.

    ``grasps[i]`` is one grasp and ``grasps[i:j]`` a smaller set, ``for grasp in grasps`` visits all,
    ``grasps.select(...)`` takes indices or a mask.
    """

    FIELDS: ClassVar[Mapping[str, ArrayField]]
    GRASP: ClassVar[type]

    object_name: np.ndarray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name, field in self.FIELDS.items():
            value = getattr(self, name)
            if value is None and field.optional:
                continue
            object.__setattr__(self, name, checked_array(name, field, value, sizes))

    def __len__(self) -> int:
        return len(self.object_name)

    @property
    def digest(self) -> str:
        """SHA-256 of all that the set says."""
        return digest(self._whole_set(), self._rows(slice(None)))

    @overload
    def __getitem__(self, index: int) -> Grasp: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int] | np.ndarray) -> Self: ...
    def __getitem__(self, index: int | slice | Sequence[int] | np.ndarray) -> Grasp | Self:
        if isinstance(index, slice | Sequence | np.ndarray):
            return self.select(index)
        row = range(len(self))[index]
        return self.GRASP(**self._whole_set(), **self._rows(row))

    def __repr__(self) -> str:
        objects = len(set(self.object_name.tolist()))
        return f"<{type(self).__name__}: {len(self)} grasps of {objects} objects>"

    def __iter__(self) -> Iterator[Grasp]:
        return (self[row] for row in range(len(self)))

    def select(self, which: ArrayLike | slice) -> Self:
        """The grasps at these indices (in that order), in this slice, or where this mask, shape [N], is true.

        Raises:
            FungraspError: a mask of another length, or an index out of range.
        """
        if not isinstance(which, slice):
            which = np.asarray(which)
            if which.dtype != bool:
                which = which.astype(int) if which.size == 0 else which
            if which.ndim != 1 or which.dtype.kind not in "biu":
                raise FungraspError(
                    f"a selection is a list of indices or a mask, not {which.dtype} of {which.shape}"
                )
            if which.dtype == bool and len(which) != len(self):
                raise FungraspError(f"the mask has {len(which)} rows, the set has {len(self)}")
            if (
                which.dtype != bool
                and which.size
                and not (-len(self) <= which.min() <= which.max() < len(self))
            ):
                raise FungraspError(
                    f"index {which.min()} or {which.max()} is outside the set of {len(self)} grasps"
                )
        return type(self)(**self._whole_set(), **self._rows(which))

    @classmethod
    def concatenate(cls, sets: Sequence[Self]) -> Self:
        """All grasps of several sets in one. Optional arrays are kept if every set has them.

        Raises:
            FungraspError: no sets, or sets that do not belong to the same hand.
        """
        if not sets:
            raise FungraspError("no grasp sets to concatenate")
        first = sets[0]._whole_set()
        for other in sets[1:]:
            for name, value in other._whole_set().items():
                if value != first[name]:
                    raise FungraspError(
                        f"cannot join grasp sets of different {name}: {first[name]} and {value}"
                    )
        return cls(**first, **_joined([grasps._rows(slice(None)) for grasps in sets]))

    def _whole_set(self) -> dict[str, Any]:
        """Values that belong to the set and not to a grasp."""
        return {}

    def _rows(self, which: Any) -> dict[str, Any]:
        """The per-grasp values at ``which``: arrays, None or a dict of arrays."""
        rows: dict[str, Any] = {}
        for name, field in self.FIELDS.items():
            value = getattr(self, name)
            if field.kind in ("name", "text") and isinstance(which, int):
                rows[name] = str(value[which])
            else:
                rows[name] = None if value is None else value[which]
        return rows


def _joined(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    joined: dict[str, Any] = {}
    for name, value in parts[0].items():
        values: list[Any] = [part.get(name) for part in parts]
        if isinstance(value, Mapping):
            common = [key for key in value if all(key in part[name] for part in parts)]
            joined[name] = _joined([{key: part[name][key] for key in common} for part in parts])
        elif any(v is None for v in values):
            joined[name] = None
        elif len({v.shape[1:] for v in values}) > 1:
            raise FungraspError(
                f"cannot join grasp sets: field '{name}' has shapes {[v.shape for v in values]}"
            )
        else:
            joined[name] = np.concatenate(values)
    return joined

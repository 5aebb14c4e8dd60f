"""What human and robot grasp sets have in common: checked arrays, one row for each grasp."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Self, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel

FILE_VERSION = 1
"""Version of the file format; a file without the field ``version`` is of version 1."""

QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1: within, it is normalized; beyond, it is an error."""

UNIT_NORM_TOLERANCE = 1e-12
"""A quaternion this close to unit norm is kept as it is, so that reading what was written changes nothing."""


@dataclass(frozen=True)
class ArrayField:
    """What one array of a grasp set must look like."""

    kind: Literal["name", "text", "number", "positive", "pose", "flag"]
    """Type of the values. ``name``: text, not empty, no path; ``pose``: numbers of which the last four are a
    unit quaternion."""
    shape: tuple[str | int, ...]
    """Sizes, or letters ("N", "M", ...) for sizes that fields of one set share."""
    optional: bool = False
    """Whether a set or a file may lack the field."""


def checked_array(name: str, field: ArrayField, value: Any, sizes: dict[str, int]) -> np.ndarray:
    """The value of a field as an array of str, bool or float64, with unit quaternions.

    Args:
        value: an array or what becomes one.
        sizes: sizes already known by letter; letters met here for the first time are added.

    Raises:
        FungraspError: wrong type or shape, not finite, not positive, or no unit quaternion; names field, row.
    """
    array = np.asarray(value)
    wanted = {"name": "US", "text": "US", "flag": "b"}.get(field.kind, "fiu")
    if array.dtype.kind not in wanted and array.size:
        words = {"US": "text", "b": "true/false values (bool)", "fiu": "numbers"}[wanted]
        raise FungraspError(f"field '{name}' holds {array.dtype}, expected {words}")
    _check_shape(name, field.shape, array.shape, sizes)
    if wanted == "US":
        array = array.astype(str)
        if field.kind == "name":
            _check_names(name, array)
        return array
    if wanted == "b":
        return array.astype(bool)
    array = array.astype(np.float64)
    check_rows(name, np.isfinite(array), "is not finite (NaN or infinite)")
    if field.kind == "positive":
        check_rows(name, array > 0, "must be greater than 0", array)
    if field.kind == "pose":
        norm = np.linalg.norm(array[..., 3:], axis=-1)
        check_rows(
            name,
            np.abs(norm - 1) <= QUATERNION_TOLERANCE,
            "has a quaternion (wxyz) that is not of length 1",
            norm,
        )
        scale = np.where(np.abs(norm - 1) <= UNIT_NORM_TOLERANCE, 1.0, norm)
        array[..., 3:] /= scale[..., None]
    return array


def check_rows(name: str, good: np.ndarray, complaint: str, values: np.ndarray | None = None) -> None:
    """Complain about the first row of a field that is not good.

    Args:
        good: shape [N, ...]; a row is good if all of it is.
        complaint: what is wrong with a row, without a subject.
        values: shape [N], shown in the message.

    Raises:
        FungraspError: a row is not good.
    """
    bad = np.flatnonzero(~good.all(axis=tuple(range(1, good.ndim))))
    if len(bad):
        row = int(bad[0])
        shown = "" if values is None else f": {float(values[row]):.6g}"
        more = "" if len(bad) == 1 else f" (and {len(bad) - 1} more rows)"
        raise FungraspError(f"field '{name}', row {row} {complaint}{shown}{more}")


def checked_extra(extra: Mapping[str, Any], count: int) -> dict[str, np.ndarray]:
    """Further numbers per grasp, by name. Unlike the fields they may be NaN, which means not measured.

    Args:
        extra: numbers or flags, each of shape [N, ...].

    Raises:
        FungraspError: not numbers, or not N rows.
    """
    checked = {}
    for name, value in extra.items():
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise FungraspError(f"field 'extra/{name}' holds {array.dtype}, expected numbers")
        if array.ndim == 0 or len(array) != count:
            raise FungraspError(f"field 'extra/{name}' has shape {array.shape}, expected ({count}, ...)")
        checked[name] = array.astype(np.float64) if array.dtype.kind == "f" else array
    return checked


def _check_shape(
    name: str, wanted: tuple[str | int, ...], found: tuple[int, ...], sizes: dict[str, int]
) -> None:
    fits = len(wanted) == len(found)
    for size, actual in zip(wanted, found, strict=False):
        fits = fits and (sizes.get(size, actual) if isinstance(size, str) else size) == actual
    if not fits:
        expected = ", ".join(str(size) for size in wanted) + ("," if len(wanted) == 1 else "")
        known = [f"{size} = {sizes[size]}" for size in wanted if isinstance(size, str) and size in sizes]
        where = f" with {', '.join(known)}" if known else ""
        raise FungraspError(f"field '{name}' has shape {found}, expected ({expected}){where}")
    sizes.update((size, actual) for size, actual in zip(wanted, found, strict=True) if isinstance(size, str))


def _check_names(name: str, array: np.ndarray) -> None:
    for row, text in enumerate(array.ravel()):
        if not text or "/" in text or "\\" in text or text in (".", ".."):
            raise FungraspError(f"field '{name}', row {row} must be a plain name, not {str(text)!r}")


Grasp = TypeVar("Grasp")


class GraspSet(Generic[Grasp]):
    """Grasps as arrays, one row each. Subclasses are frozen dataclasses whose ``FIELDS`` name their arrays.

    ``grasps[i]`` is one grasp and ``grasps[i:j]`` a smaller set, ``for grasp in grasps`` visits all,
    ``grasps.select(...)`` takes indices or a mask.
    """

    FIELDS: ClassVar[Mapping[str, ArrayField]]
    GRASP: ClassVar[type]

    object_name: np.ndarray
    objects: Mapping[str, ObjectModel]

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
        return self.GRASP(**self._shared(), **self._rows(row))

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
        return type(self)(**self._shared(), **self._rows(which))

    @classmethod
    def of(cls, grasps: Sequence[Grasp]) -> Self:
        """A set of single grasps. Optional values are kept if every grasp has them.

        Raises:
            FungraspError: no grasps, or grasps that do not belong to the same hand.
        """
        return cls.concatenate([cls._of_one(grasp) for grasp in grasps])

    @classmethod
    def _of_one(cls, grasp: Any) -> Self:
        columns = {name: getattr(grasp, name) for name in cls.FIELDS}
        rows = {name: None if value is None else np.asarray(value)[None] for name, value in columns.items()}
        return cls(**rows, **cls._whole_of(grasp))

    @classmethod
    def _whole_of(cls, grasp: Any) -> dict[str, Any]:
        """What a set has beside the arrays of ``FIELDS``, of one grasp."""
        return {"objects": grasp.objects}

    def save(self, path: str | Path) -> None:
        """Write an ``.npz`` file (docs/file-format.md), without the objects. Nothing is lost: numbers are
        kept as float32 where that is exact, else as float64.

        Raises:
            FungraspError: the set is empty or the file can't be written.
        """
        if not len(self):
            raise FungraspError(f"no grasps to write to {path}")
        arrays = {name: getattr(self, name) for name in self.FIELDS} | self._further_arrays()
        stored = {name: _compact(value) for name, value in arrays.items() if value is not None}
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, version=np.array(FILE_VERSION), **stored)  # pyright: ignore[reportArgumentType]

    def _further_arrays(self) -> dict[str, np.ndarray]:
        """What a file has beside the arrays of ``FIELDS``."""
        return {}

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
        objects: dict[str, ObjectModel] = {}
        for grasps in sets:
            for name, model in grasps.objects.items():
                if objects.setdefault(name, model).digest != model.digest:
                    raise FungraspError(f"cannot join grasp sets: they mean different objects by '{name}'")
        whole: dict[str, Any] = {**first, "objects": objects}
        return cls(**whole, **_joined([grasps._rows(slice(None)) for grasps in sets]))

    def _whole_set(self) -> dict[str, Any]:
        """Values that belong to the set and not to a grasp."""
        return {}

    def _shared(self) -> dict[str, Any]:
        """The same and the objects, which are not a part of what the set says."""
        return {**self._whole_set(), "objects": self.objects}

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


def _compact(array: np.ndarray) -> np.ndarray:
    if array.dtype != np.float64:
        return array
    with np.errstate(over="ignore"):
        short = array.astype(np.float32)
    return short if np.array_equal(short.astype(np.float64), array, equal_nan=True) else array

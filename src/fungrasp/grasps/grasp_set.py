"""Base class of human and robot grasp sets: checked arrays with one row per grasp."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Self, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest
from fungrasp.core.formats.checks import is_plain_name

if TYPE_CHECKING:
    from fungrasp.objects import ObjectModel

FILE_VERSION = 1
"""Version of the file format; files without the field ``version`` have version 1."""

QUATERNION_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's norm from 1; within it, quaternions are normalized."""

BOUNDS = "object_bounds/"
"""Prefix of the names of objects' bounds in files."""

OTHER_MESH = 5e-3
"""Largest difference between the bounds of meshes of the same object [m], such as two scans."""

UNIT_NORM_TOLERANCE = 1e-12
"""Quaternions this close to unit norm are not modified, so that reading a written file is exact."""


@dataclass(frozen=True)
class ArrayField:
    """Specification of one array of a grasp set."""

    kind: Literal["name", "text", "number", "positive", "pose", "flag"]
    """Type of the values. ``name``: text, not empty, not a path; ``text``: one line; ``pose``: numbers, the
    last four a unit quaternion."""
    shape: tuple[str | int, ...]
    """Sizes, or letters ("N", "M", ...) for sizes shared by fields of a set."""
    optional: bool = False
    """Whether the field may be missing."""


def checked_array(name: str, field: ArrayField, value: Any, sizes: dict[str, int]) -> np.ndarray:
    """Check a field and convert it to str, bool or float64, with unit quaternions.

    Args:
        value: array-like value.
        sizes: known sizes by letter; new ones are added.

    Raises:
        FungraspError: type, shape, a value or a quaternion is invalid; the message names field and row.
    """
    array = np.asarray(value)
    wanted = {"name": "US", "text": "US", "flag": "b"}.get(field.kind, "fiu")
    if array.dtype.kind not in wanted and array.size:
        words = {"US": "text", "b": "true/false values (bool)", "fiu": "numbers"}[wanted]
        raise FungraspError(f"field '{name}' holds {array.dtype}, expected {words}")
    _check_shape(name, field.shape, array.shape, sizes)
    if wanted == "US":
        array = array.astype(str)
        for row, text in enumerate(array.ravel().tolist()):
            good = (
                is_plain_name(text) if field.kind == "name" else text.strip() == text and text.isprintable()
            )
            if not good:
                raise FungraspError(f"field '{name}', row {row} must be a plain {field.kind}, not {text!r}")
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
    """Check the rows of a field.

    Args:
        good: whether values are valid, shape [N, ...].
        complaint: predicate of the message, such as "is not finite".
        values: values for the message, shape [N].

    Raises:
        FungraspError: a row has an invalid value.
    """
    bad = np.flatnonzero(~good.all(axis=tuple(range(1, good.ndim))))
    if len(bad):
        row = int(bad[0])
        shown = "" if values is None else f": {float(values[row]):.6g}"
        more = "" if len(bad) == 1 else f" (and {len(bad) - 1} more rows)"
        raise FungraspError(f"field '{name}', row {row} {complaint}{shown}{more}")


def checked_extra(extra: Mapping[str, Any], count: int) -> dict[str, np.ndarray]:
    """Check additional values by name. Unlike fields, they may be NaN, which means not measured.

    Args:
        extra: numbers or flags, shape [N, ...] each.

    Raises:
        FungraspError: values are not numbers, or there are not N rows.
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


Grasp = TypeVar("Grasp")


class GraspSet(Generic[Grasp]):
    """Grasps as arrays with one row each. Subclasses are frozen dataclasses with arrays as in ``FIELDS``.

    ``grasps[i]`` is one grasp and ``grasps[i:j]`` a smaller set; ``grasps.select(...)`` takes indices or a
    mask.
    """

    FIELDS: ClassVar[Mapping[str, ArrayField]]
    GRASP: ClassVar[type]

    object_name: np.ndarray
    task: np.ndarray | None
    objects: Mapping[str, ObjectModel]
    object_bounds: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        corners = ArrayField("number", (2, 3))
        bounds = {name: model.bounds for name, model in self.objects.items()}
        for name, given in self.object_bounds.items():
            if name not in bounds:
                bounds[name] = checked_array(BOUNDS + name, corners, given, {})
        object.__setattr__(self, "object_bounds", bounds)
        sizes: dict[str, int] = {}
        for name, field in self.FIELDS.items():
            value = getattr(self, name)
            if value is None and field.optional:
                continue
            object.__setattr__(self, name, checked_array(name, field, value, sizes))
        if self.task is None:
            object.__setattr__(self, "task", np.full(len(self), ""))

    def __len__(self) -> int:
        return len(self.object_name)

    @property
    def digest(self) -> str:
        """SHA-256 of the content, without the objects."""
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
        """Return the grasps selected by indices (in their order), a slice, or a mask, shape [N] bool.

        Raises:
            FungraspError: the mask has another length, or an index is out of range.
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
            size = len(self)
            if which.dtype != bool and len(which) and not -size <= which.min() <= which.max() < size:
                raise FungraspError(
                    f"index {which.min()} or {which.max()} is outside the set of {len(self)} grasps"
                )
        return type(self)(**self._shared(), **self._rows(which))

    @classmethod
    def of(cls, grasps: Iterable[Grasp] | Grasp) -> Self:
        """Return a set of single grasps. Optional values are kept if every grasp has them.

        Raises:
            FungraspError: there are no grasps, one is of another kind, their hands differ, or different
                objects have one name.
        """
        grasps = list(grasps) if isinstance(grasps, Iterable) else [grasps]
        for grasp in grasps:
            if not isinstance(grasp, cls.GRASP):
                raise FungraspError(
                    f"{cls.__name__}.of makes a set of single grasps ({cls.GRASP.__name__}), not of a "
                    f"{type(grasp).__name__}; {cls.__name__}.concatenate joins sets"
                )
        return cls.concatenate([cls._of_one(grasp) for grasp in grasps])

    @classmethod
    def _of_one(cls, grasp: Any) -> Self:
        columns = {name: getattr(grasp, name) for name in cls.FIELDS}
        rows = {name: None if value is None else np.asarray(value)[None] for name, value in columns.items()}
        return cls(**rows, **cls._whole_of(grasp))

    @classmethod
    def _whole_of(cls, grasp: Any) -> dict[str, Any]:
        """Return the other arguments of a set, besides ``FIELDS``, for one grasp."""
        return {"objects": grasp.objects, "object_bounds": grasp.object_bounds}

    def save(self, path: str | Path) -> None:
        """Write an ``.npz`` file (docs/file-format.md) with the objects' bounds, but without their meshes.
        Arrays are stored as float32 if this is exact, else as float64.

        Raises:
            FungraspError: the set is empty, or the file cannot be written.
        """
        if not len(self):
            raise FungraspError(f"no grasps to write to {path}")
        arrays = {name: getattr(self, name) for name in self.FIELDS} | self._further_arrays()
        named = set(self.object_name.tolist())
        arrays |= {BOUNDS + name: corners for name, corners in self.object_bounds.items() if name in named}
        stored = {name: _compact(value) for name, value in arrays.items() if value is not None}
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, version=np.array(FILE_VERSION), **stored)  # pyright: ignore[reportArgumentType]

    def _further_arrays(self) -> dict[str, np.ndarray]:
        """Return the other arrays of a file, besides ``FIELDS``."""
        return {}

    @classmethod
    def concatenate(cls, sets: Sequence[Self]) -> Self:
        """Join sets. Optional arrays are kept if every set has them.

        Raises:
            FungraspError: there are no sets, their hands differ, or different objects have one name.
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
        bounds: dict[str, np.ndarray] = {}
        for grasps in sets:
            for name, model in grasps.objects.items():
                if objects.setdefault(name, model).digest != model.digest:
                    raise FungraspError(f"cannot join grasp sets: '{name}' stands for different objects")
            for name, corners in grasps.object_bounds.items():
                if np.abs(bounds.setdefault(name, corners) - corners).max() > OTHER_MESH:
                    raise FungraspError(f"cannot join grasp sets: '{name}' stands for different meshes")
        whole: dict[str, Any] = {**first, "objects": objects, "object_bounds": bounds}
        return cls(**whole, **_joined([grasps._rows(slice(None)) for grasps in sets]))

    def _whole_set(self) -> dict[str, Any]:
        """Return the values common to all grasps, without the objects and their bounds."""
        return {}

    def _shared(self) -> dict[str, Any]:
        """Return the values common to all grasps."""
        return {**self._whole_set(), "objects": self.objects, "object_bounds": self.object_bounds}

    def _rows(self, which: Any) -> dict[str, Any]:
        """Return the values of selected grasps: arrays, None or a dict of arrays."""
        rows: dict[str, Any] = {}
        for name, field in self.FIELDS.items():
            value = getattr(self, name)
            if field.kind in ("name", "text") and isinstance(which, int):
                rows[name] = str(value[which])
            else:
                rows[name] = None if value is None else value[which]
        return rows


def given_bounds(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the objects' bounds among the arrays of a file, by the objects' names."""
    return {name.removeprefix(BOUNDS): value for name, value in arrays.items() if name.startswith(BOUNDS)}


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

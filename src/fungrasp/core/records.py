"""Serialization of frozen dataclasses: batches of arrays in NumPy files, and settings as JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Literal, Self, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import one_line
from fungrasp.core.formats.numpy_files import read_npz


class BatchRecord:
    """Base class of the data types shared by planner, policy, simulation and robot.

    A subclass is a frozen dataclass. Its fields are arrays with the batch axis first, None for unknown
    quantities, and scalars (in ``SCALARS``) for the whole batch.
    """

    SCALARS: ClassVar[tuple[str, ...]] = ()
    FORMER_NAMES: ClassVar[Mapping[str, str]] = {}
    """New names of fields by their old names in files."""

    def __len__(self) -> int:
        return next(len(value) for value in self._rows().values())

    def __repr__(self) -> str:
        known = ", ".join(name for name in self._rows())
        return f"<{type(self).__name__}: {len(self)} rows of {known}>"

    def __getitem__(self, rows: int | slice | Sequence[int] | np.ndarray) -> Self:
        """Return some rows of the batch; a number selects a batch of one."""
        if isinstance(rows, slice):
            return self.select(rows)
        return self.select(np.atleast_1d(np.asarray(rows)))

    def select(self, rows: np.ndarray | slice) -> Self:
        """Return some rows of the batch. rows: indices, a mask or a slice."""
        return self._with({name: value[rows] for name, value in self._rows().items()})

    def replaced(self, rows: np.ndarray, other: Self) -> Self:
        """Return a copy with some rows replaced.

        Args:
            rows: indices, shape [I].
            other: I rows with the same quantities.

        Raises:
            FungraspError: a quantity is known in only one of the two.
        """
        self._check_same(other)
        arrays = {name: value.copy() for name, value in self._rows().items()}
        for name, value in other._rows().items():
            arrays[name][rows] = value
        return self._with(arrays)

    def mapped(self, function: Callable[[Any], Any]) -> Self:
        """Return a copy with a function applied to each array, for example to move it to a device."""
        return self._with({name: function(value) for name, value in self._rows().items()})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Concatenate batches; scalars are those of the first.

        Raises:
            FungraspError: a quantity is known in only some of them.
        """
        for part in parts[1:]:
            parts[0]._check_same(part)
        rows = [part._rows() for part in parts]
        return parts[0]._with({name: np.concatenate([r[name] for r in rows]) for name in rows[0]})

    def save(self, path: str | Path) -> None:
        """Write to an ``.npz`` file atomically.

        Raises:
            FungraspError: the file can't be written.
        """
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **self.arrays())  # pyright: ignore[reportArgumentType]

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of ``save``.

        Raises:
            FungraspError: the file does not exist or has different content.
        """
        arrays = read_npz(path, f"{cls.__name__} file")
        try:
            return cls.from_arrays(arrays)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FungraspError(f"{path} holds no {cls.__name__}: {one_line(error)}") from error

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the known quantities by name, for a file."""
        shared = {name: np.asarray(getattr(self, name)) for name in self.SCALARS}
        return shared | self._rows()

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> Self:
        """Create a record from the result of ``arrays``; other names are ignored.

        Raises:
            KeyError: a quantity without a default is missing.
        """
        arrays = {cls.FORMER_NAMES.get(name, name): value for name, value in arrays.items()}
        wanted = fields(cls)  # pyright: ignore[reportArgumentType]
        missing = [f.name for f in wanted if f.default is MISSING and f.name not in arrays]
        if missing:
            raise KeyError(f"no {', '.join(missing)}")
        given = {f.name: arrays[f.name] for f in wanted if f.name in arrays}
        values: dict[str, Any] = {n: v.item() if n in cls.SCALARS else v for n, v in given.items()}
        return cls(**values)

    def _check_same(self, other: Self) -> None:
        """Raise an error if a quantity is known in only one of two records."""
        names = ", ".join(sorted(set(self._rows()) ^ set(other._rows())))
        if names:
            raise FungraspError(f"{type(self).__name__}: {names} is given in one of the two records only")

    def _rows(self) -> dict[str, np.ndarray]:
        """Return the known arrays with one row for each member of the batch."""
        names = [f.name for f in fields(self)]  # pyright: ignore[reportArgumentType]
        values = {name: getattr(self, name) for name in names if name not in self.SCALARS}
        return {name: value for name, value in values.items() if value is not None}

    def _with(self, arrays: dict[str, np.ndarray]) -> Self:
        unknown = {f.name: None for f in fields(self) if f.name not in arrays}  # pyright: ignore[reportArgumentType]
        return type(self)(**unknown | {name: getattr(self, name) for name in self.SCALARS}, **arrays)


class CheckedRecord:
    """Base class of settings: a subclass is a frozen dataclass whose values are checked against the types of
    its fields. Whole numbers are accepted as floats, lists and arrays as tuples, and mappings as settings."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value has a wrong type.
        """
        for name, hint in _field_types(type(self)).items():
            value = _value(hint, getattr(self, name), name)
            object.__setattr__(self, name, value)

    @classmethod
    def given(cls, settings: Self | None) -> Self:
        """Return settings given as an argument, or the defaults if None.

        Raises:
            FungraspError: the argument has another type.
        """
        if settings is not None and not isinstance(settings, cls):
            raise FungraspError(f"expected a {cls.__name__}, not {_words(settings)}")
        return cls() if settings is None else settings


@cache
def _field_types(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in fields(kind) if f.init}  # pyright: ignore[reportArgumentType]


Record = TypeVar("Record")


def record_to_json(record: Any) -> Any:
    """Convert a dataclass with all its fields to JSON data.

    Raises:
        FungraspError: a type is not supported, or a number is not finite.
    """
    if is_dataclass(record) and not isinstance(record, type):
        return {f.name: record_to_json(getattr(record, f.name)) for f in fields(record)}
    if isinstance(record, Mapping):
        return {str(name): record_to_json(value) for name, value in record.items()}
    if isinstance(record, list | tuple):
        return [record_to_json(value) for value in record]
    if isinstance(record, Path):
        return str(record)
    if isinstance(record, float) and not math.isfinite(record):
        raise FungraspError(f"{record} can't be written as JSON")
    if record is None or isinstance(record, bool | int | float | str):
        return record
    raise FungraspError(f"a {type(record).__name__} can't be written as JSON")


def record_from_json(kind: type[Record], data: Any, where: str) -> Record:
    """Create a dataclass from the JSON data of ``record_to_json``; missing fields get their defaults.

    Args:
        where: prefix of error messages, for example "the specification lift.json".

    Raises:
        FungraspError: a field is unknown or missing, or a value has a wrong type.
    """
    if not isinstance(data, Mapping):
        raise FungraspError(f"{where}: expected the fields of {kind.__name__}, not {_words(data)}")
    types = _field_types(kind)
    for name in data:
        if name not in types:
            near = get_close_matches(str(name), types, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(types)}"
            raise FungraspError(f"{where}: there is no field '{name}'; {hint}")
    values = {name: _value(types[name], item, f"{where}: {name}") for name, item in data.items()}
    needed = [f for f in fields(kind) if f.init and f.default is f.default_factory is MISSING]  # pyright: ignore
    if missing := [f.name for f in needed if f.name not in values]:
        raise FungraspError(f"{where}: the field '{missing[0]}' is missing")
    return kind(**values)


def _value(hint: Any, value: Any, where: str) -> Any:
    """Return a value checked against a type and converted as by ``CheckedRecord``."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return value
    if origin in (Union, UnionType):
        return _one_of(arguments, value, where)
    if origin is Literal:
        if value in arguments:
            return value
        raise FungraspError(f"{where}: expected {' or '.join(map(repr, arguments))}, not {_words(value)}")
    if origin is tuple:
        return _tuple(arguments, value, where)
    if origin is not None and issubclass(origin, Mapping):
        if isinstance(value, Mapping):
            return {name: _value(arguments[1], item, f"{where}.{name}") for name, item in value.items()}
        raise FungraspError(f"{where}: expected values by name, not {_words(value)}")
    if is_dataclass(hint):
        kind = cast("type[Any]", hint)
        return value if isinstance(value, kind) else record_from_json(kind, value, where)
    return _plain(hint, value, where)


def _plain(hint: type, value: Any, where: str) -> Any:
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise FungraspError(f"{where}: expected a finite number, not {value}")
        return float(value)
    if isinstance(value, hint) and not (hint is int and isinstance(value, bool)):
        return value
    raise FungraspError(f"{where}: expected {_KINDS.get(hint, hint.__name__)}, not {_words(value)}")


def _one_of(kinds: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and NoneType in kinds:
        return None
    errors: list[FungraspError] = []
    for kind in kinds:
        if kind is not NoneType:
            try:
                return _value(kind, value, where)
            except FungraspError as error:
                errors.append(error)
    raise errors[0]


def _tuple(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    if is_list and len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if not is_list or len(kinds) != len(value):
        size = "" if Ellipsis in kinds else f" of {len(kinds)}"
        raise FungraspError(f"{where}: expected a list{size}, not {_words(value)}")
    return tuple(_value(k, v, f"{where}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))


_KINDS = {str: "text", int: "a whole number", float: "a number", bool: "true or false", Path: "a path"}


def _words(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."

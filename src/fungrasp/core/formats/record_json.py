"""Frozen dataclasses as JSON and back: requests and settings that travel to a worker or stand in a result.

What a field may be: text, numbers, flags, ``None``, ``Path``, a ``Literal``, tuples, mappings by name, and
dataclasses of these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from fungrasp.core.errors import FungraspError

Record = TypeVar("Record")


def record_to_json(record: Any) -> Any:
    """What JSON can hold of a dataclass: all its fields, whether they are defaults or not.

    Raises:
        FungraspError: it holds something else than the module says, or a number that is not finite.
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
    """A dataclass from what ``record_to_json`` gave; a field that is not there has its default.

    Args:
        kind: the dataclass.
        data: read from JSON.
        where: begins the messages: "the specification lift.json".

    Raises:
        FungraspError: an unknown field, or a value of another type; says which, and what is allowed.
    """
    if not isinstance(data, Mapping):
        raise FungraspError(f"{where}: expected the fields of a {kind.__name__}, not {_words(data)}")
    hints = get_type_hints(kind)
    names = [f.name for f in fields(kind) if f.init]  # pyright: ignore[reportArgumentType]
    for name in data:
        if name not in names:
            near = get_close_matches(str(name), names, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(names)}"
            raise FungraspError(f"{where}: there is no field '{name}'; {hint}")
    values = {name: _value(hints[name], data[name], f"{where}: {name}") for name in names if name in data}
    try:
        return kind(**values)
    except TypeError as error:
        raise FungraspError(f"{where}: {str(error).partition(') ')[2] or error}") from None


def _value(hint: Any, value: Any, where: str) -> Any:
    """A value of a type, as strictly as JSON allows: a whole number is a float as well."""
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
        return record_from_json(cast("type[Any]", hint), value, where)
    return _plain(hint, value, where)


def _plain(hint: type, value: Any, where: str) -> Any:
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
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
    if not isinstance(value, list | tuple):
        raise FungraspError(f"{where}: expected a list, not {_words(value)}")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value):
        raise FungraspError(f"{where}: expected a list of {len(kinds)}, not of {len(value)}")
    return tuple(_value(k, v, f"{where}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))


_KINDS = {str: "text", int: "a whole number", float: "a number", bool: "true or false", Path: "a path"}


def _words(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."

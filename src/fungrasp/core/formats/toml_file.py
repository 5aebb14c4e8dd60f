"""TOML files, and checks of the types of what they hold."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import DEEPEST, check_tree, one_line, read_text

LARGEST = 250_000
"""Bytes of the largest file that is read."""

Schema = type | tuple[type, ...] | list[Any] | Mapping[str, Any]
"""Types that a value may have; ``[schema]``: a list of such values; a mapping: a table whose keys, if they
are there, have such values, where the key "*" stands for all others."""

_PART = r"""(?:"[^"\n]*"|'[^'\n]*'|[\w-]++)[ \t]*+"""
_LONG_NAME = re.compile(rf"(?<![\w-])(?:{_PART}\.[ \t]*+){{{DEEPEST}}}")
"""A dotted name with so many parts that the parser's time, which grows with their square, matters."""

_WORDS = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """What a TOML file holds.

    Args:
        path: the file.
        what: it should be, for messages: "hand file".

    Raises:
        FungraspError: it can't be read, is too large or is not valid TOML.
    """
    text = read_text(path, what, LARGEST)
    if _LONG_NAME.search(text):
        raise FungraspError(f"{path} holds a name of more than {DEEPEST} parts")
    try:
        tree = tomllib.loads(text)
    except RecursionError as error:
        raise FungraspError(f"{path} is nested too deeply") from error
    except ValueError as error:
        raise FungraspError(f"{path} is not valid TOML: {one_line(error)}") from error
    check_tree(tree, str(path))
    return tree


def type_faults(value: Any, schema: Schema, name: str = "") -> Iterator[str]:
    """What has another type than the schema says, one phrase each: "'palm' must be a text, not 3"."""
    if isinstance(schema, Mapping):
        if not isinstance(value, Mapping):
            yield f"'{name}' must be a table, not {one_line(repr(value), 60)}"
            return
        for key, item in value.items():
            kind = schema.get(key, schema.get("*"))
            if kind is not None:
                yield from type_faults(item, kind, one_line(f"{name}.{key}" if name else key, 80))
    elif isinstance(schema, list):
        if not isinstance(value, list):
            yield f"'{name}' must be a list, not {one_line(repr(value), 60)}"
            return
        for i, item in enumerate(value):
            yield from type_faults(item, schema[0], f"{name}[{i}]")
    else:
        kinds = schema if isinstance(schema, tuple) else (schema,)
        fits = isinstance(value, (*kinds, int) if float in kinds else kinds)
        if not fits or (isinstance(value, bool) and bool not in kinds):
            words = " or ".join(_WORDS[kind] for kind in kinds)
            yield f"'{name}' must be {words}, not {one_line(repr(value), 60)}"

"""JSON, TOML, YAML and XML files, and checks of their content."""

from __future__ import annotations

import json
import math
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import DEEPEST, check_tree, one_line, read_bytes, read_text

LARGEST_JSON = 16_000_000
"""Default maximum size of a file [bytes]."""


def read_json(path: str | Path, what: str, largest: int = LARGEST_JSON) -> Any:
    """Read a JSON file.

    Raises:
        FungraspError: the file can't be read, is too large or is not valid JSON.
    """
    return parse_json(read_bytes(path, what, largest), f"the {what} {path}")


def parse_json(text: str | bytes, where: str) -> Any:
    """Parse JSON text. where: prefix of error messages.

    Raises:
        FungraspError: the text is not valid JSON, is nested too deeply or has integers beyond 64 bits.
    """
    try:
        tree = json.loads(text)
    except RecursionError as error:
        raise FungraspError(f"{where} is nested too deeply") from error
    except ValueError as error:
        raise FungraspError(f"{where} is not valid JSON: {one_line(error)}") from error
    check_tree(tree, where)
    return tree


def finite(value: Any) -> Any:
    """Convert a value for JSON: NumPy numbers to Python's, paths to text, NaN and infinities to None."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return finite(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


LARGEST_TOML = 250_000
"""Maximum size of a file [bytes]."""

Schema = type | tuple[type, ...] | list[Any] | Mapping[str, Any]
"""Allowed types of a value; ``[schema]`` for a list of such values; a mapping for a table with the schemas of
its optional keys, where "*" matches all other keys."""

_PART = r"""(?:"[^"\n]*"|'[^'\n]*'|[\w-]++)[ \t]*+"""
_LONG_NAME = re.compile(rf"(?<![\w-])(?:{_PART}\.[ \t]*+){{{DEEPEST}}}")
"""A dotted name with many parts; the parser's time is quadratic in their number."""

_WORDS = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        FungraspError: the file can't be read, is too large or is not valid TOML.
    """
    text = read_text(path, what, LARGEST_TOML)
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
    """Yield violations of the schema, for example "'palm' must be a text, not 3"."""
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


LARGEST_YAML = 1_000_000
"""Maximum size of a file [bytes]; PyYAML takes about a second for 100 kB."""

TUPLE = "tag:yaml.org,2002:python/tuple"
"""PyYAML's tag of Python tuples, as in DexYCB's ``extrinsics.yml``."""


def read_yaml(path: Path) -> Mapping[str, Any]:
    """Read the fields of a YAML file. Tuples are read as lists; other tags of Python types are not supported.

    Raises:
        FungraspError: PyYAML is missing, or the file can't be read or has no fields.
    """
    try:
        import yaml
    except ImportError as error:
        raise FungraspError('reading DexYCB needs PyYAML: pip install ".[dexycb]" in the clone') from error

    class Loader(yaml.SafeLoader):
        """Plain data and tuples."""

    def construct_list(loader: Any, node: Any) -> list[Any]:
        return loader.construct_sequence(node, deep=True)

    Loader.add_constructor(TUPLE, construct_list)
    text = read_text(path, "file", LARGEST_YAML)
    try:
        content = yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise FungraspError(f"{path} is not valid YAML: {one_line(error)}") from error
    if not isinstance(content, Mapping):
        raise FungraspError(f"{path} holds no fields")
    check_tree(content, str(path))
    return content


DEEPEST_ELEMENT = 200
"""Maximum nesting depth of XML elements."""


def check_entities(text: str, where: str) -> None:
    """Refuse XML text that declares entities, which can expand to gigabytes or include other files.

    Raises:
        FungraspError: the text declares entities.
    """
    if "<!ENTITY" in text:
        raise FungraspError(f"{where} declares XML entities; write what they stand for")


def parse_xml_text(text: str, where: str) -> ElementTree.Element:
    """Return the root element of an XML document. where: prefix of error messages.

    Raises:
        FungraspError: the text is not valid XML, declares entities or is nested too deeply.
    """
    check_entities(text, where)
    parser = ElementTree.XMLPullParser(("start", "end"))
    root: ElementTree.Element | None = None
    depth = 0
    try:
        # Parse in pieces, to stop early at too deep nesting.
        for start in range(0, len(text), _PIECE):
            parser.feed(text[start : start + _PIECE])
            for event, element in parser.read_events():  # pyright: ignore[reportAssignmentType]
                assert isinstance(element, ElementTree.Element)
                root = element if root is None else root
                depth += 1 if event == "start" else -1
                if depth > DEEPEST_ELEMENT:
                    raise FungraspError(f"{where} is nested more than {DEEPEST_ELEMENT} levels deep")
        parser.close()
    except ElementTree.ParseError as error:
        raise FungraspError(f"{where} is not valid XML: {one_line(error)}") from error
    if root is None:
        raise FungraspError(f"{where} is not valid XML: it has no element")
    return root


_PIECE = 1 << 16

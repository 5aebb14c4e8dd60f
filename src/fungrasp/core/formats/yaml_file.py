"""YAML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import check_tree, one_line, read_text

LARGEST = 1_000_000
"""Bytes of the largest file that is read: PyYAML takes about a second for each 100 kB."""

TUPLE = "tag:yaml.org,2002:python/tuple"
"""How PyYAML marks Python's tuples, as in DexYCB's ``extrinsics.yml``."""


def read_yaml(path: Path) -> Mapping[str, Any]:
    """Fields of a YAML file. Of the tags that name Python's types only that of tuples is known; they are read
    as lists.

    Raises:
        FungraspError: PyYAML is missing, or the file can't be read or holds no fields.
    """
    try:
        import yaml
    except ImportError as error:
        raise FungraspError('reading DexYCB needs PyYAML: pip install "fungrasp[dexycb]"') from error

    class Loader(yaml.SafeLoader):
        """Plain data and tuples."""

    def construct_list(loader: Any, node: Any) -> list[Any]:
        return loader.construct_sequence(node, deep=True)

    Loader.add_constructor(TUPLE, construct_list)
    text = read_text(path, "file", LARGEST)
    try:
        content = yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise FungraspError(f"{path} is not valid YAML: {one_line(error)}") from error
    if not isinstance(content, Mapping):
        raise FungraspError(f"{path} holds no fields")
    check_tree(content, str(path))
    return content

"""JSON files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fungrasp.errors import FungraspError
from fungrasp.formats.file_bytes import check_tree, one_line, read_bytes

LARGEST = 16_000_000
"""Bytes of the largest file that is read."""


def read_json(path: str | Path, what: str, largest: int = LARGEST) -> Any:
    """What a JSON file holds.

    Args:
        path: the file.
        what: it should be, for messages: "hand file".
        largest: [bytes].

    Raises:
        FungraspError: it can't be read, is too large or is not valid JSON.
    """
    return parse_json(read_bytes(path, what, largest), f"the {what} {path}")


def parse_json(text: str | bytes, where: str) -> Any:
    """What JSON text holds; ``where`` begins the messages.

    Raises:
        FungraspError: it is not valid JSON, is nested too deeply or holds integers beyond 64 bits.
    """
    try:
        tree = json.loads(text)
    except RecursionError as error:
        raise FungraspError(f"{where} is nested too deeply") from error
    except ValueError as error:
        raise FungraspError(f"{where} is not valid JSON: {one_line(error)}") from error
    check_tree(tree, where)
    return tree

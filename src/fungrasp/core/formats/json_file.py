"""JSON files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.file_bytes import check_tree, one_line, read_bytes

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


def finite(value: Any) -> Any:
    """The same for JSON: NumPy's numbers as Python's, paths as text, None for NaN and infinities."""
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

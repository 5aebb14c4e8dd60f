"""DexYCB's YAML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fungrasp.errors import FungraspError


def read_yaml(path: Path) -> Mapping[str, Any]:
    """Fields of a YAML file.

    Raises:
        FungraspError: PyYAML is missing, or the file can't be read or holds no fields.
    """
    try:
        import yaml
    except ImportError as error:
        raise FungraspError("reading DexYCB needs PyYAML: pip install 'fungrasp[dexycb]'") from error
    try:
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        raise FungraspError(f"cannot read {path}: {error.strerror or error}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise FungraspError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, Mapping):
        raise FungraspError(f"{path} holds no fields")
    return content

"""MJCF and URDF files, tried in a child process with limits before MuJoCo reads them here."""

from __future__ import annotations

import functools
from pathlib import Path

import mujoco

from fungrasp.errors import FungraspError
from fungrasp.formats.file_bytes import cannot_read, one_line, read_text
from fungrasp.formats.sandbox import run_limited

LARGEST = 20_000_000
"""Bytes of the largest file that is read, those of its meshes not counted."""

LARGEST_SIZE = 100_000
"""Largest of the sizes that a model may declare: user data, constraints, contacts, keyframes."""

SIZES = ("njmax", "nconmax", "nuserdata", "nkey", "nuser_body", "nuser_geom", "nuser_jnt", "nuser_site")

_PACKAGE = Path(__file__).parents[1]


def read_model_text(path: str | Path, what: str = "hand's model") -> str:
    """The XML text of a model file, without entities of its own.

    Raises:
        FungraspError: it can't be read or declares entities.
    """
    text = read_text(path, what, LARGEST)
    if "<!ENTITY" in text:
        raise FungraspError(f"the {what} {one_line(path)} declares XML entities; write what they stand for")
    return text


def read_model(path: str | Path, what: str = "hand's model") -> mujoco.MjSpec:
    """A model for editing and compiling.

    Args:
        path: an MJCF or URDF file.
        what: it is, for messages.

    Raises:
        FungraspError: it can't be read, or takes too much time or memory.
    """
    path = Path(path)
    if not path.resolve().is_relative_to(_PACKAGE):
        read_model_text(path, what)
        fault = _fault(path.absolute(), what, path.stat().st_mtime_ns)
        if fault:
            raise FungraspError(fault)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise FungraspError(f"cannot read the {what} {one_line(path)}: {one_line(error)}") from error
    for name in SIZES:
        value = getattr(spec, name)
        if value > LARGEST_SIZE:
            raise FungraspError(
                f"the {what} {one_line(path)} declares {name} = {value}; at most {LARGEST_SIZE} is taken"
            )
    return spec


@functools.lru_cache(maxsize=256)
def _fault(path: Path, what: str, stamp: int) -> str | None:
    """Why a model is not read here, if so; kept while the file is the same."""
    try:
        size = sum(file.stat().st_size for file in path.parent.iterdir() if file.is_file())
        run_limited("model", path, what, min(size, 100_000_000))
    except OSError as error:
        return str(cannot_read(path.parent, error))
    except FungraspError as error:
        return str(error)
    return None

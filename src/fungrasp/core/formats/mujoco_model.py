"""MJCF and URDF files, tested in a limited child process before MuJoCo reads them in this process."""

from __future__ import annotations

import contextlib
import functools
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.checks import cannot_read, one_line, read_text
from fungrasp.core.formats.sandbox import run_limited
from fungrasp.core.formats.text_files import check_entities

LARGEST = 20_000_000
"""Maximum size of a file without its meshes [bytes]."""

LARGEST_SIZE = 100_000
"""Maximum of the sizes that a model declares: user data, constraints, contacts, keyframes."""

SIZES = ("njmax", "nconmax", "nuserdata", "nkey", "nuser_body", "nuser_geom", "nuser_jnt", "nuser_site")

NUMBERS = {
    "body": ("pos", "quat", "ipos", "iquat", "mass", "inertia"),
    "jnt": ("pos", "axis", "range", "stiffness"),
    "geom": ("pos", "quat", "size"),
    "site": ("pos", "quat"),
    "eq": ("data",),
}
"""Fields of a compiled model that ``check_model_numbers`` checks, by element type."""

TITLES = {"pos": "place", "ipos": "center of mass", "iquat": "inertia's frame"}
"""What fields are called in messages."""

LENGTHS = ("pos", "ipos", "size")
"""Checked fields that are lengths [m]."""

_PACKAGE = Path(__file__).parents[2]


def read_model_text(path: str | Path) -> str:
    """Read the XML text of a model file.

    Raises:
        FungraspError: the file can't be read or declares entities.
    """
    text = read_text(path, "hand's model", LARGEST)
    check_entities(text, f"the hand's model {one_line(path)}")
    return text


def read_model(path: str | Path) -> mujoco.MjSpec:
    """Read a model for editing and compiling.

    Raises:
        FungraspError: the file can't be read, or takes too much time or memory.
    """
    path = Path(path)
    if not path.resolve().is_relative_to(_PACKAGE):
        read_model_text(path)
        fault = _fault(path.absolute(), path.stat().st_mtime_ns)
        if fault:
            raise FungraspError(fault)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise FungraspError(f"cannot read the hand's model {one_line(path)}: {one_line(error)}") from error
    _check_sizes(spec, f"the hand's model {one_line(path)}")
    return spec


def parse_model(text: str, where: str) -> mujoco.MjSpec:
    """Parse XML text as a model for editing and compiling, without loading files that it names.

    Raises:
        ValueError: MuJoCo can't parse the text.
        FungraspError: parsing takes too much time or memory.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(text, encoding="utf-8")
        run_limited("model", path, "", len(text), where)
    spec = mujoco.MjSpec.from_string(text)
    _check_sizes(spec, where)
    return spec


def check_model_numbers(model: mujoco.MjModel, where: str, longest: float = 1000.0) -> None:
    """Check that positions, directions, sizes, masses and limits are finite, and positions and sizes at most
    ``longest`` [m], because sampling of surfaces takes time and memory in proportion.

    Raises:
        FungraspError: a value is invalid; the message begins with ``where`` and names the first.
    """
    for kind, fields in NUMBERS.items():
        for name in fields:
            values = np.asarray(getattr(model, f"{kind}_{name}"))
            largest = longest if name in LENGTHS else np.finfo(float).max
            bad = ~(np.abs(values) <= largest).all(axis=tuple(range(1, values.ndim)))
            if bad.any():
                i = int(np.argmax(bad))
                title = {"jnt": "joint", "eq": "equality"}.get(kind, kind)
                value, words = float(np.abs(values[i]).max()), TITLES.get(name, name)
                owner = one_line(getattr(model, title)(i).name or i, 60)
                raise FungraspError(
                    f"{where}: the {words} of {title} '{owner}' is "
                    + (f"{value:.3g} m: is it in meters?" if np.isfinite(value) else "not finite")
                )


def _check_sizes(spec: mujoco.MjSpec, where: str) -> None:
    for name in SIZES:
        value = getattr(spec, name)
        if value > LARGEST_SIZE:
            raise FungraspError(f"{where} declares {name} = {value}; at most {LARGEST_SIZE} is taken")


@functools.lru_cache(maxsize=256)
def _fault(path: Path, stamp: int) -> str | None:
    """Return why a model can't be read, or None; cached until the file changes."""
    try:
        size = sum(file.stat().st_size for file in path.parent.iterdir() if file.is_file())
        run_limited("model", path, "model", min(size, 100_000_000))
    except OSError as error:
        return str(cannot_read(path.parent, error))
    except FungraspError as error:
        return str(error)
    return None


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress warnings of MuJoCo and Python in the terminal and in a log file; findings replace them."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        mujoco.set_mju_user_warning(before)

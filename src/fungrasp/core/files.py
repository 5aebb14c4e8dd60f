"""Atomic writing of files, the cache folder, and digests for cache keys."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import os
import platform
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError

MOVE_CACHE = "set FUNGRASP_CACHE to a folder that can be written to"

_HOST = hashlib.sha256(platform.node().encode()).hexdigest()[:6]
"""Identifies processes of this machine among machines that share a folder."""


class CannotWriteError(FungraspError):
    """A file or folder can't be created or written to, or the disk is full."""


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``. It replaces ``path`` on success and is removed otherwise.

    The temporary name has the same suffix, for libraries that choose a format by suffix.

    Raises:
        CannotWriteError: the folder can't be written to, or the disk is full.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}.{_HOST}-{os.getpid()}-", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
    except OSError as error:
        raise CannotWriteError(f"cannot write {path}: {error.strerror or error}") from error
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OSError as error:
        raise CannotWriteError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(paths: Mapping[str, str | Path]) -> None:
    """Check that output files can be written, before the work starts. Nothing is created.

    Args:
        paths: output files by option name.

    Raises:
        FungraspError: a path is a folder, lies below a file or in a folder that can't be written to, or two
            are the same.
    """
    names: dict[Path, str] = {}
    for name, path in paths.items():
        whole = Path(path).absolute()
        if whole in names:
            raise FungraspError(f"{names[whole]} and {name} are the same file, {path}")
        names[whole] = name
        if whole.is_dir():
            raise FungraspError(f"cannot write {path} ({name}): it is a folder: add a file's name")
        above = next(folder for folder in whole.parents if folder.exists())
        if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
            problem = "can't be written to" if above.is_dir() else "is a file"
            raise FungraspError(f"cannot write {path} ({name}): {above} {problem}")


def check_suffix(path: str | Path, what: str, *suffixes: str) -> Path:
    """Return the path of an output file after checking its suffix, in any case.

    Args:
        what: the content, for messages: "a picture".

    Raises:
        FungraspError: the suffix is another one.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise FungraspError(f"{what} is a {' or '.join(suffixes)} file, not {path}")
    return path


def remove_leftovers(path: str | Path) -> None:
    """Delete temporary files of ``path`` that killed processes of this machine left."""
    path = Path(path)
    for left in path.parent.glob(f".{glob.escape(path.stem)}.{_HOST}-*{glob.escape(path.suffix)}"):
        owner = left.name.removeprefix(f".{path.stem}.{_HOST}-").partition("-")[0]
        if owner.isdigit() and not _alive(int(owner)):
            with contextlib.suppress(OSError):
                left.unlink()


def cache_path(kind: str) -> Path:
    """Return the cache folder for one ``kind`` of data ("convex_pieces", ...), existing or not.

    It is in ``$FUNGRASP_CACHE`` if set, else ``$XDG_CACHE_HOME/fungrasp``, else ``~/.cache/fungrasp``. The
    path can't be created without a home folder.
    """
    root = os.environ.get("FUNGRASP_CACHE")
    if root is None:
        with contextlib.suppress(RuntimeError):
            root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fungrasp"
    return Path(os.devnull if root is None else root) / kind


def cache_folder(kind: str) -> Path:
    """Return ``cache_path`` for writing, creating the folder if necessary.

    Raises:
        CannotWriteError: the folder can't be created or written to; the message names the variable that moves
            it.
    """
    folder = cache_path(kind)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise CannotWriteError(f"cannot make the cache folder {folder}: {reason}; {MOVE_CACHE}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise CannotWriteError(f"cannot write to the cache folder {folder}; {MOVE_CACHE}")
    return folder


def digest(*things: Any) -> str:
    """Return the SHA-256 of arrays, bytes, mappings, lists, objects with a ``digest``, and anything described
    by ``repr``."""
    result = hashlib.sha256()

    def add(obj: Any) -> None:
        own = getattr(obj, "digest", None)
        if isinstance(own, str):
            result.update(own.encode())
        elif isinstance(obj, Mapping):
            for key in sorted(obj):
                result.update(f"{key}:".encode())
                add(obj[key])
        elif isinstance(obj, list | tuple):
            result.update(f"{len(obj)}:".encode())
            for item in obj:
                add(item)
        elif isinstance(obj, np.ndarray):
            result.update(f"{obj.dtype}{obj.shape}".encode())
            result.update(np.ascontiguousarray(obj).tobytes())
        else:
            result.update(obj if isinstance(obj, bytes) else repr(obj).encode())
        result.update(b";")

    for obj in things:
        add(obj)
    return result.hexdigest()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask

"""Results cached on disk; concurrent processes compute each result once."""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import logging
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from fungrasp.core.files import CannotWriteError, cache_folder, cache_path

T = TypeVar("T")


def cached_on_disk(kind: str, key: str, read: Callable[[Path], T], write: Callable[[Path], None]) -> T:
    """Read the result cached under ``key``; if it is missing or broken, make it with ``write``.

    Args:
        write: computes the result and writes the file atomically.

    If the cache folder can't be written to or is full, results are kept for this process only.
    """
    name = f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npz"
    found = _try_read(cache_path(kind) / name, read)
    if found is not None:
        return found
    try:
        return _made(cache_folder(kind) / name, read, write)
    except CannotWriteError as error:
        if not _temporary_folder.cache_info().currsize:
            logging.getLogger(__name__).warning("%s: results are not kept", error)
        return _made(_temporary_folder() / f"{kind}-{name}", read, write)


def _made(path: Path, read: Callable[[Path], T], write: Callable[[Path], None]) -> T:
    with _locked(path.with_suffix(".lock")):
        found = _try_read(path, read)
        if found is not None:
            return found
        write(path)
        return read(path)


@functools.cache
def _temporary_folder() -> Path:
    """Return a folder that is removed when this process ends."""
    folder = tempfile.mkdtemp(prefix="fungrasp-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _try_read(path: Path, read: Callable[[Path], T]) -> T | None:
    try:
        return read(path) if path.exists() else None
    except (OSError, ValueError, LookupError, TypeError) as error:
        logging.getLogger(__name__).warning("%s is unreadable (%s): computing it again", path, error)
        return None


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Lock ``path`` against other processes, if the system supports it (POSIX)."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    try:
        file = path.open("w")
    except OSError as error:
        raise CannotWriteError(f"cannot write {path}: {error.strerror}") from error
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield

"""Results computed once and cached on disk; processes that run at the same time read the same file."""

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

from fungrasp.errors import FungraspError
from fungrasp.files import cache_folder, cache_path

T = TypeVar("T")


def cached_on_disk(kind: str, key: str, read: Callable[[Path], T], write: Callable[[Path], None]) -> T:
    """What ``read`` finds in the file cached under ``key``; ``write`` makes it where it is missing or broken.

    Args:
        kind: folder in the cache.
        key: everything the result depends on.
        read: reads the file.
        write: computes the result and writes the file, whole or not at all.

    Where the cache folder can't be written to, results are kept for this process only.
    """
    name = f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npz"
    found = _try_read(cache_path(kind) / name, read)
    if found is not None:
        return found
    try:
        path = cache_folder(kind) / name
    except FungraspError as error:
        path = _temporary_folder(str(error)) / f"{kind}-{name}"
        found = _try_read(path, read)
        if found is not None:
            return found
    with _locked(path.with_suffix(".lock")):
        found = _try_read(path, read)
        if found is not None:
            return found
        write(path)
        return read(path)


@functools.cache
def _temporary_folder(reason: str) -> Path:
    """A folder that goes with this process."""
    logging.getLogger(__name__).warning("%s: results are not kept", reason)
    folder = tempfile.mkdtemp(prefix="fungrasp-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _try_read(path: Path, read: Callable[[Path], T]) -> T | None:
    if not path.exists():
        return None
    try:
        return read(path)
    except (OSError, ValueError, LookupError, TypeError) as error:
        logging.getLogger(__name__).warning("%s is unreadable (%s): computing it again", path, error)
        return None


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold ``path`` against other processes, where the system can (POSIX)."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield

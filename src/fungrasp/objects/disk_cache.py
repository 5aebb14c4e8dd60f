"""Results computed once and cached on disk; processes that run at the same time read the same file."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from fungrasp.files import cache_folder

T = TypeVar("T")


def cached_on_disk(kind: str, key: str, read: Callable[[Path], T], write: Callable[[Path], None]) -> T:
    """What ``read`` finds in the file cached under ``key``; ``write`` makes it where it is missing or broken.

    Args:
        kind: folder in the cache.
        key: everything the result depends on.
        read: reads the file.
        write: computes the result and writes the file, whole or not at all.

    Raises:
        FungraspError: the cache folder can't be written to.
    """
    path = cache_folder(kind) / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.npz"
    found = _try_read(path, read)
    if found is not None:
        return found
    with _locked(path.with_suffix(".lock")):
        found = _try_read(path, read)
        if found is not None:
            return found
        write(path)
        return read(path)


def _try_read(path: Path, read: Callable[[Path], T]) -> T | None:
    if not path.exists():
        return None
    try:
        return read(path)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
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

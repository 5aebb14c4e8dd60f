"""One program at a time moves a device: two on this computer would each undo what the other does."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

from fungrasp.robots.device import RobotError

try:
    import fcntl
except ImportError:  # Windows has no such locks.
    fcntl = None


class DeviceLock:
    """Held from when a device is taken until its loop ends, however that ends."""

    def __init__(self, name: str):
        """name: type and address of the device."""
        self._name, self._file = name, -1

    def take(self) -> None:
        """Raises: RobotError: another program has the device."""
        if fcntl is None or self._file >= 0:
            return
        mark = hashlib.sha256(self._name.encode()).hexdigest()[:12]
        path = Path(tempfile.gettempdir()) / f"fungrasp-{mark}.lock"
        try:
            # Without O_CREAT first: systems refuse it for another user's file in a common folder.
            exists = path.exists()
            file = os.open(path, os.O_RDONLY if exists else os.O_RDONLY | os.O_CREAT, 0o644)
        except OSError as error:
            raise RobotError(f"cannot lock {self._name}: {path}: {error.strerror}") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            raise RobotError(
                f"{self._name} is moved by another program on this computer: end that one first"
            ) from None
        self._file = file

    def release(self) -> None:
        """Another program may have it. Never raises."""
        if self._file >= 0:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = -1

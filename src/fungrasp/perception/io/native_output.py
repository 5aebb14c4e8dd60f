"""Filtering the log output of native libraries on stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryFile

DROPPED_PREFIX = b"INFO:"
"""How lines begin that are left out."""


@contextmanager
def filtered_native_output() -> Iterator[None]:
    """Hold back what is written to stderr meanwhile; then pass it on without lines that begin with "INFO:".

    For libraries that write past Python and have no setting for it. Keep what runs inside short: the whole
    process's stderr is held back.
    """
    try:
        stderr = os.dup(2)
    except OSError:
        # There is no stderr.
        yield
        return
    with TemporaryFile() as held:
        _flush()
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            _flush()
            os.dup2(stderr, 2)
            os.close(stderr)
            held.seek(0)
            kept = b"".join(line for line in held if not line.startswith(DROPPED_PREFIX))
            if kept:
                os.write(2, kept)


def _flush() -> None:
    if sys.stderr is not None:
        sys.stderr.flush()

"""A child process with limited time and memory, for files that third-party libraries read.

A server process forks a child for each file, so that a child costs milliseconds. On systems without fork, the
work is done in this process, without limits.
"""

from __future__ import annotations

import atexit
import json
import os
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats import sandbox_worker
from fungrasp.core.parallel import worker_environment

MEMORY = 1_600_000_000
"""Memory limit of a child [bytes]."""

SECONDS = 4.0
"""Limit of processor time for a small file [s]. The limit of wall time is ten times as long, in case other
programs use the processors."""

BYTES_PER_SECOND = 5e6
"""A file gets one more second for each such number of bytes."""

_lock = threading.Lock()
_server: tuple[int, subprocess.Popen[bytes]] | None = None


def run_limited(job: str, path: str | Path, what: str, size: int = 0, where: str | None = None) -> bytes:
    """Return the result of a ``sandbox_worker`` job on a file.

    Args:
        job: one of ``sandbox_worker.JOBS``.
        size: total size of the files to read [bytes].
        where: prefix of error messages; "the WHAT PATH" if None.

    Raises:
        FungraspError: the job refused the file, exceeded its time or memory, or crashed.
    """
    seconds = SECONDS + size / BYTES_PER_SECOND
    request = {"job": job, "path": str(Path(path).absolute()), "seconds": seconds, "memory": MEMORY}
    status, answer = _ask(request) if hasattr(os, "fork") else sandbox_worker.work(job, str(path))
    if status == sandbox_worker.DONE:
        return answer
    where = where or f"the {what} {path}"
    raise FungraspError(
        {
            sandbox_worker.REFUSED: f"cannot read {where}: {answer.decode()}",
            sandbox_worker.SLOW: f"{where} was not read: it takes more than {seconds:.0f} s",
            sandbox_worker.LARGE: f"{where} was not read: it takes more than {MEMORY / 1e9:.1f} GB of memory",
            sandbox_worker.CRASHED: f"{where} was not read: it crashes its reader ({answer.decode()})",
        }[status]
    )


def _ask(request: dict[str, Any]) -> tuple[int, bytes]:
    global _server
    line = json.dumps(request).encode() + b"\n"
    with _lock:
        for _ in range(2):
            if _server is None or _server[0] != os.getpid() or _server[1].poll() is not None:
                _server = os.getpid(), _start()
            process = _server[1]
            assert process.stdin is not None and process.stdout is not None
            try:
                process.stdin.write(line)
                process.stdin.flush()
                head = process.stdout.read(sandbox_worker.HEAD.size)
                status, size = sandbox_worker.HEAD.unpack(head)
                return status, process.stdout.read(size)
            except (OSError, struct.error):
                process.kill()
                process.wait()
            except BaseException:
                # Interrupted: the next answer would belong to this request.
                process.kill()
                process.wait()
                raise
    return sandbox_worker.CRASHED, b"the process that reads files ended"


def _start() -> subprocess.Popen[bytes]:
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", sandbox_worker.__name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=worker_environment(),
            start_new_session=True,
        )
    except OSError as error:
        raise FungraspError(f"cannot start the process that reads files: {error.strerror}") from error
    atexit.register(_stop, process, os.getpid())
    return process


def _stop(process: subprocess.Popen[bytes], owner: int) -> None:
    if os.getpid() == owner and process.poll() is None:
        process.kill()
        process.wait()

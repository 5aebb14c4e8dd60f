"""Long jobs of independent parts, run in this process or on a Ray cluster. Finished parts are stored, so that
interrupted jobs can continue."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any, Generic, Self, TypeVar
from uuid import uuid4

import numpy as np

from fungrasp.core import __version__
from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, digest
from fungrasp.core.formats.numpy_files import read_npz

__all__ = ["Arrays", "ClusterUse", "Job", "PartStore", "RayCluster", "part_key", "run_job"]

MOST_ARRAYS = 1000


class PartStore:
    """Stored results of finished parts by key, one file each.

    As a context manager, it deletes its files at the end of the block, unless there was an exception::

        with PartStore.beside(out) as store:
            result = evaluate(robot, objects, store=store)
            result.save(out)
    """

    def __init__(self, folder: str | Path):
        """folder: created on demand. An unreadable file counts as missing."""
        self._folder = Path(folder)

    @classmethod
    def beside(cls, result: str | Path) -> Self:
        """Return the store for a result file: the folder ``<result>.partial``."""
        path = Path(result)
        return cls(path.with_name(f"{path.name}.partial"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.remove()

    def __contains__(self, key: str) -> bool:
        """Whether the part is stored."""
        return self._file(key).is_file()

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """Return the arrays of a part by name, or None if it is not stored."""
        if key not in self:
            return None
        try:
            return dict(read_npz(self._file(key), "finished part", most=MOST_ARRAYS))
        except FungraspError:
            return None

    def save(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store the arrays of a part; they are on disk when this returns.

        Raises:
            FungraspError: the file can't be written.
        """
        with atomic_path(self._file(key)) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]

    def kept(self, key: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the arrays of a part, computed and stored if they are missing.

        Raises:
            FungraspError: the file can't be written.
        """
        found = self.load(key)
        if found is None:
            found = make()
            self.save(key, found)
        return found

    def remove(self) -> None:
        """Delete the parts, and the folder if it is then empty."""
        for file in self._folder.glob("*.npz"):
            file.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def _file(self, key: str) -> Path:
        return self._folder / f"{key}.npz"


Result = TypeVar("Result")

WAITING = 2
"""Jobs per processor that are sent at a time, one running and one waiting, to limit memory."""

MOST_LOSSES = 5
"""Maximum number of repetitions of a job whose worker or machine is lost."""

CONNECTING = 10.0
"""Timeout of the connection to the head of a cluster [s]."""

COUNTING = 1.0
"""Maximum period between counts of the processors [s]."""

LOCAL = "local"
"""Address of a cluster that is started on this machine alone."""


@dataclass(frozen=True)
class ClusterUse:
    """Utilization of a cluster."""

    jobs: int
    """Number of finished jobs."""
    processors: float
    """Average number of available processors."""
    seconds: float
    """Time from the first job sent to the last result [s]."""
    working: float
    """Sum of the wall times of finished jobs [s]."""

    @property
    def share(self) -> float:
        """Share of the processors' time spent on finished jobs."""
        return self.working / max(self.processors * self.seconds, 1e-9)

    @property
    def words(self) -> str:
        """The utilization as one line of text."""
        return (
            f"{self.jobs} jobs on {self.processors:.3g} processors in {self.seconds:.0f} s, of which they "
            f"worked {self.share:.0%}"
        )


class RayCluster:
    """A Ray cluster. It connects with the first job."""

    def __init__(self, address: str = LOCAL):
        """address: head of a running cluster ("auto": on this machine), or ``LOCAL``. A process that is
        already connected keeps its cluster."""
        self._address = address
        self.use: ClusterUse | None = None
        """Utilization in the last ``run``; None before the first."""

    def run(
        self,
        work: Callable[..., Result],
        jobs: Iterable[tuple[Any, ...]],
        finished: Callable[[tuple[Any, ...], Result], None],
        shared: Any = None,
    ) -> None:
        """Run each job once on any processor.

        Jobs run in the current folder of this process if the machine has it. A job is repeated if its machine
        is lost. Jobs must be independent of each other and of the machine; their order is not kept.

        Args:
            work: function of a module that every machine can import, called with ``shared`` and a job's
                items.
            finished: called in this process with each job and its result, one after another.
            shared: data for all jobs, sent to each machine once.

        Raises:
            FungraspError: Ray is not installed, there is no cluster at the address, a machine has a different
                version of fungrasp, or ``work`` fails.
        """
        ray, begun = _connected(self._address)
        send = ray.remote(num_cpus=1, max_retries=MOST_LOSSES)(_work)
        sent, folder = ray.put(shared), Path.cwd()
        running: dict[Any, tuple[Any, ...]] = {}
        remaining = iter(jobs)
        count, working, offered = 0, 0.0, 0.0
        start = last = perf_counter()
        try:
            while True:
                # Machines may join or leave, so count the processors again.
                processors = max(int(ray.cluster_resources().get("CPU", 1)), 1)
                for job in islice(remaining, max(WAITING * processors - len(running), 0)):
                    running[send.remote(work, __version__, folder, sent, job)] = job
                if not running:
                    seconds = last - start
                    self.use = ClusterUse(count, offered / max(seconds, 1e-9), seconds, working)
                    return
                for done in ray.wait(list(running), num_returns=1, timeout=COUNTING)[0]:
                    result, took = _result(ray, done)
                    finished(running.pop(done), result)
                    count, working = count + 1, working + took
                now = perf_counter()
                offered, last = offered + processors * (now - last), now
        finally:
            for job in running:
                ray.cancel(job, force=True)
            if begun:
                ray.shutdown()


def _connected(address: str) -> tuple[Any, bool]:
    """Return Ray, and whether this call connected the process."""
    try:
        import ray
    except ImportError as error:
        raise FungraspError('work on a cluster needs Ray: pip install ".[ray]" in the clone') from error
    if ray.is_initialized():
        return ray, False
    _check_reachable(address)
    options: dict[str, Any] = {"include_dashboard": False} if address == LOCAL else {}
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **options)
    except (ConnectionError, ValueError, RuntimeError, OSError) as error:
        words = str(error).strip().splitlines() or [type(error).__name__]
        raise FungraspError(f"no Ray cluster at '{address}': {words[0]}") from None
    return ray, True


def _check_reachable(address: str) -> None:
    """Fail early: Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), CONNECTING).close()
    except (OSError, OverflowError) as error:
        raise FungraspError(f"no Ray cluster at '{address}': {error}") from None


def _work(
    work: Callable[..., Result], version: str, folder: Path, shared: Any, job: tuple[Any, ...]
) -> tuple[Result, float]:
    """Return the result and the wall time [s] of a job."""
    if version != __version__:
        raise FungraspError(f"a machine of the cluster has fungrasp {__version__}, not {version}")
    # A worker starts in the folder in which its machine joined; relative paths need the caller's folder.
    if folder.is_dir():
        os.chdir(folder)
    start = perf_counter()
    result = work(shared, *job)
    return result, perf_counter() - start


def _result(ray: Any, done: Any) -> Any:
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, FungraspError):
            raise FungraspError(str(error.cause)) from None
        if isinstance(error.cause, ray.exceptions.RaySystemError):
            # The last line of the remote traceback, for example a missing package.
            words = str(error.cause).strip().splitlines()[-1]
            raise FungraspError(f"a machine of the cluster can't begin a job: {words}") from None
        raise
    except ray.exceptions.RayError as error:
        words = str(error).strip().splitlines()[0]
        raise FungraspError(f"a job was lost {MOST_LOSSES + 1} times on the cluster: {words}") from None


Part = TypeVar("Part")

Arrays = dict[str, np.ndarray]
"""Result of a part: the content of an ``.npz`` file."""

VERSIONS = (__version__, version("mujoco-core"))
"""Versions in part keys, so that parts of other versions are not reused."""


def part_key(*inputs: Any) -> str:
    """Return the key of a part in the store.

    Args:
        inputs: everything that determines the result (``fungrasp.core.files.digest``). The versions of
            fungrasp and MuJoCo are added.
    """
    return digest(VERSIONS, *inputs)[:32]


class Job(ABC, Generic[Part]):
    """A job of independent parts. A subclass is a frozen dataclass with the inputs. Values of
    ``cached_property`` are not sent to other processes."""

    @abstractmethod
    def parts(self) -> list[Part]:
        """Return all parts, in the order of the results."""

    @abstractmethod
    def key(self, part: Part) -> str:
        """Return the ``part_key`` of a part."""

    @abstractmethod
    def run(self, parts: Sequence[Part], progress: Callable[[float], None]) -> list[Arrays]:
        """Return the results of some parts. They must not depend on which parts are run together.

        Args:
            parts: a single part, or a group of ``together``.
            progress: called with the finished size.
        """

    def size(self, part: Part) -> float:
        """Return the amount of work of a part."""
        return 1.0

    def together(self, missing: list[Part]) -> list[list[Part]]:
        """Return groups of parts to run together, which keeps all threads of a process busy."""
        return [[part] for part in missing]

    def is_whole(self, part: Part) -> bool:
        """Return whether the files that the part wrote elsewhere (recordings) still exist."""
        return True

    def on_one_processor(self) -> Self:
        """Return the job for a worker of a cluster, which has one processor."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        fields: dict[str, Any] = getattr(self, "__dataclass_fields__", {})
        return {name: getattr(self, name) for name in fields}


def run_job(
    job: Job[Part],
    store: PartStore | None = None,
    *,
    ray: RayCluster | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> list[Arrays]:
    """Run the parts of a job that are not stored yet.

    Args:
        store: stores finished parts, so that an interrupted run can continue. The caller removes it.
        ray: cluster to run on; this process if None. The results are the same.
        progress: called with the finished share, 0 to 1.

    Returns:
        The results in the order of ``job.parts()``.

    Raises:
        FungraspError: the job or the cluster fails, or a part can't be written.
    """
    parts = job.parts()
    keys = ["" if store is None else job.key(part) for part in parts]
    found: list[Arrays | None] = [
        store.load(key) if store is not None and job.is_whole(part) else None
        for key, part in zip(keys, parts, strict=True)
    ]
    done = sum(job.size(part) for part, arrays in zip(parts, found, strict=True) if arrays is not None)
    whole = sum(map(job.size, parts)) or 1.0
    progress(done / whole)

    def finished(number: int, arrays: Arrays) -> None:
        nonlocal done
        if store is not None:
            store.save(keys[number], arrays)
        found[number] = arrays
        done += job.size(parts[number])

    def arrived(sent: tuple[int, Part], arrays: Arrays) -> None:
        finished(sent[0], arrays)
        progress(done / whole)

    missing = [number for number, arrays in enumerate(found) if arrays is None]
    if ray is not None:
        shared = (uuid4().hex, job.on_one_processor())
        ray.run(
            _run_part,
            [(number, parts[number]) for number in missing],
            arrived,
            shared,
        )
    else:
        waiting = iter(missing)
        for group in job.together([parts[number] for number in missing]):
            results = job.run(group, lambda more, before=done: progress((before + more) / whole))
            for arrays in results:
                finished(next(waiting), arrays)
            progress(done / whole)
    return [arrays for arrays in found if arrays is not None]


_jobs: dict[str, Job[Any]] = {}
"""The current job of this worker by key, so that its cached properties are computed once."""


def _run_part(shared: tuple[str, Job[Any]], number: int, part: Any) -> Arrays:
    key, job = shared
    if key not in _jobs:
        _jobs.clear()
        _jobs[key] = job
    return _jobs[key].run([part], lambda done: None)[0]

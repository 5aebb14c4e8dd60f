"""Independent parts of work on the processors of a Ray cluster (extra ``ray``)."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, TypeVar

from fungrasp.core.errors import FungraspError
from fungrasp.core.version import __version__

Result = TypeVar("Result")

WAITING = 2
"""Jobs sent out for each processor: one at work and one waiting. It bounds what lies in memory, however many
jobs there are."""

MOST_LOSSES = 5
"""A job whose worker or machine is lost is done again so many times; one that always ends so is at fault."""

CONNECTING = 10.0
"""Time to wait for the head of a cluster [s]."""

COUNTING = 1.0
"""Time after which the processors are counted again at the latest [s]."""

LOCAL = "local"
"""Address of a cluster of this machine alone, which is started."""


@dataclass(frozen=True)
class ClusterUse:
    """What became of a cluster's time."""

    jobs: int
    """That were done."""
    processors: float
    """At hand, on average."""
    seconds: float
    """From the first job to be sent to the last result."""
    working: float
    """Sum of the times that finished jobs took [s]."""
    processor_seconds: float
    """Sum of the processor time that they took [s]."""

    @property
    def share(self) -> float:
        """Of the processors' time, that in which jobs were done which finished."""
        return self.working / max(self.processors * self.seconds, 1e-9)

    @property
    def words(self) -> str:
        """In a line."""
        return (
            f"{self.jobs} jobs on {self.processors:.3g} processors in {self.seconds:.0f} s, of which they "
            f"worked {self.share:.0%}"
        )


class RayCluster:
    """A Ray cluster, connected to when there is something to do."""

    def __init__(self, address: str = LOCAL):
        """address: of the head of a running cluster ("auto": the one on this machine), or ``LOCAL``. A
        process that is connected already stays with its cluster."""
        self._address = address
        self.use: ClusterUse | None = None
        """How well it was used by the last ``run``; None before."""

    def run(
        self,
        work: Callable[..., Result],
        jobs: Iterable[tuple[Any, ...]],
        finished: Callable[[tuple[Any, ...], Result], None],
        shared: Any = None,
    ) -> None:
        """Do each job once on some processor.

        Work is done in the folder of this process, where a machine has it. A job whose machine goes away is
        done again on another. Jobs must not depend on each other nor on where they are done; their order is
        not kept.

        Args:
            work: a function of a module that every machine can import, called with ``shared`` and a job's
                items.
            jobs: their items, small.
            finished: called here with each job and its result, one after another.
            shared: what all jobs need; sent to each machine once.

        Raises:
            FungraspError: the package is missing, no cluster is at the address, a machine has another version
                of this one, or what ``work`` raised.
        """
        ray, begun = _connected(self._address)
        send = ray.remote(num_cpus=1, max_retries=MOST_LOSSES)(_work)
        sent, folder = ray.put(shared), Path.cwd()
        running: dict[Any, tuple[Any, ...]] = {}
        remaining = iter(jobs)
        count, working, worked, offered = 0, 0.0, 0.0, 0.0
        start = last = perf_counter()
        try:
            while True:
                # Machines come and go, so their processors are counted anew.
                processors = max(int(ray.cluster_resources().get("CPU", 1)), 1)
                for job in islice(remaining, max(WAITING * processors - len(running), 0)):
                    running[send.remote(work, __version__, folder, sent, job)] = job
                if not running:
                    seconds = last - start
                    self.use = ClusterUse(count, offered / max(seconds, 1e-9), seconds, working, worked)
                    return
                for done in ray.wait(list(running), num_returns=1, timeout=COUNTING)[0]:
                    result, took, used = _result(ray, done)
                    finished(running.pop(done), result)
                    count, working, worked = count + 1, working + took, worked + used
                now = perf_counter()
                offered, last = offered + processors * (now - last), now
        finally:
            for job in running:
                ray.cancel(job, force=True)
            if begun:
                ray.shutdown()


def _connected(address: str) -> tuple[Any, bool]:
    """Ray, and whether this process was not connected before."""
    try:
        import ray
    except ImportError as error:
        raise FungraspError('work on a cluster needs Ray: pip install "fungrasp[ray]"') from error
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
    """Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), CONNECTING).close()
    except (OSError, OverflowError) as error:
        raise FungraspError(f"no Ray cluster at '{address}': {error}") from None


def _work(
    work: Callable[..., Result], version: str, folder: Path, shared: Any, job: tuple[Any, ...]
) -> tuple[Result, float, float]:
    """Its result, and the time and the processor time that it took [s]."""
    if version != __version__:
        raise FungraspError(f"a machine of the cluster has fungrasp {__version__}, not {version}")
    # A worker begins in the folder in which its machine joined, where relative paths mean something else.
    if folder.is_dir():
        os.chdir(folder)
    start, used = perf_counter(), process_time()
    result = work(shared, *job)
    return result, perf_counter() - start, process_time() - used


def _result(ray: Any, done: Any) -> Any:
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, FungraspError):
            raise FungraspError(str(error.cause)) from None
        if isinstance(error.cause, ray.exceptions.RaySystemError):
            # The last line of a traceback from there, as where a package is missing.
            words = str(error.cause).strip().splitlines()[-1]
            raise FungraspError(f"a machine of the cluster can't begin a job: {words}") from None
        raise
    except ray.exceptions.RayError as error:
        words = str(error).strip().splitlines()[0]
        raise FungraspError(f"a job was lost {MOST_LOSSES + 1} times on the cluster: {words}") from None

"""Work that falls into parts which do not depend on each other, and how it is done."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any, Generic, Self, TypeVar
from uuid import uuid4

import numpy as np

from fungrasp.core.files import digest
from fungrasp.core.jobs.ray_cluster import RayCluster
from fungrasp.core.jobs.store import PartStore
from fungrasp.core.version import __version__

Part = TypeVar("Part")

Arrays = dict[str, np.ndarray]
"""The result of a part: what an ``.npz`` file holds."""

VERSIONS = (__version__, version("mujoco-core"))
"""Of what computes: parts of other versions are not taken for those of this one."""


def part_key(*inputs: Any) -> str:
    """The name under which a part is kept.

    Args:
        inputs: all that its result depends on but the versions of fungrasp and MuJoCo; what has a ``digest``
            of its own (a hand, an object, a grasp set) counts as that (``fungrasp.core.files.digest``).
    """
    return digest(VERSIONS, *inputs)[:32]


class Job(ABC, Generic[Part]):
    """Work in parts. A subclass is a frozen dataclass of what the work needs; what it makes of that once (a
    ``cached_property``) stays in its process when the job is sent to another one."""

    @abstractmethod
    def parts(self) -> list[Part]:
        """All parts, in the order of the results."""

    @abstractmethod
    def key(self, part: Part) -> str:
        """``part_key`` of all that the part's result depends on."""

    @abstractmethod
    def run(self, parts: Sequence[Part], progress: Callable[[float], None]) -> list[Arrays]:
        """The results of some parts. They must not depend on which parts are run together.

        Args:
            parts: a single one, or a group of ``together``.
            progress: called with how much of their size is done.
        """

    def size(self, part: Part) -> float:
        """How much work a part is."""
        return 1.0

    def together(self, missing: list[Part]) -> list[list[Part]]:
        """Groups of parts that one process runs at once, where its threads have more to share in this way."""
        return [[part] for part in missing]

    def is_whole(self, part: Part) -> bool:
        """Whether all that the part has left elsewhere (recordings) is still there."""
        return True

    def on_one_processor(self) -> Self:
        """The job as a worker of a cluster does it."""
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
    """Do the parts of a job that are not kept yet.

    Args:
        job: what to do.
        store: keeps finished parts, and knows those of an interrupted run; who calls removes it.
        ray: does the parts on a cluster; this process if None. The results are the same.
        progress: called with the share that is done, 0 to 1.

    Returns:
        The results in the order of ``job.parts()``.

    Raises:
        FungraspError: of the job, of the cluster, or a part can't be written.
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
"""The job that this worker does, by its key, so that what it makes once is made once."""


def _run_part(shared: tuple[str, Job[Any]], number: int, part: Any) -> Arrays:
    key, job = shared
    if key not in _jobs:
        _jobs.clear()
        _jobs[key] = job
    return _jobs[key].run([part], lambda done: None)[0]

"""What ``--ray`` does: the parts of a command's work on a cluster, kept where the command then finds them.

The command itself goes on as if an earlier run had been interrupted after its last part, so that its result
is that of one process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import progress_bar
from fungrasp.errors import FungraspError
from fungrasp.jobs.ray_cluster import LOCAL, ClusterUse, RayCluster

if TYPE_CHECKING:
    from fungrasp.cli.train import Train

Names = tuple[str, str]


def on_cluster(words: tuple[str, ...] | None) -> RayCluster | None:
    """The cluster that ``--ray`` means; None where it is not given.

    Args:
        words: what follows it.

    Raises:
        FungraspError: more than one address.
    """
    return None if words is None else RayCluster(cluster_address(words))


def print_use(cluster: RayCluster | None) -> None:
    """Say how well a cluster was used, if there was one."""
    if cluster is not None and cluster.use is not None:
        print(f"on the cluster: {cluster.use.words}")


def cluster_address(words: tuple[str, ...]) -> str:
    """What follows ``--ray``.

    Raises:
        FungraspError: more than one address.
    """
    if len(words) > 1:
        raise FungraspError(f"--ray takes one address, not {len(words)}")
    return words[0] if words else LOCAL


def _spread(
    work: Callable[..., Any],
    jobs: Sequence[tuple[Any, ...]],
    keep: Callable[[Any, Any], None],
    size: Callable[[Any], int],
    words: tuple[str, ...],
    shared: Any = None,
) -> ClusterUse:
    """``RayCluster.run`` with a progress bar, and words about it at the end. size: of a job."""
    done = 0
    with progress_bar("on the cluster", sum(map(size, jobs))) as show:

        def finished(job: tuple[Any, ...], result: Any) -> None:
            nonlocal done
            keep(job, result)
            done += size(job)
            show(done)

        cluster = RayCluster(cluster_address(words))
        cluster.run(work, jobs, finished, shared)
    assert cluster.use is not None
    print(f"on the cluster: {cluster.use.words}")
    return cluster.use


# ---------------------------------------------------------------- train


def train_on_cluster(commands: Sequence[Train], words: tuple[str, ...]) -> None:
    """Run trainings, each on one processor in its own folder, which every machine must be able to write to.
    One whose machine is lost goes on from its checkpoint on another.

    Args:
        commands: what to run.
        words: what follows ``--ray``.

    Raises:
        FungraspError: as ``RayCluster.run``.
    """
    jobs = [(replace(command, threads=1),) for command in commands]
    _spread(_train, jobs, lambda job, result: None, lambda job: 1, words)


def _train(shared: None, command: Train) -> None:
    command.run()

"""What several commands make of the same option."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.jobs import RayCluster


def on_cluster(words: tuple[str, ...] | None) -> RayCluster | None:
    """The cluster that ``--ray`` means; None where it is not given.

    Args:
        words: what follows it.

    Raises:
        FungraspError: more than one address.
    """
    from fungrasp.jobs import RayCluster

    if words is None:
        return None
    if len(words) > 1:
        raise FungraspError(f"--ray takes one address, not {len(words)}")
    return RayCluster(*words)


def print_use(cluster: RayCluster | None) -> None:
    """Say how well a cluster was used, if there was one."""
    if cluster is not None and cluster.use is not None:
        print(f"on the cluster: {cluster.use.words}")

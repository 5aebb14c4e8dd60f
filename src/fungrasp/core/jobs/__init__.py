"""Long work in independent parts: done here or on a Ray cluster, kept as they are finished, resumed after an
interruption."""

from fungrasp.core.jobs.job import Arrays, Job, part_key, run_job
from fungrasp.core.jobs.ray_cluster import ClusterUse, RayCluster
from fungrasp.core.jobs.store import PartStore

__all__ = ["Arrays", "ClusterUse", "Job", "PartStore", "RayCluster", "part_key", "run_job"]

"""Recorded episodes in other physics engines."""

from benchmarks.engines.audit.bundle import EpisodeBundle, load_bundle, make_bundle
from benchmarks.engines.audit.other_engines import AuditResult, EngineName, audit, load_bundles
from benchmarks.engines.audit.replay import Replayed

__all__ = [
    "AuditResult",
    "EngineName",
    "EpisodeBundle",
    "Replayed",
    "audit",
    "load_bundle",
    "load_bundles",
    "make_bundle",
]

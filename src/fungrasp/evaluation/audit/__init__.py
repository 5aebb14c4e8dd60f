"""Recorded episodes in other physics engines."""

from fungrasp.evaluation.audit.bundle import EpisodeBundle, load_bundle, make_bundle
from fungrasp.evaluation.audit.other_engines import AuditResult, EngineName, audit, load_bundles
from fungrasp.evaluation.audit.replay import Replayed

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
